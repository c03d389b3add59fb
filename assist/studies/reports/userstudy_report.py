"""The report of a user study (`report.md` and `.html`, `summary.json`, figures), from its folder or an export of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...declare.catalogue import Catalogue, catalogue
from ...declare.declared import NOTHING, is_declared, names_of, plain, shown
from ...drawing.plots import style
from ...drawing.plots import userstudy as draw
from ...learning.statistics import FEW
from ...live.store import stored
from ...person.settings import Setting
from ..userstudy.csv_tables import rows
from ..userstudy.plan import UserStudy, UserStudyPlan
from ..userstudy.plan_file import read
from ..userstudy.questionnaires import TLX, Item
from ..userstudy.session import JOURNAL, PLAN
from ..userstudy.tables import COLUMNS, Tables, tables
from . import report_files
from .preregistration import compared
from .report_files import FIGURES, html_page, rendered, write_files
from .userstudy_summary import ALL, measures, summarise
from .wording import interval, number, p_value, short, value

if TYPE_CHECKING:
    from matplotlib.figure import Figure

require = partial(report_files.require, "jinja2", "markdown")


def of_folder(folder: Path) -> tuple[UserStudy, Tables]:
    """Read a study's data from its journal, during the study or afterwards, or from an unpacked export.

    Raises
    ------
    InputFileError, OSError
        The folder is neither a study's folder nor an unpacked export, or a file in it is damaged.
    """
    study = read(folder / PLAN, carried_out=True)
    if any((folder / name).exists() for name in (JOURNAL, Path(JOURNAL).with_suffix(".jsonl"))):
        return study, tables(study, folder / JOURNAL)
    return study, Tables(**{name: list(rows(folder / f"{name}.csv", columns)) for name, columns in COLUMNS.items()})


def write_report(folder: Path, out: Path) -> dict[str, Any]:
    """Write the report of a study; return its numbers.

    It is written again if somebody has withdrawn or was erased meanwhile.

    Parameters
    ----------
    folder : Path
        Folder of the study, or of an unpacked export.
    out : Path

    Raises
    ------
    InputFileError, OSError
        The folder is neither a study's folder nor an unpacked export, or a file in it is damaged.
    """
    while True:
        before = _removed(folder)
        summary = _written(folder, out)
        if _removed(folder) == before:
            return summary


def _removed(folder: Path) -> int:
    """Return the number of events of a study whose records were removed; 0 for an export."""
    file = folder / JOURNAL
    return sum(at is None for at, _ in stored(file)[1]) if file.exists() else 0


def _written(folder: Path, out: Path) -> dict[str, Any]:
    study, found = of_folder(folder)
    found = found.analysed()
    summary = summarise(study, found) | {"preregistration": compared(study, found, folder)}
    pictures = dict(_pictures(study, found, summary))
    for name, (_, figure) in pictures.items():
        style.save_for_pages(figure, out / FIGURES, name, dark=False)
    text = report_text(study, summary, {name: said for name, (said, _) in pictures.items()})
    page = html_page(study.title, text, dark=False, language=study.catalogue.tag)
    write_files(out, summary, text, page)
    return summary


def headline(summary: dict[str, Any], texts: Catalogue | None = None) -> tuple[list[str], list[list[str]]]:
    """Return the titles and rows of a table with the mean of each measure in each condition."""
    names = [cell["condition"] for cell in summary["measures"][0]["cells"]]
    rows = [[one["label"], *(value(cell, texts) for cell in one["cells"])] for one in summary["measures"]]
    return ["", *names], rows


def _pictures(
    study: UserStudy, found: Tables, summary: dict[str, Any]
) -> Iterator[tuple[str, tuple[str, Callable[[], Figure]]]]:
    texts, phrase = study.catalogue, study.catalogue.phrase
    shown = [one for one in summary["measures"] if any(cell["n"] for cell in one["cells"])]
    if shown:
        points = {
            one.name: {name: list(own.values()) for name, own in one.values.items()} for one in measures(study, found)
        }
        yield "outcomes", (phrase("report.figures.outcomes"), partial(draw.outcomes_figure, shown, points, texts))
    differing = [one for one in shown if one["differences"]]
    if differing:
        text = phrase("report.differences.title", reference=study.reference)
        yield "differences", (text, partial(draw.differences_figure, differing, study.reference, texts))
    for one in summary["questionnaires"]:
        if one["n"]:
            own = study.questionnaire(one["questionnaire"])
            names = {item.name: _name(own.form, item, texts) for item in own.scale}
            items = [row | {"condition": _where(row["condition"], texts)} for row in one["items"]]
            figure = partial(draw.scales_figure, one | {"items": items}, names, own.scale[0].ends[:2])
            yield f"scales-{own.name}", (phrase("report.figures.scales", name=own.name), figure)
    if summary["flow"][0]["reached"]:
        yield "flow", (phrase("report.figures.flow"), partial(draw.flow_figure, summary["flow"], texts))


def _name(form: str, item: Item, texts: Catalogue) -> str:
    """Return the label of an item in a figure."""
    if form == TLX:
        return item.name
    return texts.phrase("report.reversed", item=short(item.text)) if item.reversed else short(item.text)


def _where(condition: str, texts: Catalogue) -> str:
    """Return the name of a condition, or what stands for all participants."""
    return texts.phrase("report.all") if condition == ALL else condition


def report_text(study: UserStudy, summary: dict[str, Any], pictures: dict[str, str]) -> str:
    """Return the report in Markdown, in the study's language; `pictures` has the description of each figure."""
    texts = study.catalogue
    head, rows = headline(summary, texts)
    return rendered(
        "userstudy_report.md.jinja",
        study=study, summary=summary, pictures=pictures, few=FEW, phrase=texts.phrase,
        head=[texts.phrase("report.conditions.measure"), *head[1:]], rows=rows,
        number=partial(number, texts=texts), value=partial(value, texts=texts), where=partial(_where, texts=texts),
        difference_rows=partial(_difference_rows, texts=texts), rank_rows=partial(_rank_rows, texts=texts),
        spread_rows=list(_spread_rows(summary["measures"], texts)),
        mixed_rows=list(_mixed_rows(summary["measures"], texts)),
        plan=[*_setup_rows(study, summary["setup"]), *_plan_rows(study)], notes=list(notes(summary, texts)),
        described=partial(_described, texts=texts), made=_made(summary["setup"], texts),
    )  # fmt: skip


