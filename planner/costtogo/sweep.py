"""The sweep: all reachable states of a task and their exact cost-to-go, fast and in little memory.

`sweep` computes a `Table` in three steps: it constructs a ranking of the states (`ranking`), finds the reachable states
and their distances (`forward_search`, `backward_search`), and numbers the states as `search.state_space` says.

Tasks with derived variables, with ranks beyond 62 bits, or with operators that split into very many moves use a slower
method: a registry of packed states, with all transitions in memory.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

from ..grounding.task import Task
from ..pddl.formulas import LARGEST_COST
from ..search.backward_search import distances
from ..search.forward_search import explore
from ..search.numbering import SweepOptions, strides
from ..search.search_space import SearchSpace
from ..search.sorted_space import SortedSpace, TooLargeError
from ..search.state_space import StateSpace
from ..system.limits import Budget, CostLimitError, LimitError, MemoryLimitError, processors
from ..system.progress import Progress, Wanted, shows_progress
from .load import task_of
from .table import Table

if TYPE_CHECKING:
    from .load import AnyTask


@shows_progress
def sweep(
    task: AnyTask,
    *,
    max_states: int | None = None,
    memory_limit_mb: float | None = None,
    deadline: float | None = None,
    threads: int | None = None,
    stop: threading.Event | None = None,
    progress: Wanted = None,
    reserved_bytes: Callable[[], float] = float,
    options: SweepOptions | None = None,
) -> Table:
    """Enumerate the reachable states of a task, and compute the exact cost-to-go of all of them.

    Parameters
    ----------
    task : Task, or whatever `load` takes
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
    reserved_bytes : callable, optional
        Returns the number of bytes that are currently reserved for another computation.
    options : SweepOptions, optional

    Raises
    ------
    LimitError
        A limit is reached, or a cost is larger than `LARGEST_COST`.
    """
    assert callable(progress)
    task = task_of(task)
    require_sweepable(task)
    budget = Budget.within(max_states, memory_limit_mb, deadline, stop, reserved_bytes)
    threads = threads or processors()
    space, note = explored(task, budget, threads, progress, options or SweepOptions())
    distance = distances(space, task.goal, budget, threads, progress)
    found = StateSpace(task, len(distance), space.initial, space.transitions, space.index, budget.check_memory)
    return Table(found, distance, note)


def require_sweepable(task: Task) -> None:
    """Check that all values of numbers are known, and that no cost is larger than `LARGEST_COST`."""
    if task.beyond:
        raise LimitError(f"{task.instance}: not all states are known, since a number has no proven bound")
    if (largest := max(task.costs, default=0)) > LARGEST_COST:
        raise CostLimitError(f"{task.instance}: a cost of {largest} is too large; expected at most {LARGEST_COST}")


def explored(
    task: Task, budget: Budget, threads: int, progress: Progress, options: SweepOptions
) -> tuple[SearchSpace, str | None]:
    """Return the space of all reachable states, and a note.

    The note is None, or says why a slower search without a ranking was used.
    """
    if (space := _small(task, budget, progress, options)) is not None:
        return space, None
    from ..search import compiled_search  # the compiler takes longer to import than a small task to solve

    return compiled_search.explored(task, budget, threads, progress, options)


def _small(task: Task, budget: Budget, progress: Progress, options: SweepOptions) -> SortedSpace | None:
    """Return the space of a task by the readable search; None if the task is not small."""
    if not options.small_states:
        return None
    try:
        space = SortedSpace(task, budget, options.small_states)
        explore(space, budget, 1, progress)
        stride = strides(task, space.transitions, budget, options)
    except (TooLargeError, MemoryLimitError, MemoryError):
        return None
    if stride is not None:
        space.by_rank(stride)
    return space
