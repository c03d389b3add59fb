"""Many instances: in parallel, on this machine or on a cluster, resumable.

`solve_batch` runs `solve_instance` on each and keeps what is finished in a folder of results: a record is added as
soon as it is there. The records do not depend on where they were made.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from .machine import available_memory, processors
from .pddl import Instance
from .reports import Progress
from .results import Results, key
from .solving import Record, SolveOptions, solve_instance, unsolved
from .workers import WorkerDiedError, outcomes

GRACE = 10.0  # seconds that a worker may take to end by itself after its time limit


def solve_batch(
    instances: Sequence[Instance],
    options: SolveOptions | None = None,
    *,
    out: Path | None = None,
    jobs: int = 1,
    resume: bool = False,
    scheduler: str | None = None,
    progress: Callable[[Record], None] | None = None,
    stages: Callable[..., None] | None = None,
) -> list[Record]:
    """Solve many instances.

    Parameters
    ----------
    instances : sequence of Instance
    options : SolveOptions, optional
    out : Path, optional
        A folder for `results.jsonl`, to which each record is added as soon as it is there, and for
        tables and plans.
    jobs : int
        Worker processes, at most; those that run share the machine's memory and processors.
    resume : bool
        Keep what the folder holds as solved or unsolvable and was made from the same files, and run the rest.
    scheduler : str, optional
        Address of a Dask scheduler whose workers solve the instances instead of processes of this machine. They
        have to see the same files at the same paths, and run one thread each.
    progress : callable, optional
        Called with each record as it comes in.
    stages : callable, optional
        Called, in a thread, with an instance and with what `solve_instance` calls its `progress` with.

    Returns
    -------
    list of Record
        In the order of `instances`.

    Raises
    ------
    ResultsExistError
        There are results in `out` already, and `resume` is not set.
    DamagedFileError
        What is in `out` is none of this program's.
    MissingExtraError
        A cluster is asked for, and the extra `cluster` is not installed.
    """
    options = options or SolveOptions()
    results = None if out is None else Results(out, instances, options, resume=resume)
    records = {} if results is None else dict(results.records)
    todo = [instance for instance in instances if key(instance) not in records]
    if progress is not None:
        for instance in instances:
            if key(instance) in records:
                progress(records[key(instance)])
    jobs = min(jobs, len(todo))
    work = [(instance, None if results is None else results.place(instance)) for instance in todo]
    timeout = None if options.time_limit is None else options.time_limit + GRACE
    shared = options if scheduler is not None else _shared(options, jobs)

    def hear(item: tuple[Instance, Path | None], *stage: Any) -> None:
        if stages is not None:
            stages(item[0], *stage)

    try:
        ways: dict[str, Any] = {"jobs": jobs, "scheduler": scheduler, "timeout": timeout, "hear": hear}
        with closing(outcomes(_solve, work, (shared,), **ways)) as coming:
            for (instance, _), outcome in coming:
                record = _unsolved(instance, outcome, options) if isinstance(outcome, Exception) else outcome
                records[key(instance)] = record
                if results is not None:
                    results.add(record)
                if progress is not None:
                    progress(record)
    finally:
        if results is not None and scheduler is None:
            results.remove_unfinished()  # by workers that were stopped
    if results is not None:
        results.finish(instances)
    return [records[key(instance)] for instance in instances]


def _shared(options: SolveOptions, jobs: int) -> SolveOptions:
    """Share the machine between workers."""
    if jobs <= 1:
        return options
    memory = available_memory() / 1e6 / jobs
    limit = memory if options.memory_limit is None else min(memory, options.memory_limit)
    threads = max(1, processors() // jobs)
    return replace(options, memory_limit=limit, threads=options.threads or threads)


def _solve(work: tuple[Instance, Path | None], options: SolveOptions, progress: Progress) -> Record:
    instance, place = work
    return solve_instance(instance, options, place, progress=progress)


def _unsolved(instance: Instance, error: Exception, options: SolveOptions) -> Record:
    """Say why there is no result; a fault of this program stops one instance, not all."""
    if isinstance(error, TimeoutError):
        return unsolved(instance, "limit", f"out of time ({options.time_limit:g} s)")
    if isinstance(error, WorkerDiedError):
        return unsolved(instance, "limit", str(error))
    return unsolved(instance, "invalid", f"internal error: {error!r}")
