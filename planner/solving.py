"""One instance, from its files to its record.

`solve_instance` solves an instance within its limits of time and memory and describes the outcome; on request it
saves the cost-to-go table as `.npz` and the plan. The records' fields are a contract that scripts depend on;
`docs/commands.md` lists them.
"""

from __future__ import annotations

import errno
import os
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import fast_downward
from .budget import MAX_STATES
from .checker import Checker
from .checking import InvalidPlanError
from .errors import MismatchError
from .fast_downward import FastDownwardError, LimitError, Limits
from .machine import memory_limit, peak_memory_mb, processors, reset_peak_memory, used_mb
from .pddl import Instance, PDDLError
from .replay import replay
from .reports import Progress
from .source import Source
from .storage import atomic
from .task import Effect, Operator, Task, Variable, ground
from .threads import NO_MORE_THREADS

if TYPE_CHECKING:
    from .costtogo import Table
    from .orbits import Orbits

Record = dict[str, Any]

SWEEP_SHARE = 0.75
"""Share of an instance's time in which all states are to be swept; what is left is for the initial one alone."""

DISK_IS_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@dataclass(frozen=True)
class SolveOptions:
    """How an instance is solved.

    Attributes
    ----------
    time_limit : float or None
        Seconds of wall-clock time for one instance.
    memory_limit : float or None
        MB for one instance.
    max_states : int
        A task with more states is solved on demand: from its initial state only.
    verify : int
        States that are compared with Fast Downward's A*, the initial one among them; none if 0.
    verify_seconds : float
        Comparisons end after this time for each of these states, or a second later.
    threads : int, optional
        Threads of one instance's sweep.
    """

    time_limit: float | None = None
    memory_limit: float | None = None
    max_states: int = MAX_STATES
    verify: int = 20
    verify_seconds: float = 0.5
    threads: int | None = None


COMPILING = "compiling"
"""What is under way while code is compiled that is in no cache yet."""


class _Phases:
    """Seconds spent in each named phase, and the deadline of all of them."""

    def __init__(self, limit: float | None, memory_mb: float | None, progress: Progress) -> None:
        self.seconds: dict[str, float] = {}
        self.memory_mb = memory_mb
        self.progress = progress
        self.start = time.monotonic()
        self.deadline = None if limit is None else self.start + limit

    @contextmanager
    def phase(self, name: str, doing: str | None = None) -> Iterator[None]:
        start = time.monotonic()
        if self.deadline is not None and start > self.deadline:
            raise LimitError(f"out of time before the phase '{name}'")
        if doing is not None:
            self.progress(doing, 0, None)
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.monotonic() - start

    def part(self, share: float) -> float | None:
        """Give when a share of all the time is over."""
        return None if self.deadline is None else self.start + share * (self.deadline - self.start)

    def limits(self) -> Limits:
        left = None if self.deadline is None else max(0.01, self.deadline - time.monotonic())
        return Limits(left, self.memory_mb)


def versions() -> dict[str, str]:
    """Name the versions that a result depends on."""
    import importlib.metadata  # takes its time

    packages = {"kitassist": "kitassist", "unified_planning": "unified-planning", "numpy": "numpy"}
    found = {key: importlib.metadata.version(package) for key, package in packages.items()}
    return {**found, "fast_downward": fast_downward.version(), "python": platform.python_version()}


def empty_record(instance: Instance, status: str, error: dict[str, Any] | None) -> Record:
    """Give the record of an instance of which nothing is known."""
    return {
        "instance": str(instance.problem),
        "domain": str(instance.domain),
        "status": status,
        "cost": None,
        "plan": None,
        "states": None,
        "transitions": None,
        "dead_ends": None,
        "max_cost_to_go": None,
        "method": None,
        "verified": 0,
        "consistent": 0,
        "seconds": {},
        "peak_memory_mb": None,
        "versions": versions(),
        "error": error,
        "note": None,
    }


