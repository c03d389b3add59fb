"""The report of a simulation study.

`report.md` and `report.html` have the same content; the numbers are those of `summary.json`. Claims of a reference are
treated in `assist.reports.study_claims`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from planner.system.files import atomic, remove_unfinished
from planner.system.workers import outcomes

from ..person.suggestion_threshold import SuggestionThreshold
from ..plots import style
from ..study.runner import load_study, without_suggestions
from ..study.study import OWN, Study
from . import study_claims
from . import study_claims as claims
from .html_page import html_page, require_packages
from .statistics import FEW
from .study_figures import ReportFigure, of_kinds, of_whom, pictures
from .study_summary import ARM, BASELINES, MEASURES, Found, average
from .wording import Record, beside, interval, named, sign, table, varying, with_deviation

FIGURES = "figures"
COLUMNS = {"population": "people", "setting": "setting", "prior": "robot's prior"}


def require() -> None:
    """Check that reports can be written.

    Raises
    ------
    MissingExtraError
        pandas, Jinja2, Markdown or matplotlib is not installed.
    """
    style.require()
    require_packages("pandas", "jinja2", "markdown")


@dataclass(frozen=True)
class Report:
    """A report that is ready to be written.

    Attributes
    ----------
    summary : dict
        All numbers.
    text : str
        The report in Markdown.
    pictures : tuple of ReportFigure
        Figures, not drawn yet.
    """

    summary: Record
    text: str
    pictures: tuple[ReportFigure, ...]

    @classmethod
    def of(cls, study: Study, folder: str | Path) -> Report:
        """Build the report of a study's results."""
        found = Found(study, load_study(Path(folder)), without_suggestions(folder))
        summary = found.summary()
        shown = tuple(pictures(found, summary))
        text = "\n\n".join(_sections(found, summary, {each.name: each.text for each in shown})) + "\n"
        return cls(summary, text, shown)

    def page(self, title: str) -> str:
        """Return the report as an HTML page, with figures for light and dark backgrounds."""
        return html_page(title, self.text, dark=True)


def write_report(study: Study, folder: str | Path, *, jobs: int = 1) -> Record:
    """Write `summary.json`, the figures, `report.md` and `report.html` to a study's folder; return the summary.

    Parameters
    ----------
    study : Study
    folder : path
        Folder of the results.
    jobs : int
        Number of processes that draw figures.
    """
    folder = Path(folder)
    report = Report.of(study, folder)
    _draw_all(report.pictures, folder / FIGURES, jobs)
    for name, text in {
        "summary.json": json.dumps(report.summary, indent=1) + "\n",
        "report.md": report.text,
        "report.html": report.page(study.title),
    }.items():
        with atomic(folder / name) as path:
            path.write_text(text, encoding="utf-8")
    return report.summary


def _draw_all(pictures: Sequence[ReportFigure], folder: Path, jobs: int) -> None:
    if jobs == 1:  # starting a process takes longer than drawing a figure
        for picture in pictures:
            _draw(picture, folder)
        return
    try:
        with closing(outcomes(_draw, pictures, (folder,), jobs=jobs)) as drawn:
            for _, outcome in drawn:
                if isinstance(outcome, Exception):
                    raise outcome
    finally:
        remove_unfinished([folder])  # files of stopped processes


def _draw(picture: ReportFigure, folder: Path) -> None:
    style.save_for_pages(picture.figure, folder, picture.name)


