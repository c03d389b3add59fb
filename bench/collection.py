"""Tasks of the public collection `aibasel/downward-benchmarks`: the first instance of each domain, solved or read.

    DOWNWARD_BENCHMARKS=FOLDER python bench/collection.py [DOMAIN...] [--read] [--all] [--instance K] [--out FILE]
                                                          [--busy N] [--compare SECONDS] [--count SECONDS]

Each instance is solved in a process of its own, within limits of time and memory; with `--read` it is only read. If it
is swept, 20 states are compared with Fast Downward's A*, for at most `--compare` seconds. Otherwise its states are
counted, for at most `--count` seconds and up to the number that `solve` enumerates. The result is a line of JSON for
each instance (status, method, states, seconds, message) and a table. With `--before FILE`, the `--out` of an earlier
run, the table contains its outcomes too. Instances in `--out FILE` are not run again. On a shared machine, `--busy N`
allows N times as much wall-clock time; processor time is limited in any case. `--record FILE` writes the table for the
documentation, and the numbers of instances by outcome to `FILE-outcomes.json`.

With `--read`, the task is compared with the output of Fast Downward's translator alone: the same task, another task, or
refused. Domains of satisficing and agile tracks and split domains are omitted unless `--all` is given.
"""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from tables import Columns, cell, record_option, write_record

from planner import Limits, Task, find_instances, instance
from planner.system.limits import MAX_STATES, processors

LEFT_OUT = ("sat", "agl", "mco", "split")
GRACE = 30.0  # seconds that a process may exceed its limit, for cleaning up
STATES = 20  # states of each instance that are compared with Fast Downward's A*
SEARCHES = (None, "astar(blind())")  # run concurrently for each state
COUNT_MEMORY = 12e9  # bytes for counting states
UNCHECKED = "read by Fast Downward's translator, not checked by unified-planning: "


def instances(folder: Path, number: int, *, every: bool) -> list[tuple[Path, Path]]:
    """Return the n-th problem of each domain with its domain file, whatever their names."""
    found = []
    for place in sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith(".")):
        if every or not any(word in place.name for word in LEFT_OUT):
            found += find_instances([place])[number - 1 : number]
    return [(one.domain, one.problem) for one in found]


def name_of(problem: Path) -> str:
    """Return the name of an instance in the collection."""
    return "/".join(problem.parts[-2:] if problem.parent.name != "mprime-renamed" else problem.parts[-3:])


def read(domain: str, problem: str, seconds: float) -> dict[str, Any]:
    """Read an instance, and compare it with the output of Fast Downward's translator alone."""
    from planner import LimitError, Limits, PDDLError, load

    try:
        alone = translated(domain, problem, seconds)
        task = load(instance(problem, domain), limits=Limits(seconds))
    except PDDLError as error:
        return {"status": "refused by both" if alone is None else "refused", "said": str(error)}
    except (LimitError, subprocess.TimeoutExpired) as error:
        return {"status": "time out", "said": str(error)}
    sizes = {"variables": len(task.variables), "operators": len(task.operators)}
    if alone is None:
        return {"status": "read here only", "said": None, **sizes}
    names = ("variables", "actions", "costs", "operators", "axioms", "initial", "goal")
    other = [name for name in names if getattr(task, name) != getattr(alone, name)]
    return {"status": "differs" if other else "read alike", "said": ", ".join(other) or None, **sizes}


def translated(domain: str, problem: str, seconds: float) -> Task | None:
    """Return the task that Fast Downward's translator makes of unchanged files; None if it refuses them."""
    from planner.grounding.fast_downward import TRANSLATE_OPTIONS
    from planner.grounding.translation import from_sas

    with tempfile.TemporaryDirectory() as folder:
        sas = Path(folder) / "output.sas"
        command = [sys.executable, "-m", "fast_downward.translate", *TRANSLATE_OPTIONS, "--sas-file", str(sas)]
        done = subprocess.run([*command, domain, problem], capture_output=True, timeout=seconds, check=False)
        if done.returncode or not sas.is_file():
            return None
        return from_sas(sas.read_text(encoding="utf-8"), instance(problem, domain))


