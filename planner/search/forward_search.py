"""The reachable states of a task, breadth first from the initial state.

`ForwardSearch` works on ranks. It expands sorted blocks of a layer, and stores no transitions. `enumerated` works for
every task. It numbers packed states in the order of their discovery, and stores all transitions for the backward
search. It serves tasks with derived variables, with operators that split into very many moves, or with too large ranks.
Both expand blocks on several threads. `enumerated` numbers the results in order, so that the numbers do not depend on
the number of threads.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import zip_longest
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Task
from ..states.packing import Ints, Packing, Words
from ..system.limits import Budget
from ..system.progress_reports import Progress
from ..system.threads import on_threads
from .checkpoint import Checkpoint
from .kernels import expansion, packed_successors, ranked_states
from .kernels.ranked_states import RankSet
from .kernels.ranked_successors import RankedOperators
from .ranking.state_ranking import StateRanking
from .state_registry import RegistryIndex, StateRegistry, _Growing
from .successor_generator import STATES_AT_A_TIME, TRANSITIONS_AT_A_TIME, Expanded, expanded, packed_operators

RANKS_AT_A_TIME = 1 << 16
"""Ranks in a block of the frontier, which is the unit of a thread's work and of checks of limits."""

SMALL_BITMAP = 1 << 29
"""Size in bits (64 MB) up to which a bitmap is always used if memory allows it."""

SPARSE = 1 << 10
"""Ranks per state above which a larger bitmap is replaced by a hash table, which then needs less memory."""

T = TypeVar("T")

Push = Callable[[Ints, int, Ints, int], tuple[int, int, int]]
"""Kernel that pushes the successors of a block.

Arguments are the ranks, the first position, the output and its filled length. It returns the position reached, the
filled length, and the number of transitions.
"""


