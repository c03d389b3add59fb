"""The transition function of a task, on arrays of packed states.

States are bit-packed into 64-bit words, so that thousands of them are tested against an operator with one
comparison per word. `Successors` takes packed states to what each action leads to; it covers all that the
translator produces, conditional effects and derived variables included.

Derived variables are part of a packed state: they follow from the others by the axioms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..grounding.task import Effect, Fact, Task
from ..system.arrays import outline

Ints = NDArray[np.int64]
Words = NDArray[np.uint64]


class Transitions(NamedTuple):
    """The choices of n states as compressed rows.

    Attributes
    ----------
    offsets : int64 array, shape (n + 1,)
        The choices of the i-th state are the rows `offsets[i]:offsets[i + 1]` of the next two.
    actions : int32 array, shape (m,)
        Ground actions, ascending within a state, none twice.
    targets : int32 or int64 array, shape (m,)
        The state that each leads to.
    """

    offsets: Ints
    actions: NDArray[np.int32]
    targets: NDArray[np.signedinteger]

    def __repr__(self) -> str:
        return outline(self)


@dataclass(frozen=True)
class Packing:
    """Where the value of each variable stands in the words of a packed state.

    Attributes
    ----------
    word, shift, bits : int64 arrays, shape (variables,)
        Value `v` of a variable is stored as `v << shift` in `word`; no variable crosses a word's end.
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
        """Lay out the variables of a task, one after the other."""
        return cls.of_sizes([len(variable.facts) for variable in task.variables])

    @classmethod
    def of_sizes(cls, sizes: Sequence[int]) -> Packing:
        """Lay out variables of so many values each, one after the other."""
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
        """Give the values, shape (..., variables), of packed states, shape (..., words)."""
        values = states.take(self.word, axis=-1)
        values >>= self.shift.astype(np.uint64)  # in place: of millions of states a copy takes longer than all else
        values &= (np.uint64(1) << self.bits.astype(np.uint64)) - np.uint64(1)
        return values.view(np.int64)

    def condition(self, facts: Sequence[Fact]) -> tuple[Words, Words]:
        """Give mask and bits, each of shape (words,): the facts hold in `s` where `s & mask == bits`."""
        mask, value = np.zeros(self.words, dtype=np.uint64), np.zeros(self.words, dtype=np.uint64)
        for variable, wanted in facts:
            word, shift = self.word[variable], np.uint64(self.shift[variable])
            mask[word] |= ((np.uint64(1) << np.uint64(self.bits[variable])) - np.uint64(1)) << shift
            value[word] |= np.uint64(wanted) << shift
        return mask, value

    def keys(self, states: Words) -> NDArray[np.generic]:
        """Give packed states, shape (n, words), as one sortable key each, shape (n,)."""
        if self.words == 1:
            return states[:, 0]
        return np.ascontiguousarray(states.astype(">u8")).view(f"S{8 * self.words}")[:, 0]


def holds(states: Words, mask: Words, value: Words) -> NDArray[np.bool_]:
    """Tell for each packed state, shape (n, words), whether a condition holds."""
    result = np.ones(len(states), dtype=bool)
    for word in np.flatnonzero(mask):
        result &= (states[:, word] & mask[word]) == value[word]
    return result


def can_hold(facts: Sequence[Fact]) -> bool:
    """Tell whether facts do not contradict each other."""
    return len(dict(facts)) == len(set(facts))


