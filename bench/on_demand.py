"""Cost-to-go on demand for a task that is too large to enumerate: without a cache, and from the cache.

    python bench/on_demand.py [--states N] [--jobs N]

The states are the initial state of `ladder-6x12` (3.7e11 states) and those of a random walk. They are solved without a
cache first, and then looked up by a new process in the cache that the first has written.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import click
import numpy as np

from planner import Cache, OnDemand, load

HUGE = Path(__file__).resolve().parent.parent / "domains" / "kitting" / "ladder-6x12.pddl"


def ask(folder: Path, states: int, jobs: int | None) -> None:
    """Look up the states of a random walk, and print the times."""
    start = time.perf_counter()
    task = load(HUGE, cache=folder)
    loaded = time.perf_counter()
    asked = OnDemand(task, cache=Cache(task, folder), jobs=jobs)
    rng = np.random.default_rng(0)
    walk = [asked.initial]
    while len(set(walk)) <= states:
        walk.append(int(rng.choice(asked.choices([walk[-1]]).targets)))
    walked = time.perf_counter()
    h = asked.lookup(walk)
    done = time.perf_counter()
    times = (
        f"read and ground {loaded - start:.2f} s, cache and walk {walked - loaded:.2f} s, look up {done - walked:.2f} s"
    )
    print(f"{len(set(walk))} different states, h* from {h.min():g} to {h.max():g}: {times}")


@click.command()
@click.option("--states", type=click.IntRange(min=1), default=100, show_default=True)
@click.option(
    "--jobs", type=click.IntRange(min=1), help="Number of concurrent searches. One per processor unless given."
)
@click.option("--cache", type=click.Path(path_type=Path), hidden=True)
def main(states: int, jobs: int | None, cache: Path | None) -> None:
    """Measure cost-to-go on demand."""
    if cache is not None:
        ask(cache, states, jobs)
        return
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(2):
            command = [sys.executable, __file__, "--cache", folder, "--states", str(states)]
            subprocess.run([*command, *(["--jobs", str(jobs)] if jobs else [])], check=True)


if __name__ == "__main__":
    main()
