"""Every reachable state of a task and its exact cost-to-go, fast and in little memory.

`sweep` takes a `Task` to a `Table`. Forward from the initial state and backward from the goal, both searches work
on indices (`coding`), a sorted block at a time, on several threads. The set of states is a bitmap over all
indices where that is small or well filled, a hash table of indices where it is not; the *number* of a state is
its rank among the indices of all states. The backward search applies the inverse moves, so that no transition
is stored.

Tasks with derived variables, with indices beyond 62 bits, or with operators that split into very many moves
take a slower way: all transitions in memory (`statespace.explore`).
"""

from __future__ import annotations

import heapq
import os
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import zip_longest
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from . import kernels, reached
from .budget import Budget, MemoryLimitError, available_memory
from .coding import Coding, choose
from .costtogo import Table, backward, compact, smallest_type
from .fast_downward import LimitError
from .kernels import Tests
from .moves import split_operators
from .reached import States
from .statespace import StateSpace, explore
from .successors import Ints, Packing, Transitions
from .task import Fact, Task
from .trie import build_tests

BLOCK = 1 << 16
"""Indices in one block of a frontier: the unit of work of a thread, and of the checks of limits."""

SMALL_BITMAP = 1 << 29
"""Bits of a bitmap that is not worth avoiding (64 MB)."""

