"""Time and memory of computing the cost-to-go of every reachable state, compared with other tools.

    python bench/cost_to_go.py [INSTANCE...] [--out DIR] [--timeout S] [--peers a,b] [--record FILE]

An INSTANCE is a problem file, with `domain.pddl` in its folder, or `kitting-C-I`: the kitting domain with C containers,
and I items that fit each of I slots. Every tool runs on every instance in a process of its own
(`bench/peers/cost_to_go.py`):

- `kitassist`: this project;
- `pymimir`: its state space, which contains the goal distance of every state;
- `fd-astar`: one Fast Downward A* per state, on a task that is translated once.

The last one is measured on a sample of states and extrapolated; the results say so. All exact answers are compared: the
number of states, h* of the initial state, and the histogram of h*.

The environment variable PEER_PYTHON names a Python interpreter with pymimir, if it is not installed for this one. The
results are written to `results.json`.
"""

from __future__ import annotations

import json
import os
import platform
import re
import signal
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from tables import Columns, record_option, write_record

Row = dict[str, Any]

HERE = Path(__file__).resolve().parent
DOMAINS = (HERE.parent / "domains").resolve()
FAMILY_DOMAIN = DOMAINS / "kitting" / "domain.pddl"
FAMILY = ("kitting-3-4", "kitting-4-5", "kitting-4-6", "kitting-4-7")
SMALL = ("tiny", "unsolvable", "paper-fixed", "paper", "sealed", "costs/ways")
LARGE = "kitting-4-8"  # 7,208,645 states
OWN = "kitassist"
ELSEWHERE = ("pymimir",)  # peers that run with PEER_PYTHON
STATE_BY_STATE = ("fd-astar",)
PEERS = (OWN, *ELSEWHERE, *STATE_BY_STATE)
OUT = Path("build/bench/cost_to_go")
NO_SAMPLE = '{"count": null, "states": [], "atoms": []}'
QUICK = 5.0  # seconds; slower runs are not repeated


@dataclass(frozen=True)
class Instance:
    """The name of an instance and its two files."""

    name: str
    domain: Path
    problem: Path


def kitting_problem(containers: int, items: int) -> str:
    """Return a problem of the kitting family, in which every item fits each of `items` slots.

    As in the paper's example, the items are divided evenly among the containers, and the first containers hold the
    remaining ones. The task has (containers + 1) * sum over k of binomial(items, k)^2 * k! states.
    """
    boxes = [f"box-{number}" for number in range(1, containers + 1)]
    things = [f"item-{number}" for number in range(1, items + 1)]
    slots = [f"slot-{number}" for number in range(1, items + 1)]
    each, more = divmod(items, containers)
    homes = [box for place, box in enumerate(boxes) for _ in range(each + (place < more))]
    init = [f"(in-storage {box})" for box in boxes] + ["(platform-free)"]
    for thing, box in zip(things, homes, strict=True):
        init += [f"(contains {box} {thing})", f"(belongs {thing} {box})"]
    init += [f"({word} {slot})" for slot in slots for word in ("slot-free", "removable")]
    init += [f"(fits {thing} {slot})" for thing in things for slot in slots]
    goal = [f"(in-slot {thing} {slot})" for thing, slot in zip(things, slots, strict=True)]
    goal += [f"(in-storage {box})" for box in boxes]
    lines = "\n    "
    return (
        f"(define (problem kitting-{containers}-{items})\n  (:domain kitting)\n"
        f"  (:objects {' '.join(boxes)} - container\n"
        f"    {' '.join(things)} - item\n    {' '.join(slots)} - slot)\n"
        f"  (:init {lines.join(init)})\n  (:goal (and {lines.join(goal)})))\n"
    )


