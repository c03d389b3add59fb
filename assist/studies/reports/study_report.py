"""The report of a simulation study.

`report.md` and `report.html` have the same content; the numbers are those of `summary.json`. Claims of a reference are
treated in `assist.studies.reports.study_claims`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from pathlib import Path

from planner.system.results import Result, markdown_table

from ...declare.declared import plain, sentences
from ..protocol import study_of
from ..runner import load_study
from ..statistics import FEW
from ..study import OWN, Study, StudyPlan
from . import report_files, study_claims
from .report_files import ReportFigure, draw_all, html_page, rendered, write_files
from .study_figures import of_kinds, of_whom, pictures, watched
from .study_summary import ARM, MEASURES, Found, average
from .wording import Record, beside, interval, named, number, prior, sign, varying, with_deviation

COLUMNS = {"population": "people", "setting": "setting", "prior": "robot's prior"}


require = partial(report_files.require, "pandas", "jinja2", "markdown")


@dataclass(frozen=True, eq=False, repr=False)
class Report(Result):
    """The report of a simulation study.

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

    def __repr__(self) -> str:
        cells = self.summary["cells"]
        episodes = sum(cell["episodes"] for cell in cells)
        return f"<Report of {self.summary['title']}: {len(cells)} cells, {episodes:,} episodes>"

    def __eq__(self, other: object) -> bool:
        """Whether both have the same numbers and text."""
        return isinstance(other, Report) and self.summary == other.summary and self.text == other.text

    def records(self) -> list[Record]:
        """Return a row for each arm, team size and policy: the mean of each measure, and the ends of its interval."""
        return [
            {
                column: value
                for name, content in cell.items()
                for column, value in (
                    {name: content["mean"], f"{name}_low": content["low"], f"{name}_high": content["high"]}
                    if isinstance(content, dict) else {name: content}
                ).items()
            }
            for cell in self.summary["cells"]
        ]  # fmt: skip

    @classmethod
    def of(cls, study: Study | str | Path, folder: str | Path) -> Report:
        """Build the report of a study's results; the study may be given by its file or shipped name."""
        study = study_of(study)
        found = Found(study, load_study(Path(folder)))
        summary = found.summary()
        shown = tuple(pictures(found, summary))
        text = report_text(found, summary, {each.name: each.text for each in shown})
        return cls(summary, text, shown)

    def page(self, title: str) -> str:
        """Return the report as an HTML page, with figures for light and dark backgrounds."""
        return html_page(title, self.text, dark=True)


def write_report(study: Study | str | Path, folder: str | Path, *, jobs: int = 1) -> Report:
    """Write `summary.json`, the figures, `report.md` and `report.html` to a study's folder; return the report.

    Parameters
    ----------
    study : Study, or str or Path
        A study, or its file or shipped name.
    folder : path
        Folder of the results.
    jobs : int
        Number of processes that draw figures.
    """
    folder, study = Path(folder), study_of(study)
    report = Report.of(study, folder)
    draw_all(report.pictures, folder, jobs=jobs)
    write_files(folder, report.summary, report.text, report.page(study.title))
    return report


def report_text(found: Found, summary: Record, pictures: dict[str, str]) -> str:
    """Return the report in Markdown; `pictures` has the description of each figure."""
    study = found.study
    groups = _groups(summary)
    return rendered(
        "study_report.md.jinja",
        study=study, plan=sentences(StudyPlan), setting=plain(study.default), summary=summary,
        pictures=pictures,
        FEW=FEW, OWN=OWN, whose=of_whom(found), episode=watched(study),
        people=dict(_people(study)), version=metadata.version("kitassist"),
        pools={c.name: min(study.repeats, c.repeats or study.repeats) for c in study.conditions},
        differing={name: len({group[name] for group in groups}) for name in varying(groups, COLUMNS)},
        headline=_headline(study, summary), effects=_effects(study, summary),
        notes=list(notes(summary)),
        claims=study_claims.claims(study, summary), contrasts=study_claims.contrasts(study, summary),
        team_sizes=_team_sizes(found, summary), decline=_decline(summary), kinds=_kinds_of_people(found, summary),
        readings=partial(study_claims.readings, study), sensitivity=_sensitivity(found, summary),
    )  # fmt: skip


def _people(study: Study) -> Iterator[tuple[str, str]]:
    """Yield each population with the ranges of its people's parameters."""
    for name, population in study.populations:
        found = plain(population)
        ranges = (f"{key} {found[key][0]:g} to {found[key][1]:g}" for key in ("beta", "theta", "sigma"))
        yield name, ", ".join(ranges)


