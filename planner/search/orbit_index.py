"""A numbering of orbits: a registry of canonical states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..states.packing import Ints, Words
from .state_registry import RegistryIndex
from .symmetry.canonical_states import Forms, canonical


@dataclass(frozen=True)
class OrbitIndex(RegistryIndex):
    """Orbits of states under the symmetries of a task, numbered by their canonical states.

    Transitions are those of the canonical states, and lead to the orbits of their successors.
    """

    forms: Forms
    """The symmetries, as `canonical` applies them."""

    @property
    def sizes(self) -> Ints:
        """Number of values of each variable."""
        return np.diff(self.forms.first, append=len(self.forms.at))

    def rows(self, states: Words) -> Ints:
        """Return the numbers of the orbits of packed states, shape (n, words); -1 for unknown orbits."""
        own = states.copy()
        canonical(self.forms, own)
        return super().rows(own)
