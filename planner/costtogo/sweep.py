"""Every reachable state of a task and its exact cost-to-go, fast and in little memory.

`sweep` takes a `Task` to a `Table`: it chooses the indices of states (`coding`), finds all states and their distances
(`searches`), and numbers them; the *number* of a state is its rank among the indices of all states.

Tasks with derived variables, with indices beyond 62 bits, or with operators that split into very many moves
take a slower way: a list of packed states, and all transitions in memory (`listing`).
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
"""Transitions for each move that are listed before a dense index is looked for, which takes longer than that."""

ANYWAY = 1 << 13
"""Moves that are counted beside those of the task, as looking takes seconds where listing a million takes one."""

HUGE = 1 << 38
"""Indices of which no bitmap is made: a list takes less time than a hash table of them, but more memory."""

LOOKING = 0.25
"""Share of the time in which a denser index is looked for; after that, what there is has to do."""


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
    progress : callable or bool, optional
        Who is told how far it is, as in `planner.system.progress`, after each layer of the search: what is under way is
        "states" or "cost-to-go", what is done the states that have been found, or have got theirs.
    checkpoint : path, optional
        A file in which a long sweep keeps what it has found, every ten minutes; another sweep of the same task
        continues from there. It is removed when the sweep is done. One that is damaged is ignored, which the table's
        note says.
    lent : callable, optional
        Tells how many bytes of the memory something else may take for now.

    Raises
    ------
    LimitError
        One of the limits does not suffice, or a cost is larger than `LARGEST_COST`.
    """
    assert callable(progress)
    if (dearest := max(task.costs, default=0)) > LARGEST_COST:
        raise CostLimitError(f"{task.instance}: a cost of {dearest} is too large; expected at most {LARGEST_COST}")
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
    """Return the search by an index, or why there is none, or the table where listing is done before one is found."""
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
        with suppress(MemoryLimitError, MemoryError):  # an index may take less
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
    # What is laid out is in use all the time.
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
    """List the states, which does for every task; the table's note says why, if there is a reason."""
    listing = enumerated(task, budget, threads, progress)
    assert listing is not None
    note = f"swept without an index, which takes some ten times as long as with one: {why}"
    return _settled(task, listing, budget, progress, None if why is None else note)


def _settled(task: Task, listing: ExploredGraph, budget: Budget, progress: Progress, note: str | None) -> Table:
    """Find the distances of states that are listed."""
    distance = settled(task, listing, budget, progress)
    space = StateSpace(task, len(distance), 0, len(listing.targets), listing.found)
    return Table(space, distance, note)
