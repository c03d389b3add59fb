"""A report as an HTML page."""

from __future__ import annotations

import importlib.util
import re

from planner.system.errors import MissingExtraError

from .templates import rendered

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


def html_page(title: str, text: str, *, dark: bool) -> str:
    """Return a text in Markdown as an HTML page.

    Parameters
    ----------
    title, text : str
    dark : bool
        Whether there are figures for dark backgrounds, too.
    """
    import markdown

    body = markdown.markdown(text, extensions=["tables"])
    body = IMAGE.sub(_for_both_backgrounds, body) if dark else body
    return rendered("page.html.jinja", title=title, body=body, dark=dark)


def _for_both_backgrounds(image: re.Match[str]) -> str:
    """Return an image element that selects the figure for the page's background."""
    text, name = image.groups()
    dark = f'<source srcset="{name}-dark.svg" media="(prefers-color-scheme: dark)">'
    return f'<picture>{dark}<img alt="{text}" src="{name}.svg"></picture>'
