"""A numbering of states by the order of their ranks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Fact
from ..states.packing import Ints
from ..states.successors import Transitions
from ..system.limits import Budget
from .forward_search import RANKS_AT_A_TIME
from .kernels import expansion, ranked_states, unranking
from .kernels.ranked_states import RankSet
from .kernels.ranked_successors import RankedOperators
from .ranking.state_ranking import StateRanking


@dataclass(frozen=True)
class RankedIndex:
    """Reachable states, numbered in the order of their ranks.

    Attributes
    ----------
    coding : StateRanking
    operators : RankedOperators
    budget : Budget
        Limits for building the transitions of all states.
    states : RankSet
        The ranks of all reachable states.
    """

    coding: StateRanking
    operators: RankedOperators
    budget: Budget
    states: RankSet

    def __len__(self) -> int:
        return int(self.states.ranks[-1]) if len(self.states.bits) else len(self.states.members)

    def numbers(self, values: NDArray[np.int64]) -> Ints:
        """Return the numbers of the states with the given values, shape (n, variables); -1 where there is none."""
        out = np.empty(len(values), dtype=np.int64)
        ranked_states.numbers_of(self.states, self.coding.encode(values), out)
        return out

    def values(self, numbers: Ints) -> NDArray[np.int64]:
        """Return the values, shape (n, variables), of states, shape (n,)."""
        index = np.empty(len(numbers), dtype=np.int64)
        ranked_states.select(self.states, numbers, index)
        return self.coding.decode(index)

    def blocks(self) -> Iterator[Ints]:
        """Yield the ranks of all states in ascending order, in blocks."""
        start, end = 0, len(self.states.bits) or len(self.states.members)
        while start < end:
            out = np.empty(RANKS_AT_A_TIME, dtype=np.int64)
            start, filled = ranked_states.list_members(self.states, start, out)
            yield out[:filled]

    def where(self, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        """Return whether the facts hold in each state, shape (states,)."""
        coding, parts = self.coding, [np.empty(0, dtype=bool)]
        for block in self.blocks():
            parts.append(np.empty(len(block), dtype=bool))
            unranking.mark(coding.decoder, block, *coding.packing.condition(facts), parts[-1])
        return np.concatenate(parts)

    def transitions(self, states: int, transitions: int) -> Transitions:
        """Build the transitions of all states; the arguments are the numbers of states and of transitions."""
        needed = 8 * states + 12 * transitions
        self.budget.check_memory(needed)
        small = states <= np.iinfo(np.int32).max
        rows = Transitions(
            np.zeros(states + 1, dtype=np.int64),
            np.empty(transitions, dtype=np.int32),
            np.empty(transitions, dtype=np.int32 if small else np.int64),
        )
        number = 0
        for block in self.blocks():
            expansion.fill_transitions(self.operators, self.coding.decoder, self.states, block, number, *rows)
            number += len(block)
        return rows
