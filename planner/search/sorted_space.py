"""The readable search through all states of a small task, with numpy alone.

Compiling would take longer than this whole search. States are packed into words. Every layer is compared with the
conditions of all operators at once. What has been found is kept as sorted numbers, in which new states are looked up.
The transitions are stored, so that the backward search reads the predecessors of states off them.

`SortedSpace` takes part in the same two searches as the compiled spaces, and gives states the same numbers.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Fact, Task
from ..system.arrays import Ints, Words, outline
from ..system.errors import UnsuitedError
from ..system.limits import Budget
from .state_space import Packing, Part, Rule, axiom_stages, grouped, holds, possible_operators

MOST_STATES = 100_000
"""States up to which a task is small. Their search takes a fifth of a second, compiling takes five."""
MOST_IN_LAYER = 15_000
"""States of a layer up to which a task is small. Wider ones are those of much larger tasks, which lose no time so."""
MOST_LAYERS = 1 << 11
"""Layers up to which a task is small: each takes some hundred calls of numpy, however few states it has."""
MOST_TESTS = 1 << 26
"""Tests of words of states, by conditions of operators, up to which a task is small: a fifth of a second."""
TESTS_AT_A_TIME = 1 << 16
"""Tests of words at once, so that they stay in the processor's cache."""

Keys = NDArray[Any]
"""States as values that can be sorted: by their packed words, the first word first."""


def keys(states: Words) -> Keys:
    """Return the keys of packed states, shape (n, words), as an array of shape (n,)."""
    if states.shape[1] == 1:
        return states[:, 0]
    return np.ascontiguousarray(states, dtype=">u8").view(f"S{8 * states.shape[1]}")[:, 0]


