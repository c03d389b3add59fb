"""Times of this checkout and of another one, in pairs: a gate for changes that must not make anything slower.

    python bench/pairs.py OTHER [--only NAME]... [--pairs 3] [--most 1.1]

OTHER is a folder with another checkout. Each runs its own benchmarks, one checkout after the other, in processes of the
same interpreter. A first run compiles and is not counted. The output is the median ratio of processor time, this one's
divided by the other's, with the smallest and the largest. The exit code is 1 if a median exceeds `--most`.

`decisions` are 200 of a live team, one after each action, by the program of this checkout. They are on a task whose
states are looked up on demand (`kitting/ladder-6x12`), and on one whose policies are truncated (`kitting/ladder-4x7`).
They count the states that were looked up as well; only the time of reports and decisions counts.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import click

BENCH = Path(__file__).resolve().parent

CASES = {
    "latency": "team.py latency --repeat 21",
    "rate": "team.py rate --repeat 3 --jobs 1 --people 20000",
    "wide": "wide.py --instance kitting/paper --instance kitting/ladder-3x5 --region 2000 --episodes 2000",
    "live load": "live_load.py --people 50 --seconds 30",
    "environments": "environments.py --steps 40 --repeat 3",
    "decisions, ladder-4x7": "peers/decisions.py kitting/ladder-4x7",
    "decisions, ladder-6x12": "peers/decisions.py kitting/ladder-6x12",
}
SMALLEST = {"latency": "team.py latency --repeat 1 --instance tiny", "tiny": "peers/decisions.py kitting/tiny"}


class Measured(NamedTuple):
    """Processor time of a run in seconds, and the states that were looked up if they were counted."""

    seconds: float
    lookups: int | None


def run(checkout: Path, command: str) -> Measured:
    """Run a benchmark with the packages of a checkout."""
    program, *arguments = command.split()
    own = program == "peers/decisions.py"  # which uses nothing but the public interface
    file = BENCH / program if own else checkout / "bench" / program
    before = os.times()
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, str(file), *arguments],
            env={**os.environ, "PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"}, cwd=folder,
            capture_output=True, text=True, check=False,
        )  # fmt: skip
    after = os.times()
    if done.returncode:
        raise click.ClickException(f"{checkout}: {command}: {(done.stderr.strip().splitlines() or ['failed'])[-1]}")
    if own:
        return Measured(**json.loads(done.stdout.splitlines()[-1]))
    return Measured(
        after.children_user + after.children_system - before.children_user - before.children_system, None
    )  # fmt: skip


@click.command()
@click.argument("other", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--only", multiple=True, type=click.Choice([*CASES]), help="Some of the benchmarks.")
@click.option("--pairs", type=click.IntRange(min=1), default=3, show_default=True)
@click.option("--most", type=float, default=1.1, show_default=True, help="Largest median ratio.")
@click.option("--smallest", is_flag=True, help="One pair of the smallest cases, which shows that it works.")
def main(other: Path, only: tuple[str, ...], pairs: int, most: float, smallest: bool) -> None:
    """Print the ratios of times."""
    both, late = (other.resolve(), BENCH.parent), False
    cases = SMALLEST if smallest else {name: CASES[name] for name in only or CASES}
    for name, command in cases.items():
        for checkout in both if not smallest else ():
            run(checkout, command)  # which compiles
        begun, ratios, looked = time.perf_counter(), list[float](), list[int | None]()
        for number in range(1 if smallest else pairs):
            found = [run(checkout, command) for checkout in (both if number % 2 == 0 else both[::-1])]
            before, after = found if number % 2 == 0 else found[::-1]
            ratios.append(after.seconds / before.seconds)
            looked = [before.lookups, after.lookups]
        middle = statistics.median(ratios)
        late |= middle > most and not smallest
        states = "" if looked[0] is None else f"; states looked up: {looked[0]:,} and {looked[1]:,}"
        print(
            f"{name}: {middle:.3f} ({min(ratios):.3f} to {max(ratios):.3f}, {len(ratios)} pairs, "
            f"{time.perf_counter() - begun:.0f} s){states}", flush=True,
        )  # fmt: skip
    sys.exit(int(late))


if __name__ == "__main__":
    main()
