"""People with habits, and robots that know them or not: the protocol `people` and its tables in the documentation.

    python bench/habits.py [--pools N] [--people N] [--humans K] [--instance NAME] [--jobs N] [--out DIR] [--into DIR]

Episodes in `--out` are kept and the study is resumed; `kitassist study --protocol people --out DIR` gives the same. The
results are three tables with means over pools (`assist.reports.statistics`): the actions under each policy
(`habits-policies`), the loss of a robot that models people with habits by cost alone (`habits-unknown`), and the
savings of attention switching (`habits-savings`). A pool is one observation, over all instances and team sizes.
`--into` writes the tables as records.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pandas as pd
from tables import save

from assist.reports.statistics import IntervalEstimate, mean, saving
from assist.study import Study, load_study, read, run_study

MEASURES = {
    "actions a person": "human_actions_per_person", "interventions": "interventions", "return": "discounted_return",
}  # fmt: skip
ARM = ["condition", "prior"]
SEED = 0
"""Seed of the bootstrap, as in a study's own report."""


def of_pools(episodes: pd.DataFrame) -> pd.DataFrame:
    """Return the mean of each measure in each pool, one row for each arm, policy and pool."""
    keys = [*ARM, "policy", "repeat"]
    means = episodes.groupby(keys, observed=True, sort=False)[list(MEASURES.values())].mean()
    return means.rename(columns={column: name for name, column in MEASURES.items()})


def shown(estimate: IntervalEstimate) -> str:
    """Format a number with its interval."""
    return f"{estimate.value:.2f} ({estimate.low:.2f} to {estimate.high:.2f})"


def policies(pools: pd.DataFrame) -> list[list[str]]:
    """Return the table of measures in each arm under each policy."""
    rows = [["people", "the robot takes them for", "policy", *MEASURES]]
    for (condition, prior, policy), own in pools.groupby([*ARM, "policy"], observed=True, sort=False):
        rows.append([condition, prior, policy, *(shown(mean(own[measure])) for measure in MEASURES)])
    return rows


def unknown(pools: pd.DataFrame) -> list[list[str]]:
    """Return the table of losses, paired by pool, if the robot's prior differs from the population."""
    rows = [["people", "policy", *(f"{measure}, more" for measure in MEASURES)]]
    for condition, own in pools.groupby("condition", observed=True, sort=False):
        priors = own.index.get_level_values("prior").unique()
        for prior in [p for p in priors if p != "own"]:
            known, mistaken = own.xs("own", level="prior"), own.xs(prior, level="prior")
            difference = (mistaken - known).dropna()
            for policy, pairs in difference.groupby("policy", observed=True, sort=False):
                if policy in ("none", "reactive"):  # these policies have no beliefs
                    continue
                rows.append([condition, policy, *(shown(mean(pairs[measure])) for measure in MEASURES)])
    return rows


def savings(pools: pd.DataFrame, policy: str = "attention") -> list[list[str]]:
    """Return the table of savings of a policy against both baselines in each arm, in percent."""
    against = {"none": ["actions a person"], "reactive": ["actions a person", "interventions"]}
    heads = [f"{measure}, against {other}" for other, measures in against.items() for measure in measures]
    rows = [["people", "the robot takes them for", *heads]]
    for (condition, prior), own in pools.groupby(ARM, observed=True, sort=False):
        mine = own.xs(policy, level="policy").droplevel(ARM)
        cells = []
        for other, measures in against.items():
            its = own.xs(other, level="policy").droplevel(ARM).loc[mine.index]
            cells += [shown(saving(mine[m], its[m], np.random.default_rng(SEED))) for m in measures]
        rows.append([condition, prior, *cells])
    return rows


def study_of(pools: int, people: int, humans: tuple[int, ...], instance: str | None) -> Study:
    """Return the protocol, or a smaller version of it."""
    study = read("people", repeats=pools)
    instances = tuple(pair for pair in study.instances if instance in (None, pair[0]))
    names = tuple(name for name, _ in instances)
    conditions = tuple(replace(c, humans=humans or c.humans, instances=names) for c in study.conditions)
    return replace(study, pool=people, conditions=conditions, instances=instances)


@click.command()
@click.option("--pools", type=click.IntRange(min=2), default=30, show_default=True)
@click.option("--people", type=click.IntRange(min=1), default=12, show_default=True, help="In a pool.")
@click.option("--humans", type=click.IntRange(min=1), multiple=True, help="Team sizes; those of the protocol if none.")
@click.option("--instance", type=click.Choice(["paper", "paper-fixed"]), help="One of the two.")
@click.option("--jobs", type=click.IntRange(min=1), default=2, show_default=True)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the episodes; an existing study is resumed.",
)
@click.option("--into", type=click.Path(path_type=Path, file_okay=False), help="Write records here.")
def main(
    pools: int, people: int, humans: tuple[int, ...], instance: str | None, jobs: int, out: Path | None,
    into: Path | None,
) -> None:  # fmt: skip
    """Run the study."""
    with tempfile.TemporaryDirectory(prefix="habits-") as scratch:
        folder = out or Path(scratch)
        failed = run_study(study_of(pools, people, humans, instance), folder, jobs=jobs, resume=True)
        if failed:
            sys.exit(f"{len(failed)} cells failed; the first: {failed[0]}")
        found = of_pools(load_study(folder))
        written = pd.Timestamp((folder / "episodes.jsonl").stat().st_mtime, unit="s").strftime("%Y-%m-%d")
    for name, table in (("policies", policies(found)), ("unknown", unknown(found)), ("savings", savings(found))):
        print("\n".join(" | ".join(row) for row in table), end="\n\n")
        if into is not None:
            commands = ["python bench/habits.py --into bench/records"]
            save(into / f"habits-{name}.json", {"commands": commands, "made": written, "pools": pools, "table": table})


if __name__ == "__main__":
    main()
