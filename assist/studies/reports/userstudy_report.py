"""The report of a user study (`report.md` and `.html`, `summary.json`, figures), from its folder or an export of it."""

from __future__ import annotations

import tempfile
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

from planner.system.errors import InputFileError

from ...declare.declared import NOTHING, is_declared, names_of, plain, shown
from ...drawing.plots import userstudy as draw
from ...live.record import require_database
from ...live.store import stored
from ...people.ranges import advice_takers
from ...person.settings import Setting
from ..plan_tables import among
from ..statistics import FEW
from ..userstudy.forms import FORMS, Item
from ..userstudy.plan import UserStudy, UserStudyPlan
from ..userstudy.plan_file import read
from ..userstudy.session import JOURNAL, PLAN
from ..userstudy.tables import Tables, exported, tables
from . import report_files
from .preregistration import compared
from .report_files import ReportFigure, draw_all, html_page, rendered, write_files
from .userstudy_data import ALL, StudyData
from .userstudy_summary import summarise
from .wording import Wording, short

require = partial(report_files.require, "jinja2", "markdown")


@contextmanager
def unpacked(place: Path) -> Iterator[Path]:
    """Yield the folder with a study's data: the given one, or a temporary one with the content of an export.

    Raises
    ------
    InputFileError
        It is a file, but no ZIP file.
    """
    if place.is_dir():
        yield place
        return
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / place.name  # which messages name
        try:
            with zipfile.ZipFile(place) as packed:
                packed.extractall(folder)
        except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError):
            raise InputFileError(f"{place}: no ZIP file; expected the folder of a study, or an export of one") from None
        yield folder


def of_folder(folder: Path) -> tuple[UserStudy, Tables]:
    """Read a study's data from its journal, during the study or afterwards, or from an unpacked export.

    Raises
    ------
    InputFileError, OSError
        The folder is neither a study's folder nor an unpacked export, or a file in it is damaged.
    """
    if not (folder / PLAN).exists():
        raise InputFileError(
            f"{folder}: no {PLAN}; expected the folder of a study that has begun, or an unpacked export"
        )
    study = read(folder / PLAN, carried_out=True)
    if (folder / JOURNAL).exists():
        return study, tables(study, folder / JOURNAL)
    require_database(folder / JOURNAL)
    return study, exported(study, folder)


def write_report(place: Path, out: Path, *, baseline: str | None = None) -> dict[str, Any]:
    """Write the report of a study; return its numbers.

    It is written again if somebody has withdrawn or was erased meanwhile.

    Parameters
    ----------
    place : Path
        Folder of the study, or an export of it, as a ZIP file or unpacked.
    out : Path
    baseline : str, optional
        The condition with which the others are compared, in place of the study's reference. All comparisons are then
        exploratory.

    Raises
    ------
    InputFileError, OSError
        It is neither a study's folder nor an export, or a file in it is damaged.
    """
    with unpacked(place) as folder:
        while True:
            before = _removed(folder)
            summary = _written(folder, out, baseline)
            if _removed(folder) == before:
                return summary


def _removed(folder: Path) -> int:
    """Return the number of events of a study whose records were removed; 0 for an export."""
    file = folder / JOURNAL
    return sum(at is None for at, _ in stored(file)[1]) if file.exists() else 0


def _written(folder: Path, out: Path, baseline: str | None) -> dict[str, Any]:
    study, found = of_folder(folder)
    if baseline not in (None, study.reference):
        among(study.file, "baseline", (str(baseline),), [one.name for one in study.conditions])
        study = replace(study, reference=baseline, confirmatory=())
    found = found.analysed()
    summary = summarise(study, found) | {"preregistration": compared(study, found, folder)}
    figures = list(_pictures(study, found, summary))
    draw_all(figures, out, dark=False)
    text = report_text(study, summary, {one.name: one.text for one in figures})
    page = html_page(study.title, text, dark=False, language=study.catalogue.tag)
    write_files(out, summary, text, page)
    return summary


