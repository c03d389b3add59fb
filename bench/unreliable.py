"""What errors of observation cost: the return of robots that miss or confuse people's actions, and the latency.

    python bench/unreliable.py returns [--instance NAME] [--episodes N] [--record FILE]
    python bench/unreliable.py latency [--instance NAME] [--people N] [--record FILE]

All robots see the same people with the same random numbers, so that losses are paired by episode. Intervals are normal,
at 95 %. The latency is that of an observation and the next recommendation in one process.
"""

from __future__ import annotations

import math
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
import numpy as np
from tables import Columns, cell, record_option, write_record

from assist.live import Assistant
from assist.people.choices import Choices
from assist.people.decision import Floats
from assist.person import ObservationModel, Setting
from assist.simulation import Pool, simulate
from assist.texts import InapplicableError
from planner import instance as find
from planner import load, sweep

RETURNS: Columns = {
    "policy": cell("policy"), "missed": cell("miss", ".0%"), "confused": cell("confusion", ".0%"),
    "return": cell("return", ".2f", "error"), "loss of return": cell("loss"), "share of the gain lost": cell("share"),
    "actions per person": cell("actions", ".2f"), "suggestions": cell("suggestions", ".2f"),
    "probability left out": cell("pruned", ".1e"),
}  # fmt: skip


def interval(values: Floats, normal: float = 1.96) -> tuple[float, float, float]:
    """Return a mean with the ends of its interval at 95 %."""
    mean, half = float(values.mean()), normal * float(values.std(ddof=1)) / math.sqrt(len(values))
    return mean, mean - half, mean + half


@click.group()
def main() -> None:
    """Measure what errors of observation cost."""


@main.command()
@click.option("--instance", default="kitting/paper", show_default=True)
@click.option("--episodes", type=click.IntRange(min=2), default=4000, show_default=True)
@click.option("--humans", type=click.IntRange(min=1), default=3, show_default=True)
@click.option("--pool", "size", type=click.IntRange(min=1), default=12, show_default=True)
@click.option("--seed", type=int, default=1, show_default=True)
@record_option
def returns(instance: str, episodes: int, humans: int, size: int, seed: int, record: Path | None) -> None:
    """Compare returns with and without errors, for attention switching and priority."""
    table, rows = sweep(load(find(instance))), []
    exact: dict[str, Floats] = {}
    for miss, confusion in ((0.0, 0.0), (0.05, 0.0), (0.0, 0.1), (0.05, 0.1), (0.2, 0.2)):
        setting = Setting(suggestions="all", observation=ObservationModel(miss, confusion))
        pool = Pool.sample(table, size, seed=seed, setting=setting)
        for policy in ("none", "reactive", "attention", "priority"):
            if policy == "none" and "none" in exact:  # which sees nothing
                continue
            found = simulate(pool, policy, humans=humans, episodes=episodes, seed=seed)
            reward, summary = found.discounted_return, found.summary()
            loss = interval(exact.setdefault(policy, reward) - reward)
            gain = (exact[policy] - exact["none"]).mean() or math.nan
            row: dict[str, Any] = {
                "policy": policy, "miss": miss, "confusion": confusion, "pruned": summary.pruned or 0.0,
                "return": reward.mean(), "error": summary.discounted_return[1],
                "loss": f"{loss[0]:.2f} ({loss[1]:.2f} to {loss[2]:.2f})", "share": f"{loss[0] / gain:.0%}",
                "actions": summary.actions[0], "suggestions": summary.interventions[0] / humans,
            }  # fmt: skip
            rows.append(row)
            print(" | ".join(show(row) for show in RETURNS.values()), flush=True)
    write_record(record, RETURNS, rows)


LATENCY: Columns = {
    "task": cell("task"), "policy": cell("policy"), "people": cell("people"), "missed": cell("miss", ".0%"),
    "confused": cell("confusion", ".0%"), "states, median": cell("states", ".0f"),
    "states, largest": cell("most", ".0f"), "observe and recommend, median, ms": cell("median", ".2f"),
    "95 %, ms": cell("high", ".1f"), "largest, ms": cell("largest", ".1f"),
    "processor time, median, ms": cell("processor", ".2f"),
}  # fmt: skip


@main.command()
@click.option("--instance", default="kitting/paper", show_default=True)
@click.option("--people", type=click.IntRange(min=1), default=200, show_default=True)
@click.option("--actions", type=click.IntRange(min=1), default=10, show_default=True, help="Actions of each person.")
@click.option("--policy", "policies", multiple=True, default=("attention", "priority"), show_default=True)
@record_option
def latency(instance: str, people: int, actions: int, policies: tuple[str, ...], record: Path | None) -> None:
    """Measure observations and recommendations of live people who act in turn, at random, or as was suggested."""
    table, rows = sweep(load(find(instance))), []
    choices = Choices.of(table)
    for policy in policies:
        for miss, confusion in ((0.0, 0.0), (0.05, 0.1)):
            model, rng = ObservationModel(miss, confusion), np.random.default_rng(1)
            names = [f"person-{number}" for number in range(people)]
            setting = Setting(c_suggest=0.2, suggestions="all", observation=model)
            desk, at = Assistant(table, names, policy=policy, setting=setting), dict.fromkeys(names, choices.initial)
            times, processor, states = [], [], []
            desk.recommend()
            desk.observe(names[0], likelihoods={choices.name(choices.initial, 0): 1.0})  # loads the compiled code
            desk.undo(names[0])
            for name in names * actions:
                if choices.goal[at[name]]:
                    continue
                done = [choices.name(at[name], slot) for slot in np.flatnonzero(choices.applicable[at[name]])]
                said = desk.person(name).suggestion
                slot = done.index(said) if said in done else int(rng.integers(len(done)))
                seen = model.draw(choices, at[name], slot, rng.random(2))
                at[name] = int(choices.targets[at[name], slot])
                if seen is None or desk.person(name).finished:
                    continue
                begin, worked = time.perf_counter(), time.process_time()
                with suppress(InapplicableError):  # which leaves everything as it was
                    desk.observe(name, choices.action_name(seen))
                desk.recommend()
                times.append(1000 * (time.perf_counter() - begin))
                processor.append(1000 * (time.process_time() - worked))
                states.append(max(1, len(desk.person(name).states)))
            row: dict[str, Any] = {
                "task": instance, "policy": policy, "people": people, "miss": miss, "confusion": confusion,
                "states": np.median(states), "most": max(states), "median": np.median(times),
                "high": np.percentile(times, 95), "largest": max(times), "processor": np.median(processor),
            }  # fmt: skip
            rows.append(row)
            print(" | ".join(show(row) for show in LATENCY.values()), flush=True)
    write_record(record, LATENCY, rows)


if __name__ == "__main__":
    main()
