"""Solving many instances in parallel, on this machine or on a cluster.

`solve_batch` runs `solve_instance` on each instance, and adds each record to a folder of results at once. A run can be
resumed. The records do not depend on where they were computed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ..pddl.instances import Instance
from ..system.files import held
from ..system.limits import available_memory, processors
from ..system.processes import outcomes
from .results_folder import Key, Results, SolveOptions, SolveRecord, key, unfinished, unsolved
from .solve_instance import solve_instance

NEW_RECORD = "record"
"""Stage that a worker reports with an intermediate record, and whether its table and plan are saved."""

Work = tuple[Instance, Path | None]
"""An instance, and the path of its table and plan."""


def solve_batch(
    instances: Sequence[Instance],
    options: SolveOptions | None = None,
    *,
    out: Path | None = None,
    jobs: int = 1,
    resume: bool = False,
    scheduler: str | None = None,
    progress: Callable[[SolveRecord], None] | None = None,
    stages: Callable[..., None] | None = None,
    tell: Callable[[SolveRecord], None] | None = None,
) -> list[SolveRecord]:
    """Solve many instances, and return their records, in the order of the instances.

    The folder `out` receives tables, plans and `results.jsonl`, to which each record is added at once. With `resume`,
    its valid records of solved and unsolvable instances are kept, and only the others are run; without it, results in
    the folder raise a `InputFileError`. At most `jobs` worker processes share the machine's memory and processors;
    with `jobs=0`, a fork of this process solves them one after another (`outcomes`). Instead, the workers of the
    Dask `scheduler` at an address can solve the instances. They must see the same files at the same paths, and run one
    thread each.

    `progress` is called with each final record, `stages` with an instance and the arguments of `progress` in
    `solve_instance`, and `tell` with each new intermediate record of an unfinished instance. If the run is interrupted,
    `tell` is called with the latest record of each. A cluster reports none.
    """
    grace = 10.0  # seconds that a worker may take to stop after its time limit, before it is killed
    options = options or SolveOptions()
    with ExitStack() as holding:
        if out is not None:
            holding.enter_context(held(out))
        results = None if out is None else Results(out, instances, options, resume=resume)
        records = {} if results is None else dict(results.records)
        todo = [instance for instance in instances if key(instance) not in records]
        if progress is not None:
            for instance in instances:
                if key(instance) in records:
                    progress(records[key(instance)])
        jobs = min(jobs, len(todo))
        timeout = None if options.time_limit is None else options.time_limit + grace
        shared = options if scheduler is not None else _shared(options, jobs)
        with ExitStack() as at_the_end:
            ongoing = _Ongoing(records, results, tell)
            work: list[Work] = [(one, None if results is None else results.place(one)) for one in todo]

            def hear(item: Work, what: str, *told: Any) -> None:
                if what == NEW_RECORD:
                    ongoing.hear(item[0], *told)
                elif stages is not None:
                    stages(item[0], what, *told)

            if results is not None and scheduler is None:
                at_the_end.callback(results.remove_unfinished)  # of workers that were stopped
            ways: dict[str, Any] = {"jobs": jobs, "scheduler": scheduler, "timeout": timeout, "hear": hear}
            coming = at_the_end.enter_context(closing(outcomes(_solve, work, (shared,), **ways)))
            try:
                _collect(coming, ongoing, options, progress)
            except BaseException:
                for instance in todo:
                    ongoing.store(instance)
                raise
        if results is not None:
            results.finish(instances)
        return [records[key(instance)] for instance in instances]


def _shared(options: SolveOptions, jobs: int) -> SolveOptions:
    """Return the options with the machine's memory and processors divided among the workers."""
    if jobs <= 1:
        return options
    memory = available_memory() / 1e6 / jobs
    limit = memory if options.memory_limit is None else min(memory, options.memory_limit)
    threads = max(1, processors() // jobs)
    return replace(options, memory_limit=limit, threads=options.threads or threads)


def _solve(work: Work, options: SolveOptions, report: Callable[..., None]) -> SolveRecord:
    return solve_instance(work[0], options, work[1], progress=report, tell=partial(report, NEW_RECORD))


class _Ongoing:
    """Intermediate records of unfinished instances, as their workers report them."""

    def __init__(
        self,
        records: dict[Key, SolveRecord],
        results: Results | None,
        tell: Callable[[SolveRecord], None] | None,
    ) -> None:
        self._records, self._results, self._tell = records, results, tell
        self.latest: dict[Key, tuple[SolveRecord, bool]] = {}
        """The latest intermediate record of each instance, and whether table and plan are saved."""
        self._stored: dict[Key, SolveRecord] = {}

    def hear(self, instance: Instance, record: SolveRecord, saved: bool) -> None:
        """Store an intermediate record, unless only the number of compared states has changed, and report it."""
        before = self.latest.get(key(instance))
        self.latest[key(instance)] = record, saved
        if before is None or saved != before[1]:
            self.store(instance)

    def store(self, instance: Instance) -> None:
        """Store the latest intermediate record of an instance if there is a new one, and report it."""
        record, saved = self.latest.get(key(instance), (None, False))
        if record is None or key(instance) in self._records or record == self._stored.get(key(instance)):
            return
        with suppress(OSError):  # a lasting fault is reported with the final record
            if self._results is not None:
                self._results.add(record, lasting=saved)
            if self._tell is not None:
                self._tell(record)
            self._stored[key(instance)] = record  # last: if Ctrl-C comes before, the record is reported once more

    def end(self, instance: Instance, record: SolveRecord) -> None:
        """Store the final record of an instance."""
        self._records[key(instance)] = record
        if self._results is not None:
            self._results.add(record)


def _collect(
    coming: Iterable[tuple[Work, SolveRecord | Exception]],
    ongoing: _Ongoing,
    options: SolveOptions,
    progress: Callable[[SolveRecord], None] | None,
) -> None:
    """Store the final record of each instance, and report it."""
    for (instance, _), outcome in coming:
        if isinstance(outcome, Exception):
            outcome = _ended(instance, outcome, options, ongoing.latest.get(key(instance)))
        ongoing.end(instance, outcome)
        if progress is not None:
            progress(outcome)


def _ended(
    instance: Instance, error: Exception, options: SolveOptions, latest: tuple[SolveRecord, bool] | None
) -> SolveRecord:
    """Return the record of an instance whose worker ended early. An internal error affects one instance only."""
    if not isinstance(error, TimeoutError | ChildProcessError):
        return unsolved(instance, "invalid", f"internal error: {error!r}")
    why = str(error) if isinstance(error, ChildProcessError) else f"out of time ({options.time_limit:g} s)"
    return unsolved(instance, "limit", why) if latest is None else unfinished(latest[0], why)
