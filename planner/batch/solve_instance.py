"""Solving one instance, from its files to its record.

`solve_instance` solves an instance within limits of time and memory, and returns a record of the result. On request it
saves the cost-to-go table as `.npz` and the plan.
"""

from __future__ import annotations

import errno
import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..costtogo.astar import Answer, Early, check_plan, check_successors, mismatch, search_of, verify
from ..costtogo.number_values import grounded
from ..grounding.fast_downward import FastDownwardError
from ..grounding.task import Task, plan_cost, replay
from ..pddl.compilation import NO_SEQUENTIAL_PLAN
from ..pddl.instances import Instance, PDDLError
from ..pddl.plan_execution import execute
from ..pddl.reader import Reading, read
from ..pddl.validation import SecondReader
from ..system.errors import MismatchError, UnsuitedError
from ..system.files import atomic
from ..system.jit import compiling
from ..system.limits import (
    LimitError,
    Limits,
    MemoryLimitError,
    memory_limit,
    peak_memory_mb,
    processors,
    reset_peak_memory,
    used_mb,
)
from ..system.processes import NO_MORE_THREADS
from ..system.progress import Progress
from .results_folder import (
    COMPARING,
    COMPILING,
    PLANNING,
    SWEEPING,
    VALIDATING,
    SolveOptions,
    SolveRecord,
    empty_record,
    error_entry,
    saved_files,
    unfinished,
    unsolved,
)

if TYPE_CHECKING:
    from ..costtogo.on_demand import OnDemand
    from ..costtogo.table import Table


SECOND_READER = 20.0
"""Longest time in seconds for which the second reader is waited for once all else is done, and the answer is known."""

UNCHECKED = "read by Fast Downward's translator, not checked by unified-planning"


class _Phases:
    """Time spent in each phase, the common deadline, what was compiled away, and the latest intermediate record.

    The first answer comes from a thread of its own. `lock` is held while files and their record are written.
    """

    def __init__(
        self,
        limit: float | None,
        memory_mb: float | None,
        progress: Progress,
        tell: Callable[[SolveRecord, bool], None] | None = None,
    ) -> None:
        self.seconds: dict[str, float] = {}
        self.memory_mb = memory_mb
        self.progress = progress
        self.latest: SolveRecord | None = None
        self.compiled: Mapping[str, int] = {}
        self.lock, self.saved = threading.RLock(), False
        self._tell = tell
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
            self.add(name, start)

    def add(self, name: str, start: float) -> None:
        """Add the time since `start` to a phase."""
        self.seconds[name] = self.seconds.get(name, 0.0) + time.monotonic() - start

    def part(self, share: float) -> float | None:
        """Return the time, on the clock of `time.monotonic()`, at which a share of the total time is used up."""
        return None if self.deadline is None else self.start + share * (self.deadline - self.start)

    def left(self) -> float:
        """Return the number of seconds left."""
        return math.inf if self.deadline is None else self.deadline - time.monotonic()

    def limits(self, share: float = 1.0) -> Limits:
        """Return the limits of one call that may use a share of the time left."""
        return Limits(None if self.deadline is None else max(0.01, share * self.left()), self.memory_mb)

    def tell(self, record: SolveRecord, *, saved: bool) -> None:
        """Report an intermediate record. It is ignored if its files are not saved and those of an earlier one are."""
        with self.lock:
            if saved >= self.saved:
                self.saved, self.latest = saved, self.measured(record)
                if self._tell is not None:
                    self._tell(self.latest, saved)

    def measured(self, record: SolveRecord) -> SolveRecord:
        """Return the record with what was compiled away, its times and peak memory."""
        seconds = {name: round(seconds, 6) for name, seconds in self.seconds.copy().items()}
        seconds["total"] = round(time.monotonic() - self.start, 6)
        compiled_away = dict(self.compiled) or None
        return {**record, "compiled": compiled_away, "seconds": seconds, "peak_memory_mb": round(peak_memory_mb(), 1)}


