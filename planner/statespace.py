"""Every reachable state of a task, numbered, and what each action leads to.

A `StateSpace` is what a sweep finds: how many states there are, which number each has, and, only when asked
for, the choices of all of them. How states are numbered is behind the `Numbering` that it holds: `Listed`
here keeps the packed states themselves, in breadth-first order; `sweep` has a more compact one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .fast_downward import LimitError
from .reports import Progress
from .successors import Ints, Packing, Successors, Transitions, Words, distinct, holds
from .task import Fact, Task


class Numbering(Protocol):
    """How states are numbered: what a `StateSpace` needs of any way to enumerate them."""

    def numbers(self, values: Ints) -> Ints:
        """Give the states with values of shape (n, variables), -1 where there is none."""

    def values(self, numbers: Ints) -> Ints:
        """Give the values, shape (n, variables), of states of shape (n,)."""

    def where(self, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        """Tell of every state, shape (states,), whether facts hold."""

    def transitions(self, states: int, transitions: int) -> Transitions:
        """Build the choices of all states; the arguments are how many there are of both."""


@dataclass(frozen=True)
class StateSpace:
    """All states that a task can reach.

    Attributes
    ----------
    task : Task
    size : int
        How many there are; they are numbered from 0.
    initial : int
        The number of the initial state.
    transition_count : int
        Ground actions applicable in a state, added up over all states.
    numbering : Numbering
        What is behind the methods.
    """

    task: Task
    size: int
    initial: int
    transition_count: int
    numbering: Numbering

    def __len__(self) -> int:
        return self.size

    @cached_property
    def goal(self) -> NDArray[np.bool_]:
        """Which states are goal states, shape (n,)."""
        return self.numbering.where(self.task.goal)

    @cached_property
    def transitions(self) -> Transitions:
        """The choices of all states, built when they are first asked for."""
        rows = self.numbering.transitions(self.size, self.transition_count)
        for array in rows:
            array.flags.writeable = False
        return rows

    @cached_property
    def costs(self) -> Ints:
        """The cost of each choice, shape (m,)."""
        return np.asarray(self.task.costs, dtype=np.int64)[self.transitions.actions]

    @cached_property
    def sources(self) -> Ints:
        """The state in which each choice is made, shape (m,)."""
        return np.repeat(np.arange(self.size), np.diff(self.transitions.offsets))

    @cached_property
    def _successors(self) -> Successors:
        return Successors(self.task, Packing.of(self.task))

    def numbers(self, values: ArrayLike) -> Ints:
        """Give the numbers, shape (N,), of the states with values of shape (N, variables).

        Raises
        ------
        KeyError
            One of them is no reachable state.
        """
        array = np.asarray(values, dtype=np.int64)
        if array.ndim != 2 or array.shape[1] != len(self.task.variables):
            raise KeyError(f"values of shape {array.shape}; expected (N, {len(self.task.variables)})")
        numbers = self.numbering.numbers(array)
        if (numbers < 0).any():
            raise KeyError(tuple(array[int(np.argmax(numbers < 0))].tolist()))
        return numbers

    def values(self, states: ArrayLike) -> Ints:
        """Give the values, shape (N, variables), of states of shape (N,).

        Raises
        ------
        IndexError
            One of them is not the number of a state.
        """
        array = np.asarray(states, dtype=np.int64).reshape(-1)
        if len(array) and not 0 <= array.min() <= array.max() < self.size:
            raise IndexError(f"states are numbered from 0 to {self.size - 1}")
        return self.numbering.values(array)

    def choices(self, states: ArrayLike) -> Transitions:
        """Give the choices of some states, shape (N,), as compressed rows, without building those of all."""
        packing = self._successors.packing
        offsets, actions, after = self._successors.choices(packing.pack(self.values(states)))
        return Transitions(offsets, actions, self.numbers(packing.unpack(after)))

    def facts(self, state: int) -> list[str]:
        """Describe a state: the PDDL atoms that hold in it, of those that can change."""
        return self.task.facts(self.values([state])[0].tolist())

    def options(self, state: int) -> dict[str, int]:
        """Give the applicable ground actions of a state in PDDL, each with the state that it leads to."""
        rows = self.choices([state])
        names = (self.task.actions[action] for action in rows.actions)
        return dict(zip(names, rows.targets.tolist(), strict=True))

    def follow(self, plan: Sequence[str], state: int | None = None) -> int:
        """Give the state that a sequence of ground actions leads to, from the initial state unless given.

        Raises
        ------
        ValueError
            An action that is not applicable where its turn comes.
        """
        at = self.initial if state is None else state
        for step, action in enumerate(plan):
            options = self.options(at)
            if action not in options:
                raise ValueError(
                    f"step {step}: {action} is not applicable; applicable are {', '.join(options) or 'no actions'}"
                )
            at = options[action]
        return at


@dataclass(frozen=True)
class Listed:
    """States numbered breadth first, layers in the order of their keys.

    Attributes
    ----------
    packing : Packing
    states : uint64 array, shape (n, words)
    rows : Transitions
    """

    packing: Packing
    states: Words
    rows: Transitions

    @cached_property
    def _sorted(self) -> tuple[NDArray[np.generic], Ints]:
        keys = self.packing.keys(self.states)
        order = np.argsort(keys, kind="stable")
        return keys[order], order

    def numbers(self, values: Ints) -> Ints:
        """Give the states with values of shape (n, variables), -1 where there is none."""
        sizes = np.left_shift(1, self.packing.bits)
        legal = np.all((values >= 0) & (values < sizes), axis=1)
        wanted = self.packing.keys(self.packing.pack(np.where(legal[:, None], values, 0)))
        keys, order = self._sorted
        at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        return np.where(legal & (keys[at] == wanted), order[at], -1)

    def values(self, numbers: Ints) -> Ints:
        """Give the values, shape (n, variables), of states of shape (n,)."""
        return self.packing.unpack(self.states[numbers])

    def where(self, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        """Tell of every state, shape (states,), whether facts hold."""
        return holds(self.states, *self.packing.condition(facts))

    def transitions(self, states: int, transitions: int) -> Transitions:
        """Give the choices of all states."""
        assert (len(self.states), len(self.rows.actions)) == (states, transitions)
        return self.rows


BLOCK = 1 << 14
"""States whose transitions are worked out at a time, between two checks of limits."""


def explore(
    task: Task,
    *,
    max_states: int | None = None,
    check: Callable[[int, int], None] = lambda _states, _transitions: None,
    progress: Progress = lambda *_: None,
) -> StateSpace:
    """Enumerate the reachable states of any task, breadth first, with all transitions in memory.

    Parameters
    ----------
    task : Task
    max_states : int, optional
        The largest number of states that may be stored.
    check : callable, optional
        Called before each `BLOCK` states with how many states and how many transitions there are; it may raise
        `LimitError`.
    progress : callable, optional
        Called after each layer with "states" and how many there are by then.

    Raises
    ------
    LimitError
        More states than `max_states`.
    """
    packing = Packing.of(task)
    successors = Successors(task, packing)
    layer = successors.derive(packing.pack([task.initial]))
    layers = [layer]
    seen = packing.keys(layer)  # sorted
    edges: list[tuple[Ints, NDArray[np.int32], Words]] = []
    first = transitions = 0  # the number of a block's first state, and of the transitions before
    while len(layer):
        fresh: list[tuple[NDArray[np.generic], Words]] = []
        for start in range(0, len(layer), BLOCK):
            check(len(seen), transitions)
            block = layer[start : start + BLOCK]
            rows, actions, after = successors.edges(block)
            edges.append((rows + first, actions, after))
            first, transitions = first + len(block), transitions + len(rows)
            keys, places = np.unique(packing.keys(after), return_index=True)
            at = np.minimum(np.searchsorted(seen, keys), len(seen) - 1)
            new = seen[at] != keys
            fresh.append((keys[new], after[places[new]]))
        keys, places = np.unique(np.concatenate([own for own, _ in fresh]), return_index=True)
        layer = np.concatenate([own for _, own in fresh])[places]
        seen = np.sort(np.concatenate([seen, keys]))
        if max_states is not None and len(seen) > max_states:
            raise LimitError(f"more than {max_states} states")
        layers.append(layer)
        progress("states", len(seen), None)

    states = np.concatenate(layers)
    keys = packing.keys(states)
    order = np.argsort(keys, kind="stable")
    sources, actions, after = (np.concatenate([edge[part] for edge in edges]) for part in range(3))
    kept = distinct(sources, actions)
    targets = order[np.searchsorted(keys[order], packing.keys(after[kept]))]
    offsets = np.concatenate([[0], np.cumsum(np.bincount(sources[kept], minlength=len(states)))]).astype(np.int64)
    numbering = Listed(packing, states, Transitions(offsets, actions[kept], targets))
    return StateSpace(task, len(states), 0, len(kept), numbering)
