"""States in a registry, numbered as they are met: the search that stores transitions, and an index by layer."""

from __future__ import annotations

import copy
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Fact, Task
from ..system.arrays import Ints, Words
from ..system.limits import Budget, LimitError
from .automorphisms import Forms, canonical
from .kernels import block_steps, packed_successors, state_sets
from .kernels.packed_successors import PackedOperators
from .search_space import relaxed
from .state_space import Packing, Part, holds
from .successor_generator import TRANSITIONS_AT_A_TIME, Expanded, expanded, packed_operators

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
                state_sets.fill_slots(self.slots, self._states.rows, self._held)
        full = 0.7  # load factor above which the hash table is enlarged. Higher saves memory, and makes lookups slower
        with self._lock:
            most = self._held + len(states)
            self._states.make_room(most)
            if most > full * len(self.slots):
                self.slots = np.zeros(1 << int(most / full * 2).bit_length(), dtype=np.uint64)
                state_sets.fill_slots(self.slots, self._states.rows, self._held)
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


STATES_AT_A_TIME = 1 << 12
"""Largest number of states in a block that is expanded at once. It bounds the memory of a block."""


@dataclass(frozen=True)
class RegistryIndex:
    """The states of a registry, numbered by layer, then by packed words.

    If `forms` are given, these are canonical states, which stand for the orbits of all reachable states. Transitions
    are those of the canonical states, and lead to the orbits of their successors.
    """

    packing: Packing
    operators: PackedOperators
    states: Words
    """All states, shape (n, words)."""
    slots: Words
    """Hash table from a state to its number."""
    sizes: Ints
    """Number of values of each variable."""
    forms: Forms | None = None
    """Symmetries of the task, as `canonical` applies them."""

    def numbers(self, values: Ints) -> Ints:
        """Return the numbers of the states with the given values, shape (n, variables); -1 where there is none."""
        legal = np.all((values >= 0) & (values < self.sizes), axis=1)
        return np.where(legal, self.rows(self.packing.pack(np.where(legal[:, None], values, 0))), -1)

    def values(self, numbers: Ints) -> Ints:
        """Return the values, shape (n, variables), of states, shape (n,)."""
        return self.packing.unpack(self.states[numbers])

    def where(self, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        """Return whether the facts hold in each state, shape (states,)."""
        return holds(self.states, *self.packing.condition(facts))

    def rows(self, states: Words) -> Ints:
        """Return the numbers of packed states, shape (n, words), or of their orbits; -1 where there is none."""
        if self.forms is not None:
            states = states.copy()
            canonical(self.forms, states)
        numbers = np.empty(len(states), dtype=np.int64)
        state_sets.look_up(self.slots, self.states, states, numbers)
        return numbers

    def transitions(self, numbers: Ints | None = None) -> Iterator[Part]:
        """Yield the transitions of states, shape (n,), in parts; by default those of all states, in order."""
        states = self.states if numbers is None else self.states[numbers]
        for counts, actions, after in expanded(self.operators, states):
            yield counts, actions, self.rows(after)


Form = Callable[[Words], None]
"""Function that replaces states, shape (n, words), by their canonical states in place."""


class RegistrySpace:
    """The states of a task in a registry, for a search; `form` canonicalises states before they are looked up."""

    def __init__(self, task: Task, budget: Budget, form: Form | None = None) -> None:
        self._packing, self._budget, self._form = Packing.of(task), budget, form
        self._sizes = np.array(task.sizes, dtype=np.int64)
        self._operators = packed_operators(task, self._packing, budget.during("operators were laid out"))
        self._met = StateRegistry(self._packing.words)
        start = self._packing.pack([task.initial])
        packed_successors.derive(self._operators.axioms, self._operators.again, start)
        if form is not None:
            form(start)
        self._met.numbers(start)
        self.initial = self._expanded = self.transitions = 0
        self._layers = [0]  # where each layer begins
        self.costs, self._kind_of = np.unique(task.costs, return_inverse=True)
        self._counts, self._targets = GrowingArray(np.int32), GrowingArray(np.int32)
        self._kinds = GrowingArray(np.uint16 if len(self.costs) <= 1 << 16 else np.uint32)
        self._into = self._sources = np.empty(0, dtype=np.int64)

    def __len__(self) -> int:
        return len(self._met)

    @property
    def nbytes(self) -> float:
        """Bytes in use, or soon in use by the backward search."""
        each = 8 * self._packing.words + 24
        return self._met.slots.nbytes + each * len(self) + (8 + 4 * (len(self.costs) > 1)) * self.transitions

    def start(self) -> list[range]:
        """Return the number of the initial state."""
        return [range(1)]

    def blocks(self, layer: list[Any], threads: int) -> deque[Any]:  # noqa: ARG002
        """Return the numbers of a layer in blocks with a bounded number of transitions; the given list is emptied.

        The forward search's layers are ranges, one after the other, so that they take no memory.
        """
        if isinstance(layer[0], range):
            numbers: Any = range(layer[0].start, layer[-1].stop)
            self._layers.append(numbers.stop)
        else:
            numbers = np.concatenate(layer)
        layer.clear()
        of_each = max(1, self.transitions // max(1, self._expanded))
        size = max(1, min(STATES_AT_A_TIME, TRANSITIONS_AT_A_TIME // of_each))
        return deque(numbers[at : at + size] for at in range(0, len(numbers), size))

    def expand(self, block: range) -> list[Expanded]:
        """Return the successors of a block's states, canonical if there is a `form`, as `expanded` yields them."""
        parts = []
        for part in expanded(self._operators, self._met.states(slice(block.start, block.stop))):
            self._budget.check_time(len(self))
            if self._form is not None:
                self._form(part[2])
            parts.append(part)
        return parts

    def add(self, expanded: list[Expanded]) -> list[range]:
        """Number the new states and store the transitions; return the numbers of the new states."""
        before = len(self)
        for counts, actions, after in expanded:
            self._counts.append(self._expanded, counts)
            self._targets.append(self.transitions, self._met.numbers(after))
            if len(self.costs) > 1:
                self._kinds.append(self.transitions, self._kind_of[actions])
            self._expanded += len(counts)
            self.transitions += len(actions)
        return [range(before, len(self))] if len(self) > before else []

    def finish(self) -> None:
        """Number the states by layer and packed words, build the index, and sort the transitions by their targets."""
        number = self._met.sort(self._layers)
        self.index = RegistryIndex(self._packing, self._operators, self._met.trimmed(), self._met.slots, self._sizes)
        targets = self._targets.trimmed(self.transitions)
        kinds = self._kinds.trimmed(self.transitions if len(self.costs) > 1 else 0)
        self._into = np.zeros(len(self) + 2, dtype=np.int64)
        self._sources, sorted_kinds = np.empty_like(targets), np.empty_like(kinds)
        block_steps.transpose(
            self._counts.trimmed(self._expanded), targets, kinds, number, self._into, self._sources, sorted_kinds
        )
        self._kinds.rows = sorted_kinds
        self._counts, self._targets = GrowingArray(np.int32), GrowingArray(np.int32)

    def begin(self, goal: Sequence[Fact], distance: NDArray[Any]) -> list[Ints]:
        """Set the distance of the goal states to 0, and return their numbers."""
        numbers = np.flatnonzero(self.index.where(goal))
        distance[numbers] = 0
        return [numbers]

    def settle(self, block: Ints, d: Any, distance: NDArray[Any], costs: NDArray[Any]) -> list[tuple[int, Ints]]:
        """Relax the stored transitions into the states of a block at distance `d`."""
        relax = partial(block_steps.relax_stored, self._into, self._sources, self._kinds.rows, costs, distance)
        ends = self._into[block + 1] - self._into[block]
        return relaxed(relax, block, d, max(TRANSITIONS_AT_A_TIME, int(ends.max(initial=1))), len(costs))