def solve_instance(
    instance: Instance,
    options: SolveOptions | None = None,
    place: Path | None = None,
    *,
    progress: Progress | None = None,
    tell: Callable[[SolveRecord, bool], None] | None = None,
    use: Callable[[Table], None] | None = None,
) -> SolveRecord:
    """Solve one instance, and return its record.

    Faults of the instance or of its solution are not raised. They are reported in the fields `status` and `error`. A
    table that contradicts Fast Downward, and a plan that the validator rejects, are such faults.

    `place` is the path for the cost-to-go table and the plan, without their endings `.npz` and `.plan`. `progress` is
    called with the stage, the number of items done, and their total (None if it is unknown). `use` is called at the
    end with the table of all states, if they were swept; its time is not limited.

    `tell` is called with an intermediate record, and whether the table and the plan are saved: when the plan is known
    before all states are, in another thread, and before and during the comparison with A*. Each record replaces the
    earlier ones.
    """
    options = options or SolveOptions()
    phases = _Phases(options.time_limit, options.memory_limit, progress or (lambda *_: None), tell)
    reset_peak_memory()
    try:
        if _too_low(options):  # before anything fails in its own way
            raise MemoryError
        with phases.phase("read"):
            reading = read(instance)
        with ExitStack() as until_solved:
            second = None  # it knows neither what a compilation stands for nor derived predicates
            if not (reading.numeric or reading.domain.rules):
                second = until_solved.enter_context(SecondReader(reading, phases.limits()))
            until_solved.enter_context(compiling(lambda _: phases.progress(COMPILING, 0, None)))
            task = _grounded(reading, options, phases)
            record = _solve(task, second, options, place, phases, use)
    except Exception as error:
        found = _record_of(error, instance, options)
        if found is None:
            raise
        record = found
    if phases.latest is not None and record["status"] == "limit":
        record = unfinished(phases.latest, record["error"]["message"])
    elif phases.latest is not None and record["status"] == "invalid" and place is not None:
        for file in saved_files(place):
            file.unlink(missing_ok=True)
    return phases.measured(record)


def _record_of(error: Exception, instance: Instance, options: SolveOptions) -> SolveRecord | None:
    """Return the record of an instance that an error ended; None for an internal error."""
    if isinstance(error, PDDLError):
        return empty_record(instance, "invalid", error_entry(error.file, error.line, error.message))
    if isinstance(error, LimitError):
        return unsolved(instance, "limit", f"{error}{_too_low(options) if isinstance(error, MemoryLimitError) else ''}")
    if isinstance(error, FastDownwardError | MismatchError):
        return unsolved(instance, "invalid", str(error))
    number = error.errno if isinstance(error, OSError) else None
    no_thread = isinstance(error, RuntimeError) and str(error) == NO_MORE_THREADS
    unloaded = isinstance(error, ImportError) and "failed to map" in str(error)  # the system's loader
    if (
        isinstance(error, MemoryError) or no_thread or unloaded or number == errno.ENOMEM
    ):  # this at a subprocess's start
        limit = f" ({options.memory_limit:g} MB)" if options.memory_limit else ""
        return unsolved(instance, "limit", f"out of memory{limit}{_too_low(options)}")
    if isinstance(error, OSError):
        status = "limit" if number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG) else "invalid"  # a full disk
        file = instance.problem if error.filename is None else Path(os.fsdecode(error.filename))
        return empty_record(instance, status, error_entry(file, None, error.strerror or str(error)))
    return None


def _too_low(options: SolveOptions) -> str:
    """Return what is said of a limit that is below what Python itself takes; nothing of any other."""
    used, limit = used_mb(), options.memory_limit
    if limit is None or used is None or limit >= used:
        return ""
    return f"; a limit of {limit:g} MB is below what Python itself takes here, {used:.0f} MB; expected more"