def solve(domain: str, problem: str, seconds: float, memory: float, patience: float) -> dict[str, Any]:
    import numpy as np

    from planner import Table, verify
    from planner.batch.results_folder import SolveOptions
    from planner.batch.solve_instance import solve_instance
    from planner.costtogo.astar import check_successors, sample

    compared = {"verified": 0, "consistent": 0, "compare_cpu": 0.0}

    def compare(table: Table) -> None:
        before, generator = processor_seconds(resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN), np.random.default_rng
        known: dict[int, float] = {}
        end = time.monotonic() + patience
        for state in sample(len(table), table.initial, STATES, generator(0)):
            if (left := end - time.monotonic()) > 0:
                known |= first_answer(table.task, state, table.values([state])[0].tolist(), Limits(left, memory))
        compared["verified"] = verify(table, STATES, generator(0), seconds=0.0, known=known)
        compared["consistent"] = check_successors(table, STATES, generator(0), seconds=patience)
        after = processor_seconds(resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        compared["compare_cpu"] = round(after - before, 2)

    options = SolveOptions(time_limit=seconds, memory_limit=memory, verify=0)
    record = solve_instance(instance(problem, domain), options, use=compare)
    said = record["error"]["message"] if record["error"] else record["note"]
    kept = {key: record[key] for key in ("status", "method", "states", "cost", "peak_memory_mb")}
    return {**kept, **compared, "search": record["seconds"].get("search"), "said": said}


def first_answer(task: Task, number: int, state: list[int], limits: Limits) -> dict[int, float]:
    """Return h* of a state by its number, from the first of several searches that finishes; nothing if none does."""
    from planner import LimitError, astar

    done = threading.Event()
    with ThreadPoolExecutor(len(SEARCHES)) as pool:
        try:
            own = limits.ended_by(done)
            for each in as_completed([pool.submit(astar, task, state, search=one, limits=own) for one in SEARCHES]):
                with suppress(LimitError):
                    return {number: each.result()[0]}
        finally:
            done.set()
    return {}


def count(domain: str, problem: str, seconds: float) -> dict[str, Any]:
    """Count states, up to the number that `solve` enumerates."""
    from planner import LimitError, load
    from planner.costtogo.table import SweepOptions, explored
    from planner.system.limits import Budget

    found, task, why = 1, load(instance(problem, domain)), None

    def told(_: str, states: int, __: int | None) -> None:
        nonlocal found
        found = states

    try:
        budget = Budget(MAX_STATES, COUNT_MEMORY, time.monotonic() + seconds)
        explored(task, budget, processors(), told, SweepOptions())
    except LimitError as error:
        why = str(error)
    return {"at_least": found, "counted": why is None, "count_said": why}


def processor_seconds(*of: int) -> float:
    """Return the processor seconds of this process, or of its finished child processes."""
    return sum(used.ru_utime + used.ru_stime for used in map(resource.getrusage, of))


@dataclass(frozen=True)
class Limited:
    """Limits of an instance: seconds of each stage on an idle machine, the slowdown of this machine, and MB."""

    seconds: float
    compare: float
    count: float
    busy: float
    memory: float

    @property
    def most(self) -> dict[str, float]:
        """Wall-clock limit of each kind of work, in seconds."""
        compare = 3 * self.compare  # a search that starts just before the limit, and the comparison of its successors
        seconds = {"read": 2 * self.seconds, "solve": self.seconds + compare, "count": self.seconds + self.count}
        return {what: one * self.busy + GRACE for what, one in seconds.items()}

    def options(self) -> list[str]:
        """Return the limits as command-line options."""
        given = ("seconds", "compare", "count", "busy", "memory")
        return [word for name in given for word in (f"--{name}", str(getattr(self, name)))]


def done(what: str, domain: str, problem: str, limits: Limited) -> dict[str, Any]:
    """Run one kind of work in this process."""
    _, most = resource.getrlimit(resource.RLIMIT_CPU)
    seconds = limits.most[what] if what != "solve" else limits.seconds + limits.compare + GRACE
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds * processors()), most))
    if what == "read":
        return read(domain, problem, limits.seconds * limits.busy)
    if what == "count":
        return count(domain, problem, limits.count * limits.busy)
    return solve(domain, problem, limits.seconds * limits.busy, limits.memory, limits.compare * limits.busy)


