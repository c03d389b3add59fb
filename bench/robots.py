"""Teams of several robots: value and certified gap of each policy, and pooled robots against separate ones.

    python bench/robots.py [--humans K] [--robots M] [--episodes 5000] [--rollout-episodes 500] [--record FILE] [--more]

People share one model (`knowledge="exact"`), so that a bound needs one person's problem. All policies of a cell meet
the same people and random numbers; differences from priority are paired. *Pooled* is the value of M robots for K people
less M times the value of one robot for K / M people, with priority in both.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click
import numpy as np
from tables import Columns, cell, more_option, record_option, write_record
from team import pool_of

from assist.certify.certificate import returns
from assist.certify.team_bound import upper_bound
from assist.people.decision import Floats

OTHERS = ("none", "reactive", "attention", "whittle", "rollout")


def _known(name: str):  # type: ignore[no-untyped-def]
    """Return a formatter of a difference and its standard error, or of a dash where there is none."""
    shown = cell(name, ".2f", f"{name} stderr")
    return lambda row: shown(row) if name in row else "-"


SHOWN: Columns = {
    "people": cell("humans"), "robots": cell("robots"), "bound": cell("bound", ".2f"),
    "priority": cell("priority", ".2f", "priority stderr"), "gap": lambda row: f"**{row['gap %']:.2f} %**",
    **{name: _known(name) for name in (*OTHERS, "pooled")}, "episodes": cell("episodes"),
}  # fmt: skip


def _mean(row: dict[str, Any], name: str, values: Floats) -> None:
    """Add the mean of some values and its standard error to a row."""
    row |= {name: float(values.mean()), f"{name} stderr": float(values.std(ddof=1) / np.sqrt(len(values)))}


@click.command()
@click.option("--instance", default="paper-fixed", show_default=True, help="Kitting instance.")
@click.option("--humans", "sizes", type=int, multiple=True, default=(2, 6, 24, 100), show_default=True)
@click.option("--robots", "numbers", type=int, multiple=True, default=(1, 2, 3), show_default=True)
@click.option("--episodes", type=click.IntRange(min=2), default=5000, show_default=True)
@click.option("--rollout-episodes", type=click.IntRange(min=0), default=500, show_default=True)
@click.option("--time-limit", type=float, default=40.0, show_default=True, help="Seconds for each bound.")
@record_option
@more_option
def main(
    instance: str, sizes: tuple[int, ...], numbers: tuple[int, ...], episodes: int, rollout_episodes: int,
    time_limit: float, record: Path | None, more: bool,
) -> None:  # fmt: skip
    """Compare policies of teams with several robots."""
    rows = []
    for humans in sizes:
        for robots in numbers:
            start, team = time.perf_counter(), list(range(humans))
            pool = pool_of(instance, humans, 0, knowledge="exact", robots=robots)
            travel = pool.setting.travel(humans)
            found = upper_bound(pool, gap=5e-4, time_limit=time_limit)
            base = returns(pool, "priority", team, travel, episodes=episodes, seed=0)
            row: dict[str, Any] = {"humans": humans, "robots": robots, "bound": found.upper, "episodes": episodes}
            _mean(row, "priority", base)
            row["gap %"] = 100 * (found.upper - row["priority"]) / abs(row["priority"])
            for name in OTHERS:
                if count := rollout_episodes if name == "rollout" else episodes:
                    own = returns(pool, name, team, travel, episodes=count, seed=0)
                    _mean(row, name, own - base[:count])
            if robots > 1 and humans % robots == 0:
                alone = pool_of(instance, humans // robots, 0, knowledge="exact")
                part = list(range(humans // robots))
                separate = returns(alone, "priority", part, alone.setting.travel(len(part)), episodes=episodes, seed=1)
                row["pooled"] = row["priority"] - robots * float(separate.mean())
                error = robots * float(separate.std(ddof=1)) / np.sqrt(episodes)
                row["pooled stderr"] = float(np.hypot(row["priority stderr"], error))
            rows.append(row)
            shown = ", ".join(f"{name} {show(row)}" for name, show in SHOWN.items())
            print(f"{shown} ({time.perf_counter() - start:.0f} s)", flush=True)
    write_record(record, SHOWN, rows, more=more)


if __name__ == "__main__":
    main()
