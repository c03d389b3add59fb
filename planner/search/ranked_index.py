"""The compiled search through all states of a task of any size: ranked if the task allows it, else with a registry.

Ranked states are numbered in the order of their ranks. The reachable ranks are a bitmap, on which the search works.
"""

from __future__ import annotations

import math
import mmap
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Fact, Task
from ..system.arrays import Ints, Words
from ..system.errors import UnsuitedError
from ..system.limits import Budget, LimitError, MemoryLimitError
from ..system.processes import on_threads
from ..system.progress import Progress
from .invariants import Mutexes
from .kernels import block_steps, ranked_successors, state_sets
from .kernels.ranked_successors import RankedOperators
from .kernels.state_sets import RankSet
from .numbering import LOOKING, MANY, TOO_MUCH_MEMORY, SweepOptions, TNFOperator, moves_and_groups
from .search_space import SearchSpace, explore, relaxed
from .state_ranking import StateRanking
from .state_registry import RegistrySpace
from .state_space import Part
from .successor_generator import ranked_operators

RANKS_AT_A_TIME = 1 << 16
"""Ranks in a block of the frontier, which is the unit of a thread's work and of checks of limits."""

TRANSITIONS_AT_A_TIME = 1 << 18
"""Most transitions that are built at once, so that they fit the processor's cache."""

CLOSED_BITMAP_SHARE = 0.75
"""Share of the available memory up to which the backward search uses a bitmap of closed ranks. The bitmap saves time.
"""


