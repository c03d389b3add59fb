"""One call for the exact cost-to-go of a task, whatever its size.

`cost_to_go` estimates what a sweep of all states would take, and what asking for the states that are wanted
would, and returns a `Table` or an `OnDemand`; both are a `CostToGo`.
"""

from __future__ import annotations

import math
import os
import time

import numpy as np
from numpy.typing import ArrayLike

from .budget import MemoryLimitError
from .costtogo import Table, astar
from .fast_downward import NO_LIMITS, LimitError, Limits
from .ondemand import Cache, OnDemand
from .sweep import sweep
from .task import Task

MAX_STATES = 50_000_000
"""States that are enumerated, unless another number is given."""

SWEEP_RATE = 3e6
"""States per second that the choice of the method counts on; measured by `bench/cost_to_go.py`."""


def largest_size(task: Task) -> int:
    """Give an upper bound on the number of reachable states: the product of the variables' domain sizes."""
    return math.prod(len(variable.facts) for variable in task.variables if variable.axiom_layer < 0)


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
) -> Table | OnDemand:
    """Choose how to come by the exact cost-to-go of a task, and begin.

    All states are swept where they fit the limits. Otherwise, and where only a few states are wanted and
    asking for them promises to be faster, the result answers on demand.

    Parameters
    ----------
    task : Task
    states : int array, shape (N, variables), optional
        The values of the states that are wanted; all unless given.
    max_states : int
        Sweep at most so many.
    memory_limit_mb : float, optional
        What a sweep may use in addition to what the process has already; what the machine has left unless given.
        It is estimated before anything is allocated.
    deadline : float, optional
        A time on `time.monotonic()`'s clock.
    cache : Cache, optional
        Where answers on demand are kept.
    jobs : int, optional
        Threads of the sweep, or searches at a time; one per processor unless given.
    limits : Limits
        Of each single search on demand.

    Returns
    -------
    Table or OnDemand
        Both are a `CostToGo`; the latter says in `reason` why.

    Raises
    ------
    LimitError
        The deadline has passed.
    """
    if states is not None:
        count, size = len(np.atleast_2d(np.asarray(states))), largest_size(task)
        start = time.monotonic()
        try:
            astar(task, limits=limits)
            asking = count * (time.monotonic() - start) / (jobs or os.cpu_count() or 1)
        except LimitError:  # asking does not even answer for one state
            asking = math.inf
        if asking < min(size, max_states) / SWEEP_RATE:
            reason = f"{count} states are wanted, of up to {size:.3g}"
            return OnDemand(task, cache=cache, jobs=jobs, limits=limits, reason=reason)
    try:
        return sweep(
            task,
            max_states=max_states,
            memory_limit_mb=memory_limit_mb,
            deadline=deadline,
            threads=jobs,
            if_likely=True,
        )
    except (MemoryLimitError, MemoryError):
        reason = "a table of all states does not fit the memory"  # how much is missing differs from run to run
    except LimitError as error:
        if deadline is not None and time.monotonic() > deadline:
            raise
        reason = str(error)
    return OnDemand(task, cache=cache, jobs=jobs, limits=limits, reason=reason)
