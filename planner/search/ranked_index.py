"""States numbered by their rank among all reachable ranks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Fact
from ..states.packing import Ints
from ..states.successors import Transitions
from .bucket_dijkstra import Searches
from .kernels import expansion, ranked_states, unranking
from .kernels.ranked_states import States


@dataclass(frozen=True)
class Indexed:
    """States numbered by their index."""

    searches: Searches
    states: States

    def numbers(self, values: NDArray[np.int64]) -> Ints:
        """Give the states with values of shape (n, variables), -1 where there is none."""
        out = np.empty(len(values), dtype=np.int64)
        ranked_states.numbers_of(self.states, self.searches.coding.encode(values), out)
        return out

    def values(self, numbers: Ints) -> NDArray[np.int64]:
        """Give the values, shape (n, variables), of states of shape (n,)."""
        index = np.empty(len(numbers), dtype=np.int64)
        ranked_states.select(self.states, numbers, index)
        return self.searches.coding.decode(index)

    def where(self, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        """Tell of every state, shape (states,), whether facts hold."""
        coding, parts = self.searches.coding, [np.empty(0, dtype=bool)]
        for block in self.searches.blocks(self.states):
            parts.append(np.empty(len(block), dtype=bool))
            unranking.mark(coding.decoder, block, *coding.packing.condition(facts), parts[-1])
        return np.concatenate(parts)

    def transitions(self, states: int, transitions: int) -> Transitions:
        """Build the choices of all states; the arguments are how many there are of both."""
        needed = 8 * states + 12 * transitions
        self.searches.budget.check_memory(needed)
        small = states <= np.iinfo(np.int32).max
        rows = Transitions(
            np.zeros(states + 1, dtype=np.int64),
            np.empty(transitions, dtype=np.int32),
            np.empty(transitions, dtype=np.int32 if small else np.int64),
        )
        number = 0
        for block in self.searches.blocks(self.states):
            expansion.fill_transitions(
                self.searches.forward, self.searches.coding.decoder, self.states, block, number, *rows
            )
            number += len(block)
        return rows
