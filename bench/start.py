"""Wall-clock time of the shortest commands, and its parts for a small task.

    python bench/start.py [--repeat N] [--record FILE]

Every command is a new process, with compiled code in numba's cache. The results are medians of N runs after one that is
not counted. Commands alternate, so that other load affects all of them. If KITASSIST_BEFORE names the `kitassist` of an
earlier checkout's environment, its times are shown too.
"""

from __future__ import annotations

import json
import os
import resource
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path

import click
from tables import record_option, write_record

ROOT = Path(__file__).resolve().parent.parent
TINY = str(ROOT / "domains" / "kitting" / "tiny.pddl")

PHASES = {
    "reading and grounding, by two other programs": ("read", "translate"),
    "the sweep": ("search",),
    "comparing 20 states with Fast Downward's A\\*": ("verify",),
    "checking the plan": ("plan", "validate"),
}
"""Phases of a record's seconds that are shown."""


def measured(kitassist: Path) -> dict[str, float]:
    """Run each command of an environment once; return the seconds of each row."""
    seconds = {}
    commands = {
        "`kitassist solve domains/kitting/tiny.pddl`": [str(kitassist), "solve", TINY, "--json"],
        "`kitassist --help`": [str(kitassist), "--help"],
        "`kitassist serve --help`": [str(kitassist), "serve", "--help"],
        "`kitassist --version`": [str(kitassist), "--version"],
        "`import planner`": [str(kitassist.with_name("python")), "-c", "import planner"],
    }
    for shown, command in commands.items():
        start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
        said = subprocess.run(command, capture_output=True, text=True, check=True, cwd=kitassist.parent).stdout
        seconds[shown] = time.perf_counter() - start
        if "--json" not in command:
            continue
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds["its processor time"] = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        phases = json.loads(said)[0]["seconds"]
        parts = {f"- {words}": sum(phases.get(name, 0.0) for name in own) for words, own in PHASES.items()}
        rest = seconds[shown] - sum(parts.values())
        seconds |= {**parts, "- starting Python, the command's own imports, ending": rest}
    return seconds


@click.command()
@click.option("--repeat", type=int, default=11, show_default=True)
@record_option
def main(repeat: int, record: Path | None) -> None:
    """Measure the time of short commands."""
    earlier = os.environ.get("KITASSIST_BEFORE")
    environments = {"before": Path(earlier)} if earlier else {}
    environments["now"] = Path(sys.executable).with_name("kitassist")
    found: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for turn in range(repeat + 1):
        for name, kitassist in environments.items():
            for what, seconds in measured(kitassist).items():
                if turn:
                    found[what][name].append(seconds)
    columns = {"seconds": lambda row: row["what"]}
    for name in environments:
        columns[name] = lambda row, name=name: f"{statistics.median(row[name]):.2f}"
    rows = [{"what": what, **values} for what, values in found.items()]
    for row in rows:
        print(" | ".join(show(row) for show in columns.values()))
    write_record(record, columns, rows)


if __name__ == "__main__":
    main()
