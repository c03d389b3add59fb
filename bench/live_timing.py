"""What it costs that real people are not in step: lockstep against a decision after every event.

    python bench/live_timing.py [--instance FILE] [--episodes 100]

The same simulated people, each with the same luck in a choice of their own, work either in lockstep (the robot does one
thing, then everybody acts once) or each at their own pace: the time between two of their actions is drawn anew each
time (gamma, mean 1, coefficient of variation 0.5), the robot decides after every action, and after a while without one.
"""

from __future__ import annotations

import heapq
from pathlib import Path

import click
import numpy as np

from assist.live.assistant import Assistant
from assist.live.simulated import SimulatedPerson
from assist.people.human import Population
from assist.team.settings import Setting
from planner import CostToGo, cost_to_go, load

TICK = 2.0 / 3.0
"""Of the mean time between two actions: 2 s of 3 s, as served."""

LONGEST = 500.0


def act(desk: Assistant, task: CostToGo, name: str, person: SimulatedPerson) -> bool:
    """Let somebody act; whether a suggestion had been made to them."""
    known = desk.person(name)
    desk.observe(name, person.act(task, known.state, known.applicable, known.suggestion))
    return known.suggestion is not None


def episode(task: CostToGo, setting: Setting, humans: int, seed: int, timing: str, policy: str) -> tuple[float, float]:
    """Give actions and suggestions per person."""
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
        while timing == "own pace" and now + TICK < after:  # nobody acts for a while
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


@click.command()
@click.option("--instance", default=str(Path(__file__).parent.parent / "domains/kitting/paper.pddl"))
@click.option("--episodes", default=100, show_default=True)
@click.option("--humans", multiple=True, type=int, default=(1, 3, 6))
@click.option("--c-suggest", default=0.2, show_default=True)
def main(instance: str, episodes: int, humans: tuple[int, ...], c_suggest: float) -> None:
    """Print actions and suggestions per person, and the difference from lockstep, paired, with its standard error."""
    task = cost_to_go(load(instance))
    setting = Setting(c_suggest=c_suggest, knowledge="exact")
    print("people  timing               actions per person   suggestions   more actions than in lockstep")
    for count in humans:
        found = {}
        timings = [(timing, "attention") for timing in ("lockstep", "own pace", "own pace, no tick")]
        for timing, policy in (*timings, ("lockstep", "none")):
            name = "nobody helps" if policy == "none" else timing
            found[name] = np.array([episode(task, setting, count, seed, timing, policy) for seed in range(episodes)])
            more = found[name][:, 0] - found["lockstep"][:, 0]
            error = more.std(ddof=1) / np.sqrt(episodes)
            actions, spoken = found[name].mean(axis=0)
            print(f"{count:6}  {name:18} {actions:20.2f} {spoken:13.2f} {more.mean():15.2f} ± {error:.2f}")


if __name__ == "__main__":
    main()
