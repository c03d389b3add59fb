"""Many instances: in parallel, on this machine or on a cluster, resumable.

`solve_batch` runs `solve_instance` on each and keeps what is finished in `results.jsonl`: a record is added as
soon as it is there. The records do not depend on where they were made.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

from .budget import available_memory
from .errors import MissingExtraError
from .pddl import Instance
from .solving import Record, SolveOptions, solve_instance, unsolved
from .storage import append_record, read_records, write_records

RESULTS = "results.jsonl"
DONE = ("solved", "unsolvable")  # statuses that a resumed run keeps; the others are tried again
GRACE = 10.0  # seconds that a worker may take to end by itself after its time limit

Outcomes = Iterator[tuple[Instance, Record]]


class ResultsExistError(ValueError):
    """An output folder that holds results already."""


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
    outcomes = (
        _in_processes(todo, options, out, jobs) if scheduler is None else _on_cluster(todo, options, out, scheduler)
    )
    for instance, record in outcomes:
        records[str(instance.problem)] = record
        if results is not None:
            append_record(results, record)
        if progress is not None:
            progress(record)
    ordered = [records[str(instance.problem)] for instance in instances]
    if results is not None:
        write_records(results, [*ordered, *kept.values()])
    return ordered


def _in_processes(instances: Sequence[Instance], options: SolveOptions, out: Path | None, jobs: int) -> Outcomes:
    """Solve instances in processes of this machine, which are stopped when an instance exceeds its time."""
    from pebble import ProcessExpired, ProcessPool

    if not instances:
        return
    timeout = None if options.time_limit is None else options.time_limit + GRACE
    workers = min(jobs, len(instances))
    pool = ProcessPool(max_workers=workers, context=get_context("spawn"), initializer=_ignore_interrupts)
    try:
        futures: dict[Future[Record], Instance] = {
            pool.schedule(solve_instance, args=(instance, options, out), timeout=timeout): instance
            for instance in instances
        }
        for future in as_completed(futures):
            instance = futures[future]
            try:
                record = future.result()
            except TimeoutError:
                record = unsolved(instance, "limit", f"out of time ({options.time_limit:g} s)")
            except ProcessExpired as error:
                reason = f"the worker process died with exit code {error.exitcode}, probably out of memory"
                record = unsolved(instance, "limit", reason)
            except Exception as error:  # noqa: BLE001  a fault of this program stops one instance, not all
                record = unsolved(instance, "invalid", f"internal error: {error!r}")
            yield instance, record
        pool.close()  # type: ignore[no-untyped-call]
    except BaseException:
        pool.stop()  # type: ignore[no-untyped-call]
        raise
    finally:
        pool.join()


def _on_cluster(instances: Sequence[Instance], options: SolveOptions, out: Path | None, scheduler: str) -> Outcomes:
    """Solve instances on the workers of a Dask cluster, which see the same files at the same paths."""
    try:
        from distributed import Client, KilledWorker
        from distributed import as_completed as as_completed_on_cluster
    except ImportError:
        raise MissingExtraError("a cluster needs Dask: pip install 'kitassist[cluster]'") from None

    with Client(scheduler) as client:
        futures = {
            client.submit(solve_instance, instance, options, out, pure=False): instance for instance in instances
        }
        try:
            for future in as_completed_on_cluster(list(futures)):
                instance = futures[future]
                try:
                    record = future.result()
                except KilledWorker:
                    record = unsolved(instance, "limit", "its workers died, probably out of memory")
                except Exception as error:  # noqa: BLE001  as above
                    record = unsolved(instance, "invalid", f"internal error: {error!r}")
                yield instance, record
        finally:
            client.cancel(list(futures))


def _ignore_interrupts() -> None:
    """Leave Ctrl-C to the parent, which stops the workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
