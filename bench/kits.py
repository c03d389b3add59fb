"""What it is worth to know which kit people assemble: robots that are told, that infer it, that ask.

    python bench/kits.py [--goals G]... [--episodes N] [--record FILE]
    python bench/kits.py --bounds SECONDS [--goals G]... [--episodes N] [--record FILE]

A kit of `docs/examples/kits` has one item in each of two slots, so that four items make twelve kits. Each person
assembles one of the first G of them, in a random order, with equal probability. All robots see the same people, goals
and random numbers. Gains are differences of the discounted return from that without a robot, with standard errors of
the paired differences. A robot that asks also infers; `--sharpness 1` averages over the posterior.

With `--bounds`, the robot attends to one person, who has no misconceptions, and moves for free. The certified solver
then bounds the gain of the best robot without questions, in SECONDS for each number of kits. The pool has each type of
person as often as the prior says, and the return without a robot is computed, not simulated.
"""

from __future__ import annotations

import itertools
import math
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from tables import ROOT, Columns, cell, record_option, write_record

from assist.people import Goals, Human
from assist.person import Setting
from assist.person.solver import solve
from assist.simulation import Pool, simulate
from planner import load, sweep_goals

KITS = ROOT / "docs" / "examples" / "kits"
COLUMNS: Columns = {
    "kits": cell("kits"),
    "policy": cell("policy"),
    "gain, told": cell("known", ".2f", "known_error"),
    "gain, inferred": cell("inferred", ".2f", "inferred_error"),
    "gain, likeliest": cell("likeliest", ".2f", "likeliest_error"),
    "suggestions, told": cell("known_suggestions", ".2f"),
    "suggestions, inferred": cell("inferred_suggestions", ".2f"),
    "suggestions, likeliest": cell("likeliest_suggestions", ".2f"),
    "gain, asking": cell("asking", ".2f", "asking_error"),
    "gain by asking": cell("asked", ".2f", "asked_error"),
    "questions": cell("questions", ".2f"),
}

BOUNDS: Columns = {
    "kits": cell("kits"),
    "gain, told": cell("known", ".2f", "known_error"),
    "gain, asking": cell("asking", ".2f", "asking_error"),
    "gain, inferred": cell("inferred", ".2f", "inferred_error"),
    "best gain without questions": lambda row: f"{row['lower']:.2f} to {row['upper']:.2f}",
}


def kits(seed: int) -> list[str]:
    """Return the goals of all kits in a random order."""
    every = list(itertools.permutations(("hammer", "pliers", "wrench", "tape"), 2))
    order = np.random.default_rng(seed).permutation(len(every)).tolist()
    stored = " ".join(f"(in-storage box-{box})" for box in "abc")
    return [f"(:goal (and (in-slot {every[n][0]} slot-1) (in-slot {every[n][1]} slot-2) {stored})))" for n in order]


def goals_of(texts: list[str]) -> Goals:
    """Return the goals, from a problem file for each."""
    start = (KITS / "travel.pddl").read_text().partition("(:goal")[0]
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"kit-{number}.pddl" for number in range(len(texts))]
        for file, text in zip(files, texts, strict=True):
            file.write_text(start + text)
        tables = sweep_goals([load(file, KITS / "domain.pddl") for file in files])
    return Goals(dict(zip([file.stem for file in files], tables, strict=True)))


