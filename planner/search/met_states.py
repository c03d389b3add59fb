"""States numbered in the order in which they are met, in a hash table."""

from __future__ import annotations

import copy
import threading
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..system.arrays import Ints, Words
from ..system.limits import LimitError
from .kernels import state_sets

FEW = 1 << 13
"""States that a dictionary numbers, if few are expected. More take less time and memory in the compiled hash table."""

MOST = np.iinfo(np.int32).max
"""Largest number of states in a registry (32-bit numbers)."""


class GrowingArray:
    """An array to which rows are appended. It grows by a third, in place where the system can do so.

    A view of earlier rows that is still in use keeps its contents; the array then continues as a copy.
    """

    def __init__(self, dtype: Any, *width: int) -> None:
        self.rows = np.zeros((1 << 12, *width), dtype=dtype)

    def make_room(self, rows: int) -> None:
        """Ensure that the array has at least `rows` rows."""
        if rows > len(self.rows):
            self._resize(max(rows, len(self.rows) * 4 // 3))

    def append(self, rows: int, more: NDArray[Any]) -> None:
        """Write rows after the first `rows` rows."""
        self.make_room(rows + len(more))
        self.rows[rows : rows + len(more)] = more

    def trimmed(self, rows: int) -> NDArray[Any]:
        """Return the array with its first `rows` rows only; the memory of the others is released."""
        self._resize(rows)
        return self.rows

    def _resize(self, rows: int) -> None:
        shape = (rows, *self.rows.shape[1:])
        try:
            self.rows.resize(shape)  # in place; numpy refuses this if the array is referenced elsewhere
        except ValueError:
            held, self.rows = self.rows, np.zeros(shape, dtype=self.rows.dtype)
            kept = min(rows, len(held))
            self.rows[:kept] = held[:kept]


class StateRegistry:
    """A thread-safe registry that numbers packed states, of so many words, in the order of their first occurrence.

    With `few`, the first states are numbered by a dictionary, which needs no compiled code.
    """

    def __init__(self, words: int, *, few: bool = False) -> None:
        self._states = GrowingArray(np.uint64, words)
        self.slots = np.zeros(1 << 14, dtype=np.uint64)
        self._held = 0
        self._few: dict[bytes, int] | None = {} if few else None
        self._lock = threading.Lock()

    def _numbers_of_few(self, states: Words, few: dict[bytes, int]) -> NDArray[np.int32]:
        """Return what `numbers` does, by a dictionary."""
        begin = len(few)
        numbers = np.array([few.setdefault(row.tobytes(), len(few)) for row in states], dtype=np.int32)
        new, first = np.unique(numbers, return_index=True)
        self._states.append(begin, states[first[new >= begin]])
        self._held = len(few)
        return numbers

    def __getstate__(self) -> dict[str, Any]:
        with self._lock:  # a consistent copy, which later insertions do not change
            own = {**vars(self), "_states": copy.deepcopy(self._states), "slots": self.slots.copy()}
            own["_few"] = copy.copy(self._few)
        return {name: value for name, value in own.items() if name != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _lock=threading.Lock())

    def __len__(self) -> int:
        return self._held

    def numbers(self, states: Words) -> NDArray[np.int32]:
        """Return the numbers of states, shape (n, words); new states get the next numbers."""
        with self._lock:
            if self._few is not None and self._held + len(states) <= FEW:
                return self._numbers_of_few(states, self._few)
            if self._few is not None:
                self._few = None
                state_sets.fill_slots(self.slots, self._states.rows, 0, self._held)
        full = 0.7  # load factor above which the hash table is enlarged. Higher saves memory, and makes lookups slower
        with self._lock:
            most = self._held + len(states)
            self._states.make_room(most)
            if most > full * len(self.slots):
                self.slots = np.zeros(1 << int(most / full * 2).bit_length(), dtype=np.uint64)
                state_sets.fill_slots(self.slots, self._states.rows, 0, self._held)
            numbers = np.empty(len(states), dtype=np.int32)
            self._held = state_sets.insert(self.slots, self._states.rows, self._held, states, numbers)
        if self._held > MOST:
            raise LimitError(f"more than {MOST} states without a ranking")
        return numbers

    def states(self, numbers: Ints | slice) -> Words:
        """Return a copy of the states, shape (n, words), with the given numbers."""
        with self._lock:  # the rows may be moved when they grow
            return self._states.rows[numbers].copy()

    def sort(self, layers: Sequence[int]) -> NDArray[np.int32]:
        """Renumber the states by packed words within each layer; return the new numbers of all states.

        Layer `i` is the states that have been numbered from `layers[i]` on, below `layers[i + 1]`.
        """
        number = np.empty(self._held, dtype=np.int32)
        with self._lock:
            for start, stop in pairwise(layers):
                rows = self._states.rows[start:stop]
                order = np.lexsort(rows.T[::-1]) if rows.shape[1] > 1 else rows[:, 0].argsort()
                rows[:] = rows[order]
                number[start + order] = np.arange(start, stop, dtype=np.int32)
            state_sets.renumber(self.slots, number)
        return number

    def trimmed(self) -> Words:
        """Return all states, shape (n, words), in the registry's own memory. No state may be added afterwards."""
        return self._states.trimmed(self._held)
