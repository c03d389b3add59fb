"""Latency and memory of the live assistant: one observation and the next recommendation in a large team.

    python bench/live.py [--people 1000] [--instance domains/kitting/paper.pddl] [--steps 300] [--record FILE]

Random people act: they follow the present suggestion, or take a random action. Each takes a few actions beforehand, so
that people are in different states. Then one person at a time acts, and the assistant is asked after each action.
"""

from __future__ import annotations

import resource
import time
from pathlib import Path
from typing import Any

import click
import numpy as np
from tables import cell, record_option, write_record

from assist.live.assistant import Assistant
from planner import cost_to_go, load

PAPER = str(Path(__file__).parent.parent / "domains/kitting/paper.pddl")

COLUMNS = {
    "task": cell("task"), "states": cell("states", ","), "policy": cell("policy"), "people": cell("people", ","),
    "set up, s": cell("set up", ".1f"),
    "observe, median, ms": cell("observe", ".2f"), "recommend, median, ms": cell("recommend", ".2f"),
    "both, median, ms": cell("median", ".2f"), "both, 95 %, ms": cell("high", ".1f"),
    "processor time of both, median, ms": cell("processor", ".2f"),
    "table, MB": cell("table", ".0f"), "team, MB": cell("team", ".0f"), "most, MB": cell("most", ".0f"),
    "one joins, ms": cell("joined", ".0f"), "save, ms": cell("saved", ".0f"), "restore, s": cell("restored", ".1f"),
}  # fmt: skip


@click.command()
@click.option("--instance", "instances", multiple=True, default=(PAPER,))
@click.option("--people", multiple=True, type=click.IntRange(min=1), default=(10, 1000, 10_000))
@click.option("--policy", "policies", multiple=True, default=("attention", "priority"))
@click.option("--steps", type=click.IntRange(min=2), default=300)
@click.option("--before", type=click.IntRange(min=0), default=5, help="Steps of each person before the measurement.")
@record_option
def main(
    instances: tuple[str, ...], people: tuple[int, ...], policies: tuple[str, ...], steps: int, before: int,
    record: Path | None,
) -> None:  # fmt: skip
    """Print times and memory."""
    rows = []
    print(" | ".join(COLUMNS))
    for instance in instances:
        empty = _resident()
        table = cost_to_go(load(instance))
        held = _resident() - empty
        for policy in policies:
            for count in people:
                row = {"task": Path(instance).stem, "states": len(table), "policy": policy, "people": count}
                rows.append({**row, "table": held, **_measured(table, policy, count, steps, before)})
                print(" | ".join(show(rows[-1]) for show in COLUMNS.values()), flush=True)
    write_record(record, COLUMNS, rows)


def _measured(table: Any, policy: str, count: int, steps: int, before: int) -> dict[str, float]:
    empty, begun = _resident(), time.perf_counter()
    desk = Assistant(table, [str(number) for number in range(count)], policy=policy)
    desk.recommend()
    set_up = time.perf_counter() - begun
    rng = np.random.default_rng(0)
    for _ in range(before):
        for number in range(count):
            desk.observe(*act(desk, str(number), rng))
    times = np.array([step(desk, str(rng.integers(count)), rng) for _ in range(steps)])[steps // 10 :]
    both = times[:, :2].sum(axis=1)
    begun = time.perf_counter()
    desk.join("another")
    joined = time.perf_counter() - begun
    begun = time.perf_counter()
    document = desk.to_json()
    saved = time.perf_counter() - begun
    team = _resident() - empty
    begun = time.perf_counter()
    again = Assistant.from_json(document, table)
    restored = time.perf_counter() - begun
    assert again.to_json() == document
    milliseconds = {
        "observe": np.median(times[:, 0]), "recommend": np.median(times[:, 1]), "processor": np.median(times[:, 2]),
        "median": np.median(both), "high": np.quantile(both, 0.95), "joined": joined, "saved": saved,
    }  # fmt: skip
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    return {
        **{name: 1e3 * float(value) for name, value in milliseconds.items()},
        "set up": set_up, "restored": restored, "team": team, "most": most,
    }  # fmt: skip


def act(desk: Assistant, name: str, rng: np.random.Generator) -> tuple[str, str]:
    """Return a person's name and next action."""
    person = desk.person(name)
    if person.finished:
        desk.begin(name)
        person = desk.person(name)
    return name, person.suggestion or person.applicable[rng.integers(len(person.applicable))]


def step(desk: Assistant, name: str, rng: np.random.Generator) -> tuple[float, float, float]:
    action = act(desk, name, rng)
    begun, worked = time.perf_counter(), time.process_time()
    desk.observe(*action)
    observed = time.perf_counter()
    desk.recommend()
    return observed - begun, time.perf_counter() - observed, time.process_time() - worked


def _resident() -> float:
    """Return the memory of the process in MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


if __name__ == "__main__":
    main()
