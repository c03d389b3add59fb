"""Person-steps per second of the learning environments, including observations, masks and rewards.

    python bench/environments.py [--teams 1024] [--steps 100] [--repeat 5] [--instance NAME] [--record FILE]

Actions are drawn beforehand. The rate is the median over several rounds, after one round that is not counted, in
seconds of one processor. Finished teams are reset during the rounds; their steps are not counted.
"""

from __future__ import annotations

import statistics
import time
from pathlib import Path
from typing import Any

import click
import numpy as np
from tables import Columns, cell, record_option, write_record

from assist.connect.gymnasium import TeamVectorEnv
from assist.team.pool import Pool
from planner import load, sweep

RATE: Columns = {
    "teams": cell("teams", ","), "people": cell("humans"), "beliefs": lambda row: "seen" if row["beliefs"] else "no",
    "person-steps per second": cell("rate", ",.0f"),
}  # fmt: skip


def rate(pool: Pool, teams: int, humans: int, *, beliefs: bool, steps: int, repeat: int) -> dict[str, Any]:
    """Measure one size of team."""
    env = TeamVectorEnv(pool, teams, humans, beliefs=beliefs)
    seen, _ = env.reset(seed=0)
    actions = np.random.default_rng(0).integers(int(env.single_action_space.n), size=(steps, teams))
    rates = []
    for _ in range(1 + repeat):
        acted, start = 0, time.process_time()
        for step in range(steps):
            acted += int(seen["active"].sum())  # in teams that have ended, nobody is active
            seen, *_ = env.step(actions[step])
        rates.append(acted / (time.process_time() - start))
    return {"teams": teams, "humans": humans, "beliefs": beliefs, "rate": statistics.median(rates[1:])}


@click.command()
@click.option("--instance", default="kitting/paper-fixed", show_default=True)
@click.option("--teams", type=click.IntRange(1), default=1024, show_default=True)
@click.option("--steps", type=click.IntRange(1), default=100, show_default=True)
@click.option("--repeat", type=click.IntRange(1), default=5, show_default=True)
@record_option
def main(instance: str, teams: int, steps: int, repeat: int, record: Path | None) -> None:
    """Measure teams of several sizes, with beliefs and without."""
    pool = Pool.sample(sweep(load(instance)), 12, seed=0)
    rows = []
    for humans in (1, 3, 6):
        for beliefs in (True, False):
            rows.append(rate(pool, teams, humans, beliefs=beliefs, steps=steps, repeat=repeat))
            print(" | ".join(f"{name} {show(rows[-1])}" for name, show in RATE.items()), flush=True)
    write_record(record, RATE, rows, instance=instance)


if __name__ == "__main__":
    main()
