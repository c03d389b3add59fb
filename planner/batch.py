"""Many instances: in parallel, on this machine or on a cluster, resumable.

`solve_batch` runs `solve_instance` on each and keeps what is finished in `results.jsonl`: a record is added as
soon as it is there. The records do not depend on where they were made.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from .budget import available_memory
from .errors import ResultsExistError
from .pddl import Instance
from .solving import Record, SolveOptions, solve_instance, unsolved
from .storage import append_record, read_records, write_records
from .workers import WorkerDiedError, outcomes

RESULTS = "results.jsonl"
DONE = ("solved", "unsolvable")  # statuses that a resumed run keeps; the others are tried again
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
        Worker processes.
    resume : bool
        Keep what `results.jsonl` holds as solved or unsolvable, and run the rest.
    scheduler : str, optional
        Address of a Dask scheduler whose workers solve the instances instead of processes of this machine. They
        have to see the same files at the same paths, and run one thread each.
    progress : callable, optional
        Called with each record as it comes in.

    Returns
    -------
    list of Record
        In the order of `instances`.

    Raises
    ------
    ResultsExistError
        There are results in `out` already, and `resume` is not set.
    MissingExtraError
        A cluster is asked for, and the extra `cluster` is not installed.
    """
    options = options or SolveOptions()
    if jobs > 1 and scheduler is None:  # they share the machine
        memory = available_memory() / 1e6 / jobs
        limit = memory if options.memory_limit is None else min(memory, options.memory_limit)
        threads = max(1, (os.cpu_count() or 1) // jobs)
        options = replace(options, memory_limit=limit, threads=options.threads or threads)
    results = None if out is None else out / RESULTS
    kept: dict[str, Record] = {}
    if results is not None:
        if results.exists() and not resume:
            raise ResultsExistError(f"{results} exists; resume it, or choose another folder")
        kept = {record["instance"]: record for record in read_records(results) if record["status"] in DONE}
        write_records(results, kept.values())
    records = {str(i.problem): kept.pop(str(i.problem)) for i in instances if str(i.problem) in kept}
    if progress is not None:
        for record in records.values():
            progress(record)
    todo = [instance for instance in instances if str(instance.problem) not in records]
    timeout = None if options.time_limit is None else options.time_limit + GRACE
    for instance, outcome in outcomes(
        solve_instance, todo, (options, out), jobs=jobs, scheduler=scheduler, timeout=timeout
    ):
        record = _unsolved(instance, outcome, options) if isinstance(outcome, Exception) else outcome
        records[str(instance.problem)] = record
        if results is not None:
            append_record(results, record)
        if progress is not None:
            progress(record)
    ordered = [records[str(instance.problem)] for instance in instances]
    if results is not None:
        write_records(results, [*ordered, *kept.values()])
    return ordered


def _unsolved(instance: Instance, error: Exception, options: SolveOptions) -> Record:
    """Say why there is no result; a fault of this program stops one instance, not all."""
    if isinstance(error, TimeoutError):
        return unsolved(instance, "limit", f"out of time ({options.time_limit:g} s)")
    if isinstance(error, WorkerDiedError):
        return unsolved(instance, "limit", str(error))
    return unsolved(instance, "invalid", f"internal error: {error!r}")
