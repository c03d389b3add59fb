"""The states of a task of any size that have been looked at, with the choices in them.

Whatever looks at a large task step by step keeps here what it has seen: people who are at work, and the expansion of
the likeliest states. The memory grows with the number of states. Misconceptions need none (`people.misconception`).
"""

from __future__ import annotations

import threading
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo, Transitions

from ..people.choices import Choices
from ..people.decision import Bools, Ints
from ..people.goals import Goals, costs_to_go, each_of, first_of, goals_reached, optimal_for_each
from ..people.slots import padded
from ..people.state_keys import keys_of

NONE = np.empty(0, dtype=np.int64)


class Part(NamedTuple):
    """Some states of a task, of which some have their choices.

    Attributes
    ----------
    each : list of Choices
        The choices of each goal; states of the frontier have none.
    states : int array, shape (n,)
        Number of each state in the task.
    frontier : int array
        Indices of the states without choices.
    rows : Transitions
        The transitions from the n states, to indices.
    """

    each: list[Choices]
    states: Ints
    frontier: Ints
    rows: Transitions


class StateCache:
    """The known data of all states that were looked at. All methods are thread-safe.

    A state has a *number* in the task, and an *index* here, in the order in which states were first seen.

    Parameters
    ----------
    known : CostToGo or Goals
        Cost-to-go of the task, as a table or by on-demand queries, or of each of G goals; G is 1 if the goal is known.
    """

    def __init__(self, known: CostToGo | Goals) -> None:
        self.known, self._first_goal = known, first_of(known)
        self._index: dict[int, int] = {}
        self._states = _Rows(np.int64)
        goals = len(each_of(known))
        self.h, self.goal = _Rows(np.float64, goals), _Rows(np.bool_, goals)
        self._key = _Rows(np.uint64)
        # Offset of each state's choices in the lists of choices, and their number; -1: not expanded.
        self._first, self._count = _Rows(np.int64), _Rows(np.int64)
        self._actions, self._targets, self._optimal = _Rows(np.int32), _Rows(np.int64), _Rows(np.bool_, goals)
        self._lock = threading.RLock()

    def __len__(self) -> int:
        return len(self._states)

    def around(self, states: Ints, then: Ints, *, ahead: bool, advice_is_optimal: bool) -> Part:
        """Return states and their successors; arguments as in `TruncatedTask.around`.

        No choice leads to the first N states; where one of them is a successor, it is there once more.
        """
        with self._lock:
            here = self.expand(self.add(states))
            advised = [self.add(then)]
            if ahead:
                _, at = self._at(here)
                advised.append(self._targets[at[self._optimal[at].any(axis=1)] if advice_is_optimal else at])
            after = self.expand(np.unique(np.concatenate(advised)))
            expanded = np.concatenate([here, after])
            rest = np.setdiff1d(self._targets[self._at(expanded)[1]], after)
            index = np.concatenate([expanded, rest])
            return self._part(index, np.arange(len(index)) < len(expanded), len(here))

    def every(self) -> Part:
        """Return all states in the order of their indices."""
        index = np.arange(len(self))
        return self._part(index, self.is_expanded(index))

    def add(self, states: Ints) -> Ints:
        """Return the indices of states, shape (N,); states that were not seen before are added."""
        wanted, again = np.unique(states, return_inverse=True)
        with self._lock:
            if any(number not in self._index for number in wanted.tolist()):
                each = dict.fromkeys(np.asarray(states).tolist())
                new = np.array([number for number in each if number not in self._index], dtype=np.int64)
                h = costs_to_go(self.known, new)  # a query may fail; nothing has been stored yet
                self._index |= zip(new.tolist(), range(len(self), len(self) + len(new)), strict=True)
                self._states.add(new)
                self.h.add(h)
                self.goal.add(goals_reached(self.known, new))
                self._key.add(keys_of(self._first_goal, new))
                self._first.add(np.zeros(len(new), dtype=np.int64))
                self._count.add(np.full(len(new), -1))
            index = np.array([self._index[number] for number in wanted.tolist()], dtype=np.int64)
        return index[again.reshape(-1)]

    def states(self, index: Ints) -> Ints:
        """Return the numbers of states in the task, shape (N,)."""
        return self._states[index]

    def is_expanded(self, index: Ints) -> Bools:
        """Return whether the choices in states are known, shape (N,)."""
        return np.asarray(self._count[index] >= 0)

    def expand(self, index: Ints) -> Ints:
        """Find the choices in those states in which they are not known yet, in this order, and return the indices."""
        with self._lock:
            unknown = index[self._count[index] < 0]
            if len(unknown):
                unknown = np.array(list(dict.fromkeys(unknown.tolist())))
                states = self._states[unknown]
                found = self._first_goal.choices(states)
                targets = np.asarray(found.targets, dtype=np.int64)
                found = Transitions(np.asarray(found.offsets, dtype=np.int64), found.actions, targets)
                to = self.add(targets)
                optimal = optimal_for_each(self.known, states, found)
                self._first[unknown] = len(self._actions) + found.offsets[:-1]
                self._count[unknown] = np.diff(found.offsets)
                self._actions.add(found.actions)
                self._targets.add(to)
                self._optimal.add(optimal)
        return index

    def choices(self, index: Ints, among: Bools | bool = True) -> tuple[Ints, Ints, NDArray[np.int32], Bools]:
        """Return the m choices in some states, shape (N,), of those `among` them that are looked at: all by default.

        Returns
        -------
        offsets : int array, shape (N + 1,)
            Where the choices in each state begin.
        targets, actions : int arrays, shape (m,)
            Indices of the successors, and ground actions.
        optimal : bool array, shape (m, G)
        """
        offsets, at = self._at(index, among)
        return offsets, self._targets[at], self._actions[at], self._optimal[at]

    def _at(self, index: Ints, among: Bools | bool = True) -> tuple[Ints, Ints]:
        """Return where the choices in each state begin, as `choices` does, and where they are in the lists."""
        counts = self._count[index] if among is True else np.where(among, self._count[index], 0)
        offsets = np.concatenate([[0], np.cumsum(counts)])
        return offsets, np.arange(offsets[-1]) + np.repeat(self._first[index] - offsets[:-1], counts)

    def _part(self, index: Ints, expanded: Bools, copies: int = 0) -> Part:
        """Return states by their indices; choices are in those that are `expanded`, and lead to none of the first."""
        offsets, targets, actions, optimal = self.choices(index, expanded)
        order = np.argsort(index[copies:])
        to = copies + order[np.searchsorted(index[copies:], targets, sorter=order)]
        rows, goal, h = Transitions(offsets, actions, to), self.goal[index], self.h[index]
        each = [
            Choices(
                h[:, number], reached, *padded(self._first_goal, rows, best, expanded & ~reached),
                self._first_goal.task.actions, key=self._key[index],
            )
            for number, (reached, best) in enumerate(zip(goal.T, optimal.T, strict=True))
        ]  # fmt: skip
        return Part(each, self._states[index], np.flatnonzero(~expanded), rows)


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
