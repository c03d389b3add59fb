"""A task as an assistant sees it: in every state, what the person can do and what it leads to.

`Choices` is the rectangular form of a cost-to-go table: row `x` has one slot for each action that is
applicable in state `x`. Everything else in this package works on these arrays and knows nothing of PDDL.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import CostToGo, Table, Transitions
from planner.system.arrays import outline, read_only

T = TypeVar("T", bound=np.generic)

WAIT = -1
"""The action number of standing still, the only choice in a state without applicable actions."""

STAND_STILL = "(wait)"
"""What it is called."""


BLOCK = 1 << 16
"""States whose values are unpacked at a time."""


def mix(numbers: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Mix the bits of numbers, shape (...): each of a result depends on all of a number's (splitmix64's finaliser)."""
    z = numbers + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(z ^ (z >> np.uint64(31)))


def keys_of(known: CostToGo, states: ArrayLike) -> NDArray[np.uint64]:
    """Give a key of states, shape (N,): a hash of their variables' values, however they are numbered.

    Parameters
    ----------
    known : CostToGo
        Of their task, as a table or on demand: the keys are the same.
    states : int array, shape (N,)
    """
    numbers = np.asarray(states, dtype=np.int64).reshape(-1)
    keys = np.zeros(len(numbers), dtype=np.uint64)
    for begin in range(0, len(numbers), BLOCK):
        block = slice(begin, begin + BLOCK)
        for value in known.values(numbers[block]).T:
            keys[block] = mix(keys[block] ^ value.astype(np.uint64))
    return keys


def require_goal(cost: float) -> None:
    """Refuse a task by the cost-to-go of its initial state.

    Raises
    ------
    ValueError
        The goal cannot be reached.
    """
    if not np.isfinite(cost):
        raise ValueError("the goal cannot be reached from the initial state, so there is nobody to assist")


@dataclass(frozen=True)
class Choices:
    """The choices of every state, padded to the largest number of applicable actions `A`.

    Attributes
    ----------
    h : float array, shape (n,)
        Exact cost-to-go, infinite at dead ends.
    goal : bool array, shape (n,)
    applicable : bool array, shape (n, A)
        Which slots hold a choice; they are filled from the left.
    actions : int array, shape (n, A)
        Ground action of each slot; `WAIT` where the person can only stand still (at cost 1).
    targets : int array, shape (n, A)
        The state after the action; the state itself in empty slots.
    costs : float array, shape (n, A)
        Cost of the action; 0 in empty slots.
    optimal : bool array, shape (n, A)
        Whether a cheapest way to the goal can begin with the action.
    names : tuple of str
        The ground actions in PDDL.
    initial : int
        The state in which an episode begins.
    state : int array, shape (n,), or None
        The task's state of each row, where a row is a state with what the person did before they came there
        (`memory.remembered`); every state has a row. None: the rows are the task's states.
    terms : tuple of str, or None
        The names of J terms, if any are worked out.
    features : float array, shape (n, A, J), or None
        What each of them says of each choice.
    key : uint64 array, shape (n,), or None
        What tells the task's state of each row from others (`keys_of`). None: its number does.
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

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    @classmethod
    def of(cls, table: Table) -> Choices:
        """Arrange the choices of a cost-to-go table."""
        space = table.space
        return cls.arranged(
            table.h.copy(), space.goal.copy(), space.transitions, table.optimal_choices(),
            names=table.task.actions, prices=table.task.costs, initial=space.initial,
            key=keys_of(table, np.arange(len(table))),
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
        prices: Sequence[int],
        known: NDArray[np.bool_] | None = None,
        initial: int = 0,
        key: NDArray[np.uint64] | None = None,
    ) -> Choices:
        """Arrange compressed rows of choices, with standing still where nothing else can be done.

        Parameters
        ----------
        h, goal : float and bool arrays, shape (n,)
        rows : Transitions
            The choices of all n states, m in all.
        optimal : bool array, shape (m,)
        names : tuple of str
            The ground actions.
        prices : sequence of int
            What each of them costs.
        known : bool array, shape (n,), optional
            Of which states the choices are known; the others have empty rows.
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
        costs = np.zeros(shape)
        best = np.zeros(shape, dtype=bool)
        applicable[source, slot] = True
        actions[source, slot] = rows.actions
        targets[source, slot] = rows.targets
        costs[source, slot] = np.asarray(prices, dtype=np.float64)[rows.actions]
        best[source, slot] = optimal
        stuck = (counts == 0) & ~goal & (True if known is None else known)
        applicable[stuck, 0] = True
        costs[stuck, 0] = 1.0
        return cls(h, goal, applicable, actions, targets, costs, best, names, initial, key=key)

    def __len__(self) -> int:
        return len(self.h)

    @property
    def unit(self) -> float:
        """The smallest positive cost of a choice, in cost units: the scale of the task's costs; 1 if all are free."""
        costs = self.costs[self.applicable]
        return float(costs[costs > 0].min(initial=np.inf)) if (costs > 0).any() else 1.0

    @property
    def task_states(self) -> int:
        """How many states the task has."""
        return len(self) if self.state is None else int(self.state.max(initial=-1)) + 1

    @property
    def keys(self) -> NDArray[np.uint64]:
        """What tells the task's state of each row from others, shape (n,)."""
        return self.of_task(np.arange(self.task_states, dtype=np.uint64)) if self.key is None else self.key

    def task_state(self, row: int) -> int:
        """Give the task's state of a row."""
        return row if self.state is None else int(self.state[row])

    def row(self, state: int) -> int:
        """Give the row of a state of the task as if nothing had come before it, or else any row of it."""
        if self.state is None:
            return state
        return self.initial if self.state[self.initial] == state else int(np.searchsorted(self.state, state))

    def of_task(self, array: NDArray[T]) -> NDArray[T]:
        """Give what is known of each of the task's states, shape (m, ...), for each row, shape (n, ...)."""
        return array if self.state is None else array[self.state]

    def name(self, state: int, slot: int) -> str:
        """Give the ground action in a slot of a state, in PDDL."""
        action = int(self.actions[state, slot])
        return STAND_STILL if action == WAIT else self.names[action]