def solve_instance(
    instance: Instance,
    options: SolveOptions | None = None,
    place: Path | None = None,
    *,
    progress: Progress | None = None,
    use: Callable[[Table], None] | None = None,
) -> Record:
    """Solve one instance and describe the outcome.

    Nothing is raised: what is wrong with the instance, or with its solution, stands in the record's
    `status` and `error`. A table that contradicts Fast Downward and a plan that its validator rejects are
    such errors.

    Parameters
    ----------
    instance : Instance
    options : SolveOptions, optional
    place : Path, optional
        Where the cost-to-go table and the plan are saved, without their endings `.npz` and `.plan`.
    progress : callable, optional
        Called with what is under way, how much of it is done, and of how much; None where nobody knows.
    use : callable, optional
        Called in the end with the table of all states, if they were swept; no limit is on its time.
    """
    options = options or SolveOptions()
    phases = _Phases(options.time_limit, options.memory_limit, progress or (lambda *_: None))
    reset_peak_memory()
    try:
        with phases.phase("read"):
            source = Source.of(instance)
        with Checker(source, phases.limits()) as checker, ExitStack() as until_solved:
            task = _grounded(source, checker, phases, until_solved)
            # Only now: loading libraries maps far more memory than is ever used.
            with memory_limit(options.memory_limit):
                record = _solve(task, checker, options, place, phases, use)
    except PDDLError as error:
        record = empty_record(instance, "invalid", _error(error.file, error.line, error.message))
    except LimitError as error:
        record = unsolved(instance, "limit", str(error))
    except MemoryError:
        record = _out_of_memory(instance, options)
    except (FastDownwardError, MismatchError, InvalidPlanError) as error:
        record = unsolved(instance, "invalid", str(error))
    except RuntimeError as error:
        if str(error) != NO_MORE_THREADS:
            raise
        record = _out_of_memory(instance, options)
    except OSError as error:
        if error.errno == errno.ENOMEM:  # another program found no room to begin
            record = _out_of_memory(instance, options)
        else:
            status = "limit" if error.errno in DISK_IS_FULL else "invalid"
            file = instance.problem if error.filename is None else Path(os.fsdecode(error.filename))
            record = empty_record(instance, status, _error(file, None, error.strerror or str(error)))
    record["seconds"] = {name: round(seconds, 6) for name, seconds in phases.seconds.items()}
    record["seconds"]["total"] = round(time.monotonic() - phases.start, 6)
    record["peak_memory_mb"] = round(peak_memory_mb(), 1)
    return record


def _out_of_memory(instance: Instance, options: SolveOptions) -> Record:
    limit = f" ({options.memory_limit:g} MB)" if options.memory_limit else ""
    return unsolved(instance, "limit", f"out of memory{limit}")


def _grounded(source: Source, checker: Checker, phases: _Phases, until_solved: ExitStack) -> Task:
    """Ground an instance; while other programs are at it, load what is needed until it is solved."""
    with phases.phase("translate", "reading"), ThreadPoolExecutor(1) as thread:
        grounding = thread.submit(ground, source, checker, phases.limits())
        from .compiled import compiling

        until_solved.enter_context(compiling(lambda: phases.progress(COMPILING, 0, None)))
        from .sweep import sweep

        # The smallest of tasks, a switch, has the compiled code loaded; that takes longer than most tasks.
        switch = Variable("switch", ("Atom off()", "Atom on()"), -1), Operator(0, ((0, 0),), (Effect((), 0, 1),))
        sweep(Task(source.instance, switch[:1], ("(switch)",), (1,), switch[1:], (), (0,), ((0, 1),)))
        return grounding.result()