def notes(summary: dict[str, Any], texts: Catalogue | None = None) -> Iterator[str]:
    """Yield what stands at the top of a report: whether more participants are planned, and who made no suggestion."""
    texts, counts = texts or catalogue(), summary["participants"]
    if counts["planned"] is not None and counts["completed"] < counts["planned"]:
        yield texts.phrase("report.in_progress", done=counts["completed"], planned=counts["planned"])
    for one in summary["without_suggestions"]:
        costs = {name: _short(one[name], texts) for name in ("c_suggest", "c_move")}
        yield texts.phrase("report.no_suggestions", **one | costs)


def _described(cell: dict[str, Any], texts: Catalogue) -> str:
    """Return the mean, standard deviation and range of answers, or a dash without any."""
    if not cell["n"]:
        return "-"
    spread = {"mean": number(cell["mean"], texts=texts), "sd": number(cell["sd"], "-", texts)}
    ends = {name: _short(cell[key], texts) for name, key in (("low", "min"), ("high", "max"))}
    return texts.phrase("report.questionnaires.described", **spread, **ends)


def _short(given: float, texts: Catalogue) -> str:
    """Return a number with the digits that it has."""
    return f"{given:g}".replace(".", texts.texts["decimal"])


def _made(setup: dict[str, Any], texts: Catalogue) -> str:
    """Return when the study took place, and the version that made the report; empty before anybody came."""
    if setup["first"] is None:
        return ""
    first, last = (setup[end][:16].replace("T", " ") for end in ("first", "last"))
    return texts.phrase("report.plan.made", first=first, last=last, version=metadata.version("kitassist"))


def _setup_rows(study: UserStudy, setup: dict[str, Any]) -> Iterator[list[str]]:
    """Yield tasks, conditions, robot, people and questionnaires, by the fields of the study's file."""
    texts = study.catalogue
    costs = ((one["task"], one["optimal_cost"]) for one in setup["tasks"])
    yield [
        "tasks",
        ", ".join(
            task if cost is None else texts.phrase("report.plan.optimal", task=task, cost=f"{cost:g}")
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
    people = plain(study.population)
    yield ["population", shown({name: people[name] for name in ("beta", "theta", "sigma") if name in people})]
    for asked in study.questionnaires:
        items = ", ".join(item.name for item in asked.items)
        where = {"conditions": list(asked.conditions)} if asked.conditions else {}
        yield [
            f"questionnaires: {asked.name}",
            shown({"form": asked.form, "when": asked.when, **where, "items": items}),
        ]


def _plan_rows(study: UserStudy) -> Iterator[list[str]]:
    """Yield each field of the plan that is given, as the study's file has it; but for the completion code."""
    for name in names_of(UserStudyPlan):
        given = getattr(study, name)
        if name != "code" and given not in NOTHING:
            yield [name, shown(plain(given) if is_declared(type(given)) else given)]


def _difference_rows(measures: Iterable[dict[str, Any]], texts: Catalogue) -> Iterator[list[Any]]:
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
            effect = "" if g["mean"] is None else interval(g, 2, texts)
            t = "" if other["t"] is None else f"{number(other['t'], texts=texts)} ({texts.decimal(other['df'], 1)})"
            difference, word = interval(other, texts=texts), texts.phrase(f"report.{shown}")
            yield [one["label"], other["condition"], difference, t, effect, p_value(p, texts), word]


def _spread_rows(measures: Iterable[dict[str, Any]], texts: Catalogue) -> Iterator[list[str]]:
    """Yield the rows of a table with the standard deviation and the median of each measure in each condition."""
    for one in measures:
        if one["shares"]:
            continue  # their deviation follows from the share
        yield [one["label"]] + [
            f"{number(cell['sd'], '-', texts)} ({number(cell['median'], texts=texts)})" if cell["n"] else "-"
            for cell in one["cells"]
        ]


def _mixed_rows(measures: Iterable[dict[str, Any]], texts: Catalogue) -> Iterator[list[Any]]:
    """Yield the rows of a table of the differences by mixed models."""
    for one in measures:
        for other in one["differences"]:
            if "mixed_model" in other:
                yield [one["label"], other["condition"], interval(other["mixed_model"], texts=texts)]


def _rank_rows(tests: Iterable[dict[str, Any]], texts: Catalogue) -> Iterator[list[Any]]:
    """Yield the rows of a table of comparisons by ranks, of measures or of single items."""
    for one in tests:
        own = "measure" in one
        what = texts.phrase(f"report.measures.{one['measure']}") if own else f"{one['questionnaire']}: {one['item']}"
        yield [what, one["condition"], one["n"], number(one["effect"], "", texts), p_value(one["p"], texts)]


def _shows(one: dict[str, Any]) -> str:
    """Return the key of the text that says what an interval shows."""
    if one["low"] is None:
        return "no_interval"
    return "more" if one["low"] > 0 else "less" if one["high"] < 0 else "not_shown"
