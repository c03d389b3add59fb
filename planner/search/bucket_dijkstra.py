"""The forward and the backward search of a task's states, on indices.

Forward from the initial state and backward from the goal, both work on a sorted block of indices at a time, on several
threads. The set of states is a bitmap over all indices where that is small or well filled, a hash table of indices
where it is not. The backward search applies the inverse moves, so that no transition is stored.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import zip_longest
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Fact, Task
from ..states.packing import Ints, Words
from ..system.limits import Budget
from ..system.progress_reports import Progress
from ..system.threads import on_threads
from .checkpoint import Checkpoint
from .distances import UNREACHED, compact, smallest_type
from .forward_search import Listing
from .kernels import expansion, ranked_states, relaxation, unranking
from .kernels.ranked_states import States
from .kernels.ranked_successors import Tests
from .ranking.state_ranking import Coding
from .successor_generator import STATES_AT_A_TIME

RANKS_AT_A_TIME = 1 << 16
"""Indices in one block of a frontier: the unit of work of a thread, and of the checks of limits."""

MOST_CANDIDATES = 1 << 26
"""Indices that are tried one by one as those of goal states."""

SMALL_BITMAP = 1 << 29
"""Bits of a bitmap that is not worth avoiding (64 MB)."""

SPARSE = 1 << 10
"""Indices per state from which on a larger bitmap gives way to a hash table; tasks with more are rare."""

CLOSED = 0.75
"""Share of the memory that may be in use once the backward search has a bitmap of its own."""

T = TypeVar("T")

Push = Callable[[Ints, int, Ints, int], tuple[int, int, int]]
"""Push the next states from a block: its indices, where to begin, the output and how much of it is in use; given are
how far it came, how much of the output is in use, and how many transitions there were."""


@dataclass(frozen=True)
class Searches:
    """The forward and the backward search of one task.

    Attributes
    ----------
    coding : Coding
    forward, backward : Tests
        The moves and their inverses.
    budget : Budget
    threads : int
    progress : callable
        Called after each layer with "states" or "cost-to-go", and how many states have been found, or have got theirs.
    checkpoint : Checkpoint or None
        Where searches of bitmaps, and breadth-first searches back from the goal, keep what they have found.
    """

    coding: Coding
    forward: Tests
    backward: Tests
    budget: Budget
    threads: int
    progress: Progress
    checkpoint: Checkpoint | None

    def reach(self, initial: int) -> tuple[States, int]:
        """Find the states that can be reached from an index, and count their transitions."""
        nothing = np.empty(0, dtype=np.int64)
        words = -(-self.coding.size // 512) * 8
        found, transitions = 1, 0
        frontier = [np.array([initial])]
        bits = np.empty(0, dtype=np.uint64)
        keys = nothing
        kept = self.checkpoint.load("forward") if self.checkpoint else None
        if kept is not None:
            bits, frontier = kept[1]["bits"], [kept[1]["frontier"]]
            found, transitions = kept[0]["found"], kept[0]["transitions"]
        elif not self._bitmap_fits(words, found):
            keys = self._grown(nothing, 0)
            ranked_states.insert_all(keys, frontier[0])
        while frontier:
            if self.checkpoint and self.checkpoint.due and len(bits):
                counts = {"found": found, "transitions": transitions}
                self.checkpoint.save("forward", counts, {"bits": bits, "frontier": np.concatenate(frontier)})
            if not len(bits) and self._bitmap_fits(words, found):
                bits = np.zeros(words, dtype=np.uint64)
                for block in frontier if not len(keys) else [keys[keys >= 0]]:
                    ranked_states.set_bits(bits, block)
                keys = nothing
            if len(bits):
                push = partial(expansion.spread, self.forward, self.coding.decoder, bits)
                frontier, count = self._layer(push, frontier, bits.nbytes, found)
            else:
                frontier, count, keys = self._hashed_layer(frontier, keys, found)
            transitions += count
            found += sum(map(len, frontier))
            self.progress("states", found, None)
            self.budget.check_states(found)

        if len(bits):
            states = self._ranked(bits)
        else:
            self.budget.check_memory(keys.nbytes * 2 + found * 16)
            members = keys[keys >= 0]
            members.sort()
            numbers = np.empty(len(keys), dtype=np.int64)
            starts = range(0, len(members), RANKS_AT_A_TIME)
            self._share(
                lambda at: ranked_states.number_members(keys, members[at : at + RANKS_AT_A_TIME], at, numbers), starts
            )
            states = States(bits, nothing, members, keys, numbers)
        return states, transitions

    def _ranked(self, bits: Words) -> States:
        """Count the states in a bitmap."""
        self.budget.check_memory(bits.nbytes * 9 / 8)
        nothing = np.empty(0, dtype=np.int64)
        states = States(bits, np.empty(len(bits) // 8 + 1, dtype=np.int64), nothing, nothing, nothing)
        ranked_states.fill_ranks(states.bits, states.ranks)
        return states

    def solve(self, initial: int, goal: Sequence[Fact]) -> tuple[States, int, NDArray[np.unsignedinteger]]:
        """Find the states, count their transitions, and find the distance of all states from the goal.

        The type's largest value marks dead ends.
        """
        kept = self.checkpoint.load("backward") if self.checkpoint else None
        if kept is None:
            states, transitions = self.reach(initial)
        else:
            states, transitions = self._ranked(kept[1]["bits"]), kept[0]["transitions"]
        total = int(states.ranks[-1]) if len(states.bits) else len(states.members)
        costs = np.unique(self.backward.cost)
        if len(costs) > 1 or not costs.all():
            distance = self._any_costs(states, total, list(self._with(states, total, goal)), int(costs.max()))
        elif kept is None:
            frontier = list(self._with(states, total, goal))
            distance = self._equal_costs(states, transitions, frontier, int(costs.sum()) or 1)
        else:
            frontier = [kept[1]["frontier"]]
            so_far = kept[1]["distance"], kept[0]["d"]
            distance = self._equal_costs(states, transitions, frontier, int(costs.sum()) or 1, so_far)
        if self.checkpoint:
            self.checkpoint.remove()
        return states, transitions, distance

    def _bitmap_fits(self, words: int, found: int) -> bool:
        """Whether the states are many enough for a bitmap, and the memory for one and its ranks."""
        bits = 64 * words
        return (bits <= SMALL_BITMAP or bits <= SPARSE * found) and 1.25 * bits / 8 <= self.budget.room

    def _share(self, work: Callable[[Any], T], parts: Iterable[Any]) -> list[T]:
        """Do a piece of work for each part, on all threads."""
        return on_threads(work, parts, self.threads)

    def _ascending(self, frontier: list[Ints], in_use: int) -> deque[Ints]:
        """Put a layer into blocks of ascending indices; empties the list.

        In ascending order, each move's targets ascend as well: far fewer cache and page misses.
        """
        if len(frontier) == 1 and len(frontier[0]) <= RANKS_AT_A_TIME:
            return deque([frontier.pop()])
        indices = sum(map(len, frontier))
        self.budget.check_memory(in_use + 16 * indices)
        if indices <= RANKS_AT_A_TIME:  # too few to start threads for
            layer = np.concatenate(frontier)
            frontier.clear()
            layer.sort()
            return deque([layer])
        runs = [frontier[start :: self.threads] for start in range(min(self.threads, len(frontier)))]
        frontier.clear()

        def blocks(run: list[Ints]) -> list[Ints]:
            layer = np.concatenate(run)
            run.clear()
            layer.sort()
            return np.split(layer, range(RANKS_AT_A_TIME, len(layer), RANKS_AT_A_TIME))

        # Threads take blocks of different runs in turn: each run is read in its order.
        mixed = zip_longest(*self._share(blocks, runs))
        return deque(block for group in mixed for block in group if block is not None)

    def _layer(self, push: Push, frontier: list[Ints], in_use: int, found: int) -> tuple[list[Ints], int]:
        """Give the blocks of the next layer, and the transitions to it; empties the list of the present one."""
        size = max(RANKS_AT_A_TIME, 4 * self.forward.most, 4 * self.backward.most)
        in_use += 8 * sum(map(len, frontier))
        waiting = self._ascending(frontier, in_use)
        pushed: list[Ints] = []

        def work(_: int) -> int:
            out, filled, transitions = np.empty(size, dtype=np.int64), 0, 0
            while waiting:
                try:
                    block = waiting.popleft()
                except IndexError:  # another thread took it
                    break
                self.budget.check_time(found)
                stop = 0
                while True:
                    stop, filled, count = push(block, stop, out, filled)
                    transitions += count
                    if stop == len(block):
                        break
                    pushed.append(out[:filled])
                    self.budget.check_memory(in_use + 8 * size * (len(pushed) + 2 * self.threads))
                    out, filled = np.empty(size, dtype=np.int64), 0
            if filled:
                pushed.append(out[:filled].copy() if filled < size // 2 else out[:filled])
            return transitions

        transitions = sum(self._share(work, range(min(self.threads, len(waiting)))))
        return pushed, transitions

    def _hashed_layer(self, frontier: list[Ints], keys: Ints, found: int) -> tuple[list[Ints], int, Ints]:
        """Do the same with a hash table, and give it too: it is replaced as it fills up."""
        transitions = new = 0
        pushed: list[Ints] = []
        waiting = self._ascending(frontier, keys.nbytes)
        size = max(RANKS_AT_A_TIME, 4 * self.forward.most)
        while waiting:
            self.budget.check_states(found + new)
            room = (len(keys) // 2 - found - new) // self.threads
            if room < self.forward.most:
                keys = self._grown(keys, found + new)
                continue

            def work(room: int, keys: Ints = keys, found: int = found + new) -> tuple[int, int]:
                transitions = own = 0
                while waiting and room - own >= self.forward.most:
                    try:
                        block = waiting.popleft()
                    except IndexError:  # another thread took it
                        break
                    self.budget.check_time(found + own)
                    self.budget.check_memory(keys.nbytes + 8 * size * (len(waiting) + len(pushed) + self.threads))
                    out = np.empty(min(size, room - own), dtype=np.int64)
                    stop, filled, count = expansion.spread_hashed(
                        self.forward, self.coding.decoder, block, 0, keys, room - own, out, 0
                    )
                    if stop < len(block):
                        waiting.appendleft(block[stop:])
                    if filled:
                        pushed.append(out[:filled].copy() if filled < len(out) // 2 else out[:filled])
                    transitions += count
                    own += filled
                return transitions, own

            for count, own in self._share(work, [room] * min(self.threads, len(waiting))):
                transitions += count
                new += own
        return pushed, transitions, keys

    def _grown(self, keys: Ints, held: int) -> Ints:
        """Make a hash table at least twice as large, and large enough for one more state's successors."""
        size = 1 << (max(2 * len(keys), 8 * self.threads * self.forward.most, 1 << 12) - 1).bit_length()
        self.budget.check_memory(keys.nbytes + 8 * held + 8 * size)
        larger = np.full(size, -1, dtype=np.int64)
        ranked_states.insert_all(larger, keys[keys >= 0])
        return larger

    def blocks(self, states: States) -> Iterator[Ints]:
        """List the indices of all states in ascending order, a block at a time."""
        start, end = 0, len(states.bits) or len(states.members)
        while start < end:
            out = np.empty(RANKS_AT_A_TIME, dtype=np.int64)
            start, filled = ranked_states.list_members(states, start, out)
            yield out[:filled]

    def _with(self, states: States, total: int, facts: Sequence[Fact]) -> Iterator[Ints]:
        """List the indices of the states in which facts hold, in blocks."""
        blocks: Iterable[Ints] = self.blocks(states)
        candidates = self.coding.matching(facts, min(total, MOST_CANDIDATES))
        if candidates is not None:  # fewer than there are states
            numbers = np.empty(len(candidates), dtype=np.int64)
            ranked_states.numbers_of(states, candidates, numbers)
            blocks = [candidates[numbers >= 0]]
        for block in blocks:
            self.budget.check_time(total)
            marks = np.empty(len(block), dtype=bool)
            unranking.mark(self.coding.decoder, block, *self.coding.packing.condition(facts), marks)
            if marks.any():
                yield block[marks]

    def _equal_costs(
        self,
        states: States,
        transitions: int,
        frontier: list[Ints],
        cost: int,
        so_far: tuple[NDArray[Any], int] | None = None,
    ) -> NDArray[Any]:
        """Search breadth first, from the goal or from the frontier of the distance that a checkpoint has got to."""
        total = int(states.ranks[-1]) if len(states.bits) else len(states.members)
        dtype: type[np.unsignedinteger] = np.uint8
        in_use = sum(array.nbytes for array in states) + total
        self.budget.check_memory(in_use)
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
            if self.checkpoint and self.checkpoint.due and len(states.bits):
                arrays = {"bits": states.bits, "distance": distance, "frontier": np.concatenate(frontier)}
                self.checkpoint.save("backward", {"d": d, "transitions": transitions}, arrays)
            d += cost
            if d >= np.iinfo(dtype).max:
                narrow, dtype = np.iinfo(dtype).max, smallest_type(d)
                in_use += distance.itemsize * total * 3
                self.budget.check_memory(in_use)
                wider = distance.astype(dtype)
                wider[distance == narrow] = np.iinfo(dtype).max
                distance = wider
            push: Push
            if len(closed):
                push = partial(self._label_and_spread, states, closed, distance, d - cost)
            else:
                push = partial(expansion.spread_back, self.backward, self.coding.decoder, states, distance, d)
            frontier, _ = self._layer(push, frontier, in_use, total)
            done += sum(map(len, frontier))
            self.progress("cost-to-go", done, total)
        largest = d - cost  # the last layer was empty
        return distance if largest >= np.iinfo(np.uint8).max else distance.astype(smallest_type(largest), copy=False)

    def _label_and_spread(
        self,
        states: States,
        closed: Words,
        distance: NDArray[Any],
        d: int,
        block: Ints,
        start: int,
        out: Ints,
        filled: int,
    ) -> tuple[int, int, int]:
        """Give the states of a sorted block their distance, and push the predecessors that are not closed.

        In this order, what is looked up of one state lies beside what is looked up of the next.
        """
        if start == 0:
            ranked_states.label(states, distance, d, block)
        return expansion.spread(self.backward, self.coding.decoder, closed, block, start, out, filled)

    def _closed(self, states: States, distance: NDArray[Any], in_use: int) -> Words:
        """Make the bitmap of the indices that the backward search need not look at; empty where memory is short."""
        fits = in_use + states.bits.nbytes <= self.budget.room * CLOSED
        closed = np.empty(len(states.bits) if fits else 0, dtype=np.uint64)
        if len(closed):
            ranked_states.close(states, distance, np.iinfo(distance.dtype).max, closed)
        return closed

    def _any_costs(self, states: States, total: int, frontier: list[Ints], largest: int) -> NDArray[Any]:
        """Settle the states in the order of their distance (Dial 1969), costs of zero included."""
        work: type[np.unsignedinteger] = np.uint32 if largest * total < np.iinfo(np.uint32).max else np.uint64
        in_use = sum(array.nbytes for array in states) + total * (np.dtype(work).itemsize + 4)
        self.budget.check_memory(in_use)
        costs, kinds = np.unique(self.backward.cost, return_inverse=True)
        unreached = np.iinfo(work).max
        distance = np.full(total, unreached, dtype=work)
        for block in frontier:
            ranked_states.label(states, distance, 0, block)
        closed = self._closed(states, distance, in_use)
        in_use += closed.nbytes
        relax = partial(
            relaxation.relax_moves, self.backward, self.coding.decoder, states, closed, kinds, costs, distance
        )
        self.progress("cost-to-go", 0, None)
        waiting = {0: frontier} if frontier else {}
        order = [0] if frontier else []
        held = sum(map(len, frontier))  # indices that wait
        while order:
            d = order[0]
            settling = waiting.pop(d, None)
            if settling is None:
                heapq.heappop(order)
                continue
            self.budget.check_memory(in_use + 16 * held)
            blocks = self._ascending(settling, in_use + 8 * held)
            held -= sum(map(len, blocks))

            def settle(_: int, d: int = d, blocks: deque[Ints] = blocks) -> list[tuple[Ints, Ints]]:
                size = max(RANKS_AT_A_TIME, 4 * self.backward.most)
                out, through = np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64)
                pushed: list[tuple[Ints, Ints]] = []
                while blocks:
                    try:
                        block = blocks.popleft()
                    except IndexError:  # another thread took it
                        break
                    self.budget.check_time(total)
                    stop = 0
                    while stop < len(block):
                        stop, filled = relax(block, stop, d, out, through)
                        begin = np.zeros(len(costs) + 2, dtype=np.int64)
                        ordered = np.empty(filled, dtype=np.int64)
                        relaxation.by_kind(out[:filled], through[:filled], begin, ordered)
                        pushed.append((ordered, begin))
                return pushed

            parts = self._share(settle, range(min(self.threads, len(blocks))))
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


def settled(task: Task, listing: Listing, budget: Budget, progress: Progress) -> NDArray[np.unsignedinteger]:
    """Find the distance of all states from the goal, in the order of the distances (Dial 1969).

    The type's largest value marks dead ends.
    """
    states = len(listing.counts)
    progress("cost-to-go", 0, None)
    into = np.zeros(states + 2, dtype=np.int64)
    sources, kinds = np.empty_like(listing.targets), np.empty_like(listing.kinds)
    relaxation.turn_round(listing.counts, listing.targets, listing.kinds, into, sources, kinds)
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
