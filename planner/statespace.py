"""Every reachable state of a task, and what each action leads to.

States are bit-packed into 64-bit words, so that a whole layer of a breadth-first search is tested
against an operator with one comparison per word. The result is a `StateSpace`: packed states in
breadth-first order and the choices of each state as compressed rows (state -> actions, targets).

Derived variables are part of a packed state: they follow from the others by the axioms.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .fast_downward import LimitError
from .task import Effect, Fact, Task

Words = NDArray[np.uint64]


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

    @classmethod
    def of(cls, task: Task) -> Packing:
        """Lay out the variables of a task, one after the other."""
        bits = np.array([max(1, (len(v.facts) - 1).bit_length()) for v in task.variables], dtype=np.int64)
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
        masks = (np.uint64(1) << self.bits.astype(np.uint64)) - np.uint64(1)
        return ((states[..., self.word] >> self.shift.astype(np.uint64)) & masks).astype(np.int64)

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


class Successors:
    """The transition function of a task on arrays of packed states."""

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


@dataclass(frozen=True)
class StateSpace:
    """All states that a task can reach, and their choices.

    Attributes
    ----------
    task : Task
    packing : Packing
    states : uint64 array, shape (n, words)
        Packed states in breadth-first order; state 0 is the initial one.
    goal : bool array, shape (n,)
    offsets : int64 array, shape (n + 1,)
        The choices of state `x` are the rows `offsets[x]:offsets[x + 1]` of the next two.
    actions : int32 array, shape (m,)
        Ground actions, ascending within a state, none twice.
    targets : int64 array, shape (m,)
        The state that each leads to.
    """

    task: Task
    packing: Packing
    states: Words
    goal: NDArray[np.bool_]
    offsets: NDArray[np.int64]
    actions: NDArray[np.int32]
    targets: NDArray[np.int64]

    def __post_init__(self) -> None:
        for array in (self.states, self.goal, self.offsets, self.actions, self.targets):
            array.flags.writeable = False

    def __len__(self) -> int:
        return len(self.states)

    @property
    def initial(self) -> int:
        """The number of the initial state."""
        return 0

    @cached_property
    def costs(self) -> NDArray[np.int64]:
        """The cost of each choice, shape (m,)."""
        return np.asarray(self.task.costs, dtype=np.int64)[self.actions]

    @cached_property
    def sources(self) -> NDArray[np.int64]:
        """The state in which each choice is made, shape (m,)."""
        return np.repeat(np.arange(len(self)), np.diff(self.offsets))

    def values(self, state: int) -> tuple[int, ...]:
        """Give the value of every variable in a state."""
        return tuple(int(value) for value in self.packing.unpack(self.states[state]))

    def facts(self, state: int) -> list[str]:
        """Describe a state: the PDDL atoms that hold in it, of those that can change."""
        facts = (self.task.variables[v].facts[value] for v, value in enumerate(self.values(state)))
        return sorted(fact.removeprefix("Atom ") for fact in facts if fact.startswith("Atom "))

    def choices(self, state: int) -> dict[str, int]:
        """Give the applicable ground actions of a state, each with the state that it leads to."""
        row = slice(self.offsets[state], self.offsets[state + 1])
        names = (self.task.actions[action] for action in self.actions[row])
        return dict(zip(names, (int(target) for target in self.targets[row]), strict=True))

    def follow(self, plan: Sequence[str], state: int = 0) -> int:
        """Give the state that a sequence of ground actions leads to.

        Raises
        ------
        ValueError
            An action that is not applicable where its turn comes.
        """
        for step, action in enumerate(plan):
            choices = self.choices(state)
            if action not in choices:
                raise ValueError(
                    f"step {step}: {action} is not applicable; applicable are {', '.join(choices) or 'no actions'}"
                )
            state = choices[action]
        return state


def explore(task: Task, *, max_states: int | None = None, deadline: float | None = None) -> StateSpace:
    """Enumerate the reachable states of a task, breadth first.

    Parameters
    ----------
    task : Task
    max_states : int, optional
        The largest number of states that may be stored.
    deadline : float, optional
        A time on `time.monotonic()`'s clock.

    Raises
    ------
    LimitError
        More states than `max_states`, or the deadline has passed.
    """
    packing = Packing.of(task)
    successors = Successors(task, packing)
    layer = successors.derive(packing.pack([task.initial]))
    layers = [layer]
    seen = packing.keys(layer)  # sorted
    edges: list[tuple[NDArray[np.int64], NDArray[np.int32], Words]] = []
    first = 0  # number of the layer's first state
    while len(layer):
        if deadline is not None and time.monotonic() > deadline:
            raise LimitError(f"out of time after {len(seen)} states")
        reached = [np.empty((0, packing.words), dtype=np.uint64)]
        for operator, action in enumerate(successors.actions):
            rows = successors.applicable(layer, operator)
            if len(rows):
                after = successors.apply(layer[rows], operator)
                reached.append(after)
                edges.append((rows + first, np.full(len(rows), action, dtype=np.int32), after))
        candidates = np.concatenate(reached)
        first += len(layer)
        keys, places = np.unique(packing.keys(candidates), return_index=True)
        at = np.minimum(np.searchsorted(seen, keys), len(seen) - 1)
        fresh = seen[at] != keys
        layer = candidates[places[fresh]]
        seen = np.sort(np.concatenate([seen, keys[fresh]]))
        if max_states is not None and len(seen) > max_states:
            raise LimitError(f"more than {max_states} states")
        layers.append(layer)

    states = np.concatenate(layers)
    keys = packing.keys(states)
    order = np.argsort(keys, kind="stable")
    if edges:
        sources, actions = np.concatenate([e[0] for e in edges]), np.concatenate([e[1] for e in edges])
        targets = order[np.searchsorted(keys[order], packing.keys(np.concatenate([e[2] for e in edges])))]
    else:
        sources, actions, targets = np.empty(0, np.int64), np.empty(0, np.int32), np.empty(0, np.int64)
    by_state = np.lexsort((actions, sources))
    sources, actions, targets = sources[by_state], actions[by_state], targets[by_state]
    # Operators that come from one ground action (a disjunctive precondition) are one choice.
    first_of = np.ones(len(sources), dtype=bool)
    first_of[1:] = (sources[1:] != sources[:-1]) | (actions[1:] != actions[:-1])
    sources, actions, targets = sources[first_of], actions[first_of], targets[first_of]
    offsets = np.concatenate([[0], np.cumsum(np.bincount(sources, minlength=len(states)))]).astype(np.int64)
    goal = holds(states, *packing.condition(task.goal))
    return StateSpace(task, packing, states, goal, offsets, actions, targets.astype(np.int64))
