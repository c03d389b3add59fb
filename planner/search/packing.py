"""States as 64-bit words, in which several variables share a word, and rules as masks on them.

The rules are conditional effects and axioms, in the order in which they apply.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..grounding.task import Effect, Fact, Task
from ..system.arrays import Words, outline


@dataclass(frozen=True)
class Packing:
    """Position of each variable's value in the words of a packed state.

    Attributes
    ----------
    word, shift, bits : int64 arrays, shape (variables,)
        Value `v` of a variable is stored as `v << shift` in `word`, in `bits` bits. No variable spans two words.
    words : int
        64-bit words per state.
    """

    word: NDArray[np.int64]
    shift: NDArray[np.int64]
    bits: NDArray[np.int64]
    words: int

    __repr__ = outline

    @classmethod
    def of(cls, task: Task) -> Packing:
        """Lay out the variables of a task, in order."""
        return cls.of_sizes(task.sizes)

    @classmethod
    def of_sizes(cls, sizes: Sequence[int]) -> Packing:
        """Lay out variables with the given numbers of values, in order."""
        bits = np.array([max(1, (size - 1).bit_length()) for size in sizes], dtype=np.int64)
        word, shift = np.zeros_like(bits), np.zeros_like(bits)
        at, used = 0, 0
        for variable, width in enumerate(bits):
            if used + width > 64:
                at, used = at + 1, 0
            word[variable], shift[variable] = at, used
            used += int(width)
        return cls(word, shift, bits, at + 1)

    def pack(self, values: ArrayLike) -> Words:
        """Pack states given as values, shape (..., variables), into words, shape (..., words)."""
        array = np.asarray(values).astype(np.uint64)
        packed = np.zeros((*array.shape[:-1], self.words), dtype=np.uint64)
        for variable, (word, shift) in enumerate(zip(self.word, self.shift, strict=True)):
            packed[..., word] |= array[..., variable] << np.uint64(shift)
        return packed

    def unpack(self, states: Words) -> NDArray[np.int64]:
        """Return the values, shape (..., variables), of packed states, shape (..., words)."""
        values = states.take(self.word, axis=-1)
        values >>= self.shift.astype(np.uint64)  # in place: copying millions of states would dominate the time
        values &= (np.uint64(1) << self.bits.astype(np.uint64)) - np.uint64(1)
        return values.view(np.int64)

    def condition(self, facts: Sequence[Fact]) -> tuple[Words, Words]:
        """Return mask and bits, each of shape (words,), such that the facts hold in `s` if `s & mask == bits`.

        Facts that contradict each other hold in no state.
        """
        mask, value = np.zeros(self.words, dtype=np.uint64), np.zeros(self.words, dtype=np.uint64)
        if not can_hold(facts):
            mask[0], value[0] = 1, 2
            return mask, value
        for variable, wanted in facts:
            word, shift = self.word[variable], np.uint64(self.shift[variable])
            mask[word] |= ((np.uint64(1) << np.uint64(self.bits[variable])) - np.uint64(1)) << shift
            value[word] |= np.uint64(wanted) << shift
        return mask, value


def holds(states: Words, mask: Words, value: Words) -> NDArray[np.bool_]:
    """Return whether a condition holds in each packed state, shape (n, words)."""
    result = np.ones(len(states), dtype=bool)
    for word in np.flatnonzero(mask):
        result &= (states[:, word] & mask[word]) == value[word]
    return result


def can_hold(facts: Sequence[Fact]) -> bool:
    """Return whether the facts are consistent, that is, assign at most one value to each variable."""
    return len(dict(facts)) == len(set(facts))


Masks = tuple[Words, Words, Words, Words]
"""Mask and bits of a rule's condition, then the bits that it clears and those that it sets."""


Rule = tuple[Sequence[Fact], Masks]
"""Condition of a rule as facts, and its masks."""


def possible_operators(task: Task) -> list[int]:
    """Return the operators whose preconditions are consistent, in the order of their actions."""
    possible = [n for n, operator in enumerate(task.operators) if can_hold(operator.preconditions)]
    return sorted(possible, key=lambda number: (task.operators[number].action, number))


def grouped(effects: Sequence[Effect], packing: Packing) -> list[Rule]:
    """Return effects as rules, one for each distinct condition that can hold."""
    groups: dict[tuple[Fact, ...], list[Fact]] = {}
    for effect in effects:
        if can_hold(effect.conditions):
            groups.setdefault(effect.conditions, []).append((effect.variable, effect.value))
    return [(facts, (*packing.condition(facts), *packing.condition(written))) for facts, written in groups.items()]


def axiom_stages(task: Task, packing: Packing) -> Iterator[tuple[list[Rule], bool]]:
    """Yield the stages of a task's axioms: the defaults of derived variables first, then layer by layer."""
    derived = [v for v, variable in enumerate(task.variables) if variable.axiom_layer >= 0]
    if derived:
        nothing = np.zeros(packing.words, dtype=np.uint64)
        yield [((), (nothing, nothing, *packing.condition([(v, task.initial[v]) for v in derived])))], False
    for layer in sorted({task.variables[v].axiom_layer for v in derived}):
        own = [axiom for axiom in task.axioms if task.variables[axiom.variable].axiom_layer == layer]
        yield from _stages(grouped(own, packing))


def _stages(layer: Sequence[Rule]) -> Iterator[tuple[list[Rule], bool]]:
    """Yield a layer's axioms in stages, each after the axioms that it needs, and whether the stage is cyclic."""
    left = list(layer)
    while left:
        open_ = np.bitwise_or.reduce([cleared for _, (_, _, cleared, _) in left])
        later = [bool((masks[0] & open_).any()) for _, masks in left]
        if all(later):
            yield left, True
            return
        yield [rule for rule, waits in zip(left, later, strict=True) if not waits], False
        left = [rule for rule, waits in zip(left, later, strict=True) if waits]