def find_instance(name: str, folder: Path) -> Instance:
    """Return the files of an instance; problems of the kitting family are written to `folder`."""
    if match := re.fullmatch(r"kitting-(\d+)-(\d+)", name):
        containers, items = int(match[1]), int(match[2])
        if containers and items:
            problem = folder / f"{name}.pddl"
            problem.write_text(kitting_problem(containers, items), encoding="utf-8")
            return Instance(name, FAMILY_DOMAIN, problem)
    problem = Path(name)
    domain = problem.parent / "domain.pddl"
    for file in (problem, domain):
        if not file.is_file():
            raise click.BadParameter(f"{file}: no such file (or kitting-C-I, such as kitting-4-6)")
    domain, problem = domain.resolve(), problem.resolve()
    inside = problem.is_relative_to(DOMAINS)
    shown = problem.relative_to(DOMAINS) if inside else Path(problem.parent.name, problem.name)
    return Instance(shown.with_suffix("").as_posix(), domain, problem)


def default_instances() -> list[str]:
    """Return the small bundled problems, followed by the kitting family in order of size."""
    return [*(str(DOMAINS / "kitting" / f"{name}.pddl") for name in SMALL), *FAMILY]


def run(peer: str, instance: Instance, options: dict[str, Any], timeout: float) -> Row:
    """Run one peer on one instance in a new process."""
    python = os.environ.get("PEER_PYTHON", sys.executable) if peer in ELSEWHERE else sys.executable
    program, domain, problem = map(str, (HERE / "peers" / "cost_to_go.py", instance.domain, instance.problem))
    failed: Row = {"peer": peer, "instance": instance.name, "extrapolated": peer in STATE_BY_STATE}
    try:
        process = subprocess.Popen(
            [python, program, peer, domain, problem, json.dumps(options)],
            # A fixed hash seed, so that the processes that sample states and that solve them ground the task in the
            # same way.
            env={**os.environ, "PYTHONHASHSEED": "0"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,  # so that Fast Downward ends together with the peer that runs it
        )
    except OSError as error:
        return {**failed, "status": "not installed", "note": f"PEER_PYTHON cannot be run: {error.strerror}"}
    try:
        output, errors = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        return {**failed, "status": "out of time", "note": f"stopped after {timeout:g} s"}
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    lines = output.splitlines()
    if process.returncode == 0 and lines:
        return {**json.loads(lines[-1]), "instance": instance.name}
    if process.returncode == -signal.SIGKILL or "bad_alloc" in errors:
        return {**failed, "status": "out of memory", "note": f"the process died ({process.returncode})"}
    last = (errors.strip().splitlines() or ["no message"])[-1]
    return {**failed, "status": "failed", "note": f"exit {process.returncode}: {last}"[:200]}


def repeat(count: int, peer: str, instance: Instance, options: dict[str, Any], timeout: float) -> Row:
    """Run a peer several times, unless it is slow, and return the run with the median time."""
    rows = [run(peer, instance, options, timeout)]
    while len(rows) < count and not rows[0]["extrapolated"] and (rows[-1].get("seconds") or QUICK) < QUICK:
        rows.append(run(peer, instance, options, timeout))
    times = [row["seconds"] for row in rows if row.get("seconds") is not None]
    if len(times) < len(rows):
        return next(row for row in rows if row.get("seconds") is None)
    median = statistics.median_low(times)
    return {**next(row for row in rows if row["seconds"] == median), "all_seconds": times}


def disagreements(rows: Sequence[Row]) -> list[str]:
    """Describe where two exact answers differ, or where this project failed."""
    failed = (row for row in rows if row["peer"] == OWN and row["status"] == "failed")
    found = [f"{row['instance']}: {OWN} failed: {row['note']}" for row in failed]
    for name in dict.fromkeys(row["instance"] for row in rows):
        answers = [row for row in rows if row["instance"] == name and row["status"] == "ok"]
        found += [
            f"{name}: {row['peer']} differs from {OWN} in the sampled states"
            for row in answers
            if row["extrapolated"] and row["sampled_equal"] != row["sampled"]
        ]
        exact = [row for row in answers if not row["extrapolated"]]
        for field in ("states", "initial_cost", "max_cost", "dead_ends", "checksum"):
            said = {row["peer"]: row[field] for row in exact if row[field] is not None}
            if len({json.dumps(value, sort_keys=True) for value in said.values()}) > 1:
                values = ", ".join(f"{peer} {value}" for peer, value in said.items())
                found.append(f"{name}: {field} differs" + ("" if field == "checksum" else f": {values}"))
    return found


def seconds(row: Row) -> float:
    """Return the seconds from the files to the values."""
    return float(row["seconds"])


def net_mb(row: Row) -> float:
    """Return the peak memory in MB beyond that of the interpreter with all imports."""
    return max(0.0, float(row["peak_mb"] - row["baseline_mb"]))


def took(peer: str) -> Callable[[dict[str, Any]], str]:
    """Return a formatter of a peer's result on an instance, whose rows are keyed by peer."""

    def shown(answers: dict[str, Any]) -> str:
        row = answers.get(peer, {"status": "not run"})
        if row["status"] != "ok":
            return str(row["status"])
        digits = 2 if seconds(row) < 2 else 1 if seconds(row) < 10 else 0
        return f"{seconds(row):,.{digits}f} s" + ("" if row["extrapolated"] else f", {net_mb(row):,.0f} MB")

    return shown


SHOWN: Columns = {
    "instance": lambda answers: f"`{answers[OWN]['instance']}`",
    "states": lambda answers: f"{answers[OWN]['states']:,}",
    "kitassist": took(OWN), "pymimir": took("pymimir"), "one A* per state": took("fd-astar"),
}  # fmt: skip


def as_table(rows: Sequence[Row]) -> Table:
    """Return the rows as a table for the terminal."""
    table = Table(title="Exact cost-to-go of every state: PDDL files to values in memory")
    table.add_column("instance", no_wrap=True)
    table.add_column("peer", no_wrap=True)
    for column in ("states", "seconds", "MB", "h* initial", "h* max", "dead ends"):
        table.add_column(column, justify="right", no_wrap=column != "h* initial")
    table.add_column("note", overflow="fold")

    def shown(value: Any) -> str:
        return "–" if value is None else f"{value:,}" if isinstance(value, int) else str(value)

    last = None
    for row in rows:
        if last not in (None, row["instance"]):
            table.add_section()
        name, last = ("" if last == row["instance"] else row["instance"]), row["instance"]
        note = escape(row["note"])
        if row["status"] != "ok":
            note = f"[red]{row['status']}[/red]" + (f": {note}" if note else "")
            table.add_row(name, row["peer"], "–", "–", "–", "–", "–", "–", note)
            continue
        time = f"≈ {seconds(row):,.0f}" if row["extrapolated"] else f"{seconds(row):,.3f}"
        memory = "–" if row["extrapolated"] else f"{net_mb(row):,.1f}"
        if row["extrapolated"]:
            note = f"extrapolated {note}"
        fields = [shown(row[field]) for field in ("initial_cost", "max_cost", "dead_ends")]
        table.add_row(name, row["peer"], shown(row["states"]), time, memory, *fields, note)
    return table


def machine() -> dict[str, Any]:
    """Describe the machine, as far as the results depend on it."""
    cpu = platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        cpu = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), cpu)
    except OSError:
        pass  # not Linux; report the architecture only
    system, python = platform.system(), platform.python_version()
    return {"cpu": cpu, "cores": os.cpu_count(), "system": system, "python": python}


