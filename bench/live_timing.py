"""The cost of asynchrony: lockstep compared with a decision after every event.

    python bench/live_timing.py [--instance FILE]... [--humans K]... [--episodes 100] [--record FILE]

The same simulated people, with common random numbers, work either in lockstep (the robot acts once, then everybody acts
once) or each at their own pace. At their own pace, the time between two actions of a person is gamma-distributed (mean
1, coefficient of variation 0.5). The robot decides after every action, and after a while without one.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
from tables import Columns, cell, record_option, write_record

from assist.live.assistant import Assistant
from assist.live.simulated_person import SimulatedPerson
from assist.people.ranges import Population
from assist.person.settings import Setting
from planner import CostToGo, cost_to_go, load

KITTING = Path(__file__).parent.parent / "domains/kitting"
DEFAULT = (KITTING / "tiny.pddl", KITTING / "paper-fixed.pddl")

TICK = 2.0 / 3.0
"""Time without an action after which the robot decides again, relative to the mean time between actions: 2 s of 3 s,
the defaults of `serve`.
"""

LONGEST = 500.0


def act(desk: Assistant, task: CostToGo, name: str, person: SimulatedPerson) -> bool:
    """Let a person act; return whether a suggestion had been made."""
    known = desk.person(name)
    desk.observe(name, person.act(task, known.state, known.applicable, known.suggestion))
    return known.suggestion is not None


def episode(task: CostToGo, setting: Setting, humans: int, seed: int, timing: str, policy: str) -> tuple[float, float]:
    """Return the numbers of actions and suggestions per person."""
    names = [str(number) for number in range(humans)]
    people = {name: SimulatedPerson(Population(), seed=1000 * seed + number) for number, name in enumerate(names)}
    desk = Assistant(task, names, policy=policy, setting=setting)
    clocks = np.random.default_rng([seed, 1])
    spoken = actions = 0
    if timing == "lockstep":
        while not desk.finished and actions < LONGEST * humans:
            desk.recommend()
            for name in names:
                if not desk.person(name).finished:
                    spoken += act(desk, task, name, people[name])
                    actions += 1
        return actions / humans, spoken / humans
    due = [(float(clocks.gamma(4, 0.25)), name) for name in names]
    heapq.heapify(due)
    now = 0.0
    desk.recommend()
    while due and now < LONGEST:
        after, name = heapq.heappop(due)
        while timing == "own pace" and now + TICK < after:  # no action for a while
            now += TICK
            desk.elapse()
            desk.recommend()
        now = after
        spoken += act(desk, task, name, people[name])
        actions += 1
        desk.recommend()
        if not desk.person(name).finished:
            heapq.heappush(due, (now + float(clocks.gamma(4, 0.25)), name))
    return actions / humans, spoken / humans


COLUMNS: Columns = {
    "task": cell("task"),
    "people": cell("people"),
    "timing": cell("timing"),
    "actions per person": cell("actions", ".2f"),
    "suggestions per person": cell("suggestions", ".2f"),
    "more actions than in step": lambda row: "" if row["more"] is None else f"{row['more']:.2f} ± {row['error']:.2f}",
}
TIMINGS = {
    "in step": ("lockstep", "attention"),
    "own pace, a decision after every action, and when idle": ("own pace", "attention"),
    "own pace, a decision after every action": ("own pace, no tick", "attention"),
    "in step, no help": ("lockstep", "none"),
}


def compare(task: CostToGo, setting: Setting, humans: int, episodes: int) -> Iterator[dict[str, Any]]:
    """Yield for each timing the actions and suggestions, and the paired difference from lockstep."""
    found: dict[str, Any] = {}
    for name, (timing, policy) in TIMINGS.items():
        found[name] = np.array([episode(task, setting, humans, seed, timing, policy) for seed in range(episodes)])
        more = found[name][:, 0] - found["in step"][:, 0]
        actions, spoken = found[name].mean(axis=0)
        first = name == "in step"
        yield {
            "people": humans, "timing": name, "actions": actions, "suggestions": spoken,
            "more": None if first else more.mean(), "error": more.std(ddof=1) / np.sqrt(episodes),
        }  # fmt: skip


@click.command()
@click.option("--instance", "instances", multiple=True, type=Path, default=DEFAULT)
@click.option("--episodes", default=100, show_default=True)
@click.option("--humans", multiple=True, type=int, default=(1, 3, 6))
@click.option("--c-suggest", default=0.2, show_default=True)
@record_option
def main(
    instances: tuple[Path, ...], episodes: int, humans: tuple[int, ...], c_suggest: float, record: Path | None
) -> None:
    """Print actions and suggestions per person, and the paired difference from lockstep with its standard error."""
    setting, rows = Setting(c_suggest=c_suggest, knowledge="exact"), []
    for instance in instances:
        task = cost_to_go(load(instance))
        for count in humans:
            for row in compare(task, setting, count, episodes):
                rows.append(row | {"task": instance.stem})
                print("; ".join(show(rows[-1]) for show in COLUMNS.values()), flush=True)
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
