"""The sweep: all reachable states of a task and their exact cost-to-go, fast and in little memory.

`sweep` computes a `Table` in three steps: it constructs a ranking of the states (`ranking`), finds the reachable states
and their distances (`forward_search`, `bucket_dijkstra`), and numbers the states in the order of their ranks.

Tasks with derived variables, with ranks beyond 62 bits, or with operators that split into very many moves use a slower
method: a registry of packed states, with all transitions in memory.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from ..grounding.task import Task
from ..pddl.formulas import LARGEST_COST
from ..search.bucket_dijkstra import BucketDijkstra, settled
from ..search.checkpoint import Checkpoint
from ..search.forward_search import ExploredGraph, ForwardSearch, enumerated
from ..search.kernels.ranked_successors import RankedOperators
from ..search.ranking.state_ranking import MANY, PHASE, denser, plain
from ..search.ranking.transition_normal_form import split_operators
from ..search.successor_generator import build_tests
from ..states.state_space import StateSpace
from ..system.limits import Budget, CostLimitError, LimitError, MemoryLimitError
from ..system.machine import processors
from ..system.progress import Progress, Wanted, shows_progress
from .table import Table

FEW = 128
"""Transitions per move that are enumerated before a denser ranking is sought, which takes longer than such a search."""

ANYWAY = 1 << 13
"""Added to the number of moves in that limit: seeking a ranking takes seconds, enumerating a million transitions about
one.
"""

HUGE = 1 << 38
"""Number of ranks above which the registry is tried first: it is faster than a hash table of ranks, but needs more
memory.
"""

LOOKING = 0.25
"""Share of the remaining time for the search of a denser ranking. After that, the best ranking so far is used, if any.
"""


@shows_progress
def sweep(
    task: Task,
    *,
    max_states: int | None = None,
    memory_limit_mb: float | None = None,
    deadline: float | None = None,
    threads: int | None = None,
    stop: threading.Event | None = None,
    progress: Wanted = None,
    checkpoint: str | Path | None = None,
    lent: Callable[[], float] = float,
) -> Table:
    """Enumerate the reachable states of a task, and compute the exact cost-to-go of all of them.

    Parameters
    ----------
    task : Task
    max_states : int, optional
        Largest number of states; unlimited by default.
    memory_limit_mb : float, optional
        Memory of the sweep in MB, in addition to what the process uses already; by default, the available memory.
    deadline : float, optional
        Time on the clock of `time.monotonic()`.
    threads : int, optional
        Number of threads; by default one per processor. The result does not depend on it.
    stop : threading.Event, optional
        The sweep ends with a `LimitError` once this is set.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes. The stages are "states", with the number
        of states found, and "cost-to-go", with the number of states whose cost-to-go is known.
    checkpoint : path, optional
        File in which a long sweep saves its progress every ten minutes. Another sweep of the same task continues from
        it. The file is removed when the sweep is done. A damaged file is ignored, and the table's note says so.
    lent : callable, optional
        Returns the number of bytes that are currently reserved for another computation.

    Raises
    ------
    LimitError
        A limit is reached, or a cost is larger than `LARGEST_COST`.
    """
    assert callable(progress)
    if (largest := max(task.costs, default=0)) > LARGEST_COST:
        raise CostLimitError(f"{task.instance}: a cost of {largest} is too large; expected at most {LARGEST_COST}")
    budget = Budget.within(max_states, memory_limit_mb, deadline, stop, lent)
    threads = threads or processors()
    search = _search(task, budget, threads, progress, None if checkpoint is None else Path(checkpoint))
    if isinstance(search, Table):
        return search
    if isinstance(search, str):
        return _listed(task, budget, threads, search, progress)
    ranking, kept = search.forward.coding, search.forward.checkpoint
    index, transitions, distance = search.solve(int(ranking.encode(task.initial)[0]), task.goal)
    initial = int(index.numbers(np.array([task.initial]))[0])
    note = None if kept is None else kept.fault
    return Table(StateSpace(task, len(distance), initial, transitions, index), distance, note)


def _search(
    task: Task, budget: Budget, threads: int, progress: Progress, checkpoint: Path | None
) -> BucketDijkstra | Table | str:
    """Return the ranked search; the table if enumeration finished first; or the reason why there is no ranking."""
    if any(variable.axiom_layer >= 0 for variable in task.variables):
        return "it has derived variables"
    try:
        moves = split_operators(task, budget.during("operators were split"))
        if moves is None:
            return "its operators split into very many moves"
        coding, moves = plain(task, moves, budget)
    except (MemoryLimitError, MemoryError):
        return "looking for an index took too much memory"
    if coding is None or coding.size > MANY:
        with suppress(MemoryLimitError, MemoryError):  # a ranked search may need less memory
            few = enumerated(task, budget, threads, progress, FEW * (len(moves) + ANYWAY))
            if few is not None:
                return _settled(task, few, budget, progress, None)
        why = "its states take more than 62 bits each"
        try:
            coding, moves = denser(task, coding, moves, budget.part(LOOKING))
        except (MemoryLimitError, MemoryError):
            why = "looking for an index took too much memory"
        except LimitError:
            budget.during(PHASE)(0)
            why = "looking for an index took too long"
        if coding is None:
            return why
    if coding.size > HUGE:
        with suppress(MemoryLimitError, MemoryError):
            return _listed(task, budget, threads, None, progress)
    # These tables are in use throughout the search.
    left = budget.beside(coding.decoder.rows.nbytes)
    operators: list[RankedOperators] = []
    try:
        for own in (moves, [move.inverse() for move in moves]):
            operators.append(build_tests(own, coding, task.costs, left.during("operators were laid out")))
            left = left.beside(operators[-1].table.nbytes + operators[-1].candidates.sets.nbytes)
    except (MemoryLimitError, MemoryError):
        return "its index takes too much memory"
    kept = None if checkpoint is None else Checkpoint(checkpoint, task, coding.decoder)
    return BucketDijkstra(ForwardSearch(coding, operators[0], left, threads, progress, kept), operators[1])


def _listed(task: Task, budget: Budget, threads: int, why: str | None, progress: Progress) -> Table:
    """Compute the table without a ranking, which is possible for every task. The note states the reason `why`."""
    listing = enumerated(task, budget, threads, progress)
    assert listing is not None
    note = f"swept without an index, which takes some ten times as long as with one: {why}"
    return _settled(task, listing, budget, progress, None if why is None else note)


def _settled(task: Task, listing: ExploredGraph, budget: Budget, progress: Progress, note: str | None) -> Table:
    """Compute the table from an explored graph."""
    distance = settled(task, listing, budget, progress)
    space = StateSpace(task, len(distance), 0, len(listing.targets), listing.found)
    return Table(space, distance, note)
