"""The report of a user study (`report.md` and `.html`, `summary.json`, figures), from its folder or an export of it."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planner.system.errors import DamagedFileError
from planner.system.files import atomic

from ..plots import style
from ..plots import userstudy as draw
from ..userstudy.plan import UserStudy
from ..userstudy.plan_file import read
from ..userstudy.questionnaires import TLX
from ..userstudy.session import JOURNAL, PLAN
from ..userstudy.tables import COLUMNS, Row, Tables, tables
from .html_page import html_page, require_packages
from .preregistration import compared
from .statistics import FEW
from .userstudy_summary import measures, summarise
from .wording import interval, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES = "figures"
LATER = {"utc", "group", "excluded", "failed_checks", "option", "passed"}
"""Columns that exports of earlier versions lack, besides the position of an answer."""
NUMBERS = {
    "failed_checks", "period", "position", "actions", "optimal_cost", "suboptimal_actions", "suggestions", "followed",
    "seconds", "step", "time", "cost_before", "cost_after", "score",
}  # fmt: skip
TRUTHS = {"simulated", "finished", "followed", "passed"}


def require() -> None:
    """Check that reports can be written.

    Raises
    ------
    MissingExtraError
        Markdown or matplotlib is not installed.
    """
    style.require()
    require_packages("markdown")


def of_folder(folder: Path) -> tuple[UserStudy, Tables]:
    """Read a study's data from its journal, during the study or afterwards, or from an unpacked export.

    Raises
    ------
    InputFileError, DamagedFileError, OSError
        The folder is neither a study's folder nor an unpacked export, or a file in it is damaged.
    """
    study = read(folder / PLAN, carried_out=True)
    if any((folder / name).exists() for name in (JOURNAL, Path(JOURNAL).with_suffix(".jsonl"))):
        return study, tables(study, folder / JOURNAL)
    return study, Tables(**{name: list(_rows(folder / f"{name}.csv", columns)) for name, columns in COLUMNS.items()})


def _rows(file: Path, columns: dict[str, str]) -> Iterator[Row]:
    with file.open(newline="", encoding="utf-8") as stream:
        reader = csv.DictReader(stream)
        known = list(reader.fieldnames or ())
        later = LATER | ({"position"} if "item" in columns else set())
        if known != [name for name in columns if name in known or name not in later]:
            raise DamagedFileError(file, 1, f"expected the columns {', '.join(columns)}")
        for row in reader:
            try:
                yield dict.fromkeys(columns) | {name: _cell(name, cell) for name, cell in row.items()}
            except (TypeError, ValueError):
                raise DamagedFileError(file, reader.line_num, "expected a number") from None


def _cell(name: str, cell: str) -> Any:
    if name in TRUTHS and cell in ("true", "false"):
        return cell == "true"
    if cell == "":
        return None
    return float(cell) if name in NUMBERS else cell


def write_report(folder: Path, out: Path) -> dict[str, Any]:
    """Write the report of a study; return its numbers.

    Parameters
    ----------
    folder : Path
        Folder of the study, or of an unpacked export.
    out : Path

    Raises
    ------
    InputFileError, DamagedFileError, OSError
        The folder is neither a study's folder nor an unpacked export, or a file in it is damaged.
    """
    study, found = of_folder(folder)
    found = found.analysed()
    summary = summarise(study, found) | {"preregistration": compared(study, found, folder)}
    pictures = dict(_pictures(study, found, summary))
    for name, (_, figure) in pictures.items():
        style.save_for_pages(figure, out / FIGURES, name, dark=False)
    text = "\n\n".join(_sections(study, summary, {name: said for name, (said, _) in pictures.items()})) + "\n"
    page = html_page(study.title, text, dark=False)
    numbers = json.dumps(summary, indent=1) + "\n"
    for name, content in {"summary.json": numbers, "report.md": text, "report.html": page}.items():
        with atomic(out / name) as path:
            path.write_text(content, encoding="utf-8")
    return summary


def headline(summary: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Return the titles and rows of a table with the mean of each measure in each condition."""
    names = [cell["condition"] for cell in summary["measures"][0]["cells"]]
    return ["", *names], [[one["label"], *map(_written, one["cells"])] for one in summary["measures"]]