def run(domain: Path, problem: Path, limits: Limited, *, only_read: bool) -> dict[str, Any]:
    """Read or solve one instance in a new process."""
    start, before = time.monotonic(), processor_seconds(resource.RUSAGE_CHILDREN)
    result = started("read" if only_read else "solve", domain, problem, limits)
    spent = time.monotonic() - start
    cpu = processor_seconds(resource.RUSAGE_CHILDREN) - before - result.get("compare_cpu", 0.0)
    if result["said"]:
        result["said"] = result["said"].replace(f"{domain.parent}/", "").replace(f"{problem.parent}/", "")
    row = {"instance": name_of(problem), **result, "seconds": round(spent, 2), "cpu": round(cpu, 2)}
    if more := re.search(r"more than (\d+) states", row["said"] or ""):
        row |= {"at_least": int(more[1]) + 1, "counted": False}
    return row


def counted(domain: Path, problem: Path, limits: Limited) -> dict[str, Any]:
    """Count the states of an instance in a new process."""
    result = started("count", domain, problem, limits)
    return result if "at_least" in result else {"count_said": result["said"]}


def started(what: str, domain: Path, problem: Path, limits: Limited) -> dict[str, Any]:
    """Run one kind of work in a new process."""
    own = [sys.executable, __file__, "--one", what, str(domain), str(problem), *limits.options()]
    patience = limits.most[what]
    try:
        process = subprocess.run(own, capture_output=True, text=True, timeout=patience)
    except subprocess.TimeoutExpired:
        return {"status": "limit", "said": f"no end after {patience:g} s"}
    if process.returncode == 0:
        return dict(json.loads(process.stdout.splitlines()[-1]))
    if process.returncode == -signal.SIGXCPU:
        return {"status": "limit", "said": "out of processor time"}
    return {"status": "died", "said": (process.stderr.strip().splitlines() or ["nothing"])[-1]}


def outcome(row: dict[str, Any]) -> str:
    """Return the outcome of an instance in a word or two."""
    if row["status"] != "solved" and row["status"] != "unsolvable":
        return str(row["status"])
    return {"sweep": "swept", "on-demand": "on demand", None: row["status"]}[row["method"]]


def remark(row: dict[str, Any]) -> str:
    """Return the message about an instance, shortened for a table."""
    said = row.get("said") or ""
    if said.startswith(UNCHECKED):
        said = "not checked by unified-planning" + "".join(f"; {part}" for part in said.split("; ")[1:])
    return str(said.removeprefix("solved on demand: "))


def number(value: float | None, form: str = ",") -> str:
    return "-" if value is None else format(value, form)


def states(row: dict[str, Any]) -> str:
    """Return the number of states, or the known bound on it."""
    if row.get("states") is not None or row.get("at_least") is None:
        return number(row.get("states"))
    if row["at_least"] > MAX_STATES:
        return f"> {MAX_STATES:,}"
    return f"{'' if row['counted'] else '≥ '}{row['at_least']:,}"


def columns_of(before: dict[str, dict[str, Any]]) -> Columns:
    """Return the columns of the table, including the outcome of an earlier run if there is one."""
    columns = {
        "instance": lambda row: f"`{row['instance'].removesuffix('.pddl')}`",
        "outcome": outcome,
        "states": states,
        "processor seconds": lambda row: number(row.get("cpu"), ".1f"),
        "compared": lambda row: number(row.get("verified") or None),
        "seconds of that": lambda row: number(row.get("compare_cpu") or None, ".1f"),
        "said": remark,
    }
    if before:
        columns["outcome before"] = lambda row: outcome(before[row["instance"]]) if row["instance"] in before else "-"
    return columns