class Successors:
    """The transition function of a task on arrays of packed states.

    Parameters
    ----------
    task : Task
    packing : Packing
        How its states are packed.
    """

    def __init__(self, task: Task, packing: Packing) -> None:
        self.packing = packing
        self.actions = np.array([operator.action for operator in task.operators], dtype=np.int32)
        self.conditions = [packing.condition(operator.preconditions) for operator in task.operators]
        self.effects = [self._effects(operator.effects) for operator in task.operators]
        derived = [v for v, variable in enumerate(task.variables) if variable.axiom_layer >= 0]
        self.defaults = packing.condition([(v, task.initial[v]) for v in derived])
        self.layers = [
            self._effects([axiom for axiom in task.axioms if task.variables[axiom.variable].axiom_layer == layer])
            for layer in sorted({task.variables[v].axiom_layer for v in derived})
        ]

    def _effects(self, effects: Sequence[Effect]) -> list[tuple[Words, Words, Words, Words]]:
        """Group effects by their conditions: condition mask and bits, then cleared and set bits."""
        groups: dict[tuple[Fact, ...], list[Fact]] = {}
        for effect in effects:
            if can_hold(effect.conditions):
                groups.setdefault(effect.conditions, []).append((effect.variable, effect.value))
        return [
            (*self.packing.condition(conditions), *self.packing.condition(facts))
            for conditions, facts in groups.items()
        ]

    def applicable(self, states: Words, operator: int) -> NDArray[np.int64]:
        """Give the rows of `states` in which an operator can be applied."""
        return np.flatnonzero(holds(states, *self.conditions[operator]))

    def apply(self, states: Words, operator: int) -> Words:
        """Give the states, shape (n, words), after an operator that is applicable in all of them."""
        after = states.copy()
        for mask, value, cleared, assigned in self.effects[operator]:
            rows = holds(states, mask, value)[:, None]
            after = np.where(rows, (after & ~cleared) | assigned, after)
        return self.derive(after)

    def derive(self, states: Words) -> Words:
        """Set the derived variables: layer by layer, each to its least fixed point."""
        if not self.layers:
            return states
        cleared, assigned = self.defaults
        states = (states & ~cleared) | assigned
        for layer in self.layers:
            changed = True
            while changed:
                before = states
                for mask, value, cleared, assigned in layer:
                    rows = holds(states, mask, value)[:, None]
                    states = np.where(rows, (states & ~cleared) | assigned, states)
                changed = bool((states != before).any())
        return states

    def edges(self, states: Words) -> tuple[Ints, NDArray[np.int32], Words]:
        """Apply every operator to states of shape (n, words).

        Returns
        -------
        rows : int64 array, shape (m,)
            The state from which each edge starts.
        actions : int32 array, shape (m,)
        after : uint64 array, shape (m, words)
            The edges stand in the order of the operators; operators that come from one ground action (a
            disjunctive precondition) give equal ones.
        """
        rows: list[Ints] = [np.empty(0, dtype=np.int64)]
        actions = [np.empty(0, dtype=np.int32)]
        after = [np.empty((0, self.packing.words), dtype=np.uint64)]
        for operator, action in enumerate(self.actions):
            applicable = self.applicable(states, operator)
            if len(applicable):
                rows.append(applicable)
                actions.append(np.full(len(applicable), action, dtype=np.int32))
                after.append(self.apply(states[applicable], operator))
        return np.concatenate(rows), np.concatenate(actions), np.concatenate(after)

    def choices(self, states: Words) -> tuple[Ints, NDArray[np.int32], Words]:
        """Give the choices of states of shape (n, words).

        `offsets` and `actions` are as in `Transitions`; the third array, shape (m, words), are the states
        that they lead to.
        """
        rows, actions, after = self.edges(states)
        kept = distinct(rows, actions)
        offsets = np.concatenate([[0], np.cumsum(np.bincount(rows[kept], minlength=len(states)))])
        return offsets.astype(np.int64), actions[kept], after[kept]

    def follow(self, states: Words, action: int) -> Words:
        """Give the states after a ground action that is applicable in all of them.

        Raises
        ------
        ValueError
            It is not.
        """
        after = states.copy()
        missing = np.ones(len(states), dtype=bool)
        for operator in np.flatnonzero(self.actions == action):
            rows = self.applicable(states, int(operator))
            after[rows] = self.apply(states[rows], int(operator))
            missing[rows] = False
        if missing.any():
            raise ValueError(f"action {action} is not applicable in {int(missing.sum())} of {len(states)} states")
        return after


def distinct(rows: Ints, actions: NDArray[np.int32]) -> Ints:
    """Order edges by row and action, and keep one of each."""
    order = np.lexsort((actions, rows))
    first = np.ones(len(order), dtype=bool)
    first[1:] = (np.diff(rows[order]) != 0) | (np.diff(actions[order]) != 0)
    return order[first]