def _solve(
    task: Task,
    checker: Checker,
    options: SolveOptions,
    place: Path | None,
    phases: _Phases,
    use: Callable[[Table], None] | None,
) -> Record:
    from .astar import astar
    from .methods import cost_to_go
    from .ondemand import OnDemand

    instance = task.instance
    record = empty_record(instance, "solved", None)
    notes = [task.note] if task.note else []
    unswept: str | None = None
    table: Table | None = None
    orbits: Orbits | None = None
    if not task.decided_by_translator:
        memory = None if options.memory_limit is None else max(1.0, options.memory_limit - (used_mb() or 0.0))
        with phases.phase("search"):
            try:
                answers = cost_to_go(
                    task,
                    max_states=options.max_states,
                    memory_limit_mb=memory,
                    deadline=phases.part(SWEEP_SHARE),
                    jobs=options.threads,
                    progress=phases.progress,
                    checkpoint=None if place is None else begun_sweep(place),
                )
            except LimitError as error:
                unswept = str(error)
            else:
                if isinstance(answers, OnDemand):
                    unswept, orbits = answers.reason, answers.orbits
                else:
                    table = answers
        if table is not None:
            notes += [table.note] if table.note else []
        else:
            notes.append(f"solved on demand: {unswept}")
        if orbits is not None:
            notes[-1] += f"; swept are {orbits.described}"
    if table is not None:
        finite = table.distance[~table.dead_end]
        record.update(
            method="sweep",
            states=len(table),
            transitions=table.space.transition_count,
            dead_ends=int(table.dead_end.sum()),
            max_cost_to_go=int(finite.max()) if len(finite) else None,
        )
        if options.verify:
            _verify(table, options, phases, record)
        with phases.phase("plan"):
            cost, plan = table[table.initial], table.optimal_plan()
    elif orbits is not None:
        ones = orbits.table(task)
        finite = ones.distance[~ones.dead_end]
        record.update(method="on-demand", max_cost_to_go=int(finite.max()) if len(finite) else None)
        if options.verify:
            _verify(ones, options, phases, record)
        with phases.phase("plan"):
            cost, plan = ones[ones.initial], answers.optimal_plan()
    else:
        with phases.phase("search", "A* from the initial state"):
            try:
                cost, plan = astar(task, limits=phases.limits())
            except LimitError as error:
                raise type(error)(f"{error}; not swept: {unswept}" if unswept else str(error)) from None
        record.update(method="on-demand", verified=1)
    if plan is not None:
        with phases.phase("validate"):
            if task.plan_cost(plan) != cost:
                raise MismatchError(f"{instance}: the plan costs {task.plan_cost(plan)}, not {cost:g}")
            if not task.decided_by_translator and replay(task, plan) != cost:
                raise MismatchError(f"{instance}: the plan does not cost {cost:g} when it is replayed")
            if task.note is None and (unchecked := checker.check(plan)):
                notes.append(f"the plan was replayed, but not checked by unified-planning: {unchecked}")
        record.update(cost=int(cost), plan=plan)
    else:
        record.update(status="unsolvable")
    record["note"] = "; ".join(notes) or None
    if place is not None:
        table_file, plan_file = saved_files(place)
        with phases.phase("save", "saving"):
            if table is not None:
                from .saved import save_table

                save_table(table_file, table)
            if plan is not None:
                save_plan(plan_file, task, plan)
    if table is not None and use is not None:
        use(table)
    return record


def _verify(table: Table, options: SolveOptions, phases: _Phases, record: Record) -> None:
    """Compare states of a table with A*, and with what comes after them; note in the record how many."""
    import numpy as np

    from .costtogo import check_successors, verify

    what, count = "comparing states with A*", min(options.verify, len(table))
    with phases.phase("verify", what):
        record["verified"] = verify(
            table, count, np.random.default_rng(0), seconds=count * options.verify_seconds, limits=phases.limits(),
            # Each search may take the memory that is allowed.
            jobs=1 if options.memory_limit is not None else options.threads or processors(),
            progress=lambda done: phases.progress(what, done, count),
        )  # fmt: skip
    with phases.phase("verify"):
        record["consistent"] = check_successors(
            table, count, np.random.default_rng(0), seconds=count * options.verify_seconds
        )


def unsolved(instance: Instance, status: str, message: str) -> Record:
    """Give the record of an instance that was not solved, with the reason."""
    return empty_record(instance, status, _error(instance.problem, None, message))


def _error(file: Path, line: int | None, message: str) -> dict[str, Any]:
    return {"file": str(file), "line": line, "message": message}


def saved_files(place: Path) -> tuple[Path, Path]:
    """Name the files of an instance's table and plan."""
    return place.with_name(f"{place.name}.npz"), place.with_name(f"{place.name}.plan")


def begun_sweep(place: Path) -> Path:
    """Return the file of what a long sweep has found that is not over."""
    return place.with_name(f"{place.name}.sweep")


def save_plan(file: Path, task: Task, plan: Sequence[str]) -> None:
    """Save a plan in the planners' format: an action a line, then its cost in a comment."""
    unit = all(cost == 1 for cost in task.costs)
    text = (
        "".join(f"{action}\n" for action in plan)
        + f"; cost = {task.plan_cost(plan)} ({'unit' if unit else 'general'} cost)\n"
    )
    with atomic(file) as path:
        path.write_text(text, encoding="utf-8")
