"""The methods for the cost-to-go of some states: a sweep, single searches, and `cost_to_go`, which runs both in
parallel.

    python bench/methods.py [NAME...] [--repeat N] [--limit S]

Each case consists of a task and states of random walks in it, whose cost-to-go is wanted. A sweep is far faster in some
cases, single searches in others. Each method runs in a process of its own, which reads the task and loads compiled code
before the clock starts. The methods alternate; the results are medians in seconds. `times` is the time of `cost_to_go`
divided by that of the faster method, and should not exceed 2.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import click
import numpy as np
from foreign import GENERATED, write
from tables import Columns, record_option, write_record

from planner import OnDemand, cost_to_go, load, sweep

DOMAINS = Path(__file__).resolve().parent.parent / "domains"

# For each case: the task, and the number of states that are wanted.
CASES = {
    "kitting/tiny, 5 states": ("kitting/tiny", 5),
    "kitting/paper, 100 states": ("kitting/paper", 100),
    "kitting/ladder-4x6, 3 states": ("kitting/ladder-4x6", 3),
    "kitting/ladder-4x7, 10 states": ("kitting/ladder-4x7", 10),
    "kitting/ladder-4x8, 1 state": ("kitting/ladder-4x8", 1),
    "kitting/ladder-4x8, 300 states": ("kitting/ladder-4x8", 300),
    "kitting/ladder-4x9, 10 states": ("kitting/ladder-4x9", 10),
    "kitting/ladder-6x12, 10 states": ("kitting/ladder-6x12", 10),
    "depot/nine-items, 1 state": ("depot/nine-items", 1),
    "depot/nine-items, 300 states": ("depot/nine-items", 300),
    "gripper/balls-13, 20 states": ("gripper/balls-13", 20),
    "delivery/two-vans, 30 states": ("delivery/two-vans", 30),
    "blocks/blocks-8, 100 states": ("blocks/blocks-8", 100),
    "grid of foreign.py, 30 states": ("grid", 30),
}
METHODS = ("sweep", "on demand", "cost_to_go")
LARGEST = 100_000_000
"""Largest number of states of a sweep."""


def number(value: float | None) -> str:
    return "-" if value is None else f"{value:#.2g}"


COLUMNS: Columns = {
    "task, states wanted": lambda row: f"`{row['case'].replace(', ', '`, ')}",
    "sweep, s": lambda row: number(row["seconds"]["sweep"]),
    "on demand, s": lambda row: number(row["seconds"]["on demand"]),
    "`cost_to_go`, s": lambda row: number(row["seconds"]["cost_to_go"]),
    "times the better": lambda row: number(row["times"]),
}


def seconds_of(method: str, task_name: str, count: int) -> dict[str, Any]:
    """Time one method in this process."""
    with tempfile.TemporaryDirectory() as folder:
        generated = task_name in GENERATED
        task = load(write(task_name, Path(folder)) if generated else DOMAINS / f"{task_name}.pddl")
    for small in ("kitting/tiny", "depot/two-columns"):  # loads compiled code
        swept = sweep(load(DOMAINS / f"{small}.pddl"))
    OnDemand(swept.task).lookup([0])
    walk = OnDemand(task)
    rng, states = np.random.default_rng(0), [walk.initial]
    while len(set(states)) < count:
        options = walk.choices([states[-1]]).targets
        states.append(int(rng.choice(options)) if len(options) else walk.initial)
    values = walk.values(list(dict.fromkeys(states)))
    start = time.perf_counter()
    if method == "sweep":
        table = sweep(task, max_states=LARGEST)
        h = table.lookup(table.numbers(values))
    elif method == "on demand":
        asked = OnDemand(task)
        h = asked.lookup(asked.numbers(values))
    else:
        answers = cost_to_go(task, values, max_states=LARGEST)
        h = answers.lookup(answers.numbers(values))
        method = answers.method
    return {"seconds": time.perf_counter() - start, "method": method, "sum": float(h[np.isfinite(h)].sum())}


def measured(name: str, method: str, limit: float) -> dict[str, Any]:
    """Time one method in a new process; `seconds` is None if it exceeds the limit."""
    task, count = CASES[name]
    command = [sys.executable, __file__, "--one", method, task, str(count)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit + 30, check=False)
    except subprocess.TimeoutExpired:
        return {"seconds": None, "said": f"more than {limit:g} s"}
    if done.returncode:
        return {"seconds": None, "said": (done.stderr.strip().splitlines() or ["?"])[-1]}
    return dict(json.loads(done.stdout))


@click.command()
@click.argument("names", nargs=-1)
@click.option("--repeat", type=click.IntRange(min=1), default=3, show_default=True)
@click.option("--limit", type=float, default=120.0, show_default=True, help="Seconds for one method.")
@record_option
@click.option("--one", nargs=3, type=(click.Choice(METHODS), str, int), hidden=True)
def main(
    names: tuple[str, ...], repeat: int, limit: float, record: Path | None, one: tuple[str, str, int] | None
) -> None:
    """Compare the methods for the cost-to-go of some states."""
    if one is not None:
        click.echo(json.dumps(seconds_of(*one)))
        return
    rows = []
    click.echo(f"{'case':34}" + "".join(f"{method:>12}" for method in METHODS) + f"{'times':>8}")
    for name in [case for case in CASES if not names or case.split(",")[0] in names or case in names]:
        runs: dict[str, list[dict[str, Any]]] = {method: [] for method in METHODS}
        for _ in range(repeat):
            for method, done in runs.items():
                if not done or done[-1]["seconds"] is not None:  # a method that exceeded the limit is not tried again
                    done.append(measured(name, method, limit))
        finished = {m: [r for r in done if r["seconds"] is not None] for m, done in runs.items()}
        if len({r["sum"] for done in finished.values() for r in done}) > 1:
            raise click.ClickException(f"{name}: the methods give different values")
        seconds = {m: statistics.median(r["seconds"] for r in done) if done else None for m, done in finished.items()}
        best = min((s for m, s in seconds.items() if s is not None and m != "cost_to_go"), default=None)
        own = seconds["cost_to_go"]
        chosen = finished["cost_to_go"][-1]["method"] if finished["cost_to_go"] else None
        times = None if own is None or best is None else own / best
        rows.append({"case": name, "seconds": seconds, "times": times, "chosen": chosen})
        shown = "".join(f"{number(s):>12}" for s in seconds.values())
        click.echo(f"{name:34}{shown}{number(times):>8}  {chosen}")
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
