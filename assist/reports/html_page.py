"""A report as an HTML page, in which nothing but the program's own markup has an effect.

Titles, names, reasons and options are anybody's words. Markup in them is shown as it is written; links lead nowhere.
The page's own policy forbids scripts and whatever would be loaded from elsewhere.
"""

from __future__ import annotations

import importlib.util
import re

from planner.system.errors import MissingExtraError

from .templates import rendered

ELSEWHERE = re.compile(r'<img alt="([^"]*)" src="(?!figures/[\w-]+\.(?:png|svg)")[^"]*"[^>]*/>')
"""Images that are no figures of the report; their descriptions stay."""
IMAGE = re.compile(r'<img alt="([^"]*)" src="([^"]*)\.png" />')


def require_packages(*packages: str) -> None:
    """Check that the packages that reports need are installed.

    Raises
    ------
    MissingExtraError
    """
    for package in packages:
        if importlib.util.find_spec(package) is None:
            raise MissingExtraError("reports need", package, "study")


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
