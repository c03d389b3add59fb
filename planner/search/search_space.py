"""The search through all states, forwards and backwards, and the interface to the indices of states.

`explore` finds the reachable states of a task, breadth first from the initial state, on several threads. Layers are
expanded block by block. The results are recorded in the order of the blocks, so that the numbers of states do not
depend on the number of threads.

`distances` finds their distances from the goal: Dijkstra's algorithm with buckets (Dial 1969). Buckets hold the states
of one tentative distance, and are settled in ascending order, all states of a bucket at once. Breadth-first search is
the case of a single positive cost, in which there is one bucket at a time. Costs may be zero.

Both know states by *keys*, in blocks. A `SearchSpace` expands and relaxes such blocks. There are four, each with its
own `StateIndex`:

- `SortedSpace` is for small tasks. It uses numpy alone, since compiling takes longer than to search them.
- `RankedSpace` is the fastest of the compiled ones. Keys are ranks, the reachable ones are a bitmap, and the backward
  search applies inverse operators, so that no transitions are stored.
- `RegistrySpace` works for every task. Keys are the numbers of packed states, in the order of their discovery until
  `finish` sorts each layer, and the transitions are stored.
- A `RegistrySpace` with a function that replaces each state by the canonical state of its orbit.
"""

from __future__ import annotations

import heapq
import math
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Fact
from ..system.arrays import Ints
from ..system.limits import Budget, CostLimitError
from ..system.processes import on_threads
from ..system.progress import Progress
from .state_space import EXACT, StateIndex, compact, retyped, smallest_type


class SearchSpace(Protocol):
    """The states of a task for a search: first all methods of the forward search are called, then the others."""

    transitions: int
    """Number of transitions of the states that have been expanded."""

    @property
    def index(self) -> StateIndex:
        """The numbering of the reachable states, complete after `finish`."""

    @property
    def initial(self) -> int:
        """Number of the initial state, known after `finish`."""

    @property
    def costs(self) -> Ints:
        """The distinct costs of the operators, ascending; a *kind* is a position in this array."""

    @property
    def nbytes(self) -> float:
        """Bytes in use."""

    def __len__(self) -> int:
        """Return the number of states found so far."""

    def start(self) -> list[Any]:
        """Return the first layer: the key of the initial state. A layer is a list of arrays, or of ranges, of keys."""

    def blocks(self, layer: list[Any], threads: int) -> deque[Any]:
        """Return the keys of a layer in blocks of suitable size; the given list is emptied."""

    def expand(self, block: Any) -> Any:
        """Expand the states of a block; several threads may call this at once."""

    def add(self, expanded: Any) -> list[Any]:
        """Record what `expand` returned, in the order of the blocks; return the keys of the new states."""

    def finish(self) -> None:
        """End the forward search."""

    def begin(self, goal: Sequence[Fact], distance: NDArray[Any]) -> list[Ints]:
        """Begin the backward search: set the distance of the goal states to 0, and return their keys."""

    def settle(self, block: Ints, d: int, distance: NDArray[Any], costs: NDArray[Any]) -> list[tuple[int, Ints]]:
        """Relax the transitions into the states of a block at distance `d`; several threads may call this at once.

        Return the states whose distance has decreased, as pairs of the kind of the cost and keys.
        """


def check(space: SearchSpace, budget: Budget, more: float = 0) -> None:
    """Check all limits of a search; `more` is the number of bytes that it uses besides its space."""
    budget.check_states(len(space))
    budget.check_time(len(space))
    budget.check_memory(space.nbytes + more)


def explore(
    space: SearchSpace, budget: Budget, threads: int, progress: Progress, most: float = math.inf
) -> SearchSpace | None:
    """Find all reachable states, and return the space; return None once there are `most` transitions or more.

    `progress` is called after each layer with "states" and the number of states found.
    """
    layer, turns = space.start(), threading.Lock()
    while layer:
        waiting = sum(map(len, layer))
        budget.check_memory(space.nbytes + 24 * waiting)
        blocks = space.blocks(layer, threads)
        ready: dict[int, Any] = {}  # results that wait for those of earlier blocks
        turn = 0

        def work(part: tuple[int, Any], waiting: int = waiting, ready: dict[int, Any] = ready) -> None:
            nonlocal turn
            number, block = part
            if space.transitions >= most:
                return
            check(space, budget, 8 * (waiting + sum(map(len, layer))))
            expanded = space.expand(block)
            with turns:
                ready[number] = expanded
                while turn in ready:
                    layer.extend(space.add(ready.pop(turn)))
                    turn += 1

        on_threads(work, ((number, blocks.popleft()) for number in range(len(blocks))), threads)
        if space.transitions >= most:
            return None
        progress("states", len(space), None)
        check(space, budget, 8 * sum(map(len, layer)))
    space.finish()
    return space


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
