"""Rows: where people are in a task of any size, and arrays with an entry for each.

A *situation* says where a person is in the task: a state or, with terms, a pair of a state and a memory. A *row* is the
number under which the arrays of a person's problem have this situation. A whole task has all rows from the start, and
rows and situations are the same. In a larger one, a situation gets a row when somebody comes there, and the situations
to which its choices lead get one as well. `Rows.situation_of` alone knows which is which.

Rows take memory. Where they are too many, those that nobody holds are evicted, and their numbers are used again. A
*holder* is whatever keeps numbers of rows: a chunk of episodes, a person in a live team, a decision. It says which ones
when it asks for them (`Rows.hold`), and holds them until it says others or no longer exists.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Ints

NONE = np.empty(0, dtype=np.int64)
OWN = "own"
"""The entry of a row without data where an array holds numbers of rows: its own number."""

Blank = Any
"""The entry of a row without data, and in padding: a number, or `OWN`."""


class Rows:
    """Arrays of rows that are added and evicted. The axes after the first grow with what is put.

    Parameters
    ----------
    blanks : mapping of str to number or `OWN`
        For each array its entry in rows without data.

    Attributes
    ----------
    version : int
        How often rows or arrays have been replaced, so that views of the arrays may be out of date.
    """

    def __init__(self, blanks: Mapping[str, Blank]) -> None:
        self._blanks, self._arrays = dict(blanks), dict[str, NDArray[Any]]()
        self._capacity, self._size, self._free = 0, 0, NONE
        self._situation_of, self._born = NONE, NONE
        self._situations, self._rows = NONE, NONE  # ascending situations, and the row of each
        self._held: WeakKeyDictionary[object, Ints] = WeakKeyDictionary()
        self.version = 0

    def __len__(self) -> int:
        """Return the number of rows, evicted ones included."""
        return self._size

    def __contains__(self, name: str) -> bool:
        """Return whether there is an array of this name."""
        return name in self._arrays

    def declare(self, blanks: Mapping[str, Blank]) -> None:
        """Add arrays, given by their blank entries as in `Rows`."""
        self._blanks |= blanks

    def forget(self, names: Iterable[str]) -> None:
        """Take the arrays of these names."""
        for name in names:
            self._blanks.pop(name)
            self._arrays.pop(name, None)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a view of an array, shape (n, ...)."""
        return self._arrays[name][: self._size]

    @property
    def used(self) -> int:
        """The number of rows that have a situation."""
        return len(self._situations)

    @property
    def situation_of(self) -> Ints:
        """The situation of each row, shape (n,); -1 for a row that was evicted."""
        return self._situation_of[: self._size]

    @property
    def born(self) -> Ints:
        """How many rows had been added when each was, shape (n,): another number for each situation of a row."""
        return self._born[: self._size]

    def find(self, situations: Ints) -> Ints:
        """Return the row of each situation, shape (N,); -1 for a situation without one."""
        if not len(self._situations):
            return np.full(len(situations), -1)
        at = np.minimum(np.searchsorted(self._situations, situations), len(self._situations) - 1)
        return np.where(self._situations[at] == situations, self._rows[at], -1)

    def add(self, situations: Ints) -> Ints:
        """Give rows to different situations without one, both of shape (N,); their entries are blank."""
        count = len(situations)
        again, more = self._free[:count], max(0, count - len(self._free))
        self._free = self._free[count:]
        rows = np.concatenate([again, np.arange(self._size, self._size + more)])
        self._reserve(self._size + more)
        self._size += more
        self._situation_of[rows] = situations
        self._born[rows] = self._born.max(initial=0) + 1 + np.arange(count)
        order = np.argsort(situations)
        at = np.searchsorted(self._situations, situations[order])
        self._situations = np.insert(self._situations, at, situations[order])
        self._rows = np.insert(self._rows, at, rows[order])
        self.version += 1
        return rows

    def put(self, name: str, rows: Ints, values: NDArray[Any]) -> None:
        """Set entries of an array, which becomes wider if these are."""
        array, blank = self._arrays.get(name, values[:0]), self._blanks[name]
        shape = tuple(map(max, array.shape[1:], values.shape[1:]))
        if len(array) < self._capacity or shape != array.shape[1:]:
            array = self._arrays[name] = _larger(array, (self._capacity, *shape), blank)
            self.version += 1
        array[rows] = values if values.shape[1:] == shape else _larger(values, (len(rows), *shape), blank, rows)

    def clear(self, names: Iterable[str], rows: Ints) -> None:
        """Make the entries of some rows blank in the arrays of these names."""
        for name in names:
            if name in self._arrays:
                self._arrays[name][rows] = _blank(self._blanks[name], rows, self._arrays[name].ndim)
        self.version += 1

    def hold(self, holder: object, rows: Ints) -> None:
        """Let a holder hold these rows in place of those that it held before."""
        self._held[holder] = rows

    def held(self, other_than: object = None) -> Ints:
        """Return the rows that are held by any holder but one."""
        return np.unique(np.concatenate([NONE, *(own for one, own in self._held.items() if one is not other_than)]))

    def evict(self, keep: Ints) -> None:
        """Take the rows of all situations but those of `keep`, shape (N,); their entries become blank."""
        gone = np.setdiff1d(self._rows, keep)
        stays = np.isin(self._rows, keep)
        self._situations, self._rows = self._situations[stays], self._rows[stays]
        self._situation_of[gone] = -1
        self.clear(self._blanks, gone)
        self._free = np.concatenate([self._free, gone])

    def _reserve(self, size: int) -> None:
        """Make room for a number of rows."""
        if size <= self._capacity:
            return
        self._capacity = max(size, 64, 2 * self._capacity)
        for name, array in self._arrays.items():
            self._arrays[name] = _larger(array, (self._capacity, *array.shape[1:]), self._blanks[name])
        self._situation_of = _larger(self._situation_of, (self._capacity,), -1)
        self._born = _larger(self._born, (self._capacity,), 0)


def _blank(blank: Blank, rows: Ints, dimensions: int) -> Any:
    """Return the blank entries of some rows, in a form that is broadcast to those of an array."""
    return rows.reshape(-1, *(1 for _ in range(dimensions - 1))) if isinstance(blank, str) else blank


def _larger(array: NDArray[Any], shape: tuple[int, ...], blank: Blank, rows: Ints | None = None) -> NDArray[Any]:
    """Return a larger copy of an array; further entries are blank.

    The entries of its first axis are those of `rows`, by default all in their order.
    """
    found = np.empty(shape, dtype=array.dtype)
    found[...] = _blank(blank, np.arange(shape[0]) if rows is None else rows, len(shape))
    found[tuple(slice(length) for length in array.shape)] = array
    return found
