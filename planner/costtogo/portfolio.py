"""One function for the exact cost-to-go of a task of any size.

`cost_to_go` sweeps all states if the limits allow it, and otherwise solves states on demand. If only some states are
requested, both methods run concurrently, and the first to finish provides the result. Since each has about half of the
processors, this takes at most about twice as long as the better method alone. At the start the sweep runs alone for
`FIRST` seconds. If there are too many states for a sweep, one canonical state of each orbit is swept, provided that
there are few enough orbits. The result is a `Table` or an `OnDemand`; both implement `CostToGo`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..grounding.task import Task
from ..system.limits import MAX_STATES, NO_LIMITS, LimitError, Limits, MemoryLimitError, require_limits
from ..system.progress import Progress, Wanted, shows_progress
from .cost_to_go import CostToGo
from .load import task_of
from .table import Table, sweep

if TYPE_CHECKING:
    from .load import AnyTask
    from .on_demand import Cache, OnDemand
    from .orbit_table import OrbitTable

FIRST = 0.008
"""Seconds for which the sweep runs alone. A task of some ten thousand states is swept in that time."""


class _Unswept(NamedTuple):
    """Why the states of a task were not all swept, and the table of its orbits if these were swept instead."""

    reason: str
    orbits: OrbitTable | None


@shows_progress
def cost_to_go(
    task: AnyTask,
    states: ArrayLike | None = None,
    *,
    max_states: int = MAX_STATES,
    memory_limit_mb: float | None = None,
    deadline: float | None = None,
    cache: Cache | None = None,
    jobs: int | None = None,
    limits: Limits = NO_LIMITS,
    progress: Wanted = None,
    reserved_bytes: Callable[[], float] = float,
) -> Table | OnDemand:
    """Compute the exact cost-to-go, by the method that fits the task.

    All states are swept if they fit the limits, else one canonical state of each orbit if these do. Otherwise the
    result solves states on demand. It also does so if only some states are requested and solving these finishes first;
    their costs-to-go are then known already.

    Parameters
    ----------
    task : Task, or whatever `load` takes
        A cost-to-go stands for its task.
    states : int array, shape (N, variables), optional
        Values of the requested states; all states by default.
    max_states : int
        Largest number of states that are swept, or of four times the number of orbits.
    memory_limit_mb : float, optional
        Memory of a sweep in MB, in addition to what the process uses already; by default, the available memory. The
        need is estimated before memory is allocated.
    deadline : float, optional
        Time on the clock of `time.monotonic()`. The search of orbits gets half of the time that the sweep leaves.
    cache : Cache, optional
        Cache of the results on demand.
    jobs : int, optional
        Threads of the sweep, or parallel searches; by default one per processor.
    limits : Limits
        Limits of each search on demand.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes.
    reserved_bytes
        As in `sweep`.

    Returns
    -------
    Table or OnDemand
        An `OnDemand` has the reason in `reason`, and `orbits` if these were swept.

    Raises
    ------
    LimitError
        The deadline has passed.
    TypeError
        It is no task.
    """
    assert callable(progress)
    require_limits(limits)
    task = task_of(task)
    limited: dict[str, Any] = {"max_states": max_states, "memory_limit_mb": memory_limit_mb, "deadline": deadline}
    swept = partial(_swept, task, threads=jobs, reserved_bytes=reserved_bytes, **limited)
    if states is not None:
        return _race(task, np.atleast_2d(np.asarray(states, dtype=np.int64)), swept, cache, jobs, limits, progress)
    answer = swept(progress=progress)
    if isinstance(answer, _Unswept):
        from .on_demand import OnDemand  # here and below, since most tasks need no compiled code

        return OnDemand(task, cache=cache, jobs=jobs, limits=limits, reason=answer.reason, orbits=answer.orbits)
    return answer


def known_costs(problem: AnyTask) -> CostToGo:
    """Return a cost-to-go as it is, or compute that of a task; a `TypeError` says what was expected.

    Parameters
    ----------
    problem : cost-to-go, or a task in any form that `task_of` takes
    """
    if all(hasattr(problem, name) for name in ("lookup", "choices", "task")):
        return cast(CostToGo, problem)
    return cost_to_go(problem)


def _swept(
    task: Task, *, max_states: int, deadline: float | None, stop: threading.Event | None = None, **others: Any
) -> Table | _Unswept:
    """Return the table of all states. If they exceed the limits, return the reason and the table of orbits."""
    states = 0
    try:
        return sweep(task, max_states=max_states, deadline=deadline, stop=stop, **others)
    except (MemoryLimitError, MemoryError):
        reason = "a table of all states does not fit the memory"  # the missing amount differs between runs
    except LimitError as error:
        if deadline is not None and time.monotonic() > deadline:
            raise
        if stop is not None and stop.is_set():
            return _Unswept(str(error), None)
        reason, states = str(error), max_states + 1
    from .orbit_table import orbits

    try:
        most = max_states // 4  # an orbit takes more time and memory than a state
        half = None if deadline is None else (time.monotonic() + deadline) / 2
        return _Unswept(reason, orbits(task, max_orbits=most, states=states, deadline=half, stop=stop, **others))
    except (LimitError, MemoryError):
        return _Unswept(reason, None)


def _race(
    task: Task,
    states: NDArray[np.int64],
    swept: Callable[..., Table | _Unswept],
    cache: Cache | None,
    jobs: int | None,
    limits: Limits,
    progress: Progress,
) -> Table | OnDemand:
    """Sweep the task and solve the requested states, shape (N, variables), concurrently, until one of the two is done.

    The duration of a sweep is unknown until the states are enumerated. Then its remaining part takes about as long as
    the enumeration. If the remaining requests would take four times that, the single-state search ends.
    """
    from .on_demand import OnDemand

    on_demand = OnDemand(task, cache=cache, jobs=jobs, limits=limits)
    wanted = on_demand.numbers(states)
    if not np.isnan(on_demand.known(wanted)).any():
        return on_demand.under(limits, f"the {len(states)} states that are wanted are known already")
    stop_sweep, sweep_ended, stop_searches = (threading.Event() for _ in range(3))
    solved = 0

    def count(more: int) -> None:
        nonlocal solved
        solved += more

    def report(what: str, done: int, of: int | None) -> None:
        if what == "cost-to-go" and len(states) - solved > 4 * (solved + 1):
            stop_searches.set()
        progress(what, done, of)

    def sweeping() -> Table | _Unswept:
        try:
            return swept(stop=stop_sweep, progress=report)
        finally:
            sweep_ended.set()
            stop_searches.set()

    with ThreadPoolExecutor(1) as pool:
        try:
            future = pool.submit(sweeping)
            if sweep_ended.wait(FIRST) and isinstance(table := future.result(), Table):
                return table
            start = time.monotonic()
            try:
                on_demand.under(replace(limits, stop=stop_searches), None).lookup(wanted, count)
            except LimitError:  # the sweep was faster, is expected to be, or is the only method left
                found = future.result()
                return found if isinstance(found, Table) else on_demand.under(limits, *found)
            seconds = time.monotonic() - start
        finally:
            stop_sweep.set()
    reason = f"asking for {len(states)} states took {seconds:.3g} s, in which not all states were enumerated"
    return on_demand.under(limits, reason)
