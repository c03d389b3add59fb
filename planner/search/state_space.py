"""States as 64-bit words, in which several variables share a word, and the numbered reachable states of a task.

`Packing` says where each variable is in the words; conditional effects and axioms are rules, masks on the words.

A `StateSpace` is the result of a sweep: the number of states, the number of each state, and, computed when first used,
the transitions of all states. A `StateIndex` defines the numbering. `RegistryIndex` stores the packed states.
`RankedIndex` is more compact. `SortedIndex` is that of small tasks, and stores their transitions as well.

**The numbers of states** follow one rule, so that every search gives the same ones:

- If a ranking by single variables (`Digits.of`) has at most `SweepOptions.small_bitmap` ranks, states are
  numbered by ascending rank. The rank is the sum of some variables' values, each times a stride.
- Otherwise, a task with few transitions (`SweepOptions` says how many), or without a ranking, is numbered by layer, the
  least number of actions from the initial state. Within a layer, states ascend by their packed words, the first word
  first. So do the canonical states of orbits.
- All other tasks are numbered by ascending rank, in the dense ranking if it has fewer ranks.

The rule depends on the task alone, unless memory or time ends the search for a ranking. On demand (`OnDemand`), where
states are never all known, they are numbered in the order of their first use.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..grounding.task import Effect, Fact, Task
from ..system.arrays import Ints, Words, outline
from ..system.limits import Check, unchecked


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


Part = tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.signedinteger]]
"""Number of transitions of each state of a block, their actions, and their targets."""


class Transitions(NamedTuple):
    """The transitions of n states as compressed rows.

    Attributes
    ----------
    offsets : int64 array, shape (n + 1,)
        The transitions of the i-th state are the rows `offsets[i]:offsets[i + 1]` of the other two arrays.
    actions : int32 array, shape (m,)
        Ground actions, strictly ascending within a state.
    targets : int32 or int64 array, shape (m,)
        Successor state of each transition.
    """

    offsets: Ints
    actions: NDArray[np.int32]
    targets: NDArray[np.signedinteger]

    def __repr__(self) -> str:
        return outline(self)


def joined(parts: Iterable[Part]) -> Transitions:
    """Return the transitions that are given in parts."""
    none = np.empty(0, dtype=np.int32)
    nothing: list[Part] = [(none, none, np.empty(0, dtype=np.int64))]
    counts, actions, targets = (np.concatenate(column) for column in zip(*nothing, *parts, strict=True))
    return Transitions(np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]), actions, targets)


def state_numbers(states: ArrayLike, count: int) -> Ints:
    """Return state numbers as an int64 array of the same shape; raise `IndexError` if one is no state's number."""
    array = np.asarray(states)
    if array.size and array.dtype.kind not in "iu":
        raise IndexError(f"states are numbered by integers, not by {array.dtype}")
    if array.size and not 0 <= array.min() <= array.max() < count:
        raise IndexError(f"states are numbered from 0 to {count - 1}")
    return array.astype(np.int64, copy=False)


