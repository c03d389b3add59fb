"""A numbering of states in the order of their discovery, by a hash table."""

from __future__ import annotations

import copy
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Fact
from ..states.packing import Ints, Packing, Words, holds
from ..states.successors import Transitions
from ..system.limits import LimitError
from .kernels import state_hash
from .kernels.packed_successors import PackedOperators
from .successor_generator import expanded

FULL = 0.7
"""Load factor above which the hash table is enlarged. Higher saves memory, and makes lookups slower."""


MOST = np.iinfo(np.int32).max
"""Largest number of states in a registry (32-bit numbers)."""


@dataclass(frozen=True)
class RegistryIndex:
    """The states of a registry, numbered in the order of their discovery.

    Attributes
    ----------
    packing : Packing
    book : PackedOperators
    states : uint64 array, shape (n, words)
    slots : uint64 array
        Hash table from a state to its number.
    """

    packing: Packing
    book: PackedOperators
    states: Words
    slots: Words

    def numbers(self, values: Ints) -> Ints:
        """Return the numbers of the states with the given values, shape (n, variables); -1 where there is none."""
        sizes = np.left_shift(1, self.packing.bits)
        legal = np.all((values >= 0) & (values < sizes), axis=1)
        numbers = np.empty(len(values), dtype=np.int64)
        state_hash.look_up(self.slots, self.states, self.packing.pack(np.where(legal[:, None], values, 0)), numbers)
        return np.where(legal, numbers, -1)

    def values(self, numbers: Ints) -> Ints:
        """Return the values, shape (n, variables), of states, shape (n,)."""
        return self.packing.unpack(self.states[numbers])

    def where(self, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        """Return whether the facts hold in each state, shape (states,)."""
        return holds(self.states, *self.packing.condition(facts))

    def transitions(self, states: int, transitions: int) -> Transitions:
        """Build the transitions of all states; the arguments are the numbers of states and of transitions."""
        rows = Transitions(
            np.zeros(states + 1, dtype=np.int64),
            np.empty(transitions, dtype=np.int32),
            np.empty(transitions, dtype=np.int32),
        )
        first = row = 0
        for counts, actions, after in expanded(self.book, self.states):
            rows.actions[row : row + len(actions)] = actions
            state_hash.look_up(self.slots, self.states, after, rows.targets[row : row + len(actions)])
            rows.offsets[first + 1 : first + 1 + len(counts)] = row + np.cumsum(counts)
            first, row = first + len(counts), row + len(actions)
        return rows


class _Growing:
    """An array to which rows are appended. It grows by a third, in place where the system can do so.

    If the old rows are referenced elsewhere, they stay unchanged and the new rows are a copy.
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
        """Return the first `rows` rows, and release the others."""
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
    """A thread-safe registry that numbers packed states in the order of their first occurrence.

    Parameters
    ----------
    words : int
        Words of a packed state.
    """

    def __init__(self, words: int) -> None:
        self._states = _Growing(np.uint64, words)
        self.slots = np.zeros(1 << 14, dtype=np.uint64)
        self._held = 0
        self._lock = threading.Lock()

    def __getstate__(self) -> dict[str, Any]:
        with self._lock:  # a consistent copy, which later insertions do not change
            own = {**vars(self), "_states": copy.deepcopy(self._states), "slots": self.slots.copy()}
        return {name: value for name, value in own.items() if name != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _lock=threading.Lock())

    def __len__(self) -> int:
        return self._held

    def numbers(self, states: Words) -> NDArray[np.int32]:
        """Return the numbers of states, shape (n, words); new states get the next numbers."""
        with self._lock:
            most = self._held + len(states)
            self._states.make_room(most)
            if most > FULL * len(self.slots):
                self.slots = np.zeros(1 << int(most / FULL * 2).bit_length(), dtype=np.uint64)
                state_hash.fill_slots(self.slots, self._states.rows, 0, self._held)
            numbers = np.empty(len(states), dtype=np.int32)
            self._held = state_hash.insert(self.slots, self._states.rows, self._held, states, numbers)
        if self._held > MOST:
            raise LimitError(f"more than {MOST} states without an index")
        return numbers

    def states(self, numbers: Ints | slice) -> Words:
        """Return a copy of the states, shape (n, words), with the given numbers."""
        with self._lock:  # the rows may be moved when they grow
            return self._states.rows[numbers].copy()

    def trimmed(self) -> Words:
        """Return all states; no state may be added afterwards."""
        return self._states.trimmed(self._held)