def compared(
    count: int, *, c_suggest: float, c_ask: float, sharpness: float, episodes: int, humans: int, size: int, seed: int
) -> Iterator[dict[str, Any]]:
    """Yield a row for each policy with `count` possible kits."""
    goals = replace(goals_of(kits(seed)[:count]), sharpness=sharpness)
    pool = Pool.sample(goals, size, seed=seed, setting=Setting(c_suggest=c_suggest))
    asks = replace(pool, setting=replace(pool.setting, c_ask=c_ask))
    options: dict[str, Any] = {"humans": humans, "episodes": episodes, "seed": seed}
    alone = simulate(pool, "none", **options).discounted_return
    for policy in ("attention", "priority"):
        row: dict[str, Any] = {"kits": count, "policy": policy}
        gains = {}
        for knows in ("known", "inferred", "likeliest", "asking"):
            if knows == "asking":
                found = simulate(asks, policy, **options)
                row["questions"] = found.questions.mean() / humans
            else:
                found = simulate(pool, policy, goals=knows, **options)
            gains[knows] = found.discounted_return - alone
            row[f"{knows}_suggestions"] = found.interventions.mean() / humans
        for name, values in {**gains, "asked": gains["asking"] - gains["inferred"]}.items():
            row[name], row[f"{name}_error"] = values.mean(), values.std(ddof=1) / math.sqrt(episodes)
        yield row


def bounded(
    count: int, *, c_suggest: float, c_ask: float, sharpness: float, episodes: int, size: int, seed: int, seconds: float
) -> dict[str, Any]:
    """Return a row of gains for one person, beside bounds on the gain of any robot that does not ask."""
    goals = replace(goals_of(kits(seed)[:count]), sharpness=sharpness)
    setting = Setting(c_suggest=c_suggest, c_move=0.0, knowledge="exact")
    pool = Pool.sample(goals, size, seed=seed, setting=setting)
    pomdp = pool.policies[0].pomdp
    beta, theta = np.meshgrid(pomdp.grid.beta, pomdp.grid.theta, indexing="ij")
    share = pomdp.prior.reshape(-1, beta.size).sum(axis=0).cumsum()
    drawn = share.searchsorted((np.arange(size) + 0.5) / size * share[-1])
    people = [Human(beta.flat[one], theta.flat[one], 0.0, pomdp.model.choices.h) for one in drawn]
    pool = replace(pool, people=tuple(people))
    asks = replace(pool, setting=replace(setting, c_ask=c_ask))
    options: dict[str, Any] = {"humans": 1, "episodes": episodes, "seed": seed, "explain": False}
    row: dict[str, Any] = {"kits": count}
    solution = solve(pomdp, gap=0.001, time_limit=seconds, memory_limit_mb=3000)
    for knows in ("known", "inferred", "asking"):
        more = {} if knows == "asking" else {"goals": knows}
        found = simulate(asks if knows == "asking" else pool, "attention", **more, **options).discounted_return
        row[knows] = found.mean() - solution.value_never
        row[f"{knows}_error"] = found.std(ddof=1) / math.sqrt(episodes)
    return row | {name: getattr(solution, name) - solution.value_never for name in ("lower", "upper")}


@click.command()
@click.option("--goals", "counts", type=click.IntRange(2, 12), multiple=True, default=(2, 4, 8), show_default=True)
@click.option("--c-suggest", type=float, default=0.2, show_default=True, help="Cost of a suggestion.")
@click.option("--c-ask", type=float, default=0.2, show_default=True, help="Cost of a question.")
@click.option("--sharpness", type=float, default=5.0, show_default=True, help="As in `assist.people.Goals`.")
@click.option("--episodes", type=click.IntRange(min=2), default=1000, show_default=True)
@click.option("--humans", type=click.IntRange(min=1), default=3, show_default=True)
@click.option("--pool", "size", type=click.IntRange(min=1), default=6, show_default=True)
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--bounds", type=click.FloatRange(min=1), metavar="SECONDS", help="Compare with bounds for one person.")
@record_option
def main(counts: tuple[int, ...], bounds: float | None, record: Path | None, **options: Any) -> None:
    """Compare robots that are told people's goals, that infer them, that assume the likeliest, and that ask."""
    rows = []
    if bounds is not None:
        del options["humans"]
        for count in counts:
            rows.append(bounded(count, seconds=bounds, **options))
            print(" | ".join(show(rows[-1]) for show in BOUNDS.values()), flush=True)
        write_record(record, BOUNDS, rows)
        return
    for count in counts:
        for row in compared(count, **options):
            print(" | ".join(show(row) for show in COLUMNS.values()), flush=True)
            rows.append(row)
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
