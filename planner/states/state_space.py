"""The reachable states of a task, numbered, with their transitions.

A `StateSpace` is the result of a sweep: the number of states, the number of each state, and, computed when first used,
the transitions of all states. A `StateIndex` defines the numbering. `RegistryIndex` stores the packed states in the
order of their discovery. `RankedIndex` is more compact.
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


def state_numbers(states: ArrayLike, count: int) -> Ints:
    """Return state numbers as an int64 array of the same shape, after checking their range.

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
    """A numbering of the reachable states, as a `StateSpace` needs it."""

    def numbers(self, values: Ints) -> Ints:
        """Return the numbers of the states with the given values, shape (n, variables); -1 where there is none."""

    def values(self, numbers: Ints) -> Ints:
        """Return the values, shape (n, variables), of states, shape (n,)."""

    def where(self, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        """Return whether the facts hold in each state, shape (states,)."""

    def transitions(self, states: int, transitions: int) -> Transitions:
        """Build the transitions of all states; the arguments are the numbers of states and of transitions."""


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
        """Whether each state is a goal state, shape (n,)."""
        return self.numbering.where(self.task.goal)

    @cached_property
    def transitions(self) -> Transitions:
        """The transitions of all states, built when first used."""
        rows = self.numbering.transitions(self.size, self.transition_count)
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

    @cached_property
    def _successors(self) -> Successors:
        return Successors(self.task, Packing.of(self.task))

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
        packing = self._successors.packing
        offsets, actions, after = self._successors.choices(packing.pack(self.values(states)))
        block = 1 << 13  # states that are unpacked and numbered at a time, so that they fit the processor's cache
        parts = [after[at : at + block] for at in range(0, len(after) or 1, block)]
        return Transitions(offsets, actions, np.concatenate([self.numbers(packing.unpack(part)) for part in parts]))

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

        Raises
        ------
        ValueError
            An action is not applicable in its state.
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