@dataclass(frozen=True)
class ForwardSearch:
    """Breadth-first search for the reachable states of a task with ranked states, on several threads.

    The set of states is a bitmap over all ranks if that is small or densely filled, otherwise a hash table of ranks.

    Attributes
    ----------
    coding : StateRanking
    operators : RankedOperators
    budget : Budget
    threads : int
    progress : callable
        Called after each layer with "states" and the number of states found.
    checkpoint : Checkpoint or None
        Checkpoint of a search that uses a bitmap.
    """

    coding: StateRanking
    operators: RankedOperators
    budget: Budget
    threads: int
    progress: Progress
    checkpoint: Checkpoint | None

    def reach(self, initial: int) -> tuple[RankSet, int]:
        """Return the states that are reachable from a rank, and the number of their transitions."""
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
                push = partial(expansion.expand_block, self.operators, self.coding.decoder, bits)
                frontier, count = self.next_layer(push, self.operators.most, frontier, bits.nbytes, found)
            else:
                frontier, count, keys = self._hashed_layer(frontier, keys, found)
            transitions += count
            found += sum(map(len, frontier))
            self.progress("states", found, None)
            self.budget.check_states(found)

        if len(bits):
            states = self.ranked(bits)
        else:
            self.budget.check_memory(keys.nbytes * 2 + found * 16)
            members = keys[keys >= 0]
            members.sort()
            numbers = np.empty(len(keys), dtype=np.int64)
            starts = range(0, len(members), RANKS_AT_A_TIME)
            self.share(
                lambda at: ranked_states.number_members(keys, members[at : at + RANKS_AT_A_TIME], at, numbers), starts
            )
            states = RankSet(bits, nothing, members, keys, numbers)
        return states, transitions

    def ranked(self, bits: Words) -> RankSet:
        """Return the set of states whose ranks are set in a bitmap."""
        self.budget.check_memory(bits.nbytes * 9 / 8)
        nothing = np.empty(0, dtype=np.int64)
        states = RankSet(bits, np.empty(len(bits) // 8 + 1, dtype=np.int64), nothing, nothing, nothing)
        ranked_states.fill_ranks(states.bits, states.ranks)
        return states

    def _bitmap_fits(self, words: int, found: int) -> bool:
        """Whether there are enough states for a bitmap, and enough memory for it and its counts."""
        bits = 64 * words
        return (bits <= SMALL_BITMAP or bits <= SPARSE * found) and 1.25 * bits / 8 <= self.budget.room

    def share(self, work: Callable[[Any], T], parts: Iterable[Any]) -> list[T]:
        """Apply a function to each part on all threads, and return the results in order."""
        return on_threads(work, parts, self.threads)

    def ascending(self, frontier: list[Ints], in_use: int) -> deque[Ints]:
        """Return a layer as blocks of ascending ranks; the given list is emptied.

        For ascending ranks, the targets of each operator ascend as well. This causes far fewer cache and page misses.
        """
        if len(frontier) == 1 and len(frontier[0]) <= RANKS_AT_A_TIME:
            return deque([frontier.pop()])
        indices = sum(map(len, frontier))
        self.budget.check_memory(in_use + 16 * indices)
        if indices <= RANKS_AT_A_TIME:  # too few to be worth starting threads
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

        # Blocks of different runs alternate, so that each run is processed in its order.
        mixed = zip_longest(*self.share(blocks, runs))
        return deque(block for group in mixed for block in group if block is not None)

    def next_layer(
        self, push: Push, most: int, frontier: list[Ints], in_use: int, found: int
    ) -> tuple[list[Ints], int]:
        """Return the blocks of the next layer, and the number of transitions to it; the given list is emptied.

        `most` is the largest number of ranks that `push` yields for one rank.
        """
        size = max(RANKS_AT_A_TIME, 4 * most)
        in_use += 8 * sum(map(len, frontier))
        waiting = self.ascending(frontier, in_use)
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

        transitions = sum(self.share(work, range(min(self.threads, len(waiting)))))
        return pushed, transitions

    def _hashed_layer(self, frontier: list[Ints], keys: Ints, found: int) -> tuple[list[Ints], int, Ints]:
        """Return the next layer, the number of transitions, and the hash table, which is replaced when it fills up."""
        transitions = new = 0
        pushed: list[Ints] = []
        waiting = self.ascending(frontier, keys.nbytes)
        size = max(RANKS_AT_A_TIME, 4 * self.operators.most)
        while waiting:
            self.budget.check_states(found + new)
            room = (len(keys) // 2 - found - new) // self.threads
            if room < self.operators.most:
                keys = self._grown(keys, found + new)
                continue

            def work(room: int, keys: Ints = keys, found: int = found + new) -> tuple[int, int]:
                transitions = own = 0
                while waiting and room - own >= self.operators.most:
                    try:
                        block = waiting.popleft()
                    except IndexError:  # another thread took it
                        break
                    self.budget.check_time(found + own)
                    self.budget.check_memory(keys.nbytes + 8 * size * (len(waiting) + len(pushed) + self.threads))
                    out = np.empty(min(size, room - own), dtype=np.int64)
                    stop, filled, count = expansion.expand_block_hashed(
                        self.operators, self.coding.decoder, block, 0, keys, room - own, out, 0
                    )
                    if stop < len(block):
                        waiting.appendleft(block[stop:])
                    if filled:
                        pushed.append(out[:filled].copy() if filled < len(out) // 2 else out[:filled])
                    transitions += count
                    own += filled
                return transitions, own

            for count, own in self.share(work, [room] * min(self.threads, len(waiting))):
                transitions += count
                new += own
        return pushed, transitions, keys

    def _grown(self, keys: Ints, held: int) -> Ints:
        """Return a copy of the hash table of at least twice the size.

        It has room for the successors of at least one more state per thread.
        """
        size = 1 << (max(2 * len(keys), 8 * self.threads * self.operators.most, 1 << 12) - 1).bit_length()
        self.budget.check_memory(keys.nbytes + 8 * held + 8 * size)
        larger = np.full(size, -1, dtype=np.int64)
        ranked_states.insert_all(larger, keys[keys >= 0])
        return larger


Form = Callable[[Words], None]
"""Function that replaces states, shape (n, words), by their canonical states in place."""


def as_they_are(_states: Words) -> None:
    """Leave states unchanged, for a search without symmetry reduction."""


@dataclass(frozen=True)
class ExploredGraph:
    """The reachable states and their transitions.

    Attributes
    ----------
    found : RegistryIndex
    counts : int32 array, shape (n,)
        Number of transitions of each state.
    targets : int32 array, shape (transitions,)
        Successors, in the order of the states.
    kinds : unsigned integer array, shape (transitions,)
        Index of each transition's cost among the distinct costs of the task; empty if all costs are equal.
    """

    found: RegistryIndex
    counts: NDArray[np.int32]
    targets: NDArray[np.int32]
    kinds: NDArray[np.unsignedinteger]


class _RegistrySearch:
    """Breadth-first search with a registry of the states found so far."""

    def __init__(self, task: Task, budget: Budget, form: Form = as_they_are) -> None:
        self.packing = Packing.of(task)
        self.budget = budget
        self.book = packed_operators(task, self.packing, budget.during("operators were laid out"))
        self.form = form
        self.met = StateRegistry(self.packing.words)
        initial = self.packing.pack([task.initial])
        packed_successors.derive(self.book.axioms, self.book.again, initial)
        form(initial)
        self.met.numbers(initial)

    def parts(self, threads: int) -> Generator[tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]]:
        """Yield, for all states in order, the numbers of their actions, the actions and the successors, in parts."""
        waiting: deque[Future[list[Expanded]]] = deque()
        done = given = transitions = 0
        at_once = min(STATES_AT_A_TIME, 1 << 8)
        with ThreadPoolExecutor(threads) as pool:
            try:
                while done < len(self.met):
                    while given < len(self.met) and len(waiting) <= threads:
                        block = self.met.states(slice(given, min(given + at_once, len(self.met))))
                        waiting.append(pool.submit(self._expanded, block))
                        given += len(block)
                    for counts, actions, after in waiting.popleft().result():
                        done, transitions = done + len(counts), transitions + len(actions)
                        yield counts, actions, self.met.numbers(after)
                    at_once = max(1, min(STATES_AT_A_TIME, TRANSITIONS_AT_A_TIME * done // max(1, transitions)))
            finally:
                for future in waiting:
                    future.cancel()

    def _expanded(self, states: Words) -> list[Expanded]:
        parts = []
        for part in expanded(self.book, states):
            self.budget.check_time(len(self.met))
            self.form(part[2])
            parts.append(part)
        return parts

    def check(self, per_state: int, others: int) -> None:
        """Check the limits; the arguments are the bytes per state besides its words, and all other bytes."""
        self.budget.check_states(len(self.met))
        self.budget.check_time(len(self.met))
        self.budget.check_memory(self.met.slots.nbytes + (8 * self.packing.words + per_state) * len(self.met) + others)


def enumerated(
    task: Task,
    budget: Budget,
    threads: int,
    progress: Progress,
    most: float = math.inf,
    form: Form = as_they_are,
) -> ExploredGraph | None:
    """Return the reachable states of a task, found breadth first; None once there are `most` transitions or more.

    `form` replaces states by canonical states before they are looked up.
    """
    costs, kind_of = np.unique(task.costs, return_inverse=True)
    search, targets = _RegistrySearch(task, budget, form), _Growing(np.int32)
    counts, kinds = _Growing(np.int32), _Growing(np.uint16 if len(costs) <= 1 << 16 else np.uint32)
    done = transitions = 0
    with closing(search.parts(threads)) as parts:
        for part_counts, actions, numbers in parts:
            counts.append(done, part_counts)
            targets.append(transitions, numbers)
            if len(costs) > 1:
                kinds.append(transitions, kind_of[actions])
            done, transitions = done + len(part_counts), transitions + len(numbers)
            if transitions >= most:
                return None
            search.check(24, (8 + 4 * (len(costs) > 1)) * transitions)
            progress("states", len(search.met), None)
    found = RegistryIndex(search.packing, search.book, search.met.trimmed(), search.met.slots)
    kept = transitions if len(costs) > 1 else 0
    return ExploredGraph(found, counts.trimmed(done), targets.trimmed(transitions), kinds.trimmed(kept))