def _written(cell: dict[str, Any], digits: int = 1) -> str:
    return interval(cell, digits) if cell["n"] else "-"


def _pictures(
    study: UserStudy, found: Tables, summary: dict[str, Any]
) -> Iterator[tuple[str, tuple[str, Callable[[], Figure]]]]:
    shown = [one for one in summary["measures"] if any(cell["n"] for cell in one["cells"])]
    if shown:
        points = {
            one.name: {name: list(own.values()) for name, own in one.values.items()} for one in measures(study, found)
        }
        yield "outcomes", ("Each measure by condition", partial(draw.outcomes_figure, shown, points))
    differing = [one for one in shown if one["differences"]]
    if differing:
        text = f"Differences from {study.reference}"
        yield "differences", (text, partial(draw.differences_figure, differing, study.reference))
    for one in summary["questionnaires"]:
        if one["n"]:
            own = study.questionnaire(one["questionnaire"])
            texts = {
                item.name: item.name if own.form == TLX else _short(item.text) + " (reversed)" * item.reversed
                for item in own.scale
            }
            yield (
                f"scales-{own.name}",
                (f"{own.name} by item", partial(draw.scales_figure, one, texts, own.scale[0].ends[:2])),
            )
    if summary["flow"][0]["reached"]:
        yield "flow", ("Progress of participants", partial(draw.flow_figure, summary["flow"]))


def _short(text: str, most: int = 48) -> str:
    return text if len(text) <= most else f"{text[: most - 1].rstrip()}…"


def _sections(study: UserStudy, summary: dict[str, Any], shown: dict[str, str]) -> Iterator[str]:
    def picture(name: str) -> Iterator[str]:
        if name in shown:
            yield f"![{shown[name]}]({FIGURES}/{name}.png)"

    yield f"# {study.title}"
    if summary["simulated"]:
        yield (
            "**Rehearsal.** Participants are simulated and their answers are generated, so the results say nothing "
            "about people."
        )
    yield _registered(summary["preregistration"])
    yield from _who_took_part(study, summary, picture("flow"))
    yield from _what_was_found(study, summary)
    yield from picture("outcomes")
    yield from _compared(study, summary)
    yield from picture("differences")
    for one in summary["questionnaires"]:
        yield f"## {study.questionnaire(one['questionnaire']).title} ({one['questionnaire']})"
        alphas = [
            f"{'undefined' if alpha is None else f'{alpha:.2f}'}{f' ({name})' if name else ''}"
            for name, alpha in (one["alphas"] or {"": one["alpha"]}).items()
        ]
        alpha = f"is {', '.join(alphas)}"
        items = study.questionnaire(one["questionnaire"]).scale
        turned = " Reversed items are recoded." if any(item.reversed for item in items) else ""
        answered = f"It was answered {one['n']} times" if one["alphas"] else f"{one['n']} participants answered"
        yield f"{answered}. Cronbach's alpha over its items {alpha}.{turned}"
        yield from picture(f"scales-{one['questionnaire']}")
    yield from _other_answers(study, summary["answers"])


def _other_answers(study: UserStudy, answers: list[dict[str, Any]]) -> Iterator[str]:
    """Yield tables of the answers to questions that belong to no scale."""
    if not answers:
        return
    yield "## Other questions"
    rows = []
    for one in answers:
        item = next(i for i in study.questionnaire(one["questionnaire"]).items if i.name == one["item"])
        text = f"{one['passed']} of {one['n']} passed this attention check" if "passed" in one else ""
        if "mean" in one:
            text = _written(one)
        elif one["counts"] and not text:
            text = ", ".join(f"{option}: {count}" for option, count in one["counts"].items())
        rows.append([_short(item.text), one["condition"], one["n"], text])
    yield table(["question", "condition", "answered", "answers"], rows)


def _registered(record: dict[str, Any] | None) -> str:
    """Return whether the study was preregistered, and how it differs from what was registered."""
    if record is None:
        return "The study was not preregistered."
    if record["deviations"]:
        return f"**Preregistered** at {record['registered']}, **but** {'; '.join(record['deviations'])}."
    return f"Preregistered at {record['registered']}: the study's file and the analysis have not changed."


