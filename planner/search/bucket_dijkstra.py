"""Distances of all reachable states from the goal, by a backward search in ascending order of distance.

`BucketDijkstra` is for ranked states. It applies the inverse operators, so that no transitions are stored. It processes
sorted blocks of ranks on several threads. `settled` is for states in a registry, whose transitions are stored.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Fact, Task
from ..states.packing import Ints, Words
from ..system.limits import Budget
from ..system.progress_reports import Progress
from .distances import UNREACHED, compact, smallest_type
from .forward_search import RANKS_AT_A_TIME, ExploredGraph, ForwardSearch, Push
from .kernels import expansion, ranked_states, relaxation, unranking
from .kernels.ranked_states import RankSet
from .kernels.ranked_successors import RankedOperators
from .ranked_index import RankedIndex
from .successor_generator import STATES_AT_A_TIME

MOST_CANDIDATES = 1 << 26
"""Largest number of ranks that are tested one by one as goal states. Beyond it, all states are scanned."""

CLOSED = 0.75
"""Share of the available memory up to which the backward search uses a bitmap of closed ranks. The bitmap saves time.
"""


@dataclass(frozen=True)
class BucketDijkstra:
    """Backward search on ranks: bucket Dijkstra (Dial 1969), or breadth first if costs are equal and positive.

    Attributes
    ----------
    forward : ForwardSearch
        The search of the reachable states, whose limits, threads and checkpoint this search shares. Only breadth-first
        searches write checkpoints.
    operators : RankedOperators
        The inverse operators.
    """

    forward: ForwardSearch
    operators: RankedOperators

    @property
    def _budget(self) -> Budget:
        return self.forward.budget

    def solve(self, initial: int, goal: Sequence[Fact]) -> tuple[RankedIndex, int, NDArray[np.unsignedinteger]]:
        """Return the reachable states, the number of transitions, and the distance of each state from the goal.

        The largest value of the distances' type marks dead ends.
        """
        checkpoint = self.forward.checkpoint
        kept = checkpoint.load("backward") if checkpoint else None
        if kept is None:
            states, transitions = self.forward.reach(initial)
        else:
            states, transitions = self.forward.ranked(kept[1]["bits"]), kept[0]["transitions"]
        index = RankedIndex(self.forward.coding, self.forward.operators, self.forward.budget, states)
        total = len(index)
        costs = np.unique(self.operators.cost)
        if len(costs) > 1 or not costs.all():
            distance = self._any_costs(states, total, list(self._with(index, goal)), int(costs.max()))
        elif kept is None:
            frontier = list(self._with(index, goal))
            distance = self._equal_costs(states, transitions, frontier, int(costs.sum()) or 1)
        else:
            frontier = [kept[1]["frontier"]]
            so_far = kept[1]["distance"], kept[0]["d"]
            distance = self._equal_costs(states, transitions, frontier, int(costs.sum()) or 1, so_far)
        if checkpoint:
            checkpoint.remove()
        return index, transitions, distance

    def _with(self, index: RankedIndex, facts: Sequence[Fact]) -> Iterator[Ints]:
        """Yield, in blocks, the ranks of the states in which the facts hold."""
        coding, states, total = index.coding, index.states, len(index)
        blocks: Iterable[Ints] = index.blocks()
        candidates = coding.matching(facts, min(total, MOST_CANDIDATES))
        if candidates is not None:  # at most as many as states
            numbers = np.empty(len(candidates), dtype=np.int64)
            ranked_states.numbers_of(states, candidates, numbers)
            blocks = [candidates[numbers >= 0]]
        for block in blocks:
            self._budget.check_time(total)
            marks = np.empty(len(block), dtype=bool)
            unranking.mark(coding.decoder, block, *coding.packing.condition(facts), marks)
            if marks.any():
                yield block[marks]

    def _equal_costs(
        self,
        states: RankSet,
        transitions: int,
        frontier: list[Ints],
        cost: int,
        so_far: tuple[NDArray[Any], int] | None = None,
    ) -> NDArray[Any]:
        """Compute the distances breadth first, from the goal or from the frontier in a checkpoint."""
        total = int(states.ranks[-1]) if len(states.bits) else len(states.members)
        dtype: type[np.unsignedinteger] = np.uint8
        in_use = sum(array.nbytes for array in states) + total
        self._budget.check_memory(in_use)
        if so_far is not None:
            distance, d = so_far
            dtype = distance.dtype.type
        else:
            distance, d = np.full(total, np.iinfo(dtype).max, dtype=dtype), 0
        for block in frontier:
            ranked_states.label(states, distance, d, block)
        done = sum(map(len, frontier)) if so_far is None else int((distance != np.iinfo(dtype).max).sum())
        closed = self._closed(states, distance, in_use)
        in_use += closed.nbytes
        while frontier:
            if self.forward.checkpoint and self.forward.checkpoint.due and len(states.bits):
                arrays = {"bits": states.bits, "distance": distance, "frontier": np.concatenate(frontier)}
                self.forward.checkpoint.save("backward", {"d": d, "transitions": transitions}, arrays)
            d += cost
            if d >= np.iinfo(dtype).max:
                narrow, dtype = np.iinfo(dtype).max, smallest_type(d)
                in_use += distance.itemsize * total * 3
                self._budget.check_memory(in_use)
                wider = distance.astype(dtype)
                wider[distance == narrow] = np.iinfo(dtype).max
                distance = wider
            push: Push
            if len(closed):
                push = partial(self._label_and_spread, states, closed, distance, d - cost)
            else:
                push = partial(
                    expansion.expand_block_back, self.operators, self.forward.coding.decoder, states, distance, d
                )
            frontier, _ = self.forward.next_layer(push, self.operators.most, frontier, in_use, total)
            done += sum(map(len, frontier))
            self.forward.progress("cost-to-go", done, total)
        largest = d - cost  # the last layer was empty
        return distance if largest >= np.iinfo(np.uint8).max else distance.astype(smallest_type(largest), copy=False)

    def _label_and_spread(
        self,
        states: RankSet,
        closed: Words,
        distance: NDArray[Any],
        d: int,
        block: Ints,
        start: int,
        out: Ints,
        filled: int,
    ) -> tuple[int, int, int]:
        """Set the distance of the states of a sorted block, and push the predecessors that are not closed.

        Since the block is sorted, memory accesses for consecutive states are close to each other.
        """
        if start == 0:
            ranked_states.label(states, distance, d, block)
        return expansion.expand_block(self.operators, self.forward.coding.decoder, closed, block, start, out, filled)

    def _closed(self, states: RankSet, distance: NDArray[Any], in_use: int) -> Words:
        """Return the bitmap of ranks that the backward search can skip; an empty array if memory is short."""
        fits = in_use + states.bits.nbytes <= self._budget.room * CLOSED
        closed = np.empty(len(states.bits) if fits else 0, dtype=np.uint64)
        if len(closed):
            ranked_states.close(states, distance, np.iinfo(distance.dtype).max, closed)
        return closed

    def _any_costs(self, states: RankSet, total: int, frontier: list[Ints], largest: int) -> NDArray[Any]:
        """Settle the states in ascending order of distance (Dial 1969); costs may be zero."""
        work: type[np.unsignedinteger] = np.uint32 if largest * total < np.iinfo(np.uint32).max else np.uint64
        in_use = sum(array.nbytes for array in states) + total * (np.dtype(work).itemsize + 4)
        self._budget.check_memory(in_use)
        costs, kinds = np.unique(self.operators.cost, return_inverse=True)
        unreached = np.iinfo(work).max
        distance = np.full(total, unreached, dtype=work)
        for block in frontier:
            ranked_states.label(states, distance, 0, block)
        closed = self._closed(states, distance, in_use)
        in_use += closed.nbytes
        relax = partial(
            relaxation.relax_moves, self.operators, self.forward.coding.decoder, states, closed, kinds, costs, distance
        )
        self.forward.progress("cost-to-go", 0, None)
        waiting = {0: frontier} if frontier else {}
        order = [0] if frontier else []
        held = sum(map(len, frontier))  # ranks that are not yet settled
        while order:
            d = order[0]
            settling = waiting.pop(d, None)
            if settling is None:
                heapq.heappop(order)
                continue
            self._budget.check_memory(in_use + 16 * held)
            blocks = self.forward.ascending(settling, in_use + 8 * held)
            held -= sum(map(len, blocks))

            def settle(_: int, d: int = d, blocks: deque[Ints] = blocks) -> list[tuple[Ints, Ints]]:
                size = max(RANKS_AT_A_TIME, 4 * self.operators.most)
                out, through = np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64)
                pushed: list[tuple[Ints, Ints]] = []
                while blocks:
                    try:
                        block = blocks.popleft()
                    except IndexError:  # another thread took it
                        break
                    self._budget.check_time(total)
                    stop = 0
                    while stop < len(block):
                        stop, filled = relax(block, stop, d, out, through)
                        begin = np.zeros(len(costs) + 2, dtype=np.int64)
                        ordered = np.empty(filled, dtype=np.int64)
                        relaxation.by_kind(out[:filled], through[:filled], begin, ordered)
                        pushed.append((ordered, begin))
                return pushed

            parts = self.forward.share(settle, range(min(self.forward.threads, len(blocks))))
            for ordered, begin in (pair for part in parts for pair in part):
                held += len(ordered)
                for kind in np.flatnonzero(np.diff(begin[:-1])).tolist():
                    value = d + int(costs[kind])
                    if value not in waiting:
                        waiting[value] = []
                        if value != d:
                            heapq.heappush(order, value)
                    waiting[value].append(ordered[begin[kind] : begin[kind + 1]])
        found = distance != unreached
        dtype = smallest_type(int(distance[found].max(initial=0)))
        result = np.full(total, np.iinfo(dtype).max, dtype=dtype)
        result[found] = distance[found]
        return result


def settled(task: Task, listing: ExploredGraph, budget: Budget, progress: Progress) -> NDArray[np.unsignedinteger]:
    """Return the distance of all states from the goal, settled in ascending order (Dial 1969).

    The largest value of the type marks dead ends.
    """
    states = len(listing.counts)
    progress("cost-to-go", 0, None)
    into = np.zeros(states + 2, dtype=np.int64)
    sources, kinds = np.empty_like(listing.targets), np.empty_like(listing.kinds)
    relaxation.transpose(listing.counts, listing.targets, listing.kinds, into, sources, kinds)
    costs = np.unique(task.costs).astype(np.int64) if task.costs else np.zeros(1, dtype=np.int64)
    distance = np.full(states, UNREACHED, dtype=np.int64)
    goal = np.flatnonzero(listing.found.where(task.goal))
    distance[goal] = 0
    room = max(16 * STATES_AT_A_TIME, int(np.diff(into[:-1]).max(initial=1)))
    waiting = {0: [goal]}
    order = [0]
    while order:
        d = order[0]
        if d not in waiting:
            heapq.heappop(order)
            continue
        for block in waiting.pop(d):
            stop = 0
            while stop < len(block):
                budget.check_time(states)
                out, through = np.empty(room, dtype=np.int64), np.empty(room, dtype=np.int64)
                stop, filled = relaxation.relax_stored(
                    into, sources, kinds, costs, distance, block, stop, d, out, through
                )
                begin, ordered = np.zeros(len(costs) + 2, dtype=np.int64), np.empty(filled, dtype=np.int64)
                relaxation.by_kind(out[:filled], through[:filled], begin, ordered)
                for kind in np.flatnonzero(np.diff(begin[:-1])).tolist():
                    value = d + int(costs[kind])
                    if value not in waiting:
                        waiting[value] = []
                        if value != d:
                            heapq.heappush(order, value)
                    waiting[value].append(ordered[begin[kind] : begin[kind + 1]])
    return compact(distance)