def _grounded(reading: Reading, options: SolveOptions, phases: _Phases) -> Task:
    """Compile away what Fast Downward does not know, and ground an instance."""
    with phases.phase("translate", "reading"):
        compilation, task = grounded(reading, phases.limits(), options.most_values)
        phases.compiled = {what: count for what, count in compilation.compiled.items() if count}
        return task


class _Swept(NamedTuple):
    """The result of the sweep."""

    known: Table | OnDemand | None
    """Provider of the cost-to-go of all states."""
    table: Table | None
    """Table of the swept states: all states, or one canonical state of each orbit."""
    why: str | None
    """The reason why not all states were swept."""


def _solve(
    task: Task,
    second: SecondReader | None,
    options: SolveOptions,
    place: Path | None,
    phases: _Phases,
    use: Callable[[Table], None] | None,
) -> SolveRecord:
    sweeping = True

    def answered(answer: Answer) -> None:
        if not sweeping:
            return  # the record follows
        with phases.lock:
            if place is not None and answer[1] is not None and not phases.saved:
                save_plan(saved_files(place)[1], task, answer[1])
            found = {"method": "on-demand", "verified": 1, "note": _joined(task.note, SWEEPING)}
            phases.tell(_empty(task) | _outcome(task, *answer) | found, saved=False)

    # Memory is limited only now, since imported libraries map far more memory than they use.
    search = Early(task, phases.limits(), answered, delay=options.first_answer_after)
    with search as early, memory_limit(options.memory_limit):
        swept = _Swept(None, None, None)
        if not task.decided_by_translator:
            swept = _sweep(task, options, phases, early)
        sweeping = False
        record = _found(task, swept, early, options, phases)
        if second is None and record["plan"] is not None:
            _execute(task, record, phases)
        whole = swept.table if swept.known is swept.table else None
        with phases.lock:
            if place is not None:
                _save(place, task, whole, record["plan"], phases)
            open_end = VALIDATING if swept.table is None else COMPARING
            phases.tell({**record, "note": _joined(record["note"], open_end)}, saved=True)
        if second is not None and record["plan"] is not None:
            second.ask(record["plan"])
        if swept.table is not None:
            _compare(swept.table, options, phases, record, early.answer)
        if second is not None:
            start = time.monotonic()
            phases.progress("checking the plan", 0, None)
            if unchecked := second.answer(min(SECOND_READER, phases.left())):
                record["note"] = _joined(record["note"], f"{UNCHECKED}: {unchecked}")
            phases.add("validate", start)
        if whole is not None and use is not None:
            use(whole)
    return record


def _sweep(task: Task, options: SolveOptions, phases: _Phases, early: Early) -> _Swept:
    """Compute the cost-to-go of all states, or of one canonical state of each orbit."""
    from ..costtogo.portfolio import cost_to_go
    from ..costtogo.table import Table

    memory = None if options.memory_limit is None else max(1.0, options.memory_limit - (used_mb() or 0.0))
    with phases.phase("search"):
        try:
            known = cost_to_go(
                task,
                max_states=options.max_states,
                memory_limit_mb=memory,
                deadline=phases.part(options.sweep_share),
                jobs=options.threads,
                progress=phases.progress,
                reserved_bytes=early.reserved_bytes,
            )
        except LimitError as error:
            return _Swept(None, None, str(error))
        if isinstance(known, Table):
            return _Swept(known, known, None)
        if known.orbits is None:
            return _Swept(None, None, known.reason)
        swept = f"{len(known.orbits):,} orbits of {known.orbits.order:,} symmetries"
        return _Swept(known, known.orbits.table(task), f"{known.reason}; swept are {swept}")


