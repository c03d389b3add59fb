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
from functools import partial
from pathlib import Path

import numpy as np

from ..grounding.task import Task
from ..pddl.formulas import LARGEST_COST
from ..search.bucket_dijkstra import BucketDijkstra, settled
from ..search.checkpoint import Checkpoint
from ..search.forward_search import ExploredGraph, ForwardSearch, enumerated
from ..search.ranking.state_ranking import MANY, denser, plain
from ..search.ranking.transition_normal_form import split_operators
from ..search.successor_generator import build_tests
from ..states.state_space import StateSpace
from ..system.limits import Budget, CostLimitError, LimitError, MemoryLimitError
from ..system.machine import processors
from ..system.progress import Progress, Wanted, shows_progress
from .table import Table

FEW = 128
"""Transitions for each move that are listed before a dense index is looked for, which takes longer than that."""

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
    if any(variable.axiom_layer >= 0 for variable in task.variables):
        return _listed(task, budget, threads, "it has derived variables", progress)
    moves = split_operators(task)
    if moves is None:
        return _listed(task, budget, threads, "its operators split into very many moves", progress)
    coding, moves = plain(task, moves)
    if coding is None or coding.size > MANY:
        with suppress(MemoryLimitError, MemoryError):  # an index may take less
            few = enumerated(task, budget, threads, progress, FEW * len(moves))
            if few is not None:
                return _settled(task, few, budget, progress, None)
        why = "its states take more than 62 bits each"
        try:
            coding, moves = denser(task, coding, moves, partial(budget.part(LOOKING).check_time, 1))
        except LimitError:
            budget.check_time(1)
            why = "looking for an index took too long"
        if coding is None:
            return _listed(task, budget, threads, why, progress)
    if coding.size > HUGE:
        with suppress(MemoryLimitError, MemoryError):
            return _listed(task, budget, threads, None, progress)
    kept = None if checkpoint is None else Checkpoint(Path(checkpoint), task, coding.decoder)
    forward = ForwardSearch(coding, build_tests(moves, coding, task.costs), budget, threads, progress, kept)
    backward = BucketDijkstra(forward, build_tests([move.inverse() for move in moves], coding, task.costs))
    index, transitions, distance = backward.solve(int(coding.encode(task.initial)[0]), task.goal)
    initial = int(index.numbers(np.array([task.initial]))[0])
    note = None if kept is None else kept.fault
    return Table(StateSpace(task, len(distance), initial, transitions, index), distance, note)


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
