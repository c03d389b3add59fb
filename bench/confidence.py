"""Coverage of bounds from sample paths: how often they lie below the mean that they bound, and below the optimal value.

    python bench/confidence.py [--seeds N] [--samples N] [--record FILE]

The teams are pairs of people on the tiny kit. In five settings the robot's grid has two betas and three thetas, so that
the joint problem can be solved exactly (`joint.py`). In the others the grid has 60 pairs, and sample paths have longer
tails; their paths take longer, so there are half as many seeds. For each setting and each share alpha of the conflicts,
one group of sample paths is drawn per seed. A bound is computed from each group, with the present interval and with
Student's t at 95 %. The mean over all groups stands for the mean that is bounded. At most 5 % of the bounds, plus three
standard errors of this share, may lie below it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
from joint import joint_bounds
from scipy.special import stdtrit
from tables import cell, record_option, write_record

from assist.certify.information_relaxation.belief_nodes import BeliefNodes
from assist.certify.information_relaxation.confidence import CONFIDENCE, FEWEST, SampledBound
from assist.certify.information_relaxation.options import RelaxationOptions
from assist.certify.information_relaxation.sampled_bound import InformationRelaxation
from assist.certify.options import BoundOptions
from assist.certify.prices import kinds_of, search, window_of
from assist.cli.options.help import Command
from assist.people.belief import Grid
from assist.people.choices import Choices
from assist.people.human import HumanModel
from assist.people.ranges import Population
from assist.person.pomdp import AssistPOMDP
from assist.person.qmdp import qmdp
from assist.person.settings import Setting
from assist.person.solver import solve
from assist.simulation.pool import Pool
from planner import cost_to_go, load

SETTINGS = [(0.95, 0.2, 0.3), (0.95, 0.05, 0.1), (0.9, 0.1, 0.0), (0.95, 0.4, 0.0), (0.8, 0.02, 0.02)]
"""gamma, c_suggest and c_move."""

POOLS = (0, 2)
"""Seeds of the teams with the full grid, in the first setting."""


def known(name: str, form: str) -> Callable[[dict[str, Any]], str]:
    """Format an entry, if the optimal value is known."""
    return lambda row: "" if math.isnan(row["truth"]) else format(row[name], form)


SHOWN = {
    "gamma": cell("gamma", "g"), "c_suggest": cell("c_suggest", "g"), "c_move": cell("c_move", "g"),
    "pairs": cell("pairs"), "alpha": cell("alpha", "g"), "best policy": known("truth", ".3f"),
    "mean bound": cell("mean", ".3f"), "half width": cell("half width", ".3f"), "skewness": cell("skewness", ".1f"),
    "paths": cell("paths"), "below the mean": cell("below mean", ".1%"), "with Student's t": cell("student", ".1%"),
    "below the best policy": known("below truth", ".1%"),
}  # fmt: skip


def pool_of(gamma: float, c_suggest: float, c_move: float, seed: int = 0) -> Pool:
    """Return two people whose misconceptions the robot knows, with a grid of two betas and three thetas."""
    choices = Choices.of(cost_to_go(load("kitting/tiny")))
    setting = Setting(gamma=gamma, c_suggest=c_suggest, c_move=c_move)
    population = Population(sigma=(0.5, 1.0))
    people = population.sample(choices, 2, np.random.default_rng(seed))
    grid = Grid(np.array([0.3, 1.5]), np.array([0.0, 0.5, 1.0]))
    policies = [
        qmdp(
            AssistPOMDP.of(
                HumanModel.own(choices, human), grid=grid, population=population, gamma=gamma, c_suggest=c_suggest
            )
        )
        for human in people
    ]
    return Pool(setting, tuple(people), tuple(policies), np.arange(2))


def relaxation(pool: Pool) -> InformationRelaxation:
    """Return the information relaxation of a team of two at prices that were optimised."""
    travel = pool.setting.travel(2)
    window = window_of(pool, (0, 1), 0)
    kinds = kinds_of(pool, (0, 1), travel, window)
    usual = BoundOptions()
    price = search(
        kinds, window, rounds=usual.price_rounds, episodes=usual.price_episodes, seed=0, deadline=math.inf,
        tell=lambda *_: None,
    )  # fmt: skip
    lattices = []
    for kind in kinds:
        visits = kind.at(price)
        lattices.append(BeliefNodes(visits, solve(visits.pomdp, gap=1e-3, best=kind.best(visits))))
    return InformationRelaxation(lattices, price, window)


def teams() -> list[tuple[tuple[float, float, float], int | None]]:
    """Return the settings, each with the seed of a pool if the joint problem is not solved."""
    return [*((setting, None) for setting in SETTINGS), *((SETTINGS[0], seed) for seed in POOLS)]


def coverage(number: int, paths: int, seeds: int) -> Iterator[dict[str, Any]]:
    """Yield the coverage of bounds from `paths` sample paths, for a setting and each alpha."""
    (gamma, c_suggest, c_move), seed = teams()[number]
    seeds = seeds if seed is None else max(2, seeds // 2)
    if seed is None:
        pool = pool_of(gamma, c_suggest, c_move)
        truth = joint_bounds(pool, gap=2e-3, time_limit=20.0).lower
    else:
        setting = Setting(gamma=gamma, c_suggest=c_suggest, c_move=c_move)
        pool, truth = Pool.sample(cost_to_go(load("kitting/tiny")), 2, seed=seed, setting=setting), math.nan
    robot, alphas = relaxation(pool), RelaxationOptions().alphas
    found = np.empty((len(alphas), paths * seeds))
    for n in range(paths * seeds):
        (path,) = robot.paths([np.random.default_rng(n)])
        found[:, n] = [robot.bound(path, alpha) for alpha in alphas]
    pairs = math.prod(pool.policies[0].pomdp.grid.shape)
    for alpha, values in zip(alphas, found, strict=True):
        groups = [SampledBound.of(own, paths, alpha) for own in values.reshape(seeds, paths)]
        mean, student = float(values.mean()), float(stdtrit(paths - 1, CONFIDENCE))
        yield {
            "gamma": gamma, "c_suggest": c_suggest, "c_move": c_move, "pairs": pairs, "alpha": alpha,
            "paths": paths, "truth": truth, "mean": mean,
            "skewness": float(((values - mean) ** 3).mean() / values.std() ** 3),
            "half width": float(np.mean([one.upper - one.mean for one in groups])),
            "below mean": float(np.mean([one.upper < mean for one in groups])),
            "student": float(np.mean([one.mean + student * one.stderr < mean for one in groups])),
            "below truth": float(np.mean([one.upper < truth for one in groups])),
        }  # fmt: skip


@click.command(cls=Command)
@click.option("--seeds", type=click.IntRange(min=2), default=200, show_default=True, help="Bounds in each setting.")
@click.option("--samples", "paths", type=click.IntRange(min=2), default=FEWEST, show_default=True, help="Sample paths.")
@click.option("--settings", type=click.IntRange(1, len(teams())), default=len(teams()), show_default=True)
@record_option
def main(seeds: int, paths: int, settings: int, record: Path | None) -> None:
    """Measure the coverage of sampled bounds; exit with 1 if too many are below their mean."""
    rows = []
    for number in range(settings):
        for row in coverage(number, paths, seeds):
            rows.append(row)
            click.echo(json.dumps(row))
    write_record(record, SHOWN, rows)
    allowed = 1 - CONFIDENCE + 3 * math.sqrt(CONFIDENCE * (1 - CONFIDENCE) / seeds)
    if max(row["below mean"] for row in rows) > allowed:
        raise SystemExit(f"more than {allowed:.1%} of the bounds are below their mean")


if __name__ == "__main__":
    main()