def choose_peers(peers: str) -> list[str]:
    """Parse the list of peers. Peers that solve single states need this project's states."""
    wanted = [peer.strip() for peer in peers.split(",") if peer.strip()]
    if unknown := [peer for peer in wanted if peer not in PEERS]:
        raise click.BadParameter(f"{', '.join(unknown)}: not among {', '.join(PEERS)}", param_hint="--peers")
    return [p for p in PEERS if p in wanted or (p == OWN and any(peer in wanted for peer in STATE_BY_STATE))]


def measure_all(
    instances: Iterable[Instance],
    peers: Sequence[str],
    options: dict[str, Any],
    *,
    timeout: float,
    repeats: int,
    console: Console,
) -> list[Row]:
    """Run every peer on every instance. A peer that exceeded a limit skips larger instances."""
    rows: list[Row] = []
    largest: dict[str, int] = {}  # for each peer, the number of states at which it exceeded a limit
    for instance in instances:
        states = 0
        Path(options["sample_file"]).write_text(NO_SAMPLE, encoding="utf-8")
        for peer in peers:
            if peer in largest and states >= largest[peer]:
                row: Row = {"peer": peer, "instance": instance.name, "status": "not run"}
                row["extrapolated"] = peer in STATE_BY_STATE
                row["note"] = f"{largest[peer]:,} states were too many"
            else:
                with console.status(f"{instance.name}: {peer}"):
                    row = repeat(repeats, peer, instance, options, timeout)
            states = row.get("states") or states
            if row["status"] in ("out of time", "out of memory") and states:
                largest[peer] = min(states, largest.get(peer, states))
            rows.append(row)
    return rows


