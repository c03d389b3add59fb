"""Solving many instances in parallel, on this machine or on a cluster.

`solve_batch` runs `solve_instance` on each instance, and adds each record to a folder of results at once. A run can be
resumed. The records do not depend on where they were computed.
"""

from __future__ import annotations

import json
import tempfile
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..pddl.instances import Instance
from ..system.files import held
from ..system.limits import available_memory, processors
from ..system.progress import Progress
from ..system.workers import outcomes
from .results_folder import Key, Results, SolveOptions, SolveRecord, key, unfinished, unsolved
from .solve_instance import solve_instance

NEW_RECORD = "record"
"""Report of a worker that it has written a new intermediate record."""

Work = tuple[Instance, Path | None, Path | None]
"""An instance, the path of its table and plan, and the file for its intermediate records."""


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

    `progress` is called with each final record. In other threads, `stages` is called with an instance and the
    arguments of `progress` in `solve_instance`, and `tell` with each new intermediate record of an unfinished
    instance. If the run is interrupted, `tell` is called with the latest record of each. A cluster reports none.
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
        with tempfile.TemporaryDirectory(prefix="kitassist-") as folder, ExitStack() as at_the_end:
            ongoing = _Ongoing(Path(folder), records, results, tell)
            work: list[Work] = [
                (
                    one,
                    None if results is None else results.place(one),
                    None if scheduler is not None else ongoing.file(one),
                )
                for one in todo
            ]

            def hear(item: Work, what: str, *stage: Any) -> None:
                if what == NEW_RECORD:
                    with suppress(OSError):  # a lasting fault is reported with the final record
                        ongoing.hear(item[0])
                elif stages is not None:
                    stages(item[0], what, *stage)

            if results is not None and scheduler is None:
                at_the_end.callback(results.remove_unfinished)  # of workers that were stopped
            ways: dict[str, Any] = {"jobs": jobs, "scheduler": scheduler, "timeout": timeout, "hear": hear}
            coming = at_the_end.enter_context(closing(outcomes(_solve, work, (shared,), **ways)))
            try:
                _collect(coming, ongoing, options, progress)
            except BaseException:
                for instance in todo:
                    with suppress(OSError):
                        ongoing.hear(instance)
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


def _solve(work: Work, options: SolveOptions, progress: Progress) -> SolveRecord:
    instance, place, file = work
    heard: bool | None = None

    def tell(record: SolveRecord, saved: bool) -> None:
        nonlocal heard
        if file is not None:
            part = file.with_suffix(".part")
            part.write_text(json.dumps([record, saved]), encoding="utf-8")
            part.replace(file)
            if saved != heard:  # otherwise only the number of compared states has changed
                progress(NEW_RECORD, 0, None)
            heard = saved

    return solve_instance(instance, options, place, progress=progress, tell=tell)


class _Ongoing:
    """Intermediate records of unfinished instances, which each worker writes to a file."""

    def __init__(
        self,
        folder: Path,
        records: dict[Key, SolveRecord],
        results: Results | None,
        tell: Callable[[SolveRecord], None] | None,
    ) -> None:
        self._folder, self._records, self._results, self._tell = folder, records, results, tell
        self._files: dict[Key, Path] = {}
        self._heard: dict[Key, SolveRecord] = {}
        self._lock = threading.Lock()  # one thread receives reports, another final records

    def file(self, instance: Instance) -> Path:
        """Return the file for an instance's intermediate records."""
        return self._files.setdefault(key(instance), self._folder / f"{len(self._files)}.json")

    def latest(self, instance: Instance) -> tuple[SolveRecord, bool] | None:
        """Return the latest intermediate record, and whether table and plan are saved; None if there is no record."""
        try:
            record, saved = json.loads(self.file(instance).read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        return record, saved

    def hear(self, instance: Instance) -> None:
        """Store the latest intermediate record of an instance, and report it."""
        with self._lock:
            latest = self.latest(instance)
            if latest is None or key(instance) in self._records or latest[0] == self._heard.get(key(instance)):
                return
            if self._results is not None:
                self._results.add(latest[0], lasting=latest[1])
        if self._tell is not None:
            self._tell(latest[0])
        self._heard[key(instance)] = latest[0]  # last: if Ctrl-C comes before, the record is reported once more

    def end(self, instance: Instance, record: SolveRecord) -> None:
        """Store the final record of an instance."""
        with self._lock:
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
    for (instance, *_), outcome in coming:
        if isinstance(outcome, Exception):
            outcome = _ended(instance, outcome, options, ongoing.latest(instance))
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