def _found(task: Task, swept: _Swept, early: Early, options: SolveOptions, phases: _Phases) -> SolveRecord:
    """Return the record of the results, after the checks that take little time.

    If the table, A* and the plan contradict each other, this raises a `MismatchError`.
    """
    record = _empty(task)
    known, table, why = swept
    notes = [task.note, f"solved on demand: {why}" if why and not task.beyond else None]  # else the task's note has it
    if known is not None and table is not None:
        record["method"] = known.method
        if known is table:
            notes.append(table.note)
            counts = len(table), table.space.transition_count, int(table.dead_end.sum())
            record.update(zip(("states", "transitions", "dead_ends"), counts, strict=True))
        cost, plan, late = _planned(known, table, early, options, phases, record | {"note": _joined(*notes, PLANNING)})
        record |= {"verified": int(early.answer is not None)} | _outcome(task, cost, plan)
        record |= _counted(table, options, phases)
        if late is not None:
            record["plan_by"] = "table"
            notes.append(f"the plan is that of the table: {late}")
    else:
        with phases.phase("search", "A* from the initial state"):
            try:
                cost, plan = early.wait(phases.limits())
            except LimitError as error:
                raise type(error)(f"{error}; not swept: {why}" if why else str(error)) from None
        record |= {"method": "on-demand", "verified": 1} | _outcome(task, cost, plan)
    if plan is not None:
        with phases.phase("validate"):
            if (found := task.in_unit(plan_cost(task, plan))) != cost:
                raise MismatchError(f"{task.instance}: the plan costs {found:g}, not {cost:g}")
            if not task.decided_by_translator and task.in_unit(replay(task, plan)) != cost:
                raise MismatchError(f"{task.instance}: the plan does not cost {cost:g} when it is replayed")
    elif phases.compiled.get("durations") and not isfinite(cost):
        notes.append(NO_SEQUENTIAL_PLAN)
    return record | {"note": _joined(*notes)}


def _planned(
    known: Table | OnDemand,
    table: Table,
    early: Early,
    options: SolveOptions,
    phases: _Phases,
    unplanned: SolveRecord,
) -> tuple[float, list[str] | None, str | None]:
    """Return cost and plan of a swept task, and why the plan is that of the table; None if it is that of A*.

    A task without a plan is not waited for. `unplanned` is the record that is reported if the plan does not come at
    once.
    """
    cost = float(table[table.initial])
    small = len(table) <= options.small
    with phases.phase("plan", "A* from the initial state"):
        if isfinite(cost) and not early.ended_within(options.first_answer_after):
            phases.tell(unplanned | _outcome(known.task, cost, None), saved=False)
        wait = math.inf if small else options.soon * isfinite(cost)
        late = early.within(wait, phases.limits(0.5))  # the rest of the time is for what follows
        if early.answer is not None and early.answer[0] != cost:
            raise mismatch(table, table.initial, early.answer[0])
        if not isfinite(cost):
            return cost, None, None
        plan = known.optimal_plan() if early.answer is None else early.answer[1]
        assert plan is not None
        check_plan(known, plan)
    return cost, list(plan), late


def _counted(table: Table, options: SolveOptions, phases: _Phases) -> SolveRecord:
    """Compare a table with its own successors, and return the fields about it."""
    (count, seconds), consistent = _allowed(table, options, phases), 0
    if count:
        with phases.phase("verify", "comparing states with their successors"):
            consistent = check_successors(table, count, np.random.default_rng(0), seconds=seconds / 2)
    finite = table.distance[~table.dead_end]
    farthest = _number(table.task.in_unit(int(finite.max()))) if len(finite) else None
    return {"consistent": consistent, "max_cost_to_go": farthest}


def _empty(task: Task) -> SolveRecord:
    """Return the record of a solved task without results."""
    return empty_record(task.instance, "solved", None)


def _outcome(task: Task, cost: float, plan: list[str] | None) -> SolveRecord:
    """Return the fields about cost and plan; a plan is that of Fast Downward."""
    if not isfinite(cost):
        return {"status": "unsolvable"}
    return {"cost": _number(cost), "plan": plan, "plan_by": None if plan is None else search_of(task)}


