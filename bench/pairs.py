"""Times of this checkout and of another one, in pairs: a gate for changes that must not make anything slower.

    python bench/pairs.py OTHER [--only NAME]... [--pairs 3] [--most 1.1] [--record FILE]

OTHER is a folder with another checkout. Each runs its own benchmarks, one checkout after the other, in processes of the
same interpreter. A first run compiles and is not counted. The ratio is the processor time of this checkout divided by
that of the other one in the same pair: a machine that is busy with other work slows both. The exit code is 1 if a
median exceeds `--most`.

`sweep` loads a task and sweeps it. `decisions` are 200 of a live team, one after each action. They are on a task whose
states are looked up on demand (`kitting/ladder-6x12`), and on one whose policies are truncated (`kitting/ladder-4x7`);
only the time of reports and decisions counts. These programs are those of this checkout, with the packages of either.
They also count states, those that were swept or looked up.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import click
from tables import Columns, cell, record_option, write_record

BENCH = Path(__file__).resolve().parent

CASES = {
    "sweep, paper": "peers/swept.py kitting/paper",
    "sweep, ladder-4x7": "peers/swept.py kitting/ladder-4x7",
    "latency": "team.py latency --repeat 21",
    "rate": "team.py rate --repeat 3 --jobs 1 --people 20000",
    "wide": "wide.py --instance kitting/paper --instance kitting/ladder-3x5 --region 2000 --episodes 2000",
    "live load": "live_load.py --people 50 --seconds 30",
    "environments": "environments.py --steps 40 --repeat 3",
    "fit": "fit.py recover --people 40 --episodes 2",
    "rules": "trust_recovery.py choice --people 12 --populations 1 --setting constant",
    "decisions, ladder-4x7": "peers/decisions.py kitting/ladder-4x7",
    "decisions, ladder-6x12": "peers/decisions.py kitting/ladder-6x12",
}
SMALLEST = {"latency": "team.py latency --repeat 1 --instance tiny", "tiny": "peers/decisions.py kitting/tiny"}
COLUMNS: Columns = {
    "benchmark": cell("name"), "pairs": cell("pairs"), "there, s": cell("there", ".2f"), "here, s": cell("here", ".2f"),
    "ratio": cell("ratio", ".3f"), "least to largest": cell("range"), "states": cell("states"),
}  # fmt: skip


class Measured(NamedTuple):
    """Processor time of a run in seconds, and its number of states if they were counted."""

    seconds: float
    count: int | None = None


def run(checkout: Path, command: str) -> Measured:
    """Run a benchmark with the packages of a checkout."""
    program, *arguments = command.split()
    own = program.startswith("peers/")  # which uses nothing but the public interface
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
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    found = json.loads(done.stdout.splitlines()[-1]) if own else {}
    return Measured(**{"seconds": spent, **found})


def compared(both: tuple[Path, Path], name: str, command: str, pairs: int) -> dict[str, Any]:
    """Return the times of a benchmark in two checkouts, the other one first."""
    times: list[tuple[float, float]] = []
    for number in range(pairs):
        found = [run(checkout, command) for checkout in (both if number % 2 == 0 else both[::-1])]
        before, after = found if number % 2 == 0 else found[::-1]
        times.append((before.seconds, after.seconds))
    ratios = [here / there for there, here in times]
    counts = [count for count in dict.fromkeys([before.count, after.count]) if count is not None]
    return {
        "name": name, "pairs": pairs, "there": statistics.median(there for there, _ in times),
        "here": statistics.median(here for _, here in times), "ratio": statistics.median(ratios),
        "range": f"{min(ratios):.3f} to {max(ratios):.3f}",
        "states": " and ".join(f"{count:,}" for count in counts),
    }  # fmt: skip


@click.command()
@click.argument("other", type=click.Path(path_type=Path, file_okay=False))
@click.option("--only", multiple=True, type=click.Choice([*CASES]), help="Some of the benchmarks.")
@click.option("--pairs", type=click.IntRange(min=1), default=3, show_default=True)
@click.option("--most", type=float, default=1.1, show_default=True, help="Largest median ratio.")
@click.option("--smallest", is_flag=True, help="One pair of the smallest cases, which shows that it works.")
@record_option
def main(
    other: Path, only: tuple[str, ...], pairs: int, most: float, smallest: bool, record: Path | None
) -> None:  # fmt: skip
    """Compare the times of two checkouts."""
    both, rows = (other.resolve(), BENCH.parent), []
    cases = SMALLEST if smallest else {name: CASES[name] for name in only or CASES}
    for name, command in cases.items():
        for checkout in both if not smallest else ():
            run(checkout, command)  # which compiles
        rows.append(row := compared(both, name, command, 1 if smallest else pairs))
        print("  ".join(show(row) for show in COLUMNS.values()), flush=True)
    write_record(record, COLUMNS, rows)
    sys.exit(not smallest and any(row["ratio"] > most for row in rows))


if __name__ == "__main__":
    main()
