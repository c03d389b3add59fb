"""The states of a task of any size that somebody has come to, with what can be done there: nothing else is kept.

What the next step of some people needs is little: the choices of the states in which they are, and of those to which
they may be advised to go, since that is what trust looks at. `StateCache.around` gives it as a `TruncatedTask` that
breaks off at once. What has been looked at is kept, so that memory grows with what is visited; a state's misconceptions
need no memory (`people.misconception`).
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo, Transitions, optimal_choices

from ..people.choices import WAIT, Choices, keys_of
from .truncated_task import TruncatedTask

Ints = NDArray[np.int64]

NONE = np.empty(0, dtype=np.int64)


class StateCache:
    """What is known of the states that have been met; it grows with what it is asked, by one thread at a time.

    Parameters
    ----------
    known : CostToGo
        Their task's, as a table or on demand.
    """

    def __init__(self, known: CostToGo) -> None:
        self.known = known
        self._prices = np.append(np.asarray(known.task.costs, dtype=np.float64), 1.0)  # standing still costs 1
        self._row: dict[int, int] = {}
        self._states = _Rows(np.int64)
        self._h, self._goal = _Rows(np.float64), _Rows(np.bool_)
        self._key = _Rows(np.uint64)
        # Where in the lists of choices those of a state begin, and how many they are; -1: nobody has looked.
        self._first, self._count = _Rows(np.int64), _Rows(np.int64)
        self._actions, self._targets, self._optimal = _Rows(np.int64), _Rows(np.int64), _Rows(np.bool_)
        self._lock = threading.RLock()

    def __len__(self) -> int:
        return len(self._states)

    def around(
        self, states: Ints, *, then: Ints = NONE, ahead: bool = False, advice_is_optimal: bool = True
    ) -> TruncatedTask:
        """Give some states with their choices, and what these lead to as a frontier.

        Parameters
        ----------
        states : int array, shape (N,)
            As `known` numbers them. Each gets a row, in this order, even if it is another's state, too.
        then : int array, shape (M,)
            States to which choices lead and that are not on the frontier either.
        ahead : bool
            Whether no state is on the frontier to which somebody may be advised to go, either.
        advice_is_optimal : bool
            Whether only optimal actions are advised, or all.
        """
        with self._lock:
            here = self._look(self._meet(states))
            advised = [self._meet(then)]
            if ahead:
                _, at = self._choices(here)
                advised.append(self._targets[at][self._optimal[at]] if advice_is_optimal else self._targets[at])
            after = self._look(np.unique(np.concatenate(advised)))
            return self._region(here, after)

    def _meet(self, states: Ints) -> Ints:
        """Give the rows of states, shape (N,)."""
        wanted, place = np.unique(states, return_inverse=True)
        numbers = wanted.tolist()
        fresh = [number for number in numbers if number not in self._row]
        if fresh:
            new = np.array(fresh, dtype=np.int64)
            h = self.known.lookup(new)  # it may fail, before anything has been kept
            self._row |= zip(fresh, range(len(self), len(self) + len(fresh)), strict=True)
            self._states.add(new)
            self._h.add(h)
            self._goal.add(self.known.is_goal(new))
            self._key.add(keys_of(self.known, new))
            self._first.add(np.zeros(len(new), dtype=np.int64))
            self._count.add(np.full(len(new), -1))
        rows = np.array([self._row[number] for number in numbers], dtype=np.int64)
        return rows[place.reshape(-1)]

    def _look(self, rows: Ints) -> Ints:
        """See to it that the choices of rows are known, and give the rows."""
        unknown = np.unique(rows[self._count[rows] < 0])
        if len(unknown):
            states = self._states[unknown]
            found = self.known.choices(states)
            targets = np.asarray(found.targets, dtype=np.int64)
            found = Transitions(np.asarray(found.offsets, dtype=np.int64), found.actions, targets)
            to = self._meet(targets)
            optimal = optimal_choices(self.known, states, found)
            self._first[unknown] = len(self._actions) + found.offsets[:-1]
            self._count[unknown] = np.diff(found.offsets)
            self._actions.add(np.asarray(found.actions, dtype=np.int64))
            self._targets.add(to)
            self._optimal.add(optimal)
        return rows

    def _choices(self, rows: Ints) -> tuple[Ints, Ints]:
        """Give the places of the choices of rows: whose they are, as a place in `rows`, and where in the lists."""
        counts = self._count[rows]
        whose = np.repeat(np.arange(len(rows)), counts)
        ends = np.cumsum(counts)
        return whose, np.arange(len(whose)) - (ends - counts)[whose] + self._first[rows][whose]

    def _region(self, here: Ints, after: Ints) -> TruncatedTask:
        """Arrange rows that have been looked at; those `here` are nobody's targets."""
        looked = np.concatenate([here, after])
        whose, at = self._choices(looked)
        targets = self._targets[at]
        rest = np.setdiff1d(targets, after)
        rows = np.concatenate([looked, rest])
        others = np.concatenate([after, rest])
        order = np.argsort(others)
        to = len(here) + order[np.searchsorted(others, targets, sorter=order)]
        counts = self._count[looked]
        shape = (len(rows), max(1, int(counts.max(initial=0))))
        slot = np.arange(len(whose)) - (np.cumsum(counts) - counts)[whose]
        goal = self._goal[rows]
        applicable, optimal = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
        actions, costs = np.full(shape, WAIT, dtype=np.int64), np.zeros(shape)
        follows = np.repeat(np.arange(len(rows))[:, None], shape[1], axis=1)
        applicable[whose, slot] = True
        actions[whose, slot] = self._actions[at]
        follows[whose, slot] = to
        costs[whose, slot] = self._prices[self._actions[at]]
        optimal[whose, slot] = self._optimal[at]
        stuck = np.flatnonzero((counts == 0) & ~goal[: len(looked)])
        applicable[stuck, 0], costs[stuck, 0] = True, self._prices[WAIT]
        choices = Choices(
            self._h[rows], goal, applicable, actions, follows, costs, optimal, self.known.task.actions,
            key=self._key[rows],
        )  # fmt: skip
        frontier = np.arange(len(looked), len(rows))
        return TruncatedTask(self.known, choices, self._states[rows], frontier[~goal[frontier]])


class _Rows:
    """An array that grows at its end."""

    def __init__(self, kind: Any) -> None:
        self._array = np.empty(1024, dtype=kind)
        self._size = 0

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, rows: Ints) -> NDArray[Any]:
        return self._array[rows]

    def __setitem__(self, rows: Ints, values: NDArray[Any]) -> None:
        self._array[rows] = values

    def add(self, values: NDArray[Any]) -> None:
        """Put values at the end."""
        end = self._size + len(values)
        if end > len(self._array):
            longer = np.empty(max(end, 2 * len(self._array)), dtype=self._array.dtype)
            longer[: self._size] = self._array[: self._size]
            self._array = longer
        self._array[self._size : end] = values
        self._size = end