def _execute(task: Task, record: SolveRecord, phases: _Phases) -> None:
    """Execute the plan of files that the second reader does not know by their meaning.

    If it costs something else, this raises a `MismatchError`. If that takes too long, the record says so.
    """
    with phases.phase("validate"):
        try:
            cost = float(execute(task.instance, record["plan"]).cost)
        except UnsuitedError as error:
            record["note"] = _joined(record["note"], f"the plan was not executed by the meaning of the files: {error}")
            return
        if cost != record["cost"]:
            raise MismatchError(f"{task.instance}: the plan costs {cost:g} by the files, not {record['cost']:g}")


def _number(cost: float) -> float:
    """Return a cost as an integer if it is a whole number."""
    return int(cost) if cost == int(cost) else cost


def _joined(*notes: str | None) -> str | None:
    return "; ".join(filter(None, notes)) or None


def _save(place: Path, task: Task, table: Table | None, plan: list[str] | None, phases: _Phases) -> None:
    """Save the table of all states and the plan, if they exist."""
    table_file, plan_file = saved_files(place)
    with phases.phase("save", "saving"):
        if table is not None:
            from ..costtogo.table import save_table

            save_table(table_file, table)
        if plan is not None:
            save_plan(plan_file, task, plan)


def _allowed(table: Table, options: SolveOptions, phases: _Phases) -> tuple[int, float]:
    """Return how many states of a table to compare, and the seconds for it."""
    count = 20 if options.verify is None else options.verify
    if options.verify is not None or len(table) <= options.small:
        return min(count, len(table)), phases.left()
    seconds = max(options.comparison_seconds, options.comparison_share * phases.seconds["search"])
    return min(count, len(table)), min(phases.left(), seconds - phases.seconds.get("verify", 0.0))


def _compare(table: Table, options: SolveOptions, phases: _Phases, record: SolveRecord, answer: Answer | None) -> None:
    """Compare states of a table with A*, and store their number in the record.

    Where A* does not answer soon, nothing more is asked of it, unless `verify` wants it.
    """
    # Largest number of seconds for the comparison of one state, so that one hard state does not use up all the time.
    comparison = 300.0
    what, each = "comparing states with A*", phases.limits().seconds
    count, seconds = _allowed(table, options, phases)
    if options.verify is None and answer is None and len(table) > options.small:
        along = "" if record["plan"] is None else f"along the plan ({len(record['plan']) + 1} states), and "
        kept = f"{along}against the successors of {record['consistent']} states"
        record["note"] = _joined(record["note"], f"A* does not answer soon: h* was checked {kept}")
        return

    def compared(done: int) -> None:
        record["verified"] = done
        phases.tell({**record, "note": _joined(record["note"], COMPARING)}, saved=True)
        phases.progress(what, done, count)

    start = time.monotonic()
    if count and seconds > 0:
        phases.progress(what, 0, None)
        record["verified"] = verify(
            table, count, np.random.default_rng(0), seconds=seconds,
            limits=Limits(comparison if each is None else min(comparison, each), options.memory_limit),
            # Each search may use all the allowed memory.
            jobs=1 if options.memory_limit is not None else options.threads or processors(),
            known={} if answer is None else {table.initial: answer[0]},
            progress=compared,
        )  # fmt: skip
    phases.add("verify", start)
    if record["verified"] < count:
        done = f"A* was asked for {count} states, and answered for {record['verified']} in time"
        record["note"] = _joined(record["note"], done)


def save_plan(file: Path, task: Task, plan: Sequence[str]) -> None:
    """Save a plan in the usual format: one action per line, then its cost in a comment."""
    kind = "unit" if (task.action_costs == 1).all() else "general"
    cost = _number(task.in_unit(plan_cost(task, plan)))
    text = "".join(f"{action}\n" for action in plan) + f"; cost = {cost} ({kind} cost)\n"
    with atomic(file) as path:
        path.write_text(text, encoding="utf-8")
