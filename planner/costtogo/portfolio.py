"""One call for the exact cost-to-go of a task, whatever its size.

`cost_to_go` sweeps all states, as far as the limits allow, and answers on demand where they do not. Where only some
states are wanted both ways are tried side by side, and whichever is done first is the answer: nothing is guessed, and
it takes at most about twice as long as the better of the two, which would have had the processors for itself. Each is
left alone for a moment first, as what is done at once is not to share them: the sweep for `FIRST`, then the search for
single states for `SECOND`. Where there are too many states for a sweep, one state of each
orbit under the task's symmetries is swept, if these are few enough; then answers on demand are looked up. The result
is a `Table` or an `OnDemand`; both are a `CostToGo`.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..grounding.task import Task
from ..system.limits import MAX_STATES, NO_LIMITS, LimitError, Limits, MemoryLimitError
from ..system.progress import Progress, Wanted, shows_progress
from .cache import Cache
from .on_demand import OnDemand
from .orbits import OrbitTable, orbits
from .sweep import sweep
from .table import Table

FIRST = 0.008
"""Seconds that a sweep has before the first state is asked for: as much as a task of some ten thousand states takes."""

SECOND = 0.03
"""Seconds in which the sweep then waits: Fast Downward takes half as long for a state that is easy."""

LONGER = 4
"""Times that asking would have to go on for as long as it has, when all states are enumerated, for it to end there."""

PER_ORBIT = 4
"""An orbit counts as so many states: it takes more time and memory."""


class _Unswept(NamedTuple):
    """Why a task was not swept, and its orbits, if these were."""

    reason: str
    orbits: OrbitTable | None


class _Stop(threading.Event):
    """Tells the sweep that it is not needed any more; a sweep that asks waits while it is not its turn."""

    def __init__(self) -> None:
        super().__init__()
        self._waits_until = -math.inf

    def pause(self, seconds: float) -> None:
        """Let who asks wait."""
        self._waits_until = time.monotonic() + seconds

    def is_set(self) -> bool:
        """Whether it is over, which ends waiting."""
        seconds = self._waits_until - time.monotonic()
        return self.wait(seconds) if seconds > 0 else super().is_set()


@shows_progress
def cost_to_go(
    task: Task,
    states: ArrayLike | None = None,
    *,
    max_states: int = MAX_STATES,
    memory_limit_mb: float | None = None,
    deadline: float | None = None,
    cache: Cache | None = None,
    jobs: int | None = None,
    limits: Limits = NO_LIMITS,
    progress: Wanted = None,
    checkpoint: str | Path | None = None,
    lent: Callable[[], float] = float,
) -> Table | OnDemand:
    """Choose how to come by the exact cost-to-go of a task, and begin.

    All states are swept where they fit the limits; else one state of each orbit, if these do. Otherwise, and where only
    a few states are wanted and asking for them is done earlier, the result answers on demand; in the latter case it
    knows them already.

    Parameters
    ----------
    task : Task
    states : int array, shape (N, variables), optional
        The values of the states that are wanted; all unless given.
    max_states : int
        Sweep at most so many, or a fourth as many orbits.
    memory_limit_mb : float, optional
        What a sweep may use in addition to what the process has already; what the machine has left unless given.
        It is estimated before anything is allocated.
    deadline : float, optional
        A time on `time.monotonic()`'s clock. Orbits have half of what a sweep leaves of the time.
    cache : Cache, optional
        Where answers on demand are kept.
    jobs : int, optional
        Threads of the sweep, or searches at a time; one per processor unless given.
    limits : Limits
        Of each single search on demand.
    progress : callable or bool, optional
        Who is told how far it is, as in `planner.system.progress`.
    checkpoint, lent
        Of the sweep.

    Returns
    -------
    Table or OnDemand
        Both are a `CostToGo`; the latter says in `reason` why, and has `orbits` where these were swept.

    Raises
    ------
    LimitError
        The deadline has passed.
    """
    assert callable(progress)

    def swept(stop: threading.Event | None = None, progress: Progress = progress) -> Table | _Unswept:
        """Sweep; give the reason if that is not possible."""
        states = 0
        try:
            return sweep(
                task,
                max_states=max_states,
                memory_limit_mb=memory_limit_mb,
                deadline=deadline,
                threads=jobs,
                stop=stop,
                progress=progress,
                checkpoint=checkpoint,
                lent=lent,
            )
        except (MemoryLimitError, MemoryError):
            reason = "a table of all states does not fit the memory"  # how much is missing differs from run to run
        except LimitError as error:
            if deadline is not None and time.monotonic() > deadline:
                raise
            if stop is not None and stop.is_set():
                return _Unswept(str(error), None)
            reason, states = str(error), max_states + 1
        try:
            found = orbits(
                task,
                max_orbits=max_states // PER_ORBIT,
                states=states,
                memory_limit_mb=memory_limit_mb,
                deadline=None if deadline is None else (time.monotonic() + deadline) / 2,
                threads=jobs,
                stop=stop,
                progress=progress,
                lent=lent,
            )
        except (LimitError, MemoryError):
            return _Unswept(reason, None)
        return _Unswept(reason, found)

    if states is not None:
        return _race(task, np.atleast_2d(np.asarray(states, dtype=np.int64)), swept, cache, jobs, limits, progress)
    answer = swept()
    if isinstance(answer, _Unswept):
        return OnDemand(task, cache=cache, jobs=jobs, limits=limits, reason=answer.reason, orbits=answer.orbits)
    return answer


def _race(
    task: Task,
    states: NDArray[np.int64],
    swept: Callable[[threading.Event, Progress], Table | _Unswept],
    cache: Cache | None,
    jobs: int | None,
    limits: Limits,
    progress: Progress,
) -> Table | OnDemand:
    """Sweep and ask for states, of shape (N, variables), at the same time, until one of the two is done.

    How long a sweep takes is not known before the states are enumerated. Then what is left of it takes about as long
    as that did; if what is left to ask for would take `LONGER` times that, the sweep has the processors for itself.
    """
    asked = OnDemand(task, cache=cache, jobs=jobs, limits=limits)
    wanted = asked.numbers(states)
    if not np.isnan(asked.known(wanted)).any():
        return asked.under(limits, f"the {len(states)} states that are wanted are known already")
    enough, over, late = _Stop(), threading.Event(), threading.Event()
    answered = 0

    def count(more: int) -> None:
        nonlocal answered
        answered += more

    def told(what: str, done: int, of: int | None) -> None:
        if what == "cost-to-go" and len(states) - answered > LONGER * (answered + 1):
            late.set()
        progress(what, done, of)

    def sweeping() -> Table | _Unswept:
        try:
            return swept(enough, told)
        finally:
            over.set()
            late.set()

    with ThreadPoolExecutor(1) as pool:
        try:
            sweep_of_all = pool.submit(sweeping)
            if over.wait(FIRST) and isinstance(table := sweep_of_all.result(), Table):
                return table
            enough.pause(SECOND)
            start = time.monotonic()
            try:
                asked.under(replace(limits, stop=late), None).lookup(wanted, count)
            except LimitError:  # the sweep was faster, or will be, or has to do
                found = sweep_of_all.result()
                return found if isinstance(found, Table) else asked.under(limits, *found)
            seconds = time.monotonic() - start
        finally:
            enough.set()
    reason = f"asking for {len(states)} states took {seconds:.3g} s, in which not all states were enumerated"
    return asked.under(limits, reason)