class Successors(NamedTuple):
    """The transition function of a small task: its possible operators, in the order of their actions, and its axioms.

    The masks have the shape (operators, words), those of the effects (rules, operators, words). An operator with fewer
    rules than others is filled up with rules that change nothing.
    """

    action: NDArray[np.int32]
    mask: Words
    bits: Words
    condition: tuple[Words, Words]
    """Mask and bits of the condition of each rule."""
    keep: Words
    value: Words
    axioms: Sequence[tuple[list[Rule], bool]]

    @classmethod
    def of(cls, task: Task, packing: Packing) -> Successors:
        """Return that of a task; an `UnsuitedError` says that it is not small."""
        order = possible_operators(task)
        rules = [grouped(task.operators[number].effects, packing) for number in order]
        shape = max(map(len, rules), default=0), len(order), packing.words
        if math.prod(shape) > MOST_TESTS >> 4:
            raise UnsuitedError
        when, bits, cleared, value = (np.zeros(shape, dtype=np.uint64) for _ in range(4))
        for place, own in enumerate(rules):
            for number, (_, masks) in enumerate(own):
                for array, mask in zip((when, bits, cleared, value), masks, strict=True):
                    array[number, place] = mask
        needed = [packing.condition(task.operators[number].preconditions) for number in order]
        each = np.array(needed, dtype=np.uint64).reshape(len(order), 2, packing.words)
        action = np.array([task.operators[number].action for number in order], dtype=np.int32)
        axioms = list(axiom_stages(task, packing))
        return cls(action, each[:, 0], each[:, 1], (when, bits), ~cleared, value, axioms)

    def applicable(self, states: Words) -> tuple[Ints, Ints]:
        """Return the states and the operators of all transitions of states, by state and then by action."""
        found = []
        size = max(1, TESTS_AT_A_TIME // max(1, len(self.action)))
        for begin in range(0, max(1, len(states)), size):
            block = states[begin : begin + size]
            met = np.ones((len(block), len(self.action)), dtype=bool)
            for word in np.flatnonzero(self.mask.any(axis=0)):
                met &= (block[:, word, None] & self.mask[:, word]) == self.bits[:, word]
            sources, operators = np.nonzero(met)
            found.append((begin + sources, operators))
        sources, operators = map(np.concatenate, zip(*found, strict=True))
        # The first applicable operator of an action counts.
        actions = self.action[operators]
        first = np.ones(len(actions), dtype=bool)
        first[1:] = (actions[1:] != actions[:-1]) | (sources[1:] != sources[:-1])
        return sources[first], operators[first]

    def expanded(self, states: Words) -> tuple[NDArray[np.int32], NDArray[np.int32], Words]:
        """Return the number of actions of each state, the actions and the packed successors, as compiled code does."""
        sources, operators = self.applicable(states)
        counts = np.bincount(sources, minlength=len(states)).astype(np.int32)
        return counts, self.action[operators], self.apply(states[sources], operators)

    def apply(self, states: Words, operators: Ints) -> Words:
        """Return the successors of states, shape (n, words), each by one operator."""
        after = states.copy()
        for mask, bits, keep, value in zip(*self.condition, self.keep, self.value, strict=True):
            changed = after & keep[operators] | value[operators]
            if mask.any():
                met = ((states & mask[operators]) == bits[operators]).all(axis=1)
                changed = np.where(met[:, None], changed, after)
            after = changed
        self.derive(after)
        return after

    def derive(self, states: Words) -> None:
        """Set the derived variables of packed states, shape (n, words), stage by stage to the least fixed point."""
        for rules, cyclic in self.axioms:
            changed = True
            while changed:
                changed = False
                for _, (mask, bits, cleared, value) in rules:
                    met = holds(states, mask, bits)
                    after = states[met] & ~cleared | value
                    changed |= cyclic and bool((after != states[met]).any())
                    states[met] = after


@dataclass(frozen=True)
class SortedIndex:
    """States in sorted arrays, with their transitions."""

    packing: Packing
    sizes: Ints
    """Number of values of each variable."""
    states: Words
    """All states, shape (n, words), in the order of their numbers."""
    sorted_keys: Keys
    by_key: NDArray[np.int32]
    """Number of the state of each sorted key."""
    offsets: Ints
    """The transitions of state `s` are the rows `offsets[s]:offsets[s + 1]` of the next two arrays."""
    actions: NDArray[np.int32]
    targets: NDArray[np.int32]

    __repr__ = outline

    def numbers(self, values: Ints) -> Ints:
        """Return the numbers of the states with the given values, shape (n, variables); -1 where there is none."""
        legal = np.all((values >= 0) & (values < self.sizes), axis=1)
        wanted = keys(self.packing.pack(np.where(legal[:, None], values, 0)))
        place = np.minimum(np.searchsorted(self.sorted_keys, wanted), len(self.sorted_keys) - 1)
        return np.where(legal & (self.sorted_keys[place] == wanted), self.by_key[place].astype(np.int64), -1)

    def values(self, numbers: Ints) -> Ints:
        """Return the values, shape (n, variables), of states, shape (n,)."""
        return self.packing.unpack(self.states[numbers])

    def where(self, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        """Return whether the facts hold in each state, shape (states,)."""
        return holds(self.states, *self.packing.condition(facts))

    def transitions(self, numbers: Ints | None = None) -> Iterator[Part]:
        """Yield the transitions of states, shape (n,), in parts; by default those of all states, in order."""
        counts = np.diff(self.offsets).astype(np.int32)
        if numbers is None:
            yield counts, self.actions, self.targets
            return
        rows = rows_of(self.offsets, numbers)
        yield counts[numbers], self.actions[rows], self.targets[rows].astype(np.int64)


def rows_of(offsets: Ints, numbers: Ints) -> Ints:
    """Return the rows `offsets[n]:offsets[n + 1]` of all given numbers `n`, one after the other."""
    counts = offsets[numbers + 1] - offsets[numbers]
    ends = np.cumsum(counts)
    return np.arange(ends[-1] if len(ends) else 0) + np.repeat(offsets[numbers] - ends + counts, counts)


class SortedSpace:
    """The states of a small task for a search; an `UnsuitedError` says that it is not small."""

    def __init__(self, task: Task, budget: Budget, most_states: int = MOST_STATES) -> None:
        self._packing, self._budget, self._most = Packing.of(task), budget, most_states
        self._sizes = np.array(task.sizes, dtype=np.int64)
        self._operators = Successors.of(task, self._packing)
        start = self._packing.pack([task.initial])
        self._operators.derive(start)
        self._layers, self._known, self._number_of = [start], keys(start), np.zeros(1, dtype=np.int32)
        # Of each layer: number of actions of each state, operators, targets.
        self._found: list[tuple[Ints, Ints, NDArray[np.int32]]] = []
        self._order: Ints | None = None
        self.transitions = self.initial = 0
        self.costs, self._kind_of = np.unique(task.costs, return_inverse=True)

    def __len__(self) -> int:
        return len(self._known)

    @property
    def nbytes(self) -> float:
        """Bytes in use, or soon in use by the backward search."""
        return (16 * self._packing.words + 32) * len(self) + (8 * self._packing.words + 32) * self.transitions

    def start(self) -> list[Any]:
        """Return the first layer."""
        return list(self._layers)

    def blocks(self, layer: list[Any], threads: int) -> deque[Any]:  # noqa: ARG002
        """Return the states, or the numbers of states, of a layer as one block; the given list is emptied."""
        block = np.concatenate(layer)
        layer.clear()
        return deque([block])

    def expand(self, block: Words) -> tuple[Ints, Ints, Words]:
        """Return the number of actions of each state, the operators of all actions, and the successors."""
        tests = len(self._operators.action) * self._packing.words * (len(self) + len(block))
        if len(self) > self._most or len(block) > MOST_IN_LAYER or len(self._layers) > MOST_LAYERS:
            raise UnsuitedError
        if tests > MOST_TESTS:
            raise UnsuitedError
        sources, operators = self._operators.applicable(block)
        self._budget.check_memory(self.nbytes + 32 * self._packing.words * len(sources))
        after = self._operators.apply(block[sources], operators)
        return np.bincount(sources, minlength=len(block)), operators, after

    def add(self, expanded: tuple[Ints, Ints, Words]) -> list[Words]:
        """Store the transitions; return the new states, in the order of their keys."""
        counts, operators, after = expanded
        successors = keys(after)
        place = np.minimum(np.searchsorted(self._known, successors), len(self) - 1)
        fresh = self._known[place] != successors
        new, first, inverse = np.unique(successors[fresh], return_index=True, return_inverse=True)
        targets = self._number_of[place]
        targets[fresh] = len(self) + inverse
        self._found.append((counts, operators, targets))
        self.transitions += len(operators)
        if not len(new):
            return []
        self._layers.append(after[fresh][first])
        place, numbers = np.searchsorted(self._known, new), np.arange(len(self), len(self) + len(new), dtype=np.int32)
        self._known = np.insert(self._known, place, new)
        self._number_of = np.insert(self._number_of, place, numbers)
        return [self._layers[-1]]

    def finish(self) -> None:
        """Leave the states numbered by layer and key."""

    def by_rank(self, stride: Sequence[int]) -> None:
        """Number the states by ascending rank instead: the sum of their values, each times its stride."""
        ranks = self._packing.unpack(np.concatenate(self._layers)) @ np.array(stride, dtype=np.int64)
        self._order = ranks.argsort()
        self.initial = int(np.flatnonzero(self._order == 0)[0])

    @cached_property
    def index(self) -> SortedIndex:
        """The numbering of the reachable states."""
        states, by_key = np.concatenate(self._layers), self._number_of
        counts, operators, targets = map(np.concatenate, zip(*self._found, strict=True))
        offsets = np.concatenate([[0], np.cumsum(counts)])
        if self._order is not None:
            number = np.empty(len(self), dtype=np.int32)
            number[self._order] = np.arange(len(self))
            rows = rows_of(offsets, self._order)
            states, by_key = states[self._order], number[by_key]
            operators, targets = operators[rows], number[targets[rows]]
            offsets = np.concatenate([[0], np.cumsum(counts[self._order])])
        actions = self._operators.action[operators]
        return SortedIndex(self._packing, self._sizes, states, self._known, by_key, offsets, actions, targets)

    @cached_property
    def _predecessors(self) -> tuple[Ints, Ints, Ints]:
        """Rows `into[s]:into[s + 1]` are the transitions into `s`: `into`, their sources, the kinds of their cost."""
        index = self.index
        order = index.targets.argsort(kind="stable")
        into = np.concatenate([[0], np.cumsum(np.bincount(index.targets, minlength=len(self)))])
        sources = np.repeat(np.arange(len(self)), np.diff(index.offsets))
        return into, sources[order], self._kind_of[index.actions[order]]

    def begin(self, goal: Sequence[Fact], distance: NDArray[Any]) -> list[Ints]:
        """Set the distance of the goal states to 0, and return their numbers."""
        numbers = np.flatnonzero(self.index.where(goal))
        distance[numbers] = 0
        return [numbers]

    def settle(self, block: Ints, d: Any, distance: NDArray[Any], costs: NDArray[Any]) -> list[tuple[int, Ints]]:
        """Relax the transitions into the states of a block at distance `d`."""
        into, every, kind_of = self._predecessors
        rows = rows_of(into, np.unique(block[distance[block] == d]))
        kinds, sources = kind_of[rows], every[rows]
        nearer = d + costs[kinds] < distance[sources]
        kinds, sources = kinds[nearer], sources[nearer]
        order = kinds.argsort(kind="stable")
        begins = np.concatenate([[0], np.flatnonzero(np.diff(kinds[order])) + 1, [len(order)]])
        pushed = []
        for begin, end in pairwise(begins.tolist() if len(order) else []):  # cheap ones first
            kind, own = int(kinds[order[begin]]), sources[order[begin:end]]
            own = np.unique(own[d + costs[kind] < distance[own]])
            distance[own] = d + costs[kind]
            pushed.append((kind, own))
        return pushed