def _pictures(study: UserStudy, found: Tables, summary: dict[str, Any]) -> Iterator[ReportFigure]:
    texts, phrase, words = study.catalogue, study.catalogue.phrase, ReportWording(study.catalogue)
    shown = [one for one in summary["measures"] if any(cell["n"] for cell in one["cells"])]
    if shown:
        points = {
            one.name: {name: list(own.values()) for name, own in one.values.items()}
            for one in StudyData(study, found).measures
        }
        yield ReportFigure(
            "outcomes", phrase("report.figures.outcomes"), partial(draw.outcomes_figure, shown, points, texts)
        )
    differing = [one for one in shown if one["differences"]]
    if differing:
        text = phrase("report.differences.title", reference=study.reference)
        yield ReportFigure("differences", text, partial(draw.differences_figure, differing, study.reference, texts))
    for one in summary["questionnaires"]:
        if one["n"]:
            own = study.questionnaire(one["questionnaire"])
            names = {item.name: words.name(own.form, item) for item in own.scale}
            items = [row | {"condition": words.where(row["condition"])} for row in one["items"]]
            figure = partial(draw.scales_figure, one | {"items": items}, names, own.scale[0].ends[:2])
            yield ReportFigure(f"scales-{own.name}", phrase("report.figures.scales", name=own.name), figure)
    if summary["flow"][0]["reached"]:
        yield ReportFigure("flow", phrase("report.figures.flow"), partial(draw.flow_figure, summary["flow"], texts))