def _sections(found: Found, summary: Record, shown: dict[str, str]) -> Iterator[str]:
    """Yield the sections of the report; `shown` has the description of each available figure."""
    study = found.study

    def picture(name: str) -> Iterator[str]:
        if name in shown:
            yield f"![{shown[name]}]({FIGURES}/{name}.png)"

    yield f"# {study.title}"
    yield from _what_was_run(study, summary)
    yield from _headline(study, summary)
    yield from (f"**Note.** {line}." for line in threshold_notes(summary))
    yield from study_claims.claims(study, summary)
    yield from _team_sizes(found, summary)
    yield from picture("team-size")
    yield from _decline(study, summary)
    yield from picture("benefit")
    yield from _kinds_of_people(found, summary, picture("categories"))
    yield from study_claims.readings(study, summary)
    yield from _sensitivity(found, summary)
    yield from picture("trade-off")
    yield "## One episode"
    yield (
        "The robot's belief about each person's expertise and influence, before each step. It is the episode with the "
        f"most interventions of the first pool{of_whom(found)}."
    )
    yield from picture("belief")


def _what_was_run(study: Study, summary: Record) -> Iterator[str]:
    yield "## What was run"
    yield (
        f"{study.repeats} pools of {study.pool} people; from each, for each team size, {study.draws} teams in "
        f"{study.trials} episodes each, under every policy with the same people and random numbers. Seed {study.seed}, "
        f"fingerprint {summary['fingerprint'][:12]}. Brackets contain 95 % intervals over pools: Student's t for "
        "means, the bias-corrected and accelerated bootstrap for savings and ratios."
    )
    yield "Setting, unless a condition differs: " + ", ".join(
        f"{name} {value}"
        for name, value in study.conditions[0].settings[0][1].as_dict().items()
        if name not in ("execute", "c_execute")
    ) + "."  # fmt: skip
    pools = [min(study.repeats, c.repeats or study.repeats) for c in study.conditions]
    yield table(
        ["condition", "populations", "settings", "robot's prior", "policies", "K", "pools"],
        (
            [
                c.name, "; ".join(c.populations), "; ".join(label or "as above" for label, _ in c.settings),
                "; ".join("its population" if p == OWN else p for p in c.priors), ", ".join(c.policies),
                ", ".join(map(str, c.humans)), number,
            ]
            for c, number in zip(study.conditions, pools, strict=True)
        ),
    )  # fmt: skip
    yield "Instances: " + ", ".join(f"{label} (`{i.problem.name}`)" for label, i in study.instances) + "."
    few = [c.name for c, number in zip(study.conditions, pools, strict=True) if number < FEW]
    if few:
        which = "All conditions" if len(few) == len(pools) else ", ".join(f"*{name}*" for name in few)
        yield (
            f"**Few pools.** {which}: fewer than {FEW} pools, so results are preliminary. A single pool gives no "
            "intervals. With two to nine pools, intervals of savings and ratios are Student's t with the jackknife "
            "standard error; they are wide and still cover somewhat less than 95 %."
        )


def _headline(study: Study, summary: Record) -> Iterator[str]:
    yield "## Headline"
    headline, reference = summary["headline"], study.reference
    groups = [headline, *headline["others"]]
    columns = varying(groups, COLUMNS)
    if columns:
        yield "The first condition has " + " and ".join(
            f"{len({group[column] for group in groups})} {'populations' if column == 'population' else f'{column}s'}"
            for column in columns
        ) + ", each with figures of its own."  # fmt: skip
    published = dict(reference.headline) if reference else {}
    rows = []
    for group in groups:
        together = [("together", group)] if len(group["instances"]) > 1 else []
        keys = [key for key, value in group.items() if isinstance(value, dict) and key != "instances"]
        for key in keys:
            for label, found in (*group["instances"].items(), *together):
                if key in found:
                    row: list[object] = [named(key), *_which(group, columns), label]
                    row.append(interval(found[key]))
                    # Published figures refer to the first group.
                    if key in published and group is headline:
                        row += [published[key], beside(found[key], published[key])]
                    elif published:
                        row += ["", ""]
                    rows.append(row)
    head = [f"{headline['policy']} saves, %", *_titles(columns), "instance", "here"]
    yield table(head + ([reference.name, "comparison"] if reference and published else []), rows)
    yield from _effects(study, summary)
    if reference:
        yield f"Figures of {reference.name}: {reference.source}."