SPARSE = 1 << 10
"""Indices per state from which on a larger bitmap gives way to a hash table; tasks with more are rare."""


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
    """

    coding: Coding
    forward: Tests
    backward: Tests
    budget: Budget
    threads: int

    def reach(self, initial: int) -> tuple[States, int]:
        """Find the states that can be reached from an index, and count their transitions."""
        nothing = np.empty(0, dtype=np.int64)
        words = -(-self.coding.size // 512) * 8
        found, transitions = 1, 0
        frontier = [np.array([initial])]
        bits = np.empty(0, dtype=np.uint64)
        keys = nothing
        if not self._bitmap_fits(words, found):
            keys = self._grown(nothing, 0)
            reached.insert_all(keys, frontier[0])
        while frontier:
            if not len(bits) and self._bitmap_fits(words, found):
                bits = np.zeros(words, dtype=np.uint64)
                for block in frontier if not len(keys) else [keys[keys >= 0]]:
                    reached.set_bits(bits, block)
                keys = nothing
            if len(bits):
                push = partial(kernels.spread, self.forward, self.coding.decoder, bits)
                frontier, count = self._layer(push, frontier, bits.nbytes, found)
            else:
                frontier, count, keys = self._hashed_layer(frontier, keys, found)
            transitions += count
            found += sum(map(len, frontier))
            self.budget.check_states(found)

        if len(bits):
            self.budget.check_memory(bits.nbytes * 9 / 8)
            states = States(bits, np.empty(words // 8 + 1, dtype=np.int64), nothing, nothing, nothing)
            reached.fill_ranks(states.bits, states.ranks)
        else:
            self.budget.check_memory(keys.nbytes * 2 + found * 16)
            members = keys[keys >= 0]
            members.sort()
            numbers = np.empty(len(keys), dtype=np.int64)
            starts = range(0, len(members), BLOCK)
            self._share(lambda at: reached.number_members(keys, members[at : at + BLOCK], at, numbers), starts)
            states = States(bits, nothing, members, keys, numbers)
        return states, transitions

    def _bitmap_fits(self, words: int, found: int) -> bool:
        """Whether the states are many enough for a bitmap, and the memory for one and its ranks."""
        bits = 64 * words
        return (bits <= SMALL_BITMAP or bits <= SPARSE * found) and 1.25 * bits / 8 <= self.budget.memory

    def _share(self, work: Callable[[Any], T], parts: Iterable[Any]) -> list[T]:
        """Do a piece of work for each part, on all threads."""
        listed = list(parts)
        if self.threads == 1 or len(listed) < 2:
            return [work(part) for part in listed]
        with ThreadPoolExecutor(min(self.threads, len(listed))) as pool:
            return list(pool.map(work, listed))

    def _ascending(self, frontier: list[Ints], in_use: int) -> deque[Ints]:
        """Put a layer into blocks of ascending indices; empties the list.

        In ascending order, each move's targets ascend as well: far fewer cache and page misses.
        """
        if len(frontier) == 1 and len(frontier[0]) <= BLOCK:
            return deque([frontier.pop()])
        self.budget.check_memory(in_use + 16 * sum(map(len, frontier)))
        runs = [frontier[start :: self.threads] for start in range(min(self.threads, len(frontier)))]
        frontier.clear()

        def blocks(run: list[Ints]) -> list[Ints]:
            layer = np.concatenate(run)
            run.clear()
            layer.sort()
            return np.split(layer, range(BLOCK, len(layer), BLOCK))

        # Threads take blocks of different runs in turn: each run is read in its order.
        mixed = zip_longest(*self._share(blocks, runs))
        return deque(block for group in mixed for block in group if block is not None)

    def _layer(self, push: Push, frontier: list[Ints], in_use: int, found: int) -> tuple[list[Ints], int]:
        """Give the blocks of the next layer, and the transitions to it; empties the list of the present one."""
        size = max(BLOCK, 4 * self.forward.most, 4 * self.backward.most)
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
        size = max(BLOCK, 4 * self.forward.most)
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
                    stop, filled, count = kernels.spread_hashed(
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
        reached.insert_all(larger, keys[keys >= 0])
        return larger

    def cost_to_go(self, states: States, total: int, goal: Sequence[Fact]) -> NDArray[np.unsignedinteger]:
        """Find the distance of all states from the goal; the type's largest value marks dead ends."""
        frontier = list(self._with(states, total, goal))
        costs = np.unique(self.backward.cost)
        if len(costs) <= 1 and costs.all():
            return self._equal_costs(states, total, frontier, int(costs[0]) if len(costs) else 1)
        return self._any_costs(states, total, frontier, int(costs.max()))

    def blocks(self, states: States) -> Iterator[Ints]:
        """List the indices of all states in ascending order, a block at a time."""
        start, end = 0, len(states.bits) or len(states.members)
        while start < end:
            out = np.empty(BLOCK, dtype=np.int64)
            start, filled = reached.list_members(states, start, out)
            yield out[:filled]

    def _with(self, states: States, total: int, facts: Sequence[Fact]) -> Iterator[Ints]:
        """List the indices of the states in which facts hold, in blocks."""
        blocks: Iterable[Ints] = self.blocks(states)
        candidates = self.coding.matching(facts, total)
        if candidates is not None:  # fewer than there are states
            numbers = np.empty(len(candidates), dtype=np.int64)
            reached.numbers_of(states, candidates, numbers)
            blocks = [candidates[numbers >= 0]]
        for block in blocks:
            self.budget.check_time(total)
            marks = np.empty(len(block), dtype=bool)
            kernels.mark(self.coding.decoder, block, *self.coding.packing.condition(facts), marks)
            if marks.any():
                yield block[marks]

    def _equal_costs(self, states: States, total: int, frontier: list[Ints], cost: int) -> NDArray[Any]:
        """Search breadth first."""
        dtype: type[np.unsignedinteger] = np.uint8
        in_use = sum(array.nbytes for array in states) + total
        self.budget.check_memory(in_use)
        distance = np.full(total, np.iinfo(dtype).max, dtype=dtype)
        for block in frontier:
            reached.label(states, distance, 0, block)
        d = 0
        while frontier:
            d += cost
            if d >= np.iinfo(dtype).max:
                narrow, dtype = np.iinfo(dtype).max, smallest_type(d)
                in_use += distance.itemsize * total * 3
                self.budget.check_memory(in_use)
                wider = distance.astype(dtype)
                wider[distance == narrow] = np.iinfo(dtype).max
                distance = wider
            push = partial(kernels.spread_back, self.backward, self.coding.decoder, states, distance, d)
            frontier, _ = self._layer(push, frontier, in_use, total)
        largest = d - cost  # the last layer was empty
        return distance if largest >= np.iinfo(np.uint8).max else distance.astype(smallest_type(largest), copy=False)

    def _any_costs(self, states: States, total: int, frontier: list[Ints], largest: int) -> NDArray[Any]:
        """Settle the states in the order of their distance (Dial 1969), costs of zero included."""
        work: type[np.unsignedinteger] = np.uint32 if largest * total < np.iinfo(np.uint32).max else np.uint64
        in_use = sum(array.nbytes for array in states) + total * (np.dtype(work).itemsize + 4)
        self.budget.check_memory(in_use)
        unreached = np.iinfo(work).max
        distance = np.full(total, unreached, dtype=work)
        size = max(BLOCK, 4 * self.backward.most)
        for block in frontier:
            reached.label(states, distance, 0, block)
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
                        stop, filled = kernels.relax(
                            self.backward, self.coding.decoder, states, block, stop, d, distance, out, through, 0
                        )
                        pushed.append((out[:filled].copy(), through[:filled].copy()))
                return pushed

            parts = self._share(settle, range(min(self.threads, len(blocks))))
            for targets, values in (pair for part in parts for pair in part):
                held += len(targets)
                for value in np.unique(values).tolist():
                    if value not in waiting:
                        waiting[value] = []
                        if value != d:
                            heapq.heappush(order, value)
                    waiting[value].append(targets[values == value])
        found = distance != unreached
        dtype = smallest_type(int(distance[found].max(initial=0)))
        result = np.full(total, np.iinfo(dtype).max, dtype=dtype)
        result[found] = distance[found]
        return result