def _who_took_part(study: UserStudy, summary: dict[str, Any], picture: Iterator[str]) -> Iterator[str]:
    yield "## Participants"
    counts, conditions = summary["participants"], summary["conditions"]
    drawn, place = ("order of conditions", "an order") if study.is_within else ("condition", "a condition")
    yield (
        f"{counts['enrolled']} arrived, {counts['randomised']} were randomised to their {drawn} when they began the "
        f"first task, {counts['completed']} completed the study. Participants who left before the first task do not "
        f"count in {place}; those who "
        + ("left later were replaced." if study.replace else "left later still count and were not replaced.")
    )
    if study.group is not None:
        groups = summary["groups"]
        yield (
            f"{groups['began']} groups of {groups['size']} shared a robot; {groups['smaller']} of them began with "
            f"fewer members. {groups['unmatched']} participants found no group in time. **The unit of analysis is the "
            "group**: each value is the mean over its members."
        )
    yield table(["participants", "number"], _counted(counts))
    head = [drawn, "policy", "randomised", "completed", "left after randomisation", "taking part"]
    yield table(
        head,
        ([one[key] for key in ("condition", "policy", "begun", "done", "left", "under_way")] for one in conditions),
    )
    yield from picture


def _units(study: UserStudy) -> str:
    """Return the units of analysis, in words."""
    return "participants" if study.group is None else "groups"


def _counted(counts: dict[str, Any]) -> Iterator[list[Any]]:
    """Yield the rows of the table of participants: how many there are at each step, with reasons."""
    yield ["enrolled", counts["enrolled"]]
    for what, key in (
        ("no consent", "declined"), ("turned away on return, as the study was full", "full"),
        ("withdrew; their data are in no table, figure or mean", "withdrew"),
        ("of them, with all records erased", "erased"),
        ("dropped out", "gone"),
    ):  # fmt: skip
        if counts[key]:
            yield [what, counts[key]]
    yield ["randomised", counts["randomised"]]
    yield ["completed", counts["completed"]]
    for reason, count in counts["excluded"].items():
        yield [f"excluded by the researchers: {reason}", count]
    yield ["completed and analysed", counts["analysed"]]


def _what_was_found(study: UserStudy, summary: dict[str, Any]) -> Iterator[str]:
    yield "## Conditions"
    yield (
        f"Means with 95 % intervals (Student's t) over {_units(study)}. Completion counts all who began a task; other "
        "measures of tasks include participants who finished all of them; questionnaires include all who answered."
    )
    head, rows = headline(summary)
    yield table(["measure", *head[1:]], rows)
    counts = [{cell["condition"]: cell["n"] for cell in one["cells"]} for one in summary["measures"]]
    yield f"{_units(study).capitalize()}: " + ", ".join(f"{name} {count}" for name, count in counts[0].items()) + "."
    lacking = [
        f"{one['label']}: " + ", ".join(f"{name} {count}" for name, count in own.items())
        for one, own in zip(summary["measures"], counts, strict=True)
        if own != counts[0]
    ]
    if lacking:
        yield (
            "Some measures have fewer values (without suggestions, none can be followed): " + "; ".join(lacking) + "."
        )
    if summary["few"]:
        whole = len(summary["few"]) == len(study.conditions)
        which = "every condition" if whole else ", ".join(summary["few"])
        yield (
            f"**Few {_units(study)}.** Fewer than {FEW} in {which}, so results are preliminary. Student's "
            "intervals assume normally distributed means, which cannot be checked with so few; see the individual "
            "points as well."
        )


