"""What influence that moves by a rule changes for robots that know the rule, and for robots that believe another one.

    python bench/trust_study.py [--pools N] [--people N] [--instance NAME] [--record FILE]
    python bench/trust_study.py --of FOLDER [--record FILE]

The study is `kitassist study --protocol trust`; `--of` reads the results of an unreduced run. Intervals are Student's t
over pools, and differences are paired by pool. A return is that of attention switching, per person and in cost units.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from tables import cell, record_option, write_record

from assist.reports.statistics import mean
from assist.study import Study, load_study, read, run_study
from planner import find_instances
from planner.pddl.instance_finder import bundled_files

SHOWN = {
    "people's rule": cell("rule"), "the robot believes": cell("believed"), "people": cell("people"),
    "return": cell("return"), "gain over reactive": cell("gain"), "gain of knowing the rule": cell("knowing"),
    "priority minus attention": cell("priority"), "actions": cell("actions"), "suggestions": cell("suggestions"),
    "to each of low theta": cell("low"), "to each of high theta": cell("high"),
}  # fmt: skip


def shown(values: Any) -> str:
    """Return a mean over pools with its interval; a dash if there is none."""
    values = np.asarray(values, dtype=float)
    values = values[np.isfinite(values)]
    if not len(values):
        return "-"
    found = mean(values)
    return f"{found.value:.2f} ({found.low:.2f} to {found.high:.2f})"


def reduced(pools: int, people: int, instance: str) -> Study:
    """Return the study with fewer pools of fewer people, at another task."""
    study = read("trust", repeats=pools)
    task = find_instances(bundled_files(instance))[0]
    conditions = tuple(
        replace(one, humans=tuple(range(1, people + 1)), instances=(instance,)) for one in study.conditions
    )
    return replace(study, pool=people, conditions=conditions, instances=((instance, task),))


def rows_of(folder: Path, low: float = 0.5, high: float = 0.85) -> Iterator[dict[str, Any]]:
    """Yield a row for each rule, belief of the robot, and population.

    Suggestions to people in teams are counted for those whose theta is below `low` at first, one in nine of the advice
    takers, and above `high`, half of them.
    """
    frame = load_study(folder)
    frame["return"] = frame["discounted_return"] / frame["humans"]
    names = ["condition", "setting", "population"]
    told = frame[(frame["policy"] == "attention") & (frame["humans"] > 1)].explode(["theta", "helped"])
    told["theta"], told["helped"] = told["theta"].astype(float), told["helped"].astype(float)
    for condition, of_rule in frame.groupby("condition", observed=True, sort=False):
        known: dict[str, Any] = {}
        for (_, setting, population), cells in of_rule.groupby(names, observed=True, sort=False):
            rule, _, believed = str(setting).removeprefix("trust ").partition(", believed_trust ")

            def by_pool(name: str, policy: str = "attention", cells: Any = cells) -> Any:
                return cells[cells["policy"] == policy].groupby("repeat")[name].mean()

            cell_of = dict(zip(names, (condition, setting, population), strict=True))
            here = told[np.logical_and.reduce([told[name] == value for name, value in cell_of.items()])]
            own = by_pool("return")
            known.setdefault(str(population), own)
            yield {
                "rule": rule, "believed": believed or "the same", "people": population, "return": shown(own),
                "gain": shown(own - by_pool("return", "reactive")),
                "knowing": shown(known[str(population)] - own) if believed else "-",
                "priority": shown(by_pool("return", "priority") - own),
                "actions": shown(by_pool("human_actions_per_person")), "suggestions": shown(by_pool("interventions")),
                "low": shown(here[here["theta"] < low].groupby("repeat")["helped"].mean()),
                "high": shown(here[here["theta"] > high].groupby("repeat")["helped"].mean()),
            }  # fmt: skip


@click.command()
@click.option("--pools", type=click.IntRange(2), default=2, show_default=True)
@click.option("--people", type=click.IntRange(1), default=3, show_default=True, help="In a pool.")
@click.option("--instance", default="kitting/paper", show_default=True)
@click.option("--of", "folder", type=click.Path(file_okay=False, path_type=Path), help="Results to read.")
@record_option
def main(pools: int, people: int, instance: str, folder: Path | None, record: Path | None) -> None:
    """Measure what rules of influence, and beliefs about them, change."""
    with tempfile.TemporaryDirectory() as made:
        if folder is None:
            folder = Path(made) / "study"
            if failed := run_study(reduced(pools, people, instance), folder):
                raise SystemExit(f"{failed[0][0]}: {failed[0][1]}")
        rows = list(rows_of(folder))
        repeats = json.loads((folder / "study.json").read_text(encoding="utf-8"))["study"]["repeats"]
    for row in rows:
        click.echo("  ".join(show(row) for show in SHOWN.values()))
    write_record(record, SHOWN, rows, pools=repeats)


if __name__ == "__main__":
    main()
