"""The choices of a person in every state of a task, as arrays.

`Choices` is the rectangular form of a cost-to-go table: row `x` has one slot for each action that is applicable in
state `x`. The rest of this package uses these arrays, and does not depend on PDDL.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from planner import AnyTask, Table, Transitions, known_costs
from planner.system.arrays import outline, read_only

from .hidden_type import KNOWN, OfGoals
from .state_keys import keys_of

T = TypeVar("T", bound=np.generic)

WAIT = -1
"""Action number of waiting, the only choice in a state without applicable actions."""

STAND_STILL = "(wait)"
"""Name of waiting."""


@dataclass(frozen=True)
class Choices:
    """The choices of every state, padded to the largest number of applicable actions `A`.

    Attributes
    ----------
    h : float array, shape (n,)
        Exact cost-to-go, infinite in dead ends.
    goal : bool array, shape (n,)
    applicable : bool array, shape (n, A)
        Whether each slot holds a choice; slots are filled from the left.
    actions : int array, shape (n, A)
        Ground action of each slot, ascending; one number for each name. `WAIT` if the person can only wait (at cost 1).
    targets : int array, shape (n, A)
        Successor of each choice; the state itself in empty slots.
    costs : float array, shape (n, A)
        Cost of the action; 0 in empty slots.
    optimal : bool array, shape (n, A)
        Whether an optimal plan can begin with the action.
    names : tuple of str
        The ground actions in PDDL notation.
    initial : int
        The state in which an episode begins.
    state : int array, shape (n,), or None
        Task state of each row, if a row is a state with the memory of the person's last action (`memory.remembered`);
        every state has a row. None if the rows are the task's states.
    terms : tuple of str, or None
        Names of the J terms in `features`.
    features : float array, shape (n, A, J), or None
        Value of each term for each choice.
    key : uint64 array, shape (n,), or None
        Key of each row's task state (`keys_of`). None if the state's number is the key.
    unknown_goal : OfGoals, or None
        The arrays of each goal, if a person pursues one of several. Then `h` is the least over the goals, `goal`
        tells whether all are reached, and `optimal` whether a choice is optimal for one that is not reached. None if
        the goal is known.
    offered : bool array, shape (n, A), or None
        Whether the robot may suggest each choice as an optimal one. None if `optimal` says so: the robot may also
        suggest what is optimal for another goal, if it does not know which one the person pursues.
    """

    h: NDArray[np.float64]
    goal: NDArray[np.bool_]
    applicable: NDArray[np.bool_]
    actions: NDArray[np.int64]
    targets: NDArray[np.int64]
    costs: NDArray[np.float64]
    optimal: NDArray[np.bool_]
    names: tuple[str, ...]
    initial: int = 0
    state: NDArray[np.int64] | None = None
    terms: tuple[str, ...] | None = None
    features: NDArray[np.float64] | None = None
    key: NDArray[np.uint64] | None = None
    unknown_goal: OfGoals | None = None
    offered: NDArray[np.bool_] | None = None

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    @classmethod
    def of(cls, table: Table | AnyTask) -> Choices:
        """Return the choices of a cost-to-go table, or of a task in any form that `planner.load` takes.

        Raises
        ------
        TypeError
            The task has no table, as it is too large.
        """
        table = table if isinstance(table, Table) else known_costs(table)
        if not isinstance(table, Table):
            raise TypeError(f"{table.task.name}: expected a task whose states have a table; this one is too large")
        space, task, rows = table.space, table.task, table.space.transitions
        return cls.arranged(
            table.h.copy(), space.goal.copy(), rows._replace(actions=task.first_of_name[rows.actions]),
            table.optimal_choices(), names=task.actions, costs=task.action_costs[rows.actions],
            initial=space.initial, key=keys_of(table, np.arange(len(table))),
        )  # fmt: skip

    @classmethod
    def arranged(
        cls,
        h: NDArray[np.float64],
        goal: NDArray[np.bool_],
        rows: Transitions,
        optimal: NDArray[np.bool_],
        *,
        names: tuple[str, ...],
        costs: NDArray[np.float64],
        known: NDArray[np.bool_] | None = None,
        initial: int = 0,
        key: NDArray[np.uint64] | None = None,
    ) -> Choices:
        """Return choices from compressed rows, with waiting as the only choice where no action is applicable.

        Parameters
        ----------
        h, goal : float and bool arrays, shape (n,)
        rows : Transitions
            The m choices of all n states.
        optimal : bool array, shape (m,)
        names : tuple of str
            The ground actions.
        costs : float array, shape (m,)
            Cost of each choice, in the file's unit.
        known : bool array, shape (n,), optional
            Whether the choices of each state are known; other states have empty rows.
        initial : int
        key : uint64 array, shape (n,), optional
        """
        counts = np.diff(rows.offsets)
        source = np.repeat(np.arange(len(h)), counts)
        slot = np.arange(len(source)) - rows.offsets[source]
        shape = (len(h), max(1, int(counts.max(initial=0))))
        applicable = np.zeros(shape, dtype=bool)
        actions = np.full(shape, WAIT, dtype=np.int64)
        targets = np.repeat(np.arange(len(h))[:, None], shape[1], axis=1)
        each = np.zeros(shape)
        best = np.zeros(shape, dtype=bool)
        applicable[source, slot] = True
        actions[source, slot] = rows.actions
        targets[source, slot] = rows.targets
        each[source, slot] = costs
        best[source, slot] = optimal
        stuck = (counts == 0) & ~goal & (True if known is None else known)
        applicable[stuck, 0] = True
        each[stuck, 0] = 1.0
        return cls(h, goal, applicable, actions, targets, each, best, names, initial, key=key)

    def __len__(self) -> int:
        return len(self.h)

    @property
    def goals(self) -> OfGoals:
        """What differs between goals, as arrays with an axis of G goals; G is 1 if the goal is known."""
        if self.unknown_goal is not None:
            return self.unknown_goal
        return OfGoals({KNOWN: 1.0}, self.h[None], self.goal[None], self.optimal[:, :, None])

    def of_goal(self, goal: int) -> Choices:
        """Return the choices of a person of whom one goal, given by its number, is known."""
        if self.unknown_goal is None:
            return self
        own = self.unknown_goal
        return replace(
            self, h=own.h[goal], goal=own.goal[goal], optimal=np.ascontiguousarray(own.optimal[:, :, goal]),
            unknown_goal=None,
        )  # fmt: skip

    def around(self, rows: NDArray[np.int64]) -> Choices:
        """Return the choices in some rows, shape (N,), which come first; their successors follow without choices."""
        after = np.unique(self.targets[rows])
        every, count = np.concatenate([rows, after]), len(rows)
        leaf = np.arange(len(every)) >= count
        targets = np.where(leaf, np.arange(len(every)), 0)[:, None].repeat(self.targets.shape[1], axis=1)
        targets[:count] = count + np.searchsorted(after, self.targets[rows])
        goals = self.unknown_goal
        return replace(
            self, h=self.h[every], goal=self.goal[every], applicable=self.applicable[every] & ~leaf[:, None],
            actions=self.actions[every], targets=targets, costs=self.costs[every], optimal=self.optimal[every],
            state=None if self.state is None else self.state[every], key=self.keys[every],
            features=None if self.features is None else self.features[every],
            unknown_goal=None if goals is None else goals.of_rows(every),
            offered=None if self.offered is None else self.offered[every],
        )  # fmt: skip

    @property
    def of_each_goal(self) -> tuple[Choices, ...]:
        """The choices with each of the goals known."""
        return tuple(map(self.of_goal, range(len(self.goals))))

    def require_one_goal(self, what: str) -> None:
        """Raise a `ValueError` that names `what`, if a person's goal is one of several."""
        if len(self.goals) > 1:
            raise ValueError(f"{what}: expected people whose goal is known, and there are {len(self.goals)} goals")

    @property
    def unit(self) -> float:
        """The smallest positive cost of a choice, in cost units: the scale of the task's costs; 1 if all are free."""
        costs = self.costs[self.applicable]
        return float(costs[costs > 0].min(initial=np.inf)) if (costs > 0).any() else 1.0

    def plan_length(self, row: int) -> float:
        """Return the smallest number of actions of an optimal plan from a row; infinite in a dead end.

        If the choices end before a goal, the rest of the plan counts in proportion to its cost.
        """
        if np.isinf(self.h[row]):
            return math.inf
        reached, seen = np.array([row]), np.zeros(len(self), dtype=bool)
        for length in range(len(self)):
            if self.goal[reached].any():
                return length
            ends = reached[~self.optimal[reached].any(axis=1)]
            if len(ends):
                left = float(self.h[ends].min())
                done = float(self.h[row]) - left
                return length + left * (length / done if done > 0 else 1 / self.unit)
            seen[reached] = True
            following = np.unique(self.targets[reached][self.optimal[reached]])
            reached = following[~seen[following]]
        return math.inf

    @property
    def task_states(self) -> int:
        """The number of states of the task."""
        return len(self) if self.state is None else int(self.state.max(initial=-1)) + 1

    @property
    def keys(self) -> NDArray[np.uint64]:
        """The key of each row's task state, shape (n,)."""
        return self.of_task(np.arange(self.task_states, dtype=np.uint64)) if self.key is None else self.key

    def task_state(self, row: int) -> int:
        """Return the task state of a row."""
        return row if self.state is None else int(self.state[row])

    def row(self, state: int) -> int:
        """Return the row of a task state without memory, or any of its rows if there is none."""
        if self.state is None:
            return state
        return self.initial if self.state[self.initial] == state else int(np.searchsorted(self.state, state))

    def of_task(self, array: NDArray[T]) -> NDArray[T]:
        """Return the entries of an array of the task's states, shape (m, ...), arranged by row, shape (n, ...)."""
        return array if self.state is None else array[self.state]

    def name(self, state: int, slot: int) -> str:
        """Return the ground action in a slot of a state, in PDDL notation."""
        return self.action_name(int(self.actions[state, slot]))

    def action_name(self, action: int) -> str:
        """Return a ground action in PDDL notation."""
        return STAND_STILL if action == WAIT else self.names[action]
