"""Runs every benchmark, in its default form or in its smallest case, which shows that it still works.

    python bench/run.py [--smallest] [--only NAME] [--jobs N] [--out DIR]

A script that fails does not stop the others; the exit code is then 1. Scripts that need another program are
omitted. Concurrent runs (`--jobs`) slow each other down, so use them only to test that scripts work; the
output of each is printed when it ends.
"""

from __future__ import annotations

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import click

BENCH = Path(__file__).resolve().parent

# For each script and its commands: the arguments of the default run, and of the smallest case.
CASES = {
    "coupled_bounds": ("--problems 50 --fleets 5", "--problems 6 --fleets 2 --paths 30"),
    "cost_to_go": (
        "kitting-3-4 kitting-4-5 --repeat 1 --timeout 60 --sample 10 --sample-seconds 5",
        "kitting-1-1 kitting-1-2 --repeat 1 --peers kitassist",
    ),
    "crosscheck": ("20", "2"),
    "endurance": (
        "--people 10 --minutes 1 --kills 1",
        "--through mqtt --instance domains/kitting/tiny.pddl --people 2 --minutes 0.03 --kills 1 --every 1",
    ),
    "explanations": ("", "--pairs 2 --texts 1"),
    "environments": ("--steps 40 --repeat 1", "--instance kitting/tiny --teams 8 --steps 5 --repeat 1"),
    "fit recover": ("--people 100", "--instance kitting/tiny --people 8 --episodes 2"),
    "fit information": ("--people 100", "kitting/tiny --people 10 --episodes 2"),
    "fit misconceptions": ("--people 2 --episodes 3 --episodes 10", "--people 1 --instance kitting/tiny --episodes 2"),
    "fit time": ("--people 8", "--people 2 --actions 6 --instance kitting/tiny"),
    "fleet": ("--cells 1/3 --cells 1/5 --instances 20 --runs 200", "--cells 1/3 --instances 2 --runs 10"),
    "foreign": ("counters stacks", "--one domains/kitting/tiny.pddl"),
    "kernels": ("", "--repeat 1"),
    "live_load": ("--people 50 --seconds 30", "--instance domains/kitting/tiny.pddl --people 2 --seconds 5"),
    "methods": ("kitting/tiny kitting/paper depot/nine-items --repeat 1 --limit 10", "kitting/tiny --repeat 1"),
    "mutants": (
        "assist/team/attention.py --sample 4 --only reactive",
        "assist/team/attention.py --sample 1 --only reactive",
    ),
    "neighbours bounds": ("--settings 20", "--settings 2"),
    "neighbours policies": ("--episodes 100 --people 2", "--episodes 10 --people 2 --rate 0.1"),
    "neighbours recovery": (
        "--populations 2 --people 10 --tasks 2",
        "--instance kitting/tiny --populations 1 --people 4 --tasks 2",
    ),
    "trust": ("", "--fixed"),
    "trust_recovery coverage": (
        "--populations 4",
        "--instance kitting/tiny --people 5 --populations 1 --suggestions 8 --setting constant",
    ),
    "trust_recovery choice": (
        "--populations 1",
        "--instance kitting/tiny --people 4 --populations 1 --suggestions 8 --setting constant",
    ),
    "trust_recovery misjudged": (
        "--people 9 --populations 2",
        "--instance kitting/tiny --people 3 --populations 2",
    ),
    "pairs": (". --pairs 1 --only rate --only environments", ". --smallest"),
    "orbits": ("kitting/ladder-4x8 --compare 5 --seconds 5", "kitting/tiny --compare 1"),
    "observed": ("", "kitting/tiny stations/one-way --limit 1"),
    "people tower": ("--made-up 20 --quick", "--made-up 4 --quick"),
    "people recover": ("--people 40 --seeds 1", "--instance kitting/tiny --people 4 --actions 20 --seeds 1"),
    "people huge": ("--people 8", "--instance kitting/tiny --people 4 --actions 10"),
    "random_pddl": ("100 --jobs 2", "10"),
    "signals": ("--walks 200", "kitting/tiny --walks 10"),
    "start": ("--repeat 3", "--repeat 1"),
    "study": ("--humans 2 --people 4", "--check"),
    "team latency": ("--repeat 11", "--repeat 1 --instance tiny"),
    "team rate": ("--repeat 1", "--repeat 1 --instance tiny --jobs 1 --people 100"),
    "team gap": (
        "--instance paper-fixed --gamma .95 --humans 2 --humans 100 --time-limit 10",
        "--instance tiny --gamma .95 --humans 2 --time-limit 1",
    ),
    "wide": (
        "--instance kitting/ladder-3x5 --episodes 2000",
        "--instance kitting/tiny --people 2 --episodes 20 --policy priority",
    ),
}
NEED_DATA = {"collection", "live_pictures", "numeric_pddl"}
"""Scripts that need other people's files or programs, another checkout, or a browser."""

WRITES = {"cost_to_go", "fit time"} | {c for c in CASES if c.startswith("team")}


def _command(name: str, smallest: bool, out: Path) -> list[str]:
    """Return the script and arguments of a case."""
    script, *command = name.split()
    written = ["--out", str(out / script)] if name in WRITES else []
    return [f"{script}.py", *command, *CASES[name][smallest].split(), *written]


def _run(command: list[str], shown: bool) -> int:
    """Run a case, print its output at once or at the end, and return its exit code."""
    if shown:
        print(f"== bench/{' '.join(command)}", flush=True)
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, str(BENCH / command[0]), *command[1:]], check=False, text=True,
        stdout=None if shown else subprocess.PIPE, stderr=None if shown else subprocess.STDOUT,
    )  # fmt: skip
    took = f"-- {time.perf_counter() - start:.0f} s, exit code {done.returncode}"
    print(took if shown else f"== bench/{' '.join(command)}\n{done.stdout}{took}", flush=True)
    return done.returncode


@click.command()
@click.option("--smallest", is_flag=True, help="Run the smallest case of each.")
@click.option("--only", type=click.Choice(sorted(CASES)), multiple=True, help="Run only these.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Number of concurrent runs.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=Path("build/bench"), show_default=True)
def main(smallest: bool, only: tuple[str, ...], jobs: int, out: Path) -> None:
    """Run all benchmarks."""
    names = only or tuple(CASES)
    with ThreadPoolExecutor(jobs) as pool:
        codes = pool.map(lambda name: _run(_command(name, smallest, out), jobs == 1), names)
        failed = [name for name, code in zip(names, codes, strict=True) if code]
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
