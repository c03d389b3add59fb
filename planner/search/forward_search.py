"""The reachable states of a task, breadth first from the initial state, on several threads.

Layers are expanded block by block. The results are recorded in the order of the blocks, so that the numbers of states
do not depend on the number of threads.
"""

from __future__ import annotations

import math
import threading
from typing import Any

from ..system.limits import Budget
from ..system.progress import Progress
from ..system.threads import on_threads
from .search_space import SearchSpace, check


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
