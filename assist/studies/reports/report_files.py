"""The files of a report: numbers, Markdown, and a page in which nothing but the program's own markup has an effect.

Titles, names, reasons and options are anybody's words. Markup in them is shown as it is written; links lead nowhere.
The page's own policy forbids scripts and whatever would be loaded from elsewhere.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planner.system.errors import require_package
from planner.system.files import atomic, remove_unfinished
from planner.system.processes import outcomes
from planner.system.results import markdown_cell, markdown_table

from ...drawing.plots import style
from . import wording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES = "figures"

ELSEWHERE = re.compile(r'<img alt="([^"]*)" src="(?!figures/[\w-]+\.(?:png|svg)")[^"]*"[^>]*/>')
"""Images that are no figures of the report; their descriptions stay."""
IMAGE = re.compile(r'<img alt="([^"]*)" src="([^"]*)\.png" />')


def require(*packages: str) -> None:
    """Check that figures, and the packages that a report needs, can be made.

    Raises
    ------
    MissingExtraError
    """
    style.require()
    for package in packages:
        require_package("reports need", package, "study")


@dataclass(frozen=True)
class ReportFigure:
    """A figure of a report: its file name, its description, and the function that draws it."""

    name: str
    text: str
    figure: Callable[[], Figure]


def draw_all(figures: Sequence[ReportFigure], folder: Path, *, jobs: int = 1, dark: bool = True) -> None:
    """Draw the figures of a report in its folder, on several processors; for dark backgrounds, too, unless not wanted.

    They are drawn here for one job: starting a process takes longer than drawing a figure.
    """
    if jobs == 1:
        for one in figures:
            _draw(one, folder / FIGURES, dark)
        return
    try:
        with closing(outcomes(_draw, figures, (folder / FIGURES, dark), jobs=jobs)) as drawn:
            for _, outcome in drawn:
                if isinstance(outcome, Exception):
                    raise outcome
    finally:
        remove_unfinished([folder / FIGURES])  # files of stopped processes


def _draw(one: ReportFigure, folder: Path, dark: bool) -> None:
    style.save_for_pages(one.figure, folder, one.name, dark=dark)


def write_files(folder: Path, summary: Any, text: str, page: str) -> None:
    """Write a report's numbers, its text in Markdown and its page to a folder."""
    numbers = json.dumps(summary, indent=1) + "\n"
    for name, content in {"summary.json": numbers, "report.md": text, "report.html": page}.items():
        with atomic(folder / name) as path:
            path.write_text(content, encoding="utf-8")


def rendered(template: str, **content: Any) -> str:
    """Return the text that a Jinja2 template of this folder makes of the content, which HTML escapes, not Markdown."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=jinja2.select_autoescape(["html.jinja"], default=False), undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters |= {
        "prior": wording.prior,
        "short": wording.short,
        "table": markdown_table,
        "cell": markdown_cell,
    }
    return environment.get_template(template).render(content).rstrip() + "\n"


def html_page(title: str, text: str, *, dark: bool, language: str = "en") -> str:
    """Return a text in Markdown as an HTML page.

    Parameters
    ----------
    title, text : str
    dark : bool
        Whether there are figures for dark backgrounds, too.
    language : str
        Tag of the text's language.
    """
    import markdown

    reader = markdown.Markdown(extensions=["tables"])
    reader.preprocessors.deregister("html_block")
    for pattern in ("html", "autolink", "automail", "link", "reference", "short_reference", "image_reference"):
        reader.inlinePatterns.deregister(pattern)
    body = ELSEWHERE.sub(r"\1", reader.convert(text))
    body = IMAGE.sub(_for_both_backgrounds, body) if dark else body
    return rendered("page.html.jinja", title=title, body=body, dark=dark, language=language)


def _for_both_backgrounds(image: re.Match[str]) -> str:
    """Return an image element that selects the figure for the page's background."""
    text, name = image.groups()
    dark = f'<source srcset="{name}-dark.svg" media="(prefers-color-scheme: dark)">'
    return f'<picture>{dark}<img alt="{text}" src="{name}.svg"></picture>'
