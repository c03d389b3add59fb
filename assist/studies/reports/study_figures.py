"""The figures of a study's report, and the data of each figure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from ...drawing.plots import study as draw
from ...drawing.plots.belief import belief_figure
from ...drawing.plots.panels_by_name import MEASURES as SHOWN
from ...drawing.plots.trade_off import trade_off_figure
from ..cells import policy_of, pool_of
from ..study import Cell, Condition, Study
from .report_files import ReportFigure
from .study_summary import MEASURES, Found, average, rows_of
from .wording import Record, named

if TYPE_CHECKING:
    import pandas as pd


def pictures(found: Found, summary: Record) -> Iterator[ReportFigure]:
    """Yield the figures for which the study has data."""
    import pandas as pd

    study, whose = found.study, of_whom(found)
    reference = study.reference
    published = {named(key): value for key, value in reference.headline.items()} if reference else {}
    source = f"{study.focus} in {reference.name}" if reference else ""

    cells = pd.DataFrame(_measured(cell for cell in summary["cells"] if found.main.items() <= cell.items()))
    text = f"Human actions and interventions against the number of people{whose}"
    yield ReportFigure("team-size", text, partial(draw.team_size_figure, cells))

    benefit = pd.DataFrame(
        {**row, "comparison": f"{row['measure']} against {row['against']}"}
        for row in summary["comparisons"]
        if row["humans"] is not None and row["policy"] == study.focus
    )
    if len(benefit) and len(set(benefit["humans"])) > 1:
        text = f"Savings of {study.focus} against the number of people{whose}"
        yield ReportFigure("benefit", text, partial(draw.benefit_figure, benefit, published, source))

    condition = of_kinds(study)
    if condition is not None:
        kinds = pd.DataFrame(_kinds(found, condition))
        marks = [
            (one.populations, one.mean)
            for one in (reference.interventions if reference else ())
            if {*one.populations} <= {*condition.populations}
        ]
        figure = partial(draw.category_figure, kinds, condition.populations, marks, source)
        yield ReportFigure("categories", "Actions and interventions for each kind of people", figure)

    points = pd.DataFrame(_points(found))
    if len(points) and len(points[["c_suggest", "c_move"]].drop_duplicates()) > 1:
        name = reference.name if reference else ""
        figure = partial(trade_off_figure, points, published, name)
        yield ReportFigure("trade-off", f"Actions against interventions for different costs{whose}", figure)

    beliefs, episode = _one_episode(found)
    if len(beliefs):  # nobody acts where the goal holds at the start
        text = f"The robot's belief over the course of one episode{whose}"
        yield ReportFigure("belief", text, partial(belief_figure, beliefs, episode))


def of_kinds(study: Study) -> Condition | None:
    """Return the first condition with several populations. Its first setting and prior are shown."""
    return next((condition for condition in study.conditions if len(condition.populations) > 1), None)


def of_whom(found: Found) -> str:
    """Return the population, setting and prior of the main figures, as far as the first condition has several."""
    first = found.study.conditions[0]
    several = {
        "population": first.populations, "setting": first.settings, "prior": first.priors,
    }  # fmt: skip
    shown = {name: found.main[name] or "default" for name, values in several.items() if len(values) > 1}
    parts = [f"{name} '{value}'" for name, value in shown.items()]
    return f" ({', '.join(parts)})" if parts else ""


def _measured(cells: Iterable[Record]) -> Iterator[Record]:
    """Yield a row for each measure of each cell."""
    for cell in cells:
        for name in SHOWN:
            yield {**cell, "measure": name, **cell[MEASURES[name]]}


def _kinds(found: Found, condition: Condition) -> Iterator[Record]:
    """Yield the actions and interventions of each population, averaged over all team sizes."""
    arms = found.arms(condition=condition.name, setting=condition.settings[0][0], prior=condition.priors[0])
    for arm, own in arms:
        for policy in dict.fromkeys(own["policy"]):
            for measure in SHOWN:
                values = own[own["policy"] == policy].groupby("repeat")[measure].mean()
                estimate = average(own, measure, policy)
                yield {
                    "instance": arm["instance"], "policy": policy, "category": arm["population"],
                    "measure": measure, "sd": float(values.std()), "n": len(values),
                    "mean": estimate.value, "low": estimate.low, "high": estimate.high,
                }  # fmt: skip


def _points(found: Found) -> Iterator[Record]:
    """Yield actions and interventions of the arms that differ from the main one in costs only, on common pools."""
    study = found.study
    main = dict(study.conditions[0].settings)[found.main["setting"]]
    arms = []
    for arm, own in found.arms(population=found.main["population"], prior=found.main["prior"]):
        setting = dict(study.condition(arm["condition"]).settings)[arm["setting"]]
        if replace(setting, c_suggest=main.c_suggest, c_move=main.c_move) == main:
            arms.append((arm, setting, own))
    common = set.intersection(*(set(own["repeat"]) for _, _, own in arms))
    for arm, setting, own in arms:
        pools = own[own["repeat"].isin(common)]
        for policy in dict.fromkeys(own["policy"]):
            row: Record = {
                "instance": arm["instance"], "policy": policy, "c_suggest": setting.c_suggest, "c_move": setting.c_move,
            }  # fmt: skip
            for measure in SHOWN:
                estimate = average(pools, measure, policy)
                row |= {measure: estimate.value, f"{measure}_low": estimate.low, f"{measure}_high": estimate.high}
            yield row


def watched(study: Study) -> tuple[str, int]:
    """Return the instance and the team size of the episode in the last figure."""
    condition = study.conditions[0]
    return condition.instances[0], min(condition.humans, key=lambda k: abs(k - 3))  # panels that fit a page


def _one_episode(found: Found) -> tuple[pd.DataFrame, Any]:
    """Return the robot's beliefs in the episode of `watched` with the most interventions in the first pool."""
    import pandas as pd

    from ...team.belief_trace import beliefs_of_episode

    study = found.study
    instance, humans = watched(study)
    wanted = {**found.main, "instance": instance, "policy": study.focus, "humans": humans}
    own = rows_of(found.episodes, wanted)
    row = own[own["repeat"] == 0].sort_values("interventions", ascending=False, kind="stable").iloc[0]
    cell = Cell(**found.main, instance=instance, repeat=0)
    pool = pool_of(study, cell)
    number = int(row["draw"]) * study.trials + int(row["trial"])
    team = study.teams(0, humans)[number]
    episode, beliefs = beliefs_of_episode(
        pool, policy_of(study, study.focus, pool), humans=team.tolist(), episode=number, seed=study.seed_of(0),
        name=study.focus,
    )  # fmt: skip
    return pd.DataFrame(beliefs), episode