@dataclass(frozen=True)
class ReportWording(Wording):
    """Sentences and rows of tables of a user study's report, in the study's language or in English."""

    def headline(self, summary: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
        """Return the titles and rows of a table with the mean of each measure in each condition."""
        names = [cell["condition"] for cell in summary["measures"][0]["cells"]]
        return ["", *names], [[one["label"], *map(self.value, one["cells"])] for one in summary["measures"]]

    def notes(self, summary: dict[str, Any]) -> Iterator[str]:
        """Yield what stands at the top: failed policies, missing participants, and who hardly made a suggestion."""
        for one in summary["faults"]:
            yield self.texts.phrase("report.policy_failed", **one)
        counts = summary["participants"]
        if counts["planned"] is not None and counts["completed"] < counts["planned"]:
            yield self.texts.phrase("report.in_progress", done=counts["completed"], planned=counts["planned"])
        for one in summary["seldom_assisted"]:
            numbers = {name: self.plain(one[name]) for name in ("c_suggest", "c_move")}
            assisted = self.texts.decimal(one["assisted"], 0)
            yield self.texts.phrase("report.seldom_assisted", **one | numbers | {"assisted": assisted})

    def name(self, form: str, item: Item) -> str:
        """Return the label of an item in a figure."""
        text = FORMS[form].label(short(item.text), item.name)
        return self.texts.phrase("report.reversed", item=text) if item.reversed else text

    def where(self, condition: str) -> str:
        """Return the name of a condition, or what stands for all participants."""
        return self.texts.phrase("report.all") if condition == ALL else condition

    def described(self, cell: dict[str, Any]) -> str:
        """Return the mean, standard deviation and range of answers, or a dash without any."""
        if not cell["n"]:
            return "-"
        spread = {"mean": self.number(cell["mean"]), "sd": self.number(cell["sd"], "-")}
        ends = {"low": self.plain(cell["min"]), "high": self.plain(cell["max"])}
        return self.texts.phrase("report.questionnaires.described", **spread, **ends)

    def made(self, setup: dict[str, Any]) -> str:
        """Return when the study took place, and the version that made the report; empty before anybody came."""
        if setup["first"] is None:
            return ""
        first, last = (setup[end][:16].replace("T", " ") for end in ("first", "last"))
        return self.texts.phrase("report.plan.made", first=first, last=last, version=metadata.version("kitassist"))

    def difference_rows(self, measures: Iterable[dict[str, Any]]) -> Iterator[list[Any]]:
        """Yield the rows of a table of the differences of conditions from the reference."""
        for one in measures:
            for other in one["differences"]:
                p, shown = other["p"], _shows(other)
                if one["confirmatory"]:
                    p = other.get("p_holm")
                    if p is None or p >= 0.05:
                        shown = "not_shown" if p is not None else "no_interval"
                    else:
                        shown = "more" if other["mean"] > 0 else "less"
                g = {"mean": other["hedges_g"], "low": other["hedges_g_low"], "high": other["hedges_g_high"]}
                effect = "" if g["mean"] is None else self.interval(g, 2)
                t = "" if other["t"] is None else f"{self.number(other['t'])} ({self.texts.decimal(other['df'], 1)})"
                word = self.texts.phrase(f"report.{shown}")
                least = self.number(other["detectable"], "")
                yield [one["label"], other["condition"], self.interval(other), t, effect, self.p_value(p), word, least]

    def spread_rows(self, measures: Iterable[dict[str, Any]]) -> Iterator[list[str]]:
        """Yield the rows of a table with the standard deviation and the median of each measure in each condition."""
        for one in measures:
            if not one["shares"]:  # whose deviation follows from the share
                yield [one["label"]] + [
                    f"{self.number(cell['sd'], '-')} ({self.number(cell['median'])})" if cell["n"] else "-"
                    for cell in one["cells"]
                ]

    def mixed_rows(self, measures: Iterable[dict[str, Any]]) -> Iterator[list[Any]]:
        """Yield the rows of a table of the differences by mixed models."""
        for one in measures:
            for other in one["differences"]:
                if "mixed_model" in other:
                    yield [one["label"], other["condition"], self.interval(other["mixed_model"])]

    def rank_rows(self, tests: Iterable[dict[str, Any]]) -> Iterator[list[Any]]:
        """Yield the rows of a table of comparisons by ranks, of measures or of single items."""
        for one in tests:
            is_measure = "measure" in one
            what = (
                self.texts.phrase(f"report.measures.{one['measure']}") if is_measure
                else f"{one['questionnaire']}: {one['item']}"
            )  # fmt: skip
            yield [what, one["condition"], one["n"], self.number(one["effect"], ""), self.p_value(one["p"])]

    def setup_rows(self, study: UserStudy, setup: dict[str, Any]) -> Iterator[list[str]]:
        """Yield tasks, conditions, robot, people and questionnaires, by the fields of the study's file."""
        costs = ((one["task"], one["optimal_cost"]) for one in setup["tasks"])
        yield [
            "tasks",
            ", ".join(
                task if cost is None else self.texts.phrase("report.plan.optimal", task=task, cost=f"{cost:g}")
                for task, cost in costs
            ),
        ]
        common, usual = plain(study.setting), plain(Setting().for_real_people())
        for one in study.conditions:
            own = {name: value for name, value in plain(one.setting).items() if common.get(name) != value}
            yield [f"conditions: {one.name}", shown({"policy": one.policy, "reasons": one.reasons, **own})]
        yield ["reference", study.reference]
        yield ["simulated", str(study.simulated)]
        always = ("c_suggest", "c_move", "gamma", "knowledge")
        yield [
            "setting",
            shown({name: value for name, value in common.items() if name in always or usual.get(name) != value}),
        ]
        whole = study.population
        people = {name: value for name, value in plain(whole).items() if name in ("beta", "theta", "sigma")}
        if whole == advice_takers(whole.beta, whole.sigma, chooses=whole.chooses):
            people["theta"] = self.texts.phrase("report.plan.real_people")
        yield ["population", shown(people)]
        for asked in study.questionnaires:
            items = ", ".join(item.name for item in asked.items)
            where = {"conditions": list(asked.conditions)} if asked.conditions else {}
            yield [
                f"questionnaires: {asked.name}",
                shown({"form": asked.form, "when": asked.when, **where, "items": items}),
            ]


def report_text(study: UserStudy, summary: dict[str, Any], pictures: dict[str, str]) -> str:
    """Return the report in Markdown, in the study's language; `pictures` has the description of each figure."""
    words = ReportWording(study.catalogue)
    head, rows = words.headline(summary)
    plan = [*words.setup_rows(study, summary["setup"]), *_plan_rows(study)]
    return rendered(
        "userstudy_report.md.jinja", study=study, summary=summary, pictures=pictures, few=FEW, words=words,
        phrase=study.catalogue.phrase, head=[study.catalogue.phrase("report.conditions.measure"), *head[1:]], rows=rows,
        plan=plan,
    )  # fmt: skip


def _plan_rows(study: UserStudy) -> Iterator[list[str]]:
    """Yield each field of the plan that is given, as the study's file has it; but for the completion code."""
    for name in names_of(UserStudyPlan):
        given = getattr(study, name)
        if name != "code" and given not in NOTHING:
            yield [name, shown(plain(given) if is_declared(type(given)) else given)]


def _shows(one: dict[str, Any]) -> str:
    """Return the key of the text that says what an interval shows."""
    if one["low"] is None:
        return "no_interval"
    return "more" if one["low"] > 0 else "less" if one["high"] < 0 else "not_shown"