def _compared(study: UserStudy, summary: dict[str, Any]) -> Iterator[str]:
    yield f"## Differences from {study.reference}"
    said = (
        "Comparisons are within participants: mean differences with 95 % intervals (Student's t), and "
        "Hedges' g of the differences (d_z). Learning from one condition to the next affects all conditions equally "
        "only if the orders above are equally frequent."
        if study.is_within
        else "Differences of means with Welch's 95 % intervals, and Hedges' g."
    )
    tests = (
        "Tests are paired t-tests, and exact McNemar tests of completion. *By period* is the difference with "
        "participants and periods as fixed effects; the *mixed model* has periods and orders as fixed effects and "
        "participants as random ones (restricted maximum likelihood)."
        if study.is_within
        else "Tests are Welch's."
        if study.group is not None
        else "Tests are Welch's, and Fisher's exact tests of completion, whose intervals are Newcombe's."
    )
    yield f"{said} {tests}"
    if study.confirmatory:
        count = len(study.confirmatory) * (len(study.conditions) - 1)
        yield "### Confirmatory"
        yield (
            f"The study's file names {', '.join(study.confirmatory)} beforehand. P-values are adjusted for the "
            f"{count} comparisons of this family (Holm), so that the family-wise error is at most 5 %."
        )
        yield _differences(study, [one for one in summary["measures"] if one["confirmatory"]])
    yield "### Exploratory"
    yield (
        "These comparisons test no hypothesis that was stated beforehand. Intervals and p-values are not adjusted: "
        "of many comparisons, one in twenty shows a difference by chance."
    )
    yield _differences(study, [one for one in summary["measures"] if not one["confirmatory"]])
    yield from _by_ranks(study, summary)
    if summary["detectable"] is not None:
        yield (
            f"Sensitivity at 80 % power: with the number of {_units(study)} in the smallest condition, four of five "
            f"studies show a difference of g = {summary['detectable']:.2f} or more. Smaller differences are "
            "likely to be missed."
        )
    else:
        yield f"Conditions with fewer than two {_units(study)} cannot be compared."


def _differences(study: UserStudy, measures: list[dict[str, Any]]) -> str:
    """Return the table of the differences of conditions from the reference."""
    rows = []
    for one in measures:
        for other in one["differences"]:
            p = other.get("p_holm") if one["confirmatory"] else other["p"]
            effect = "" if other["hedges_g"] is None else f"{other['hedges_g']:.2f}"
            models = [interval(other[model]) if model in other else "" for model in ("by_period", "mixed_model")]
            shown = ("yes" if p is not None and p < 0.05 else "no") if one["confirmatory"] else _shows(other)
            rows.append([one["label"], other["condition"], interval(other), *models, effect, _p(p), shown])
    p_head = "p (Holm)" if measures and measures[0]["confirmatory"] else "p"
    head = [
        "measure",
        "condition",
        f"minus {study.reference}",
        "by period",
        "mixed model",
        "Hedges' g",
        p_head,
        "shown",
    ]
    return table(head, rows)


def _by_ranks(study: UserStudy, summary: dict[str, Any]) -> Iterator[str]:
    """Yield the sensitivity analysis, and the comparisons of single Likert items."""
    test = "Wilcoxon's signed-rank test, or the sign test" if study.is_within else "the Mann-Whitney test"
    labels = {one["measure"]: one["label"] for one in summary["measures"]}
    if summary["worst_rank"]:
        yield "### Sensitivity: the unfinished as the worst"
        yield (
            f"All who began a task, by {test}. Those who did not finish have the worst rank. The effect is the "
            "rank-biserial correlation, positive if the condition has more."
        )
        rows = [
            [labels[one["measure"]], one["condition"], one["n"], f"{one['effect']:.2f}", _p(one["p"])]
            for one in summary["worst_rank"]
        ]
        yield table(["measure", "condition", _units(study), "effect", "p"], rows)
    if summary["likert"]:
        yield "### Single Likert items"
        yield f"Exploratory, by {test}, as the answers are ordinal; reversed items are recoded."
        rows = [
            [
                f"{one['questionnaire']}: {one['item']}", one["condition"], one["n"],
                "" if one["effect"] is None else f"{one['effect']:.2f}", _p(one["p"]),
            ]
            for one in summary["likert"]
        ]  # fmt: skip
        yield table(["item", "condition", _units(study), "effect", "p"], rows)


def _p(p: float | None) -> str:
    return "undefined" if p is None else "< .001" if p < 0.001 else f"{p:.3f}"  # as journals print p-values


def _shows(one: dict[str, Any]) -> str:
    if one["low"] is None:
        return "no interval"
    return "more" if one["low"] > 0 else "less" if one["high"] < 0 else "not shown"
