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
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import kernels
from .budget import Budget, MemoryLimitError, available_memory
from .coding import Coding, build_tests
from .costtogo import Table, backward, compact, smallest_type
from .fast_downward import LimitError
from .kernels import States, Tests
from .moves import exactly_one, split_operators
from .statespace import StateSpace, explore
from .successors import Ints, Packing, Transitions, Words
from .task import Fact, Task

BLOCK = 1 << 16
"""Indices in one block of a frontier: the unit of work of a thread, and of the checks of limits."""

SMALL_BITMAP = 1 << 29
"""Bits of a bitmap that is not worth avoiding (64 MB)."""

SPARSE = 1 << 11
"""Indices per state from which on a larger bitmap gives way to a hash table; tasks with more are rare."""

PROBE = 2_000_000
"""States that tell whether a task with very many indices is small after all."""


@dataclass(frozen=True)
class Searches:
    """The forward and the backward search of one task.

    Attributes
    ----------
    coding : Coding
    forward, backward : Tests
        The moves and their inverses.
    costs : int64 array, shape (actions,)
    budget : Budget
    threads : int
    """

    coding: Coding
    forward: Tests
    backward: Tests
    costs: Ints
    budget: Budget
    threads: int

    def reach(self, initial: int) -> tuple[States, int]:
        """Find the states that can be reached from an index, and count their transitions."""
        nothing = np.empty(0, dtype=np.int64)
        words = -(-self.coding.size // 512) * 8
        found, transitions = 1, 0
        frontier = [np.array([initial])]
        open_bits = np.empty(0, dtype=np.uint64)
        keys = nothing
        if not self._bitmap_fits(words, found):
            keys = self._grown(nothing, frontier)
        while frontier:
            if not len(open_bits) and self._bitmap_fits(words, found):
                open_bits = np.full(words, (1 << 64) - 1, dtype=np.uint64)
                for block in frontier if not len(keys) else [keys[keys >= 0]]:
                    kernels.clear_bits(open_bits, block)
                keys = nothing
            if len(open_bits):
                frontier, count = self._spread_layer(self.forward, frontier, open_bits, open_bits.nbytes, found)
            else:
                frontier, count, keys = self._spread_layer_hashed(frontier, keys, found)
            transitions += count
            found += sum(map(len, frontier))
            self.budget.check_states(found)

        if len(open_bits):
            np.invert(open_bits, out=open_bits)
            self.budget.check_memory(open_bits.nbytes * 9 / 8)
            states = States(open_bits, np.empty(words // 8 + 1, dtype=np.int64), nothing, nothing, nothing)
            kernels.fill_ranks(states.bits, states.ranks)
        else:
            self.budget.check_memory(keys.nbytes * 2 + found * 16)
            members = np.sort(keys[keys >= 0])
            numbers = np.empty(len(keys), dtype=np.int64)
            numbers[keys >= 0] = np.searchsorted(members, keys[keys >= 0])
            states = States(open_bits, nothing, members, keys, numbers)
        return states, transitions

    def _bitmap_fits(self, words: int, found: int) -> bool:
        """Whether the states are many enough for a bitmap, and the memory for two of them."""
        bits = 64 * words
        return (bits <= SMALL_BITMAP or bits <= SPARSE * found) and 2.5 * bits / 8 <= self.budget.memory

    def _spread_layer(
        self,
        tests: Tests,
        frontier: list[Ints],
        open_bits: Words,
        in_use: int,
        found: int,
        visit: Callable[[Ints], None] | None = None,
    ) -> tuple[list[Ints], int]:
        """Give the blocks of the next layer, and the transitions to it; empties the list of the present one.

        Every block of the present layer is handed to `visit`, by several threads.
        """
        size = max(BLOCK, 4 * tests.most)
        waiting = deque(frontier)
        if len(frontier) > 1:
            # In ascending order, each move's targets ascend as well: far fewer cache and page misses.
            self.budget.check_memory(in_use + 16 * size * len(frontier))
            layer = np.concatenate(frontier)
            layer.sort()
            waiting = deque(np.split(layer, range(BLOCK, len(layer), BLOCK)))
        in_use += 8 * size * len(frontier)
        frontier.clear()
        pushed: list[Ints] = []

        def work() -> int:
            out, filled, transitions = np.empty(size, dtype=np.int64), 0, 0
            while waiting:
                try:
                    block = waiting.popleft()
                except IndexError:  # another thread took it
                    break
                self.budget.check_time(found)
                if visit is not None:
                    visit(block)
                stop = 0
                while True:
                    stop, filled, count = kernels.spread(
                        tests, self.coding.decoder, block, stop, open_bits, out, filled
                    )
                    transitions += count
                    if stop == len(block):
                        break
                    pushed.append(out[:filled])
                    self.budget.check_memory(in_use + 8 * size * (len(pushed) + 2 * self.threads))
                    out, filled = np.empty(size, dtype=np.int64), 0
            if filled:
                pushed.append(out[:filled])
            return transitions

        threads = min(self.threads, len(waiting))
        if threads == 1:
            transitions = work()
            return pushed, transitions
        with ThreadPoolExecutor(threads) as pool:
            counts = [pool.submit(work) for _ in range(threads)]
            transitions = sum(count.result() for count in counts)
        return pushed, transitions

    def _spread_layer_hashed(self, frontier: list[Ints], keys: Ints, found: int) -> tuple[list[Ints], int, Ints]:
        """Do the same with a hash table, and give it too: it is replaced as it fills up."""
        size = max(BLOCK, 4 * self.forward.most)
        pushed: list[Ints] = []
        transitions = new = 0
        for block in frontier:
            stop = 0
            while stop < len(block):
                self.budget.check_time(found)
                self.budget.check_states(found + new)
                self.budget.check_memory(keys.nbytes + 8 * size * (len(frontier) + len(pushed) + 1))
                room = len(keys) // 2 - found - new
                if room < self.forward.most:
                    keys = self._grown(keys, [keys[keys >= 0]])
                    continue
                out = np.empty(min(size, room), dtype=np.int64)
                stop, filled, count = kernels.spread_hashed(
                    self.forward, self.coding.decoder, block, stop, keys, room, out, 0
                )
                pushed.append(out[:filled].copy() if filled < len(out) // 2 else out[:filled])
                transitions += count
                new += filled
        return [block for block in pushed if len(block)], transitions, keys

    def _grown(self, keys: Ints, present: list[Ints]) -> Ints:
        """Make a hash table twice as large, at least large enough for one more state's successors."""
        least = max(2 * len(keys), 8 * self.forward.most, 1 << 12)
        size = 1 << (least - 1).bit_length()
        self.budget.check_memory(2 * keys.nbytes + 8 * size)
        larger = np.full(size, -1, dtype=np.int64)
        for indices in present:
            kernels.insert_all(larger, indices)
        return larger

    def cost_to_go(self, states: States, total: int, goal: Sequence[Fact]) -> NDArray[np.unsignedinteger]:
        """Find the distance of all states from the goal; the type's largest value marks dead ends."""
        frontier = list(self._with(states, total, goal))
        costs = np.unique(self.costs[self.backward.action])
        if len(states.bits) and len(costs) <= 1 and costs.all():
            return self._equal_costs(states, total, frontier, int(costs[0]) if len(costs) else 1)
        return self._any_costs(states, total, frontier, costs)

    def blocks(self, states: States) -> Iterator[Ints]:
        """List the indices of all states in ascending order, a block at a time."""
        start, end = 0, len(states.bits) or len(states.members)
        while start < end:
            out = np.empty(BLOCK, dtype=np.int64)
            start, filled = kernels.list_members(states, start, out)
            yield out[:filled]

    def _with(self, states: States, total: int, facts: Sequence[Fact]) -> Iterator[Ints]:
        """List the indices of the states in which facts hold, in blocks."""
        blocks: Iterable[Ints] = self.blocks(states)
        candidates = self.coding.matching(facts, total)
        if candidates is not None:  # fewer than there are states
            numbers = np.empty(len(candidates), dtype=np.int64)
            kernels.numbers_of(states, candidates, numbers)
            blocks = [candidates[numbers >= 0]]
        for block in blocks:
            self.budget.check_time(total)
            marks = np.empty(len(block), dtype=bool)
            kernels.mark(self.coding.decoder, block, *self.coding.packing.condition(facts), marks)
            if marks.any():
                yield block[marks]

    def _equal_costs(self, states: States, total: int, frontier: list[Ints], cost: int) -> NDArray[Any]:
        """Search breadth first; a bitmap of the states that are still open does for a distance."""
        dtype: type[np.unsignedinteger] = np.uint8
        in_use = 2 * states.bits.nbytes + states.ranks.nbytes + total
        self.budget.check_memory(in_use)
        distance = np.full(total, np.iinfo(dtype).max, dtype=dtype)
        open_bits = states.bits.copy()
        for block in frontier:
            kernels.clear_bits(open_bits, block)
        d = 0
        while frontier:
            if d >= np.iinfo(dtype).max:
                narrow, dtype = np.iinfo(dtype).max, smallest_type(d)
                in_use += distance.itemsize * total * 3
                self.budget.check_memory(in_use)
                wider = distance.astype(dtype)
                wider[distance == narrow] = np.iinfo(dtype).max
                distance = wider
            label = partial(kernels.label, states, distance, d)
            frontier, _ = self._spread_layer(self.backward, frontier, open_bits, in_use, total, label)
            d += cost
        return distance

    def _any_costs(self, states: States, total: int, frontier: list[Ints], costs: Ints) -> NDArray[Any]:
        """Settle the states in the order of their distance (Dial 1969), costs of zero included."""
        bound = int(costs.max(initial=0)) * total
        work: type[np.integer] = np.uint32 if bound < np.iinfo(np.uint32).max else np.int64
        in_use = sum(array.nbytes for array in states) + total * (np.dtype(work).itemsize + 4)
        self.budget.check_memory(in_use)
        unreached = np.iinfo(work).max
        distance = np.full(total, unreached, dtype=work)
        by_cost = [(int(cost), _with_cost(self.backward, self.costs, int(cost))) for cost in costs]
        out = np.empty(max(BLOCK, 4 * self.backward.most), dtype=np.int64)
        for block in frontier:
            kernels.label(states, distance, 0, block)
        waiting = {0: frontier} if frontier else {}
        order = [0] if frontier else []
        held = sum(map(len, frontier))  # indices that wait
        while order:
            d = order[0]
            pieces = waiting.pop(d, None)
            if pieces is None:
                heapq.heappop(order)
                continue
            self.budget.check_memory(in_use + 16 * held)
            settling = np.concatenate(pieces)  # costs of zero put more pieces in its place
            settling.sort()
            for block in np.split(settling, range(BLOCK, len(settling), BLOCK)):
                self.budget.check_time(total)
                for cost, tests in by_cost:
                    stop = 0
                    while stop < len(block):
                        stop, filled = kernels.relax(
                            tests, self.coding.decoder, states, block, stop, d, d + cost, distance, out, 0
                        )
                        if not filled:
                            continue
                        held += filled
                        self.budget.check_memory(in_use + 16 * held)
                        if d + cost not in waiting:
                            waiting[d + cost] = []
                            if cost:
                                heapq.heappush(order, d + cost)
                        waiting[d + cost].append(out[:filled].copy())
            held -= len(settling)
        reached = distance != unreached
        dtype = smallest_type(int(distance[reached].max(initial=0)))
        result = np.full(total, np.iinfo(dtype).max, dtype=dtype)
        result[reached] = distance[reached]
        return result


def _with_cost(tests: Tests, costs: Ints, cost: int) -> Tests:
    """Keep the moves of one cost, and the tests that they need."""
    keep = costs[tests.action] == cost
    before = np.concatenate([[0], np.cumsum(keep)])
    first = before[tests.first]
    # A test is needed if a move comes between it and the test to which it skips.
    needed = first[tests.skip] > first[:-1]
    needed[:1] = True
    place = np.concatenate([[0], np.cumsum(needed)])
    return Tests(
        tests.word[needed],
        tests.mask[needed],
        tests.value[needed],
        place[tests.skip[needed]],
        np.append(first[:-1][needed], first[-1]),
        tests.delta[keep],
        tests.action[keep],
        tests.most,
    )


@dataclass(frozen=True)
class Indexed:
    """States numbered by their index."""

    searches: Searches
    states: States

    def numbers(self, values: NDArray[np.int64]) -> Ints:
        """Give the states with values of shape (n, variables), -1 where there is none."""
        out = np.empty(len(values), dtype=np.int64)
        kernels.numbers_of(self.states, self.searches.coding.encode(values), out)
        return out

    def values(self, numbers: Ints) -> NDArray[np.int64]:
        """Give the values, shape (n, variables), of states of shape (n,)."""
        index = np.empty(len(numbers), dtype=np.int64)
        kernels.select(self.states, numbers, index)
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
    if_likely: bool = False,
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
    if_likely : bool
        Give up early, after `PROBE` states, on a task that is likely to have more than `max_states`.

    Raises
    ------
    LimitError
        One of the limits does not suffice.
    """
    memory = available_memory()
    if memory_limit_mb is not None:
        memory = min(memory, memory_limit_mb * 1e6)
    budget = Budget(max_states, memory, deadline)
    if threads is None:
        threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    moves = None if any(v.axiom_layer >= 0 for v in task.variables) else split_operators(task)
    coding = None
    if moves is not None:
        groups, moves = exactly_one(task, moves)
        coding = Coding.of(task, groups, moves)
    if moves is None or coding is None:
        return _slow_sweep(task, budget)
    if if_likely and max_states is not None and max_states > PROBE and coding.size // SPARSE > max_states:
        budget = replace(budget, max_states=PROBE, remark=f", and likely more than {max_states}")
    searches = Searches(
        coding,
        build_tests(moves, coding),
        build_tests([move.inverse() for move in moves], coding),
        np.array(task.costs, dtype=np.int64),
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