def threshold_notes(summary: Record) -> Iterator[str]:
    """Yield a note for each policy that makes no suggestion. The threshold was determined on the first pool."""
    for row in summary["without_suggestions"]:
        where = ", ".join(row[name] for name in ARM if row[name] and row[name] != OWN)
        why = SuggestionThreshold(row["c_suggest"], row["worth_at"], row["searched"])
        yield f"{row['policy']} makes no suggestion ({where}): {why}"


def _titles(columns: Iterable[str]) -> list[str]:
    return [COLUMNS[column] for column in columns]


def headline(summary: Record) -> tuple[list[str], list[list[str]], str]:
    """Return the headline as a table (titles and rows), and the number of pools."""
    found = summary["headline"]
    groups = [found, *found["others"]]
    columns = varying(groups, COLUMNS)
    several = len(found["instances"]) > 1
    rows = []
    for group in groups:
        instances = [*group["instances"].values(), *([group] if several else [])]
        for key in dict.fromkeys(key for saved in group["instances"].values() for key in saved):
            cells = [interval(saved[key]) if key in saved else "-" for saved in instances]
            rows.append([named(key), *_which(group, columns), *cells])
    pools = f"{found['pools']} pools" if found["pools"] > 1 else "1 pool"
    few = f"; preliminary, since fewer than {FEW}" if found["pools"] < FEW else ""
    titles = [f"{found['policy']} saves, %", *_titles(columns), *found["instances"], *(["together"] if several else [])]
    return titles, rows, f"{pools} of people, 95 % intervals over pools{few}"


def _which(row: Record, columns: Iterable[str]) -> list[str]:
    """Return a row's labels in the given columns."""
    return [{"": "default", OWN: "its population"}.get(str(row[column]), str(row[column])) for column in columns]


def _effects(study: Study, summary: Record) -> Iterator[str]:
    effects = [
        row
        for row in summary["comparisons"]
        if row["condition"] == study.conditions[0].name and row["humans"] is None and row["policy"] == study.focus
    ]
    if effects:
        columns = varying(effects, COLUMNS)
        yield "Effect sizes (Cohen's d of the paired differences of pools), and the share of pools with a lower value:"
        yield table(
            [*_titles(columns), "instance", "measure", "against", "effect size", "pools with a lower value"],
            (
                [
                    *_which(r, columns), r["instance"], r["measure"], r["against"],
                    "-" if r["effect"] is None else f"{r['effect']:.2f}",
                    f"{100 * r['pools_better']:.0f} % of {r['pools']}",
                ]
                for r in effects
            ),
        )  # fmt: skip


def _team_sizes(found: Found, summary: Record) -> Iterator[str]:
    yield "## Team sizes"
    yield (
        "Mean ± standard deviation over episodes, with the interval of the mean over pools. Numbers of actions have a "
        "heavy tail, since people can be caught in a trap. The median is therefore given too, and the last column "
        "counts episodes in which a person had not finished at the step limit."
    )
    cells = [cell for cell in summary["cells"] if cell["condition"] == found.main["condition"]]
    columns = varying(cells, COLUMNS)
    cells.sort(key=lambda cell: (*(cell[column] for column in columns), cell["instance"], cell["humans"]))
    rows = []
    for cell in cells:
        actions, interventions, moves = (cell[column] for column in MEASURES.values())
        rows.append(
            [
                *_which(cell, columns), cell["instance"], cell["humans"], cell["policy"],
                with_deviation(actions), f"{actions['median']:.1f}", with_deviation(interventions),
                with_deviation(moves), f"{cell['cut_off']} of {cell['episodes']}",
            ]
        )  # fmt: skip
    head = ["instance", "K", "policy", "human actions per person", "median", "interventions", "moves", "cut off"]
    yield table([*_titles(columns), *head], rows)