def _small_pages(length: int, dtype: Any) -> NDArray[Any]:
    """Return zeros in small pages of memory, of which only those that are written to take memory.

    The pages of `np.zeros` have 2 MB where the system allows it. A bitmap in them is faster, but a sparse one takes
    several times as much memory.
    """
    try:
        pages = mmap.mmap(-1, length * np.dtype(dtype).itemsize, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    except OSError as error:
        raise MemoryError(str(error)) from None
    return np.frombuffer(pages, dtype=dtype)


@dataclass(frozen=True)
class RankedIndex:
    """Reachable states, numbered in the order of their ranks."""

    coding: StateRanking
    operators: RankedOperators
    budget: Budget
    """Limits for building the transitions of all states."""
    states: RankSet
    """The ranks of all reachable states."""

    def __len__(self) -> int:
        return int(self.states.before[-1])

    def numbers(self, values: NDArray[np.int64]) -> Ints:
        """Return the numbers of the states with the given values, shape (n, variables); -1 where there is none."""
        out = np.empty(len(values), dtype=np.int64)
        state_sets.numbers_of(self.states, self.coding.encode(values), out)
        return out

    def values(self, numbers: Ints) -> NDArray[np.int64]:
        """Return the values, shape (n, variables), of states, shape (n,)."""
        return self.coding.decode(self._ranks(numbers))

    def _ranks(self, numbers: Ints) -> Ints:
        ranks = np.empty(len(numbers), dtype=np.int64)
        state_sets.select(self.states, numbers, ranks)
        return ranks

    def blocks(self) -> Iterator[Ints]:
        """Yield the ranks of all states in ascending order, in blocks."""
        start = 0
        while start < len(self.states.bits):
            out = np.empty(RANKS_AT_A_TIME, dtype=np.int64)
            start, filled = state_sets.list_members(self.states, start, out)
            yield out[:filled]

    def _holding(self, ranks: Ints, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        marks = np.empty(len(ranks), dtype=bool)
        ranked_successors.mark(self.coding.decoder, ranks, *self.coding.packing.condition(facts), marks)
        return marks

    def where(self, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        """Return whether the facts hold in each state, shape (states,)."""
        return np.concatenate([np.empty(0, dtype=bool), *(self._holding(block, facts) for block in self.blocks())])

    def ranks_where(self, facts: Sequence[Fact]) -> Iterator[Ints]:
        """Yield, in blocks, the ranks of the states in which the facts hold."""
        # Largest number of ranks that are tested one by one as goal states. Beyond it, all states are scanned.
        most_candidates = 1 << 26
        blocks: Iterable[Ints] = self.blocks()
        candidates = self.coding.matching(facts, min(len(self), most_candidates))
        if candidates is not None:  # at most as many as states
            numbers = np.empty(len(candidates), dtype=np.int64)
            state_sets.numbers_of(self.states, candidates, numbers)
            blocks = [candidates[numbers >= 0]]
        for block in blocks:
            self.budget.check_time(len(self))
            yield block[self._holding(block, facts)]

    def transitions(self, numbers: Ints | None = None) -> Iterator[Part]:
        """Yield the transitions of states, shape (n,), in parts; by default those of all states, in order."""
        most = self.operators.tree.most
        size = max(1, TRANSITIONS_AT_A_TIME // most)
        for block in self.blocks() if numbers is None else [self._ranks(numbers)]:
            for at in range(0, len(block), size):
                ranks = block[at : at + size]
                counts, actions = np.empty(len(ranks), np.int32), np.empty(len(ranks) * most, np.int32)
                targets = np.empty(len(actions), np.int64)
                filled = block_steps.fill_transitions(
                    self.operators, self.coding.decoder, self.states, ranks, counts, actions, targets
                )
                yield counts, actions[:filled], targets[:filled]


class RankedSpace:
    """The states of a task by their ranks, for a search; `inverse` are the moves in the opposite direction.

    If the bitmap does not fit the memory, the constructor raises a `MemoryLimitError`.
    """

    def __init__(
        self,
        coding: StateRanking,
        operators: RankedOperators,
        inverse: RankedOperators,
        budget: Budget,
        initial: Sequence[int],
    ) -> None:
        words = -(-coding.size // 512) * 8
        budget.check_memory(9 * words)
        zeros = np.zeros if coding.size <= MANY else _small_pages
        before = np.empty(-(-words // 1024) + 1, dtype=np.int64)
        states = RankSet(zeros(words, np.uint64), before, zeros(words // 8, np.uint16))
        self.index = RankedIndex(coding, operators, budget, states)
        self.transitions = self._found = 0
        self._inverse, self._initial = inverse, initial
        self.costs, self._kinds = np.unique(inverse.cost, return_inverse=True)
        self._closed = np.empty(0, dtype=np.uint64)

    def __len__(self) -> int:
        return self._found

    @property
    def nbytes(self) -> float:
        """Bytes in use."""
        return sum(array.nbytes for array in self.index.states) + self._closed.nbytes

    @cached_property
    def initial(self) -> int:
        """Number of the initial state."""
        return int(self.index.numbers(np.array([self._initial]))[0])

    def start(self) -> list[Ints]:
        """Return the rank of the initial state."""
        rank = self.index.coding.encode(self._initial)
        self.index.states.bits[rank >> 6] = np.uint64(1) << (rank & 63).astype(np.uint64)
        self._found = 1
        return [rank]

    def blocks(self, layer: list[Ints], threads: int) -> deque[Ints]:
        """Return a layer as blocks of ascending ranks; the given list is emptied.

        For ascending ranks, the targets of each operator ascend as well. This causes far fewer cache and page misses.
        """

        def ascending(run: list[Ints]) -> list[Ints]:
            ranks = np.concatenate(run)
            run.clear()
            ranks.sort()
            return np.split(ranks, range(RANKS_AT_A_TIME, len(ranks), RANKS_AT_A_TIME))

        parts = 1 if sum(map(len, layer)) <= RANKS_AT_A_TIME else min(threads, len(layer))
        runs = [layer[start::parts] for start in range(parts)]
        layer.clear()
        # Blocks of different runs alternate, so that each run is processed in its order.
        mixed = zip_longest(*on_threads(ascending, runs, threads))
        return deque(block for group in mixed for block in group if block is not None)

    def _new(self, operators: RankedOperators, closed: Words, block: Ints) -> list[tuple[Ints, int]]:
        """Add the successors of a block, by some operators, to a bitmap; return the new ones and transition counts."""
        out, stop, found = np.empty(max(RANKS_AT_A_TIME, 4 * operators.tree.most), dtype=np.int64), 0, []
        while stop < len(block):
            stop, filled, count = block_steps.expand_block(
                operators, self.index.coding.decoder, closed, block, stop, out
            )
            found.append((out[:filled].copy(), count))
        return found

    def expand(self, block: Ints) -> list[tuple[Ints, int]]:
        """Return the successors of a block that were not visited before, and the numbers of transitions."""
        return self._new(self.index.operators, self.index.states.bits, block)

    def add(self, expanded: list[tuple[Ints, int]]) -> list[Ints]:
        """Count the new states and the transitions; return the ranks of the new states."""
        for ranks, count in expanded:
            self._found += len(ranks)
            self.transitions += count
        return [ranks for ranks, _ in expanded if len(ranks)]

    def finish(self) -> None:
        """Count the states before each block of the bitmap."""
        state_sets.count_states(*self.index.states)

    def begin(self, goal: Sequence[Fact], distance: NDArray[Any]) -> list[Ints]:
        """Set the distance of the goal states to 0, and return their ranks."""
        states, blocks = self.index.states, list(self.index.ranks_where(goal))
        self._closed = np.empty(0, dtype=np.uint64)  # of the search for another goal
        for block in blocks:
            state_sets.label(states, distance, distance.dtype.type(0), block)
        fits = self.nbytes + distance.nbytes + states.bits.nbytes <= self.index.budget.room * CLOSED_BITMAP_SHARE
        # Beyond 128 ranks per state, the bitmap takes more memory than it saves time; a megabyte does not matter.
        if fits and 64 * len(states.bits) <= 128 * max(len(self), 1 << 16):
            self._closed = np.empty(len(states.bits), dtype=np.uint64)
            state_sets.close(states, distance, np.iinfo(distance.dtype).max, self._closed)
        return blocks

    def settle(self, block: Ints, d: Any, distance: NDArray[Any], costs: NDArray[Any]) -> list[tuple[int, Ints]]:
        """Relax the moves into the states of a block at distance `d`.

        For a single positive cost, states get their distance here: it is final as soon as they are closed. This needs
        no look-up of predecessors.
        """
        states, decoder = self.index.states, self.index.coding.decoder
        if len(self._closed) and len(costs) == 1 and costs[0]:
            state_sets.label(states, distance, d, block)
            return [(0, ranks) for ranks, _ in self._new(self._inverse, self._closed, block) if len(ranks)]
        relax = partial(
            block_steps.relax_moves, self._inverse, decoder, states, self._closed, self._kinds, costs, distance
        )
        return relaxed(relax, block, d, max(RANKS_AT_A_TIME, 4 * self._inverse.tree.most), len(costs))


def explored(
    task: Task, budget: Budget, threads: int, progress: Progress, options: SweepOptions
) -> tuple[SearchSpace, str | None]:
    """Return the space of all reachable states, and a note.

    The note is None, or says why a slower search without a ranking was used.
    """

    def registry(most: float = math.inf) -> SearchSpace | None:
        return explore(RegistrySpace(task, budget), budget, threads, progress, most)

    try:
        space: SearchSpace | None = None
        moves, coding = _plain(task, budget)
        if coding is None or coding.size > options.small_bitmap:
            most = options.most_by_layer(task, len(moves), math.inf if coding is None else coding.size)
            with suppress(MemoryLimitError, MemoryError):  # a ranked search may need less memory
                space = registry(most)
        if space is None:
            moves, dense = _denser(task, coding, moves, budget, options.ranking_share)
            if dense.size > MANY:
                with suppress(MemoryLimitError, MemoryError):
                    space = registry(dense.size // options.ranks_per_transition)
        if space is None:
            space = explore(_ranked(task, dense, moves, budget), budget, threads, progress)
        assert space is not None
        return space, None
    except UnsuitedError as error:
        space = registry()
        assert space is not None
        return space, f"swept without a ranking, which takes some ten times as long as with one: {error}"


def _plain(task: Task, budget: Budget) -> tuple[list[TNFOperator], StateRanking | None]:
    """Return the moves of a task, and its ranking by single variables if 62 bits suffice."""
    moves, groups = moves_and_groups(task, budget)
    try:
        return moves, StateRanking.of(task, groups, moves, budget.during(LOOKING))
    except (MemoryLimitError, MemoryError):
        raise UnsuitedError(TOO_MUCH_MEMORY) from None


def _denser(
    task: Task, coding: StateRanking | None, moves: list[TNFOperator], budget: Budget, share: float
) -> tuple[list[TNFOperator], StateRanking]:
    """Return the moves and a ranking with at most as many ranks, a better one if the given one has too many."""
    why = "its states take more than 62 bits each"
    if coding is None or coding.size > MANY:
        part = budget.part(share)
        try:
            mutexes = Mutexes.of(task, moves, part.during(LOOKING))
            if mutexes is not None:
                part = part.beside(mutexes.together.nbytes + mutexes.barred.nbytes)
                found = StateRanking.dense(task, mutexes, part.during(LOOKING))
                if found is not None and (coding is None or found.size < coding.size):
                    return mutexes.moves, found
        except (MemoryLimitError, MemoryError):
            why = TOO_MUCH_MEMORY
        except LimitError:
            budget.during(LOOKING)(0)
            why = "looking for a ranking took too long"
    if coding is None:
        raise UnsuitedError(why)
    return moves, coding


def _ranked(task: Task, coding: StateRanking, moves: list[TNFOperator], budget: Budget) -> RankedSpace:
    """Return the space of the ranked states, with the layout of the operators in both directions."""
    left = budget.beside(coding.decoder.rows.nbytes)  # these tables are in use throughout the search
    both: list[RankedOperators] = []
    try:
        for own in (moves, [move.inverse() for move in moves]):
            both.append(ranked_operators(own, coding, task.costs, left.during("operators were laid out")))
            left = left.beside(both[-1].table.nbytes + both[-1].candidates.sets.nbytes)
        return RankedSpace(coding, both[0], both[1], left, task.initial)
    except (MemoryLimitError, MemoryError):
        raise UnsuitedError("its ranking takes too much memory") from None