@dataclass(frozen=True)
class Indexed:
    """States numbered by their index."""

    searches: Searches
    states: States

    def numbers(self, values: NDArray[np.int64]) -> Ints:
        """Give the states with values of shape (n, variables), -1 where there is none."""
        out = np.empty(len(values), dtype=np.int64)
        reached.numbers_of(self.states, self.searches.coding.encode(values), out)
        return out

    def values(self, numbers: Ints) -> NDArray[np.int64]:
        """Give the values, shape (n, variables), of states of shape (n,)."""
        index = np.empty(len(numbers), dtype=np.int64)
        reached.select(self.states, numbers, index)
        return self.searches.coding.decode(index)

    def where(self, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        """Tell of every state, shape (states,), whether facts hold."""
        coding, parts = self.searches.coding, [np.empty(0, dtype=bool)]
        for block in self.searches.blocks(self.states):
            parts.append(np.empty(len(block), dtype=bool))
            kernels.mark(coding.decoder, block, *coding.packing.condition(facts), parts[-1])
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
            kernels.fill_transitions(
                self.searches.forward, self.searches.coding.decoder, self.states, block, number, *rows
            )
            number += len(block)
        return rows


def sweep(
    task: Task,
    *,
    max_states: int | None = None,
    memory_limit_mb: float | None = None,
    deadline: float | None = None,
    threads: int | None = None,
    stop: threading.Event | None = None,
) -> Table:
    """Enumerate the reachable states of a task, and compute the exact cost-to-go of all.

    Parameters
    ----------
    task : Task
    max_states : int, optional
        The largest number of states.
    memory_limit_mb : float, optional
        What the sweep may use in addition to what the process has already; what the machine has left
        unless given.
    deadline : float, optional
        A time on `time.monotonic()`'s clock.
    threads : int, optional
        As many as there are processors unless given. The result does not depend on it.
    stop : threading.Event, optional
        The sweep is given up once it is set.

    Raises
    ------
    LimitError
        One of the limits does not suffice.
    """
    memory = available_memory()
    if memory_limit_mb is not None:
        memory = min(memory, memory_limit_mb * 1e6)
    budget = Budget(max_states, memory, deadline, stop)
    if threads is None:
        threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    moves = None if any(v.axiom_layer >= 0 for v in task.variables) else split_operators(task)
    coding = None
    if moves is not None:
        coding, moves = choose(task, moves)
    if moves is None or coding is None:
        return _slow_sweep(task, budget)
    searches = Searches(
        coding,
        build_tests(moves, coding, task.costs),
        build_tests([move.inverse() for move in moves], coding, task.costs),
        budget,
        threads,
    )
    states, transitions = searches.reach(int(coding.encode(task.initial)[0]))
    total = int(states.ranks[-1]) if len(states.bits) else len(states.members)
    distance = searches.cost_to_go(states, total, task.goal)
    numbering = Indexed(searches, states)
    initial = int(numbering.numbers(np.array([task.initial]))[0])
    return Table(StateSpace(task, total, initial, transitions, numbering), distance)


def _slow_sweep(task: Task, budget: Budget) -> Table:
    """Sweep with all transitions in memory, which does for every task."""
    # At most so many operators are applicable at once: those that agree on the value of some variable.
    most = len(task.operators)
    for variable, description in enumerate(task.variables):
        wanted = Counter(dict(operator.preconditions).get(variable, -1) for operator in task.operators)
        values = range(len(description.facts))
        most = min(most, wanted[-1] + max((wanted[value] for value in values), default=0))
    words = Packing.of(task).words
    per_state = 64 * words + most * (72 + 24 * words)
    affordable = int(budget.memory / per_state)
    limit = affordable if budget.max_states is None else min(affordable, budget.max_states)
    try:
        space = explore(task, max_states=limit, deadline=budget.deadline)
    except LimitError:
        budget.check_time(limit)
        if limit == budget.max_states:
            raise
        raise MemoryLimitError(
            f"{budget.memory / 1e6:.0f} MB of memory may not do for more than {limit} states"
        ) from None
    distance = backward(space.transitions.targets, space.sources, space.costs, space.goal, deadline=budget.deadline)
    return Table(space, compact(distance))