class StateIndex(Protocol):
    """A numbering of the reachable states, as a `StateSpace` needs it."""

    def numbers(self, values: Ints) -> Ints:
        """Return the numbers of the states with the given values, shape (n, variables); -1 where there is none."""

    def values(self, numbers: Ints) -> Ints:
        """Return the values, shape (n, variables), of states, shape (n,)."""

    def where(self, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        """Return whether the facts hold in each state, shape (states,)."""

    def transitions(self, numbers: Ints | None = None) -> Iterator[Part]:
        """Yield the transitions of states, shape (n,), in parts; by default those of all states, in order."""


@dataclass(frozen=True)
class StateSpace:
    """All reachable states of a task.

    Attributes
    ----------
    task : Task
    size : int
        Number of states, which are numbered from 0.
    initial : int
        The number of the initial state.
    transition_count : int
        Number of transitions: applicable ground actions, summed over all states.
    numbering : StateIndex
        The numbering of the states.
    check : callable
        Called with the bytes of the transitions of all states before they are built. It may raise `LimitError`.
    """

    task: Task
    size: int
    initial: int
    transition_count: int
    numbering: StateIndex
    check: Check = unchecked

    __repr__ = outline

    def __len__(self) -> int:
        return self.size

    @cached_property
    def goal(self) -> NDArray[np.bool_]:
        """Whether each state is a goal state, shape (n,)."""
        return self.numbering.where(self.task.goal)

    @cached_property
    def transitions(self) -> Transitions:
        """The transitions of all states, built when first used."""
        small = self.size <= np.iinfo(np.int32).max
        rows = Transitions(
            np.zeros(self.size + 1, dtype=np.int64),
            np.empty(self.transition_count, dtype=np.int32),
            np.empty(self.transition_count, dtype=np.int32 if small else np.int64),
        )
        self.check(sum(array.nbytes for array in rows))
        state = row = 0
        for counts, actions, targets in self.numbering.transitions():
            rows.offsets[state + 1 : state + 1 + len(counts)] = row + np.cumsum(counts)
            rows.actions[row : row + len(actions)] = actions
            rows.targets[row : row + len(actions)] = targets
            state, row = state + len(counts), row + len(actions)
        for array in rows:
            array.flags.writeable = False
        return rows

    @cached_property
    def costs(self) -> Ints:
        """Cost of each transition, shape (m,)."""
        return np.asarray(self.task.costs, dtype=np.int64)[self.transitions.actions]

    @cached_property
    def sources(self) -> Ints:
        """State in which each transition starts, shape (m,)."""
        return np.repeat(np.arange(self.size), np.diff(self.transitions.offsets))

    def numbers(self, values: ArrayLike) -> Ints:
        """Return the numbers, shape (N,), of the states with the given values, shape (N, variables).

        Raises
        ------
        KeyError
            A state is not reachable.
        """
        array = np.asarray(values)
        if array.ndim != 2 or array.shape[1] != len(self.task.variables):
            raise KeyError(f"values of shape {array.shape}; expected (N, {len(self.task.variables)})")
        if array.size and array.dtype.kind not in "iu":
            raise KeyError(f"values are integers, not {array.dtype}")
        array = array.astype(np.int64, copy=False)
        numbers = self.numbering.numbers(array)
        if (numbers < 0).any():
            raise KeyError(tuple(array[int(np.argmax(numbers < 0))].tolist()))
        return numbers

    def values(self, states: ArrayLike) -> Ints:
        """Return the values, shape (N, variables), of states, shape (N,).

        Raises
        ------
        IndexError
            One of them is not the number of a state.
        """
        return self.numbering.values(state_numbers(states, self.size).reshape(-1))

    def choices(self, states: ArrayLike) -> Transitions:
        """Return the transitions of some states, shape (N,), without building those of all states."""
        return joined(self.numbering.transitions(state_numbers(states, self.size).reshape(-1)))

    def facts(self, state: int) -> list[str]:
        """Return the PDDL atoms that hold in a state, among those that can change."""
        return self.task.facts(self.values([state])[0].tolist())

    def options(self, state: int) -> dict[str, int]:
        """Return the applicable ground actions of a state in PDDL notation, each with its successor."""
        rows = self.choices([state])
        names = (self.task.actions[action] for action in rows.actions)
        return dict(zip(names, rows.targets.tolist(), strict=True))

    def follow(self, plan: Sequence[str], state: int | None = None) -> int:
        """Return the state after a sequence of ground actions, from the initial state unless another is given.

        Parameters
        ----------
        plan : sequence of str
            Actions as `(name argument ...)`, `name argument ...` or `name(argument, ...)`.
        state : int, optional

        Raises
        ------
        ValueError
            An action is not applicable in its state.
        TypeError
            The plan is one text.
        """
        if isinstance(plan, str):
            raise TypeError(f"plan {plan!r}: expected a list of actions, such as [{plan!r}]")
        at = self.initial if state is None else state
        for step, action in enumerate(plan):
            options = self.options(at)
            after = options.get(action, options.get(_in_pddl(action)))
            if after is None:
                raise ValueError(
                    f"step {step}: {action} is not applicable; applicable are {', '.join(options) or 'no actions'}"
                )
            at = after
        return at


def _in_pddl(action: str) -> str:
    """Return an action of any notation as `(name argument ...)`."""
    words = re.findall(r"[^\s(),]+", action.lower())
    return f"({' '.join(words)})"


UNREACHED = np.iinfo(np.int64).max
"""Distance of states from which no goal state is reachable."""

EXACT = 1 << 53
"""Distances must stay below this, since they are handed on as floats, which are exact up to it."""


def smallest_type(largest: int) -> type[np.unsignedinteger]:
    """Return the smallest type for distances up to `largest`; its own largest value is reserved for dead ends."""
    types: tuple[type[np.unsignedinteger], ...] = (np.uint8, np.uint16, np.uint32, np.uint64)
    return next(t for t in types if largest < np.iinfo(t).max)


def is_dead_end(distance: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Return whether each distance marks a dead end, as the largest value of its type does."""
    return np.asarray(distance == np.iinfo(distance.dtype).max)


def retyped(distance: NDArray[np.integer], dtype: type[np.unsignedinteger]) -> NDArray[np.unsignedinteger]:
    """Return distances in another type; the largest value of each type marks dead ends."""
    result = distance.astype(dtype)
    result[is_dead_end(distance)] = np.iinfo(dtype).max
    return result


def compact(distance: NDArray[np.integer]) -> NDArray[np.unsignedinteger]:
    """Return distances in the smallest type; the largest value of each type marks dead ends."""
    return retyped(distance, smallest_type(int(distance.max(where=~is_dead_end(distance), initial=0))))


def as_floats(distance: NDArray[np.unsignedinteger]) -> NDArray[np.float64]:
    """Return distances as floats: infinite at dead ends."""
    return np.where(is_dead_end(distance), np.inf, distance)


def plan_lengths(targets: NDArray[np.signedinteger], sources: Ints, goal: NDArray[np.bool_]) -> Ints:
    """Return the least number of edges from every state to a goal state; `UNREACHED` where there is no path.

    The edges lead from `sources` to `targets`, shape (m,); `goal` has shape (states,).
    """
    from scipy.sparse import csr_array  # slow to import
    from scipy.sparse.csgraph import dijkstra

    into = csr_array((np.ones(len(targets)), (targets, sources)), shape=(len(goal), len(goal)))
    lengths = dijkstra(into, indices=np.flatnonzero(goal), unweighted=True, min_only=True)
    reached, found = np.isfinite(lengths), np.full(len(goal), UNREACHED)
    found[reached] = lengths[reached]
    return found
