"""A cache of visited states of a task of any size, with the choices in them.

The next step of some people needs little data: the choices in their states, and in the states to which suggestions may
lead, as the trust update looks at these. `StateCache.around` returns these data as a `TruncatedTask` whose frontier
follows after one step. The cache keeps all expanded states, so that its memory grows with the number of visited states.
Misconceptions need no memory (`people.misconception`).
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo, Transitions

from ..people.choices import WAIT, Choices
from ..people.goals import Goals, costs_to_go, each_of, first_of, goals_reached, optimal_for_each
from ..people.state_keys import keys_of
from .truncated_task import TruncatedTask

Ints = NDArray[np.int64]

NONE = np.empty(0, dtype=np.int64)


class StateCache:
    """The known data of all visited states. All methods are thread-safe.

    Parameters
    ----------
    known : CostToGo or Goals
        Cost-to-go of the task, as a table or by on-demand queries, or of each of G goals; G is 1 if the goal is known.
    """

    def __init__(self, known: CostToGo | Goals) -> None:
        self.known, self._first_goal = known, first_of(known)
        self._prices = np.append(self._first_goal.task.action_costs, 1.0)  # a wait costs 1
        self._row: dict[int, int] = {}
        self._states = _Rows(np.int64)
        goals = len(each_of(known))
        self._h, self._goal = _Rows(np.float64, goals), _Rows(np.bool_, goals)
        self._key = _Rows(np.uint64)
        # Offset of each state's choices in the lists of choices, and their number; -1: not expanded.
        self._first, self._count = _Rows(np.int64), _Rows(np.int64)
        self._actions, self._targets, self._optimal = _Rows(np.int64), _Rows(np.int64), _Rows(np.bool_, goals)
        self._lock = threading.RLock()

    def __len__(self) -> int:
        return len(self._states)

    def around(
        self, states: Ints, *, then: Ints = NONE, ahead: bool = False, advice_is_optimal: bool = True
    ) -> TruncatedTask:
        """Return a truncated task of the given states, with their successors as the frontier.

        Parameters
        ----------
        states : int array, shape (N,)
            Numbers of states in `known`. They are the first states, in this order, and a state may occur twice.
        then : int array, shape (M,)
            Successor states that are expanded as well, so that they are not on the frontier.
        ahead : bool
            Whether all successors after a suggestion are expanded, too.
        advice_is_optimal : bool
            Whether only optimal actions are suggested, or all.
        """
        with self._lock:
            here = self._expand(self._add(states))
            advised = [self._add(then)]
            if ahead:
                _, at = self._choices(here)
                offered = self._optimal[at].any(axis=1) if advice_is_optimal else slice(None)
                advised.append(self._targets[at][offered])
            after = self._expand(np.unique(np.concatenate(advised)))
            return self._region(here, after)

    def _add(self, states: Ints) -> Ints:
        """Return the rows of states, shape (N,); unknown states are added."""
        wanted, place = np.unique(states, return_inverse=True)
        numbers = wanted.tolist()
        unknown_states = [number for number in numbers if number not in self._row]
        if unknown_states:
            new = np.array(unknown_states, dtype=np.int64)
            h = costs_to_go(self.known, new)  # a query may fail; nothing has been stored yet
            self._row |= zip(unknown_states, range(len(self), len(self) + len(unknown_states)), strict=True)
            self._states.add(new)
            self._h.add(h)
            self._goal.add(goals_reached(self.known, new))
            self._key.add(keys_of(self._first_goal, new))
            self._first.add(np.zeros(len(new), dtype=np.int64))
            self._count.add(np.full(len(new), -1))
        rows = np.array([self._row[number] for number in numbers], dtype=np.int64)
        return rows[place.reshape(-1)]

    def _expand(self, rows: Ints) -> Ints:
        """Expand those of the rows that are not expanded yet, and return the rows."""
        unknown = np.unique(rows[self._count[rows] < 0])
        if len(unknown):
            states = self._states[unknown]
            found = self._first_goal.choices(states)
            targets = np.asarray(found.targets, dtype=np.int64)
            found = Transitions(np.asarray(found.offsets, dtype=np.int64), found.actions, targets)
            to = self._add(targets)
            optimal = optimal_for_each(self.known, states, found)
            self._first[unknown] = len(self._actions) + found.offsets[:-1]
            self._count[unknown] = np.diff(found.offsets)
            self._actions.add(np.asarray(found.actions, dtype=np.int64))
            self._targets.add(to)
            self._optimal.add(optimal)
        return rows

    def _choices(self, rows: Ints) -> tuple[Ints, Ints]:
        """Return the choices of rows: their position in `rows` and their position in the lists of choices."""
        counts = self._count[rows]
        owner = np.repeat(np.arange(len(rows)), counts)
        ends = np.cumsum(counts)
        return owner, np.arange(len(owner)) - (ends - counts)[owner] + self._first[rows][owner]

    def _region(self, here: Ints, after: Ints) -> TruncatedTask:
        """Return the truncated task of expanded states, with their other successors as the frontier.

        The first rows are those of `here`, to which no choice leads; a successor has a row of its own.
        """
        expanded = np.concatenate([here, after])
        owner, at = self._choices(expanded)
        targets = self._targets[at]
        rest = np.setdiff1d(targets, after)
        rows = np.concatenate([expanded, rest])
        others = np.concatenate([after, rest])
        order = np.argsort(others)
        to = len(here) + order[np.searchsorted(others, targets, sorter=order)]
        counts = self._count[expanded]
        shape = (len(rows), max(1, int(counts.max(initial=0))))
        slot = np.arange(len(owner)) - (np.cumsum(counts) - counts)[owner]
        goal, h, optimal = self._goal[rows], self._h[rows], self._optimal[at]
        applicable = np.zeros(shape, dtype=bool)
        actions, costs = np.full(shape, WAIT, dtype=np.int64), np.zeros(shape)
        follows = np.repeat(np.arange(len(rows))[:, None], shape[1], axis=1)
        applicable[owner, slot] = True
        actions[owner, slot] = self._first_goal.task.first_of_name[self._actions[at]]
        follows[owner, slot] = to
        costs[owner, slot] = self._prices[self._actions[at]]
        key, frontier = self._key[rows], np.arange(len(expanded), len(rows))

        def of_goal(number: int) -> Choices:
            reached, advised = goal[:, number], np.zeros(shape, dtype=bool)
            advised[owner, slot] = optimal[:, number]
            stuck = np.flatnonzero((counts == 0) & ~reached[: len(expanded)])
            waits, price = applicable.copy(), costs.copy()
            waits[stuck, 0], price[stuck, 0] = True, self._prices[WAIT]
            names = self._first_goal.task.actions
            return Choices(h[:, number], reached, waits, actions, follows, price, advised, names, key=key)

        each = [of_goal(number) for number in range(goal.shape[1])]
        return TruncatedTask.joined(self.known, each, self._states[rows], frontier)


class _Rows:
    """An array that grows at its end; `shape` is that of an entry."""

    def __init__(self, kind: Any, *shape: int) -> None:
        self._array = np.empty((1024, *shape), dtype=kind)
        self._size = 0

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, rows: Ints) -> NDArray[Any]:
        return self._array[rows]

    def __setitem__(self, rows: Ints, values: NDArray[Any]) -> None:
        self._array[rows] = values

    def add(self, values: NDArray[Any]) -> None:
        """Append values."""
        end = self._size + len(values)
        if end > len(self._array):
            shape = (max(end, 2 * len(self._array)), *self._array.shape[1:])
            longer = np.empty(shape, dtype=self._array.dtype)
            longer[: self._size] = self._array[: self._size]
            self._array = longer
        self._array[self._size : end] = values
        self._size = end