def _groups(summary: Record) -> list[Record]:
    """Return the savings in the first condition: of the main group, and of other populations, settings and priors."""
    return [summary["headline"], *summary["headline"]["others"]]


def _headline(study: Study, summary: Record) -> str:
    """Return the table of savings, compared with the published ones."""
    reference, groups = study.reference, _groups(summary)
    columns = varying(groups, COLUMNS)
    published = reference.headline if reference else {}
    rows = []
    for group in groups:
        together = [("together", group)] if len(group["instances"]) > 1 else []
        keys = [key for key in group if "_vs_" in key]
        for key in keys:
            for label, found in (*group["instances"].items(), *together):
                if key in found:
                    row: list[object] = [named(key), *_which(group, columns), label, interval(found[key])]
                    # Published figures refer to the first group.
                    if key in published and group is groups[0]:
                        row += [published[key], beside(found[key], published[key])]
                    elif published:
                        row += ["", ""]
                    rows.append(row)
    head = [f"{summary['headline']['policy']} saves, %", *_titles(columns), "instance", "here"]
    return markdown_table(head + ([reference.name, "comparison"] if reference and published else []), rows)


def notes(summary: Record) -> Iterator[str]:
    """Yield what a reader of the headline should know: of episodes cut off, of little assistance, and of rare pools."""
    yield from _limit_notes(summary)
    yield from _cost_notes(summary)
    yield from _pool_notes(summary)


def _limit_notes(summary: Record) -> Iterator[str]:
    """Yield a note for each part of the headline in which episodes were cut off, with what can be compared then."""
    groups = _groups(summary)
    columns = varying(groups, COLUMNS)
    for group in groups:
        if group["cut_off"]:
            where = f" ({', '.join(_which(group, columns))})" if columns else ""
            finished = ", ".join(f"{policy} {interval(each, 2)}" for policy, each in group["finished"].items())
            yield (
                f"in {group['cut_off']:,} of {group['episodes']:,} episodes{where} somebody had not finished after "
                f"{group['max_steps']} steps, or could not any more: savings count until then, and their intervals say "
                f"nothing about a longer time; people who finished, %: {finished}"
            )


def _cost_notes(summary: Record) -> Iterator[str]:
    """Yield a note for each policy that weighs costs and hardly assists anybody."""
    for row in summary["seldom_assisted"]:
        yield (
            f"{row['policy']} suggests something to {row['assisted']:.0f} % of people ({_where(row)}): hardly any "
            f"suggestion is worth its cost (c_suggest {row['c_suggest']:g}); set a lower one in `[setting]`"
        )


def _pool_notes(summary: Record) -> Iterator[str]:
    """Yield a note for each condition with means that rest on few of many pools."""
    for condition in dict.fromkeys(row["condition"] for row in summary["uneven"]):
        rows = [row for row in summary["uneven"] if row["condition"] == condition]
        least = min(rows, key=lambda row: float(row["alike"]))
        weigh = f"{least['pools']} pools weigh as {least['alike']:.1f} alike ones"
        which = f"a mean of {condition}, that" if len(rows) == 1 else f"{len(rows)} means of {condition}, such as that"
        yield (
            f"few pools make up most of {which} of {least['policy']}'s {least['measure']} ({_where(least)}), where "
            f"{weigh}. Rare pools decide there, such as those with people in a trap. These results are preliminary: "
            "intervals are too narrow if the pools have fewer such people than there are"
        )


def _where(row: Record) -> str:
    return ", ".join(row[name] for name in ARM if row[name] and row[name] != OWN)


def headline(summary: Record) -> tuple[list[str], list[list[str]], str]:
    """Return the headline as a table (titles and rows), and the number of pools."""
    found, groups = summary["headline"], _groups(summary)
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


def _titles(columns: Iterable[str]) -> list[str]:
    return [COLUMNS[column] for column in columns]


def _which(row: Record, columns: Iterable[str]) -> list[str]:
    """Return a row's labels in the given columns."""
    return [{"": "default", OWN: "its population"}.get(str(row[column]), str(row[column])) for column in columns]


def _by_arm(head: list[str], rows: Sequence[Record], cells: Callable[[Record], list[object]]) -> str:
    """Return a table whose first columns are those of `COLUMNS` in which the rows differ; empty without rows."""
    columns = varying(rows, COLUMNS)
    lines = [[*_which(row, columns), row["instance"], *cells(row)] for row in rows]
    return markdown_table([*_titles(columns), "instance", *head], lines) if rows else ""


