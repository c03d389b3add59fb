"""Processor time of tasks in this checkout and in another one, in alternating pairs of processes.

    python bench/paired.py OTHER [TASK...] [--pairs 12] [--record FILE]

OTHER is a checkout of another commit, for instance one from `git archive`. Each process loads a task from its files and
sweeps it; its processor time includes Python's start and Fast Downward's translator. A first pair, in which code is
compiled and cached, does not count. The ratio is the median over pairs of the time here, divided by the time there: a
machine that is busy with other work slows both halves of a pair.
"""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

import click
from tables import Columns, cell, record_option, write_record

ROOT = Path(__file__).resolve().parent.parent
TASKS = ("kitting/paper", "kitting/ladder-4x7", "depot/six-items")
WORK = "import sys; from planner import load, sweep; print(len(sweep(load(sys.argv[1]))))"

COLUMNS: Columns = {
    "task": cell("task"), "states": cell("states", ","), "pairs": cell("pairs"), "there, s": cell("there", ".2f"),
    "here, s": cell("here", ".2f"), "ratio": cell("ratio", ".3f"), "half of the ratios": cell("middle"),
}  # fmt: skip


def spent(checkout: Path, task: str) -> tuple[float, int]:
    """Return the processor seconds of a process that sweeps a task with the code of a checkout, and its states."""
    environment = {**os.environ, "PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-c", WORK, str(ROOT / "domains" / f"{task}.pddl")],
        capture_output=True, text=True, check=True, cwd=checkout, env=environment,
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, int(done.stdout)


def compared(other: Path, task: str, pairs: int) -> dict[str, Any]:
    """Return the times of a task in both checkouts."""
    here, there = [], []
    states = {spent(ROOT, task)[1], spent(other, task)[1]}
    for pair in range(pairs):
        sides = [(ROOT, here), (other, there)]
        for checkout, times in sides if pair % 2 else reversed(sides):
            times.append(spent(checkout, task)[0])
    if len(states) != 1:
        raise click.ClickException(f"{task}: {states} states")
    ratios = [mine / theirs for mine, theirs in zip(here, there, strict=True)]
    low, _, high = statistics.quantiles(ratios, n=4)
    return {
        "task": task, "states": states.pop(), "pairs": pairs, "there": statistics.median(there),
        "here": statistics.median(here), "ratio": statistics.median(ratios), "middle": f"{low:.3f} to {high:.3f}",
    }  # fmt: skip


@click.command()
@click.argument("other", type=click.Path(path_type=Path, file_okay=False, resolve_path=True))
@click.argument("tasks", nargs=-1)
@click.option("--pairs", type=click.IntRange(min=2), default=12, show_default=True, help="Number of pairs.")
@record_option
def main(other: Path, tasks: tuple[str, ...], pairs: int, record: Path | None) -> None:
    """Compare the processor time of tasks with another checkout."""
    rows = []
    for task in tasks or TASKS:
        rows.append(row := compared(other, task, pairs))
        print("  ".join(show(row) for show in COLUMNS.values()), flush=True)
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