def outcomes(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Count the instances with each outcome."""
    parts: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        found = outcome(row)
        if found in ("on demand", "limit"):
            many = f"more than {MAX_STATES:,} states" if row.get("at_least", 0) > MAX_STATES else "states not counted"
            found = f"{found}, {states(row)} states" if row.get("counted") else f"{found}, {many}"
        parts.setdefault(found, []).append(row)
    return [
        {
            "outcome": found,
            "instances": len(some),
            "states": max(row.get("states") or 0 for row in some) or None,
            "cpu": max(row["cpu"] for row in some),
            "verified": sum(row.get("verified", 0) for row in some),
            "enough": sum(row.get("verified", 0) >= min(STATES, row.get("states") or STATES) for row in some),
        }
        for found, some in sorted(parts.items(), reverse=True)
    ]


OUTCOMES: Columns = {
    "outcome": lambda row: row["outcome"],
    "instances": cell("instances", ","),
    "most states": lambda row: number(row["states"]),
    "most processor seconds": cell("cpu", ".1f"),
    "states compared": lambda row: number(row["verified"] or None),
    f"with {STATES} or all of them compared": lambda row: number(row["enough"] or None),
}
"""Columns of the table of outcomes in the documentation."""


def rows_of(file: Path | None) -> dict[str, dict[str, Any]]:
    """Return the rows in a file by instance; the last row of each counts."""
    lines = [] if file is None or not file.is_file() else file.read_text().splitlines()
    return {row["instance"]: row for row in map(json.loads, lines)}


def keep(found: dict[str, dict[str, Any]], row: dict[str, Any], out: Path | None) -> None:
    """Store a row, and append it to a file."""
    found[row["instance"]] = row
    print(f"{row['instance']}: {row['status']}, {states(row)} states, {row['seconds']} s", file=sys.stderr)
    if out is not None:
        with out.open("a") as stream:
            stream.write(json.dumps(row) + "\n")


@click.command()
@click.argument("domains", nargs=-1)
@click.option("--read", "only_read", is_flag=True, help="Read only, and compare with the translator.")
@click.option("--all", "every", is_flag=True, help="The domains of all tracks.")
@click.option("--instance", "which", type=int, default=1, show_default=True, help="Which instance of each domain.")
@click.option("--seconds", type=float, default=60.0, show_default=True)
@click.option("--compare", type=float, default=20.0, show_default=True, help="Seconds for comparing.")
@click.option("--count", "counting", type=float, default=0.0, help="Seconds for counting what is not swept.")
@click.option("--busy", type=float, default=1.0, help="How many times slower than an idle machine it may be.")
@click.option("--memory", type=float, default=6000.0, show_default=True, help="MB.")
@click.option("--out", type=click.Path(path_type=Path), help="A file for the rows, as JSON Lines.")
@click.option("--before", type=click.Path(path_type=Path, exists=True), help="The rows of an earlier run.")
@record_option
@click.option("--one", nargs=3, hidden=True)
def main(
    domains: tuple[str, ...], only_read: bool, every: bool, which: int, seconds: float, compare: float, counting: float,
    busy: float, memory: float, out: Path | None, before: Path | None, record: Path | None,
    one: tuple[str, str, str] | None,
) -> None:  # fmt: skip
    """Read or solve an instance of each domain of the collection."""
    limits = Limited(seconds, compare, counting, busy, memory)
    if one is not None:
        print(json.dumps(done(*one, limits)))
        return
    folder = os.environ.get("DOWNWARD_BENCHMARKS")
    if folder is None:
        print("DOWNWARD_BENCHMARKS is not set to the collection's folder: nothing to do")
        return
    found = rows_of(out)
    chosen = [
        pair for pair in instances(Path(folder), which, every=every) if not domains or {*domains} & {*pair[1].parts}
    ]
    for domain, problem in chosen:
        if name_of(problem) not in found:
            keep(found, run(domain, problem, limits, only_read=only_read), out)
    for domain, problem in chosen:
        row = found[name_of(problem)]
        if counting and outcome(row) in ("on demand", "limit") and "at_least" not in row:
            keep(found, {**row, **counted(domain, problem, limits)}, out)
    rows = [found[name] for name in sorted(found)]
    columns = columns_of(rows_of(before))
    for row in rows:
        print(" | ".join(show(row) for show in columns.values()))
    write_record(record, columns, rows)
    if record is not None:
        write_record(record.with_name(f"{record.stem}-outcomes.json"), OUTCOMES, outcomes(rows))


if __name__ == "__main__":
    main()
