"""States numbered in the order in which they were found, by a hash table."""

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
"""Share of the slots that may be taken."""


MOST = np.iinfo(np.int32).max
"""So many states can be numbered."""


@dataclass(frozen=True)
class RegistryIndex:
    """The states that have been found, in the order in which they were.

    Attributes
    ----------
    packing : Packing
    book : Rulebook
    states : uint64 array, shape (n, words)
    slots : uint64 array
        The hash table from a state to its number.
    """

    packing: Packing
    book: PackedOperators
    states: Words
    slots: Words

    def numbers(self, values: Ints) -> Ints:
        """Give the states with values of shape (n, variables), -1 where there is none."""
        sizes = np.left_shift(1, self.packing.bits)
        legal = np.all((values >= 0) & (values < sizes), axis=1)
        numbers = np.empty(len(values), dtype=np.int64)
        state_hash.look_up(self.slots, self.states, self.packing.pack(np.where(legal[:, None], values, 0)), numbers)
        return np.where(legal, numbers, -1)

    def values(self, numbers: Ints) -> Ints:
        """Give the values, shape (n, variables), of states of shape (n,)."""
        return self.packing.unpack(self.states[numbers])

    def where(self, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        """Tell of every state, shape (states,), whether facts hold."""
        return holds(self.states, *self.packing.condition(facts))

    def transitions(self, states: int, transitions: int) -> Transitions:
        """Build the choices of all states; the arguments are how many there are of both."""
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
    """Rows that are appended to; the memory grows by a third at a time, without a second copy where the system can.

    Where something else refers to the old rows these stay as they are, and the new ones are a copy.
    """

    def __init__(self, dtype: Any, *width: int) -> None:
        self.rows = np.zeros((1 << 12, *width), dtype=dtype)

    def make_room(self, rows: int) -> None:
        """Have at least so many rows."""
        if rows > len(self.rows):
            self._resize(max(rows, len(self.rows) * 4 // 3))

    def append(self, rows: int, more: NDArray[Any]) -> None:
        """Write what comes after so many rows."""
        self.make_room(rows + len(more))
        self.rows[rows : rows + len(more)] = more

    def trimmed(self, rows: int) -> NDArray[Any]:
        """Give the rows, of which so many are in use."""
        self._resize(rows)
        return self.rows

    def _resize(self, rows: int) -> None:
        shape = (rows, *self.rows.shape[1:])
        try:
            self.rows.resize(shape)  # in place, which numpy refuses where anything else refers to the array
        except ValueError:
            held, self.rows = self.rows, np.zeros(shape, dtype=self.rows.dtype)
            kept = min(rows, len(held))
            self.rows[:kept] = held[:kept]


class StateRegistry:
    """States that are numbered as they are met, in the order in which they are. Any thread may ask.

    Parameters
    ----------
    words : int
        Of a packed state.
    """

    def __init__(self, words: int) -> None:
        self._states = _Growing(np.uint64, words)
        self.slots = np.zeros(1 << 14, dtype=np.uint64)
        self._held = 0
        self._lock = threading.Lock()

    def __getstate__(self) -> dict[str, Any]:
        with self._lock:  # what is copied or written meanwhile is no longer that of this object
            own = {**vars(self), "_states": copy.deepcopy(self._states), "slots": self.slots.copy()}
        return {name: value for name, value in own.items() if name != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _lock=threading.Lock())

    def __len__(self) -> int:
        return self._held

    def numbers(self, states: Words) -> NDArray[np.int32]:
        """Give the numbers of states, shape (n, words); those that are new get the next ones."""
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
        """Give a copy of the states, shape (n, words), of some numbers."""
        with self._lock:  # the rows move as they grow
            return self._states.rows[numbers].copy()

    def trimmed(self) -> Words:
        """Give all states; no more can be met."""
        return self._states.trimmed(self._held)