def _decline(study: Study, summary: Record) -> Iterator[str]:
    rows = summary["decline"]
    if not rows:
        return
    first, last = rows[0]["humans"]
    yield "## Does the benefit decline with the number of people?"
    yield (
        f"The saving of {study.focus} with K = {first} minus that with K = {last}, in percentage points. It declines "
        "if the whole interval is above 0. Against no assistance, the baseline is the mean over all K, since the "
        "size of the team makes no difference without assistance."
    )
    columns = varying(rows, COLUMNS)
    yield table(
        [*_titles(columns), "instance", "measure", "against", "decline, percentage points", "declines"],
        ([*_which(r, columns), r["instance"], r["measure"], r["against"], interval(r), sign(r)] for r in rows),
    )


def _kinds_of_people(found: Found, summary: Record, picture: Iterator[str]) -> Iterator[str]:
    condition = of_kinds(found.study)
    if condition is None:
        return
    yield "## Kinds of people"
    which = {"condition": condition.name, "setting": condition.settings[0][0], "prior": condition.priors[0]}
    rows = []
    for arm, own in found.arms(**which):
        largest = own[own["humans"] == own["humans"].max()]
        for policy in dict.fromkeys(own["policy"]):
            values = [average(own, "actions", policy), average(own, "interventions", policy)]
            values.append(average(largest, "interventions", policy))
            rows.append([arm["instance"], arm["population"], policy, *(interval(v.record()) for v in values)])
    yield (
        f"Condition *{condition.name}*, over all team sizes unless K is given. Interventions are per episode of a team "
        "whose members are of the same kind."
    )
    most = f"interventions, K = {max(condition.humans)}"
    yield table(["instance", "people", "policy", "actions per person", "interventions", most], rows)
    yield from picture
    main = [c for c in summary["contrasts"] if which.items() <= c.items()]
    if main:
        yield "Ratios of interventions between kinds:"
        yield table(
            ["instance", "contrast", "policy", "ratio of interventions", "above 1"],
            ([c["instance"], c["contrast"], c["policy"], interval(c), sign(c, 1.0)] for c in main),
        )
    others = [c for c in summary["contrasts"] if not which.items() <= c.items()]
    if others:
        yield "The same under other conditions:"
        yield table(
            ["condition", "instance", "setting", "robot's prior", "contrast", "policy", "ratio", "above 1"],
            (
                [
                    c["condition"], c["instance"], c["setting"] or "default", study_claims.prior(c["prior"]),
                    c["contrast"], c["policy"], interval(c), sign(c, 1.0),
                ]
                for c in others
            ),
        )  # fmt: skip


def _sensitivity(found: Found, summary: Record) -> Iterator[str]:
    """Yield the savings under all conditions, except for kinds of people, which are compared elsewhere."""
    kinds = {name for c in found.study.conditions if len(c.populations) > 1 for name in c.populations}
    rows = [
        row
        for row in summary["comparisons"]
        if row["humans"] is None and row["policy"] not in BASELINES
        and (row["population"] == found.main["population"] or row["population"] not in kinds)
    ]  # fmt: skip
    if len({tuple(row[name] for name in (*ARM, "policy") if name != "instance") for row in rows}) < 2:
        return
    yield "## Sensitivity"
    yield (
        "Savings in percent over all team sizes for different conditions, with the same people and random numbers. "
        "Conditions with fewer pools have wider intervals."
    )
    grouped: dict[tuple[str, ...], dict[str, str]] = {}
    for r in rows:
        people = "" if r["population"] == found.main["population"] else r["population"]
        taken = "" if r["prior"] == found.main["prior"] else f"prior {claims.prior(r['prior'])}"
        what = ", ".join(part for part in (r["setting"], people, taken) if part)
        key = (what or "default", r["policy"], r["instance"], str(r["pools"]))
        grouped.setdefault(key, {})[f"{r['measure']} against {r['against']}"] = interval(r)
    columns = list(dict.fromkeys(name for cells in grouped.values() for name in cells))
    yield table(
        ["variation", "policy", "instance", "pools", *columns],
        ([*key, *(cells.get(name, "-") for name in columns)] for key, cells in grouped.items()),
    )
