"""The report of a study: what was run, what was found, and what of the reference's claims holds.

`report.md` and `report.html` say the same; the numbers are those of `summary.json`.
"""

from __future__ import annotations

import html
import importlib.util
import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planner.errors import MissingExtraError
from planner.storage import atomic
from planner.workers import outcomes

from ..plots import episode as figures
from .runner import PROFILE, load_study
from .study import OWN, Cell, Study
from .summary import BASELINES, MEASURES, Found, average

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

FIGURES = "figures"
SHOWN_READINGS = 8
SHOWN_PEOPLE = 3  # in the picture of an episode

Record = dict[str, Any]


def require() -> None:
    """Check that reports can be written.

    Raises
    ------
    MissingExtraError
        pandas, Markdown or matplotlib is not installed.
    """
    figures.require()
    for package in ("pandas", "markdown"):
        if importlib.util.find_spec(package) is None:
            raise MissingExtraError(f"reports need {package}: pip install 'kitassist[study]'")


@dataclass(frozen=True)
class Picture:
    """A picture of the report: its file's name, what it shows, and what draws it."""

    name: str
    text: str
    figure: Callable[[], Figure]


def write_report(study: Study, folder: Path, *, jobs: int = 1) -> Record:
    """Write `summary.json`, the pictures, `report.md` and `report.html` beside a study's results; give the summary.

    With several `jobs` pictures are drawn in as many processes.
    """
    import markdown

    found = Found(study, load_study(folder))
    summary = found.summary()
    with atomic(folder / "summary.json") as path:
        path.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    pictures = list(_pictures(found, summary))
    _draw_all(pictures, folder / FIGURES, jobs)
    text = "\n\n".join(_sections(found, summary, {each.name: each.text for each in pictures})) + "\n"
    with atomic(folder / "report.md") as path:
        path.write_text(text, encoding="utf-8")
    body = PICTURE.sub(_picture, markdown.markdown(text, extensions=["tables"]))
    with atomic(folder / "report.html") as path:
        path.write_text(PAGE.format(title=html.escape(study.title), body=body), encoding="utf-8")
    return summary


PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<meta name="color-scheme" content="light dark">
<title>{title}</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }}
table {{ border-collapse: collapse; font-size: 0.85rem; display: block; overflow-x: auto; }}
th, td {{ padding: 0.2rem 0.7rem; border-bottom: 1px solid #8886; text-align: left; }}
img {{ max-width: 100%; }}
</style>
{body}
</html>
"""


PICTURE = re.compile(r'<img alt="([^"]*)" src="([^"]*)\.png" />')


def _picture(found: re.Match[str]) -> str:
    """Show each picture as it is made for the page's background."""
    text, name = found.groups()
    dark = f'<source srcset="{name}-dark.svg" media="(prefers-color-scheme: dark)">'
    return f'<picture>{dark}<img alt="{text}" src="{name}.svg"></picture>'


def _draw_all(pictures: Sequence[Picture], folder: Path, jobs: int) -> None:
    if jobs == 1:  # another process takes longer to start than a picture to draw
        for picture in pictures:
            _draw(picture, folder)
        return
    for _, outcome in outcomes(_draw, pictures, (folder,), jobs=jobs):
        if isinstance(outcome, Exception):
            raise outcome


def _draw(picture: Picture, folder: Path) -> None:
    from ..plots import study as study_figures

    study_figures.save(picture.figure, folder, picture.name)


def _pictures(found: Found, summary: Record) -> Iterator[Picture]:
    """Give the pictures for which the study has data."""
    import pandas as pd

    from ..plots import study as draw

    study = found.study
    cells = pd.DataFrame(_measured(cell for cell in summary["cells"] if found.main.items() <= cell.items()))
    yield Picture(
        "team-size",
        "Human actions and interventions against the number of people",
        partial(draw.team_size_figure, cells),
    )
    benefit = pd.DataFrame(
        {**row, "comparison": f"{row['measure']} against {row['against']}"}
        for row in summary["comparisons"]
        if row["humans"] is not None and row["policy"] == study.focus
    )
    if len(benefit) and len(set(benefit["humans"])) > 1:
        text = f"What {study.focus} saves, against the number of people"
        yield Picture("benefit", text, partial(draw.benefit_figure, benefit))
    categories = pd.DataFrame(_categories(found))
    if len(categories):
        text = "Interventions and actions of kinds of people"
        yield Picture("categories", text, partial(draw.category_figure, categories))
    points = pd.DataFrame(_points(found))
    if len(points) and len(points[["c_suggest", "c_move"]].drop_duplicates()) > 1:
        paper = draw.PAPER_SAVINGS if study.reference and study.reference.headline else None
        text = "Actions against interventions as costs vary"
        yield Picture("trade-off", text, partial(draw.trade_off_figure, points, paper))
    text = "What the robot believes in the course of one episode"
    yield Picture("belief", text, partial(draw.belief_figure, *_one_episode(found)))


def _measured(cells: Iterable[Record]) -> Iterator[Record]:
    """Give a row for each measure of each cell."""
    for cell in cells:
        for name in ("actions", "interventions"):
            yield {**cell, "measure": name, **cell[MEASURES[name]]}


def _categories(found: Found) -> Iterator[Record]:
    """Give actions and interventions of each population, over all team sizes, where several are compared at first."""
    from ..plots.study import CATEGORIES

    condition = _of_categories(found.study)
    if condition is None:
        return
    named = {
        "condition": condition.name, "setting": condition.settings[0][0], "prior": condition.priors[0],
    }  # fmt: skip
    for arm, own in found.arms(**named):
        if arm["population"] not in CATEGORIES:
            continue
        for policy in dict.fromkeys(own["policy"]):
            for measure in ("actions", "interventions"):
                values = own[own["policy"] == policy].groupby("repeat")[measure].mean()
                estimate = average(own, measure, policy)
                yield {
                    "instance": arm["instance"], "policy": policy, "category": arm["population"],
                    "measure": measure, "sd": float(values.std()), "n": len(values),
                    "mean": estimate.value, "low": estimate.low, "high": estimate.high,
                }  # fmt: skip


def _of_categories(study: Study) -> Any:
    return next((condition for condition in study.conditions if len(condition.populations) > 1), None)


def _points(found: Found) -> Iterator[Record]:
    """Give actions and interventions wherever nothing but costs differs from the first condition, of common pools."""
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
            for measure in ("actions", "interventions"):
                estimate = average(pools, measure, policy)
                row |= {measure: estimate.value, f"{measure}_low": estimate.low, f"{measure}_high": estimate.high}
            yield row


def _one_episode(found: Found) -> tuple[pd.DataFrame, Any]:
    """Give what the robot believes in one episode of the first pool: the one with the most interventions."""
    import pandas as pd

    from ..simulation.belief_trace import beliefs_of_episode

    study, condition = found.study, found.study.conditions[0]
    humans = min(condition.humans, key=lambda k: abs(k - SHOWN_PEOPLE))
    instance = condition.instances[0]
    own = found.episodes
    for name, value in {**found.main, "instance": instance, "policy": study.focus, "humans": humans}.items():
        own = own[own[name] == value]
    row = own[own["repeat"] == 0].sort_values("interventions", ascending=False, kind="stable").iloc[0]
    cell = Cell(**found.main, instance=instance, repeat=0)
    pool = study.people(cell)
    number = int(row["draw"]) * study.trials + int(row["trial"])
    team = study.teams(0, humans)[number]
    episode, beliefs = beliefs_of_episode(
        pool, study.policy(study.focus, pool), humans=team.tolist(), episode=number, seed=study.luck(0),
        name=study.focus,
    )  # fmt: skip
    return pd.DataFrame(beliefs), episode


def _sections(found: Found, summary: Record, pictures: dict[str, str]) -> Iterator[str]:
    study = found.study
    yield f"# {study.title}"
    yield from _what_was_run(study, summary)
    yield from _headline(study, summary)
    yield from _claims(study, summary)
    yield from _team_sizes(found, summary)
    yield from _shown(pictures, "team-size")
    yield from _decline(study, summary)
    yield from _shown(pictures, "benefit")
    yield from _kinds_of_people(found, summary, pictures)
    yield from _readings(study, summary)
    yield from _sensitivity(found, summary)
    yield from _shown(pictures, "trade-off")
    yield "## One episode"
    yield (
        "The robot's belief about each person's expertise and influence, before each step. It is the episode with the "
        "most interventions of the first pool."
    )
    yield from _shown(pictures, "belief")


def _shown(pictures: dict[str, str], name: str) -> Iterator[str]:
    if name in pictures:
        yield f"![{pictures[name]}]({FIGURES}/{name}.png)"


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def _interval(estimate: Record, digits: int = 1) -> str:
    if estimate["mean"] is None:
        return "only these get any"
    text = f"{estimate['mean']:.{digits}f}"
    if estimate["low"] is None:
        return text
    return f"{text} ({estimate['low']:.{digits}f} to {estimate['high']:.{digits}f})"


def _what_was_run(study: Study, summary: Record) -> Iterator[str]:
    yield "## What was run"
    first = study.conditions[0]
    yield (
        f"{study.repeats} pools of {study.pool} people; from each, for each team size, {study.draws} teams in "
        f"{study.trials} episodes each, under every policy with the same people and the same luck. Seed {study.seed}, "
        f"fingerprint {summary['fingerprint'][:12]}. In brackets are 95 % intervals over pools: Student's t for means, "
        "the bias-corrected and accelerated bootstrap for savings and ratios."
    )
    taken = first.settings[0][1]
    yield "Setting, unless a condition says otherwise: " + ", ".join(
        f"{name} {value}" for name, value in asdict(taken).items() if name not in ("execute", "c_execute")
    ) + "."  # fmt: skip
    yield _table(
        ["condition", "populations", "settings", "robot's prior", "policies", "K", "pools"],
        (
            [
                c.name, "; ".join(c.populations), "; ".join(label or "as above" for label, _ in c.settings),
                "; ".join("its population" if p == OWN else p for p in c.priors), ", ".join(c.policies),
                ", ".join(map(str, c.humans)), min(study.repeats, c.repeats or study.repeats),
            ]
            for c in study.conditions
        ),
    )  # fmt: skip
    yield "Instances: " + ", ".join(f"{label} (`{i.problem.name}`)" for label, i in study.instances) + "."


def _headline(study: Study, summary: Record) -> Iterator[str]:
    yield "## Headline"
    headline = summary["headline"]
    keys = [key for key, value in headline.items() if isinstance(value, dict) and key != "instances"]
    together = [("together", headline)] if len(headline["instances"]) > 1 else []
    reference = dict(study.reference.headline) if study.reference else {}
    rows = []
    for key in keys:
        for label, found in (*headline["instances"].items(), *together):
            if key not in found:
                continue
            row: list[object] = [key.replace("_", " "), label, _interval(found[key])]
            if key in reference:
                row += [reference[key], _better(found[key], reference[key])]
            elif reference:
                row += ["", ""]
            rows.append(row)
    head = [f"{headline['policy']} saves, %", "instance", "here"]
    yield _table(head + (["paper", "here against the paper"] if reference else []), rows)
    effects = [
        row
        for row in summary["comparisons"]
        if row["condition"] == study.conditions[0].name and row["humans"] is None and row["policy"] == study.focus
    ]
    if effects:
        yield "Effect sizes (Cohen's d of the paired differences of pools), and in how many pools the sign is the same:"
        yield _table(
            ["instance", "measure", "against", "effect size", "pools in which it is less"],
            (
                [
                    r["instance"], r["measure"], r["against"], "-" if r["effect"] is None else f"{r['effect']:.2f}",
                    f"{100 * r['pools_better']:.0f} % of {r['pools']}",
                ]
                for r in effects
            ),
        )  # fmt: skip
    if study.reference:
        yield f"The paper's figures: {study.reference.source}."


def _better(estimate: Record, reference: float) -> str:
    if estimate["low"] is not None and estimate["low"] > reference:
        return "better, the whole interval"
    if estimate["high"] is not None and estimate["high"] < reference:
        return "worse, the whole interval"
    return "better, not the whole interval" if estimate["mean"] > reference else "worse, not the whole interval"


def _claims(study: Study, summary: Record) -> Iterator[str]:
    """Say which of the reference's claims hold, and under which readings of what it leaves open."""
    if study.reference is None:
        return
    yield "## Which of the paper's claims hold"
    rows = []
    for key, published in study.reference.headline:
        for instance, found in summary["headline"]["instances"].items():
            if key in found:
                verdict = {"yes": "holds", "not shown": "is not shown"}.get(_sign(found[key]), "does not hold")
                saved = f"saves {key.replace('_', ' ')} ({published:g} %)"
                rows.append([saved, instance, f"{verdict}; {_better(found[key], published)}", _interval(found[key])])
    for r in summary["decline"]:
        verdict = {"yes": "holds", "not shown": "is not shown"}.get(_sign(r), "the contrary holds")
        rows.append(
            [f"saves fewer {r['measure']} vs {r['against']} in large teams", r["instance"], verdict, _interval(r)]
        )
    yield _table([f"claim: {study.focus} ...", "instance", "verdict", "percent, or percentage points"], rows)
    for contrast in study.contrasts:
        readings: dict[str, list[str]] = {"yes": [], "not shown": [], "no, the contrary": []}
        for c in summary["contrasts"]:
            if c["contrast"] == contrast.name and c["policy"] not in BASELINES:
                name = ", ".join([c["instance"], c["policy"], c["setting"] or "default", f"prior {_prior(c['prior'])}"])
                if name not in readings[_sign(c, 1.0)]:
                    readings[_sign(c, 1.0)].append(name)
        if any(readings.values()):
            more, fewer = (" and ".join(f"*{name}*" for name in side) for side in (contrast.of, contrast.to))
            yield (
                f"More interventions for {more} than for {fewer}: shown under "
                f"{len(readings['yes'])} readings, undecided under {len(readings['not shown'])}, the contrary under "
                f"{len(readings['no, the contrary'])}. Shown under: {'; '.join(readings['yes']) or 'none'}."
            )


def _team_sizes(found: Found, summary: Record) -> Iterator[str]:
    yield "## Team sizes"
    yield (
        "Mean ± standard deviation over episodes, with the interval of the mean over pools. The actions of people who "
        "are caught in a trap have a heavy tail: the median stands beside the mean, and the last column counts "
        "episodes in which somebody had not finished at the step limit."
    )
    rows = []
    for cell in summary["cells"]:
        if not found.main.items() <= cell.items():
            continue
        actions, interventions, moves = (cell[column] for column in MEASURES.values())
        rows.append(
            [
                cell["instance"], cell["humans"], cell["policy"], _with_sd(actions), f"{actions['median']:.1f}",
                _with_sd(interventions), _with_sd(moves), f"{cell['cut_off']} of {cell['episodes']}",
            ]
        )  # fmt: skip
    head = ["instance", "K", "policy", "human actions per person", "median", "interventions", "moves", "cut off"]
    yield _table(head, sorted(rows, key=lambda row: (row[0], row[1])))


def _with_sd(cell: Record) -> str:
    if cell["sd"] is None:
        return f"{cell['mean']:.1f}"
    ends = "" if cell["low"] is None else f" ({cell['low']:.1f} to {cell['high']:.1f})"
    return f"{cell['mean']:.1f} ± {cell['sd']:.1f}{ends}"


def _decline(study: Study, summary: Record) -> Iterator[str]:
    if not summary["decline"]:
        return
    first, last = summary["decline"][0]["humans"]
    yield "## Does the benefit decline with the number of people?"
    yield (
        f"By how many percentage points {study.focus} saves less with K = {last} than with K = {first}; it declines "
        "where the whole interval is above 0. Against no assistance the baseline is that of all K together: to "
        "those whom nobody helps it makes no difference how many others there are."
    )
    yield _table(
        ["instance", "measure", "against", "percentage points less", "declines"],
        ([r["instance"], r["measure"], r["against"], _interval(r), _sign(r)] for r in summary["decline"]),
    )


def _sign(estimate: Record, at: float = 0.0) -> str:
    if estimate["mean"] is None:
        return "yes"
    if estimate["low"] is not None and estimate["low"] > at:
        return "yes"
    if estimate["high"] is not None and estimate["high"] < at:
        return "no, the contrary"
    return "not shown"


def _kinds_of_people(found: Found, summary: Record, pictures: dict[str, str]) -> Iterator[str]:
    condition = _of_categories(found.study)
    if condition is None:
        return
    yield "## Kinds of people"
    named = {"condition": condition.name, "setting": condition.settings[0][0], "prior": condition.priors[0]}
    rows = []
    for arm, own in found.arms(**named):
        largest = own[own["humans"] == own["humans"].max()]
        for policy in dict.fromkeys(own["policy"]):
            values = [average(own, "actions", policy), average(own, "interventions", policy)]
            values.append(average(largest, "interventions", policy))
            rows.append([arm["instance"], arm["population"], policy, *(_interval(v.record()) for v in values)])
    yield (
        "Over all team sizes unless K is named. Interventions are per episode of a team whose members are all of "
        "one kind."
    )
    head = [
        "instance",
        "people",
        "policy",
        "actions per person",
        "interventions",
        f"interventions, K = {max(condition.humans)}",
    ]
    yield _table(head, rows)
    yield from _shown(pictures, "categories")
    main = [c for c in summary["contrasts"] if named.items() <= c.items()]
    if main:
        yield "How many times the interventions of one kind another gets:"
        yield _table(
            ["instance", "contrast", "policy", "ratio of interventions", "more than 1"],
            ([c["instance"], c["contrast"], c["policy"], _interval(c), _sign(c, 1.0)] for c in main),
        )
    others = [c for c in summary["contrasts"] if not named.items() <= c.items()]
    if others:
        yield "The same under the other readings:"
        yield _table(
            ["instance", "setting", "robot's prior", "contrast", "policy", "ratio", "more than 1"],
            (
                [
                    c["instance"], c["setting"] or "default", _prior(c["prior"]), c["contrast"], c["policy"],
                    _interval(c), _sign(c, 1.0),
                ]
                for c in others
            ),
        )  # fmt: skip


def _prior(name: str) -> str:
    return "the kind itself" if name == OWN else name


def _readings(study: Study, summary: Record) -> Iterator[str]:
    readings = summary["readings"]
    if not readings or study.reference is None:
        return
    yield "## Which reading comes nearest to the paper's interventions"
    targets = study.reference.interventions
    yield (
        f"{study.reference.source} says that "
        + "; ".join(f"{' and '.join(f'*{name}*' for name in names)} got {mean:g}" for names, mean in targets)
        + f". How these are counted, and several parts of the model, it leaves open. Of {len(readings)} readings these "
        f"{min(SHOWN_READINGS, len(readings))} come nearest (all are in `summary.json`); *off* is by how "
        "many interventions the means miss the paper's, on average. Nothing was tuned to them."
    )
    head = [
        "Algorithm 1",
        "setting",
        "robot's prior",
        "instance",
        "counted",
        *(f"paper {m:g}" for _, m in targets),
        "off",
    ]

    def row(r: Record) -> list[object]:
        reading = "doing nothing once" if r["policy"] == "attention" else "never helping again"
        if r["policy"] not in ("attention", "attention-never"):
            reading = r["policy"]
        return [
            reading, r["setting"] or "default", _prior(r["prior"]), r["instance"], r["counted"],
            *(_interval(estimate) for estimate in r["interventions"]), f"{r['off']:.1f}",
        ]  # fmt: skip

    yield _table(head, map(row, readings[:SHOWN_READINGS]))
    default = [r for r in readings if r["setting"] == "" and r["policy"] == study.focus and r["prior"] != OWN]
    if default:
        yield "With the default costs and unit of trust, and a prior of everybody:"
        yield _table(head, map(row, default))


def _sensitivity(found: Found, summary: Record) -> Iterator[str]:
    study = found.study
    rows = [
        row
        for row in summary["comparisons"]
        if row["humans"] is None and row["policy"] not in BASELINES and _is_of_everybody(study, row["population"])
    ]
    arms = {(r["condition"], r["setting"], r["prior"], r["population"], r["policy"]) for r in rows}
    if len(arms) < 2:
        return
    yield "## Sensitivity"
    yield (
        "What is saved, in percent, over all team sizes, as what the paper leaves open is varied, on the same people "
        "with the same luck. A condition of fewer pools has wider intervals."
    )
    table: dict[tuple[str, ...], dict[str, str]] = {}
    for r in rows:
        people = "" if r["population"] == found.main["population"] else r["population"]
        what = ", ".join(part for part in (r["setting"], people) if part)
        key = (what or "default", r["policy"], r["instance"], str(r["pools"]))
        table.setdefault(key, {})[f"{r['measure']} against {r['against']}"] = _interval(r)
    columns = list(dict.fromkeys(name for cells in table.values() for name in cells))
    yield _table(
        ["what", "policy", "instance", "pools", *columns],
        ([*key, *(cells.get(name, "-") for name in columns)] for key, cells in table.items()),
    )


def _is_of_everybody(study: Study, population: str) -> bool:
    """Whether a population is no kind of people: those that are compared with each other are reported elsewhere."""
    kinds = {name for c in study.conditions if len(c.populations) > 1 for name in c.populations}
    return population not in kinds


def profile(folder: Path) -> dict[str, float]:
    """Give how many seconds of the workers each part of a study took, the longest first."""
    from planner.storage import read_records

    spent: dict[str, float] = {}
    for record in read_records(folder / PROFILE):
        for what, seconds in record["seconds"].items():
            spent[what] = spent.get(what, 0.0) + seconds
    return dict(sorted(spent.items(), key=lambda item: -item[1]))
