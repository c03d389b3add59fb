"""Distances of all reachable states from the goal: Dijkstra's algorithm with buckets (Dial 1969).

Buckets hold the states of one tentative distance, and are settled in ascending order, all states of a bucket at once.
Breadth-first search is the case of a single positive cost, in which there is one bucket at a time. Costs may be zero.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Fact
from ..system.arrays import Ints
from ..system.limits import Budget, CostLimitError
from ..system.progress import Progress
from ..system.threads import on_threads
from .distances import EXACT, compact, retyped, smallest_type
from .search_space import SearchSpace, check

Relax = Callable[[Ints, int, Any, Ints, Ints], tuple[int, int]]
"""Kernel that relaxes a block, such as `block_steps.relax_stored` with its first arguments.

Arguments are the keys, the first position, the distance, and the two outputs. It returns the position reached and the
filled length.
"""


def distances(
    space: SearchSpace,
    goal: Sequence[Fact],
    budget: Budget,
    threads: int,
    progress: Progress,
    costs: Sequence[int] | None = None,
    largest_sum: int = EXACT,
) -> NDArray[np.unsignedinteger]:
    """Return the distance of every state from the goal, shape (n,), in the smallest type.

    The states of the space have been found. The largest value of the type marks dead ends. `progress` is called after
    each bucket with "cost-to-go", the number of states settled, and their total. `costs` replace `space.costs`, in the
    same order. Sums of costs must stay below `largest_sum`, at most 2^63; if they do not, this raises a
    `CostLimitError`.
    """
    costs = space.costs.tolist() if costs is None else costs
    total, dearest = len(space), max(costs, default=0)
    if dearest >= largest_sum:
        raise CostLimitError(f"a cost of {dearest} is too large; expected less than {largest_sum}")
    # Distances of a single cost start in one byte, since layers seldom are many.
    dtype = smallest_type(dearest if len(costs) < 2 else max(dearest, np.iinfo(np.uint16).max))
    budget.check_memory(space.nbytes + np.dtype(dtype).itemsize * total)
    distance = np.full(total, np.iinfo(dtype).max, dtype=dtype)
    waiting, order, settled = {0: space.begin(goal, distance)}, [0], 0
    progress("cost-to-go", 0, total)
    while order:
        d = order[0]
        layer = waiting.pop(d, None)
        if layer is None:
            heapq.heappop(order)
            continue
        if d + dearest >= largest_sum:
            raise CostLimitError(f"sums of costs are too large; expected less than {largest_sum}")
        if d + dearest >= np.iinfo(distance.dtype).max:
            wider = smallest_type(d + dearest)
            budget.check_memory(space.nbytes + (np.dtype(wider).itemsize + distance.itemsize) * total)
            distance = retyped(distance, wider)
        keys = sum(map(len, layer))
        held = distance.nbytes + 8 * (sum(len(part) for parts in waiting.values() for part in parts) + 3 * keys)
        given = distance.dtype.type(d), distance, np.array(costs, dtype=distance.dtype)

        def settle(block: Ints, given: tuple[Any, ...] = given, held: float = held) -> list[tuple[int, Ints]]:
            check(space, budget, held)
            return space.settle(block, *given)

        blocks = space.blocks(layer, threads)
        results = on_threads(settle, (blocks.popleft() for _ in range(len(blocks))), threads)
        for kind, pushed in (pair for pairs in results for pair in pairs):
            value = d + costs[kind]
            if value not in waiting:
                waiting[value] = []
                if value != d:
                    heapq.heappush(order, value)
            waiting[value].append(pushed)
        settled = min(total, settled + keys)
        progress("cost-to-go", settled, total)
    return compact(distance)


def relaxed(relax: Relax, block: Ints, d: Any, room: int, kinds: int) -> list[tuple[int, Ints]]:
    """Relax the transitions into a block of states at distance `d` by a kernel, called until the block is finished.

    `room` is the size of the kernel's output, at least the number of predecessors of a state; `kinds` is the number
    of distinct costs. Return pairs as `SearchSpace.settle` does.
    """
    from .kernels.block_steps import by_kind  # which compiles

    pushed: list[tuple[int, Ints]] = []
    out, through = np.empty(room, dtype=np.int64), np.empty(room, dtype=np.int64)
    stop = 0
    while stop < len(block):
        stop, filled = relax(block, stop, d, out, through)
        begin, ordered = np.zeros(kinds + 2, dtype=np.int64), np.empty(filled, dtype=np.int64)
        by_kind(out[:filled], through[:filled], begin, ordered)
        pushed += [
            (kind, ordered[begin[kind] : begin[kind + 1]]) for kind in np.flatnonzero(np.diff(begin[:-1])).tolist()
        ]
    return pushed
