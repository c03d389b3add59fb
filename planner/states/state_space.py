"""Every reachable state of a task, numbered, and what each action leads to.

A `StateSpace` is what a sweep finds: how many states there are, which number each has, and, only when asked
for, the choices of all of them. How states are numbered is behind the `StateIndex` that it holds: `listing`
keeps the packed states themselves, in the order in which they are found; `sweep` has a more compact one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..grounding.task import Fact, Task
from ..system.arrays import outline
from .packing import Ints, Packing
from .successors import Successors, Transitions

BLOCK = 1 << 13
"""States whose values are looked at together: those of more would not stay in the processor's cache."""


def state_numbers(states: ArrayLike, count: int) -> Ints:
    """Return numbers of states as an array of their shape, each below the count of all states.

    Raises
    ------
    IndexError
        One of them is not the number of a state.
    """
    array = np.asarray(states)
    if array.size and array.dtype.kind not in "iu":
        raise IndexError(f"states are numbered by integers, not by {array.dtype}")
    if array.size and not 0 <= array.min() <= array.max() < count:
        raise IndexError(f"states are numbered from 0 to {count - 1}")
    return array.astype(np.int64, copy=False)


class StateIndex(Protocol):
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
    numbering: StateIndex

    __repr__ = outline

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
        """Give the values, shape (N, variables), of states of shape (N,).

        Raises
        ------
        IndexError
            One of them is not the number of a state.
        """
        return self.numbering.values(state_numbers(states, self.size).reshape(-1))

    def choices(self, states: ArrayLike) -> Transitions:
        """Give the choices of some states, shape (N,), as compressed rows, without building those of all."""
        packing = self._successors.packing
        offsets, actions, after = self._successors.choices(packing.pack(self.values(states)))
        parts = [after[at : at + BLOCK] for at in range(0, len(after) or 1, BLOCK)]
        return Transitions(offsets, actions, np.concatenate([self.numbers(packing.unpack(part)) for part in parts]))

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
