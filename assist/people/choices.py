"""The choices of a person in every state of a task, as arrays.

`Choices` is the rectangular form of a cost-to-go table: row `x` has one slot for each action that is applicable in
state `x`. The rest of this package uses these arrays, and does not depend on PDDL.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from planner import AnyTask, Table, known_costs
from planner.system.arrays import outline, read_only

from .hidden_type import KNOWN, Bools, Floats, Ints, OfGoals
from .slots import WAIT as WAIT
from .slots import padded
from .state_keys import keys_of

T = TypeVar("T", bound=np.generic)

OF_ROWS = (
    "h", "goal", "applicable", "actions", "targets", "costs", "optimal", "state", "features", "key", "offered",
)  # fmt: skip
"""The attributes of `Choices` with an entry for each row, apart from those of each goal."""

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
        the goal is known: whoever reads `goals` has one or several in the same form.
    offered : bool array, shape (n, A), or None
        Whether the robot may suggest each choice as an optimal one. None if `optimal` says so: the robot may also
        suggest what is optimal for another goal, if it does not know which one the person pursues.
    """

    h: Floats
    goal: Bools
    applicable: Bools
    actions: Ints
    targets: Ints
    costs: Floats
    optimal: Bools
    names: tuple[str, ...]
    initial: int = 0
    state: Ints | None = None
    terms: tuple[str, ...] | None = None
    features: Floats | None = None
    key: NDArray[np.uint64] | None = None
    unknown_goal: OfGoals | None = None
    offered: Bools | None = None

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
        space, task, key = table.space, table.task, keys_of(table, np.arange(len(table)))
        slots = padded(table, space.transitions, table.optimal_choices(), ~space.goal)
        return cls(table.h.copy(), space.goal.copy(), *slots, task.actions, space.initial, key=key)

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

    @property
    def of_each_goal(self) -> tuple[Choices, ...]:
        """The choices with each of the goals known."""
        return tuple(map(self.of_goal, range(len(self.goals))))

    def require_one_goal(self, what: str) -> None:
        """Raise a `ValueError` that names `what`, if a person's goal is one of several."""
        if self.goals.distinguished:
            raise ValueError(f"{what}: expected people whose goal is known, and there are {len(self.goals)} goals")

    def of_rows(self, rows: Ints, **changed: Any) -> Choices:
        """Return the choices in some rows, shape (m,), with other attributes where they are given.

        Numbers of successors stay as they are. Where rows have other numbers then, `targets` are among what is given.
        """
        every: dict[str, Any] = {name: getattr(self, name) for name in OF_ROWS if name not in changed}
        own = {name: array[rows] for name, array in every.items() if array is not None}
        goals = None if self.unknown_goal is None else self.unknown_goal.of_rows(rows)
        return replace(self, **own, unknown_goal=goals, **changed)

    def with_goals(self, h: Floats, goal: Bools, for_each: Bools, **changed: Any) -> Choices:
        """Return the choices with other arrays of each goal, as in `OfGoals`, and other attributes."""
        own = None if self.unknown_goal is None else replace(self.unknown_goal, h=h, goal=goal, optimal=for_each)
        return replace(self, h=h.min(axis=0), goal=np.asarray(goal.all(axis=0)), unknown_goal=own, **changed)

    @property
    def unit(self) -> float:
        """The smallest positive cost of a choice, in cost units: the scale of the task's costs; 1 if all are free."""
        costs = self.costs[self.applicable]
        return float(costs[costs > 0].min(initial=np.inf)) if (costs > 0).any() else 1.0

    @property
    def task_states(self) -> int:
        """The number of states of the task."""
        return len(self) if self.state is None else int(self.state.max(initial=-1)) + 1

    @property
    def keys(self) -> NDArray[np.uint64]:
        """The key of each row's task state, shape (n,)."""
        return self.of_task(np.arange(self.task_states, dtype=np.uint64)) if self.key is None else self.key

    def of_task(self, array: NDArray[T]) -> NDArray[T]:
        """Return the entries of an array of the task's states, shape (m, ...), arranged by row, shape (n, ...)."""
        return array if self.state is None else array[self.state]

    def name(self, state: int, slot: int) -> str:
        """Return the ground action in a slot of a state, in PDDL notation."""
        return self.action_name(int(self.actions[state, slot]))

    def action_name(self, action: int) -> str:
        """Return a ground action in PDDL notation."""
        return STAND_STILL if action == WAIT else self.names[action]