def _effects(study: Study, summary: Record) -> str:
    """Return the table of the focus's comparisons over all team sizes; with a baseline, of all policies."""
    rows = [
        row
        for row in summary["comparisons"]
        if row["condition"] == study.conditions[0].name and row["humans"] is None
        and (row["policy"] == study.focus or study.baseline is not None)
    ]  # fmt: skip
    of_all = study.baseline is not None
    return _by_arm(
        ["measure", "against", *["policy"] * of_all, "saves, %", "effect size", "pools with a lower value"],
        rows,
        lambda r: [
            r["measure"], r["against"], *[r["policy"]] * of_all, interval(r), number(r["effect"], "-"),
            f"{100 * r['pools_better']:.0f} % of {r['pools']}",
        ],
    )  # fmt: skip


def _team_sizes(found: Found, summary: Record) -> str:
    priced = "costs" in found.compared

    def measured(cell: Record) -> list[object]:
        actions, costs, interventions, moves = (cell[column] for column in MEASURES.values())
        return [
            cell["humans"], cell["policy"], with_deviation(actions), f"{actions['median']:.1f}",
            *[with_deviation(costs)] * priced, with_deviation(interventions), with_deviation(moves),
            f"{cell['cut_off']} of {cell['episodes']}",
        ]  # fmt: skip

    cells = [cell for cell in summary["cells"] if cell["condition"] == found.main["condition"]]
    cells.sort(key=lambda cell: [cell[column] for column in (*COLUMNS, "instance", "humans")])
    head = ["K", "policy", "human actions per person", "median", *["cost per person"] * priced, "interventions",
            "moves", "cut off"]  # fmt: skip
    return _by_arm(head, cells, measured)


def _decline(summary: Record) -> str:
    head = ["measure", "against", "decline, percentage points", "declines"]
    return _by_arm(head, summary["decline"], lambda r: [r["measure"], r["against"], interval(r), sign(r)])


def _kinds_of_people(found: Found, summary: Record) -> Record | None:
    """Return the tables of the condition with several populations, if there is one."""
    condition = of_kinds(found.study)
    if condition is None:
        return None
    which = {"condition": condition.name, "setting": condition.settings[0][0], "prior": condition.priors[0]}
    rows = []
    for arm, own in found.arms(**which):
        largest = own[own["humans"] == own["humans"].max()]
        for policy in dict.fromkeys(own["policy"]):
            values = [average(own, "actions", policy), average(own, "interventions", policy)]
            values.append(average(largest, "interventions", policy))
            rows.append([arm["instance"], arm["population"], policy, *(interval(v.record()) for v in values)])
    most = f"interventions, K = {max(condition.humans)}"
    ratios, elsewhere = [], []
    for c in summary["contrasts"]:
        ratio = [c["contrast"], c["policy"], interval(c), sign(c, 1.0)]
        if which.items() <= c.items():
            ratios.append([c["instance"], *ratio])
        else:
            elsewhere.append([c["condition"], c["instance"], c["setting"] or "default", prior(c["prior"]), *ratio])
    head = ["condition", "instance", "setting", "robot's prior", "contrast", "policy", "ratio", "above 1"]
    return {
        "condition": condition,
        "averages": markdown_table(["instance", "people", "policy", "actions per person", "interventions", most], rows),
        "ratios": markdown_table(["instance", "contrast", "policy", "ratio of interventions", "above 1"], ratios)
        if ratios
        else "",
        "elsewhere": markdown_table(head, elsewhere) if elsewhere else "",
    }


def _sensitivity(found: Found, summary: Record) -> str:
    """Return the table of savings under all conditions, except for kinds of people, which are compared elsewhere."""
    kinds = {name for c in found.study.conditions if len(c.populations) > 1 for name in c.populations}
    rows = [
        row
        for row in summary["comparisons"]
        if row["humans"] is None and row["against"] in found.study.baselines
        and (row["population"] == found.main["population"] or row["population"] not in kinds)
    ]  # fmt: skip
    if len({tuple(row[name] for name in (*ARM, "policy") if name != "instance") for row in rows}) < 2:
        return ""
    grouped: dict[tuple[str, ...], dict[str, str]] = {}
    for r in rows:
        people = "" if r["population"] == found.main["population"] else r["population"]
        taken = "" if r["prior"] == found.main["prior"] else f"prior {prior(r['prior'])}"
        what = ", ".join(part for part in (r["setting"], people, taken) if part)
        key = (r["condition"], what or "default", r["policy"], r["instance"], str(r["pools"]))
        grouped.setdefault(key, {})[f"{r['measure']} against {r['against']}"] = interval(r)
    columns = list(dict.fromkeys(name for cells in grouped.values() for name in cells))
    return markdown_table(
        ["condition", "variation", "policy", "instance", "pools", *columns],
        ([*key, *(cells.get(name, "-") for name in columns)] for key, cells in grouped.items()),
    )
