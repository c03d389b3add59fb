"""Sweeps of orbits: tasks with too many states, reduced by their symmetries to one state of each orbit.

    python bench/orbits.py [NAME...] [--compare N] [--seconds S]

Each task runs in a process of its own with one thread. The table contains the numbers of symmetries and orbits,
processor time and peak memory. It also contains the number of states of a random walk that were compared with Fast
Downward's A*; a difference is an error.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import click
import numpy as np
from tables import Columns, record_option, write_record

from planner import LimitError, Limits, OnDemand, astar, load
from planner.costtogo.orbit_table import orbits
from planner.search.state_space import is_dead_end

DOMAINS = Path(__file__).resolve().parent.parent / "domains"
NAMES = ("kitting/ladder-4x8", "kitting/ladder-4x9", "kitting/ladder-4x10", "kitting/ladder-6x12")
STEPS = 20
"""Steps of the walk between two states that are compared."""

COLUMNS: Columns = {
    "instance": lambda row: f"`{row['name']}`",
    "symmetries": lambda row: f"{row['symmetries']:,}",
    "orbits": lambda row: f"{row['orbits']:,}",
    "transitions": lambda row: f"{row['transitions']:,}",
    "largest h*": lambda row: f"{row['largest']}",
    "processor seconds": lambda row: f"{row['seconds']:.1f}",
    "peak, MB": lambda row: f"{row['memory']:,.0f}",
    "equal to A\\*": lambda row: f"{row['equal']}",
}


def measured(name: str, compare: int, seconds: float) -> dict[str, Any]:
    """Sweep the orbits of one task in this process, and compare states of a walk."""
    task = load(DOMAINS / f"{name}.pddl")
    orbits(load(DOMAINS / "kitting/tiny.pddl"), max_orbits=100)  # loads compiled code
    start = time.process_time()
    found = orbits(task, max_orbits=50_000_000, threads=1)
    spent = time.process_time() - start
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    known, rng = OnDemand(task, orbits=found), np.random.default_rng(0)
    state, begun, equal = known.initial, time.monotonic(), 0
    while equal < compare and time.monotonic() - begun < seconds:
        for _ in range(STEPS):
            state = int(rng.choice(known.choices([state]).targets))
        try:
            expected = astar(task, known.values([state])[0].tolist(), limits=Limits(seconds, None))[0]
        except LimitError:
            break
        if known.lookup([state])[0] != expected:
            raise click.ClickException(f"{name}: {known.lookup([state])[0]}, but A* says {expected}")
        equal += 1
    distance = found.distance[~is_dead_end(found.distance)]
    return {
        "name": name, "symmetries": found.order, "orbits": len(found), "transitions": found.transition_count,
        "largest": int(distance.max()), "seconds": spent, "memory": memory, "equal": equal,
    }  # fmt: skip


@click.command()
@click.argument("names", nargs=-1)
@click.option(
    "--compare", type=click.IntRange(min=0), default=20, show_default=True, help="Number of states compared with A*."
)
@click.option("--seconds", type=float, default=30.0, show_default=True, help="Seconds for comparing, per task.")
@record_option
@click.option("--one", hidden=True)
def main(names: tuple[str, ...], compare: int, seconds: float, record: Path | None, one: str | None) -> None:
    """Sweep tasks by their orbits."""
    if one is not None:
        click.echo(json.dumps(measured(one, compare, seconds)))
        return
    rows = []
    for name in names or NAMES:
        command = [sys.executable, __file__, "--one", name, "--compare", str(compare), "--seconds", str(seconds)]
        rows.append(json.loads(subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout))
        click.echo("  ".join(show(rows[-1]) for show in COLUMNS.values()))
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
