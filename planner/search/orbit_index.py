"""A numbering of orbits: a state registry of canonical states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Fact
from ..states.packing import Ints, Words
from ..states.successors import Transitions
from .kernels import state_hash
from .state_registry import RegistryIndex
from .successor_generator import expanded
from .symmetry.canonical_states import Forms, canonical


@dataclass(frozen=True)
class OrbitIndex:
    """Orbits of states under the symmetries of a task, numbered by their canonical states.

    Attributes
    ----------
    forms : Forms
        The symmetries, as `canonical` applies them.
    found : RegistryIndex
        The canonical state of each orbit.
    """

    forms: Forms
    found: RegistryIndex

    def rows(self, states: Words) -> Ints:
        """Return the numbers of the orbits of packed states, shape (n, words); -1 for unknown orbits."""
        own = states.copy()
        canonical(self.forms, own)
        rows = np.empty(len(own), dtype=np.int64)
        state_hash.look_up(self.found.slots, self.found.states, own, rows)
        return rows

    def numbers(self, values: Ints) -> Ints:
        """Return the orbits of states with values of shape (n, variables); -1 for unknown orbits."""
        sizes = np.diff(self.forms.first, append=len(self.forms.at))
        legal = np.all((values >= 0) & (values < sizes), axis=1)
        return np.where(legal, self.rows(self.found.packing.pack(np.where(legal[:, None], values, 0))), -1)

    def values(self, numbers: Ints) -> Ints:
        """Return the values, shape (n, variables), of the canonical states of orbits of shape (n,)."""
        return self.found.values(numbers)

    def where(self, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        """Return whether facts hold in each canonical state, shape (orbits,)."""
        return self.found.where(facts)

    def transitions(self, states: int, transitions: int) -> Transitions:  # noqa: ARG002
        """Return the transitions of all canonical states; each leads to the orbit of its successor."""
        counts, actions, after = (
            np.concatenate(parts) for parts in zip(*expanded(self.found.book, self.found.states), strict=True)
        )
        return Transitions(np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]), actions, self.rows(after))