@click.command()
@click.argument("names", metavar="[INSTANCE]...", nargs=-1)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=OUT, show_default=True,
              help="Folder of results.json.")  # fmt: skip
@click.option("--timeout", type=click.FloatRange(min=1), default=300.0, show_default=True,
              help="Seconds for one peer on one instance.")  # fmt: skip
@click.option("--peers", default=",".join(PEERS), show_default=True, help="Peers to run, separated by commas.")
@click.option("--memory", type=click.IntRange(min=500), default=12_000, show_default=True,
              help="MB of address space for one peer.")  # fmt: skip
@click.option("--repeat", "repeats", type=click.IntRange(min=1), default=3, show_default=True,
              help=f"Runs that take less than {QUICK:g} s are repeated; the median counts.")  # fmt: skip
@click.option("--sample", type=click.IntRange(min=1), default=50, show_default=True,
              help="Number of states for peers that solve single states.")  # fmt: skip
@click.option("--sample-seconds", type=click.FloatRange(min=0), default=10.0, show_default=True,
              help="Seconds after which these peers start no further state.")  # fmt: skip
@click.option("--large", is_flag=True, help=f"Add {LARGE} to the default instances: minutes, and gigabytes.")
@record_option
def main(
    names: tuple[str, ...],
    out: Path,
    timeout: float,
    peers: str,
    memory: int,
    repeats: int,
    sample: int,
    sample_seconds: float,
    large: bool,
    record: Path | None,
) -> None:
    """Compare the time and memory for computing h* of every reachable state."""
    chosen = choose_peers(peers)
    console = Console(width=None if sys.stdout.isatty() else 150)
    with tempfile.TemporaryDirectory(prefix="cost-to-go-") as scratch:
        folder = Path(scratch)
        instances = [find_instance(name, folder) for name in names or default_instances()]
        if large:
            instances.append(find_instance(LARGE, folder))
        warm_up = find_instance("kitting-1-1", folder)
        options = {
            "warm_up": [str(warm_up.domain), str(warm_up.problem)],
            "sample_file": str(folder / "sample.json"),
            "sample": sample,
            "sample_seconds": sample_seconds,
            "memory_mb": memory,
        }
        rows = measure_all(instances, chosen, options, timeout=timeout, repeats=repeats, console=console)
    family: dict[str, dict[str, Row]] = {}
    for row in rows:
        if row["instance"].startswith("kitting-"):
            family.setdefault(row["instance"], {})[row["peer"]] = row
    write_record(record, SHOWN, family.values())
    wrong = disagreements(rows)
    console.print(as_table(rows))
    console.print("MB: peak beyond the interpreter with all imports done; ≈: extrapolated from a sample.")
    out.mkdir(parents=True, exist_ok=True)
    results = {"machine": machine(), "agree": not wrong, "disagreements": wrong, "rows": rows}
    (out / "results.json").write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    for line in wrong:
        console.print(f"[red]{escape(line)}[/red]")
    if wrong:
        sys.exit(1)
    exact = [row["instance"] for row in rows if row["status"] == "ok" and row["checksum"]]
    shared = sum(exact.count(name) > 1 for name in set(exact))
    sampled = sum(row.get("sampled", 0) for row in rows)
    if shared or sampled:
        told = f"{shared} instances have equal tables, {sampled} states solved singly are equal"
        console.print(f"All answers agree: {told}.")
    else:
        console.print("Nothing to compare: no two peers gave an exact answer.")


if __name__ == "__main__":
    main()
