"""Other people's tasks: the first instance of each domain of the public collection `aibasel/downward-benchmarks`.

    DOWNWARD_BENCHMARKS=FOLDER python bench/collection.py [DOMAIN...] [--read] [--instance K] [--out FILE] [--busy N]

Every instance is read, and unless `--read` is given solved, in a process of its own, within limits of time and memory;
20 states of each that is swept are compared with Fast Downward's A*. The result is one line of JSON for each (status,
method, states, seconds, what was said), and a table; with `--before FILE`, an earlier run's `--out`, the table has its
figures beside. What `--out FILE` has already is not run again. On a machine that others use, `--busy N` allows N times
as much time on the clock; processor time is limited in any case.

Domains made for satisficing and agile tracks, and split ones, are left out.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import click
from tables import Columns, record_option, write_record

LEFT_OUT = ("sat", "agl", "mco", "split")
GRACE = 30.0  # seconds that a process may take to end by itself
VERIFY = 20.0  # seconds in which 20 states are compared with Fast Downward's A*
UNCHECKED = "read by Fast Downward's translator, not checked by unified-planning: "


def instances(folder: Path, number: int) -> list[tuple[Path, Path]]:
    """The n-th problem of each domain, with its domain file, however the two are named."""
    found = []
    for place in sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith(".")):
        if any(word in place.name for word in LEFT_OUT):
            continue
        problems = sorted(f for f in place.rglob("*.pddl") if "domain" not in f.name)
        for problem in problems[number - 1 : number]:
            names = ["domain.pddl", f"{problem.stem}-domain.pddl", f"domain_{problem.name}", f"domain-{problem.name}"]
            names += [f"{problem.stem[:3]}-domain.pddl"]
            beside = (problem.with_name(name) for name in names)
            found.append((next(file for file in beside if file.is_file()), problem))
    return found


def name_of(problem: Path) -> str:
    """The name of an instance in the collection."""
    return "/".join(problem.parts[-2:] if problem.parent.name != "mprime-renamed" else problem.parts[-3:])


def read(domain: str, problem: str) -> dict[str, Any]:
    from planner import PDDLError, instance, load

    try:
        task = load(instance(problem, domain))
    except PDDLError as error:
        return {"status": "invalid", "said": str(error)}
    return {"status": "read", "said": task.note, "variables": len(task.variables), "operators": len(task.operators)}


def solve(domain: str, problem: str, seconds: float, memory: float) -> dict[str, Any]:
    from planner import instance
    from planner.solving import SolveOptions, solve_instance

    options = SolveOptions(time_limit=seconds, memory_limit=memory, verify_seconds=VERIFY / SolveOptions.verify)
    record = solve_instance(instance(problem, domain), options)
    said = record["error"]["message"] if record["error"] else record["note"]
    kept = ("status", "method", "states", "cost", "verified", "peak_memory_mb")
    return {**{key: record[key] for key in kept}, "search": record["seconds"].get("search"), "said": said}


def run(domain: Path, problem: Path, *, only_read: bool, seconds: float, busy: float, memory: float) -> dict[str, Any]:
    """Read or solve one instance in a new process."""
    patience = seconds * busy
    own = [sys.executable, __file__, "--one", str(domain), str(problem), "--seconds", str(seconds)]
    own += ["--busy", str(busy), "--memory", str(memory)] + ["--read"] * only_read
    start, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    try:
        done = subprocess.run(own, capture_output=True, text=True, timeout=patience + GRACE)
    except subprocess.TimeoutExpired:
        result: dict[str, Any] = {"status": "limit", "said": f"no end after {patience + GRACE:g} s"}
    else:
        if done.returncode == 0:
            result = json.loads(done.stdout.splitlines()[-1])
        elif done.returncode == -signal.SIGXCPU:
            result = {"status": "limit", "said": f"out of processor time ({seconds + GRACE:g} s of each processor)"}
        else:
            result = {"status": "died", "said": (done.stderr.strip().splitlines() or ["nothing"])[-1]}
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if result["said"]:
        result["said"] = result["said"].replace(f"{domain.parent}/", "").replace(f"{problem.parent}/", "")
    spent = time.monotonic() - start
    return {"instance": name_of(problem), **result, "seconds": round(spent, 2), "cpu": round(cpu, 2)}


def outcome(row: dict[str, Any]) -> str:
    """What came of an instance, in a word."""
    if row["status"] != "solved" and row["status"] != "unsolvable":
        return str(row["status"])
    return {"sweep": "swept", "on-demand": "on demand", None: row["status"]}[row["method"]]


def remark(row: dict[str, Any]) -> str:
    """What was said of an instance, as short as a table has it."""
    said = row.get("said") or ""
    if said.startswith(UNCHECKED):
        said = "not checked by unified-planning" + "".join(f"; {part}" for part in said.split("; ")[1:])
    return str(said.removeprefix("solved on demand: "))


def number(value: float | None, form: str = ",") -> str:
    return "-" if value is None else format(value, form)


def columns_of(before: dict[str, dict[str, Any]]) -> Columns:
    """The columns of the table, with those of an earlier run if there is one."""
    columns = {
        "instance": lambda row: f"`{row['instance'].removesuffix('.pddl')}`",
        "outcome": outcome,
        "states": lambda row: number(row.get("states")),
        "processor seconds": lambda row: number(row.get("cpu"), ".1f"),
        "compared": lambda row: number(row.get("verified") or None),
        "said": remark,
    }
    if before:
        columns["outcome before"] = lambda row: outcome(before[row["instance"]]) if row["instance"] in before else "-"
    return columns


def rows_of(file: Path | None) -> list[dict[str, Any]]:
    return [] if file is None or not file.is_file() else [json.loads(line) for line in file.read_text().splitlines()]


@click.command()
@click.argument("domains", nargs=-1)
@click.option("--read", "only_read", is_flag=True, help="Read only.")
@click.option("--instance", "which", type=int, default=1, show_default=True, help="Which instance of each domain.")
@click.option("--seconds", type=float, default=60.0, show_default=True)
@click.option("--busy", type=float, default=1.0, help="How many times slower than an idle machine it may be.")
@click.option("--memory", type=float, default=6000.0, show_default=True, help="MB.")
@click.option("--out", type=click.Path(path_type=Path), help="A file for the rows, as JSON Lines.")
@click.option("--before", type=click.Path(path_type=Path, exists=True), help="The rows of an earlier run.")
@record_option
@click.option("--one", nargs=2, hidden=True)
def main(
    domains: tuple[str, ...], only_read: bool, which: int, seconds: float, busy: float, memory: float,
    out: Path | None, before: Path | None, record: Path | None, one: tuple[str, str] | None,
) -> None:  # fmt: skip
    """Read and solve an instance of each domain of a collection."""
    if one is not None:
        _, most = resource.getrlimit(resource.RLIMIT_CPU)
        resource.setrlimit(resource.RLIMIT_CPU, (int((seconds + GRACE) * (os.cpu_count() or 1)), most))
        print(json.dumps(read(*one) if only_read else solve(*one, seconds * busy, memory)))
        return
    folder = os.environ.get("DOWNWARD_BENCHMARKS")
    if folder is None:
        print("DOWNWARD_BENCHMARKS is not set to the collection's folder: nothing to do")
        return
    rows = rows_of(out)
    known = {row["instance"] for row in rows}
    for domain, problem in instances(Path(folder), which):
        if name_of(problem) in known or (domains and not {*domains} & {*problem.parts}):
            continue
        rows.append(run(domain, problem, only_read=only_read, seconds=seconds, busy=busy, memory=memory))
        print(f"{rows[-1]['instance']}: {rows[-1]['status']}, {rows[-1]['seconds']} s", file=sys.stderr)
        if out is not None:
            with out.open("a") as stream:
                stream.write(json.dumps(rows[-1]) + "\n")
    rows.sort(key=lambda row: str(row["instance"]))
    columns = columns_of({row["instance"]: row for row in rows_of(before)})
    for row in rows:
        print(" | ".join(show(row) for show in columns.values()))
    write_record(record, columns, rows)


if __name__ == "__main__":
    main()
