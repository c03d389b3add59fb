"""Other people's tasks: the first instance of each domain of the public collection `aibasel/downward-benchmarks`.

    DOWNWARD_BENCHMARKS=FOLDER python bench/collection.py [DOMAIN...] [--read] [--instance K] [--out FILE]
                                                           [--before FILE] [--busy N]

Every instance is read, and unless `--read` is given solved, in a process of its own, within limits of time and
memory. The result is one line of JSON for each (status, method, states, seconds, what was said), and a table; with
`--before FILE` the table has an earlier run's figures beside. What `--out FILE` has already is not run again. On a
machine that others use, `--busy N` allows N times as much time on the clock; processor time is limited in any case.
Domains made for satisficing and agile tracks, and split ones, are left out.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

LEFT_OUT = ("sat", "agl", "mco", "split")
GRACE = 30.0  # seconds that a process may take to end by itself
VERIFY = 20.0  # seconds in which 20 states are compared with Fast Downward's A*


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


def read(domain: str, problem: str) -> dict[str, object]:
    from planner import PDDLError, instance, load

    try:
        task = load(instance(problem, domain))
    except PDDLError as error:
        return {"status": "invalid", "said": str(error)}
    return {"status": "read", "said": task.note, "variables": len(task.variables), "operators": len(task.operators)}


def solve(domain: str, problem: str, seconds: float, memory: float) -> dict[str, object]:
    from planner import instance
    from planner.solving import SolveOptions, solve_instance

    record = solve_instance(
        instance(problem, domain), SolveOptions(time_limit=seconds, memory_limit=memory, verify_seconds=VERIFY)
    )
    said = record["error"]["message"] if record["error"] else record["note"]
    kept = ("status", "method", "states", "cost", "verified", "peak_memory_mb")
    return {**{key: record[key] for key in kept}, "search": record["seconds"].get("search"), "said": said}


def name_of(problem: Path) -> str:
    """The name of an instance in the collection."""
    return "/".join(problem.parts[-2:] if problem.parent.name != "mprime-renamed" else problem.parts[-3:])


def run(domain: Path, problem: Path, options: argparse.Namespace) -> dict[str, object]:
    """Read or solve one instance in a new process."""
    own = [sys.executable, __file__, "--one", str(domain), str(problem)]
    patience = options.seconds * options.busy
    own += ["--seconds", str(patience), "--memory", str(options.memory), "--busy", str(options.busy)] + [
        "--read"
    ] * options.read
    start, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    try:
        done = subprocess.run(own, capture_output=True, text=True, timeout=patience + GRACE)
    except subprocess.TimeoutExpired:
        result: dict[str, object] = {"status": "limit", "said": f"no end after {patience + GRACE:g} s"}
    else:
        if done.returncode == 0:
            result = json.loads(done.stdout.splitlines()[-1])
        elif done.returncode == -signal.SIGXCPU:
            result = {"status": "limit", "said": f"out of processor time ({options.seconds + GRACE:g} s)"}
        else:
            result = {"status": "died", "said": (done.stderr.strip().splitlines() or ["nothing"])[-1]}
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    seconds = time.monotonic() - start
    return {"instance": name_of(problem), **result, "seconds": round(seconds, 2), "cpu": round(cpu, 2)}


def show(rows: list[dict[str, object]], before: dict[object, dict[str, object]]) -> None:
    """Print a table in Markdown."""
    columns = ["status", "states", "seconds"]
    print("| instance | " + " | ".join([*(f"{c} before" for c in columns if before), *columns, "said"]) + " |")
    print("|---|" + "---|" * (len(columns) * (2 if before else 1) + 1))
    for row in rows:
        earlier = before.get(row["instance"], {})
        cells = [earlier.get(c) for c in columns if before] + [row.get(c) for c in columns] + [row.get("said") or ""]
        shown = [f"{cell:,}" if isinstance(cell, int) else "-" if cell is None else str(cell) for cell in cells]
        print(f"| {row['instance']} | " + " | ".join(shown) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("domains", nargs="*", metavar="DOMAIN", help="these folders only")
    parser.add_argument("--read", action="store_true", help="read only")
    parser.add_argument("--instance", type=int, default=1, help="which instance of each domain")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--busy", type=float, default=1.0, help="how many times slower than an idle machine it may be")
    parser.add_argument("--memory", type=float, default=6000.0, help="MB")
    parser.add_argument("--out", type=Path, help="a file for the records, as JSON Lines")
    parser.add_argument("--before", type=Path, help="the records of an earlier run")
    parser.add_argument("--one", nargs=2, metavar=("DOMAIN", "PROBLEM"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        domain, problem = options.one
        _, most = resource.getrlimit(resource.RLIMIT_CPU)
        resource.setrlimit(resource.RLIMIT_CPU, (int(options.seconds / options.busy + GRACE), most))
        done = read(domain, problem) if options.read else solve(domain, problem, options.seconds, options.memory)
        print(json.dumps(done))
        return
    folder = os.environ.get("DOWNWARD_BENCHMARKS")
    if folder is None:
        print("DOWNWARD_BENCHMARKS is not set to the collection's folder: nothing to do")
        return
    kept = options.out.read_text().splitlines() if options.out is not None and options.out.is_file() else []
    rows = [json.loads(line) for line in kept]
    known = {row["instance"] for row in rows}
    for domain, problem in instances(Path(folder), options.instance):
        if name_of(problem) in known or (options.domains and not {*options.domains} & {*problem.parts}):
            continue
        rows.append(run(domain, problem, options))
        print(f"{rows[-1]['instance']}: {rows[-1]['status']}, {rows[-1]['seconds']} s", file=sys.stderr)
        if options.out is not None:
            with options.out.open("a") as stream:
                stream.write(json.dumps(rows[-1]) + "\n")
    before = {}
    if options.before is not None:
        before = {row["instance"]: row for row in map(json.loads, options.before.read_text().splitlines())}
    show(sorted(rows, key=lambda row: str(row["instance"])), before)


if __name__ == "__main__":
    main()
