"""A report as an HTML page."""

from __future__ import annotations

import html
import importlib.util
import re

from planner.system.errors import MissingExtraError

PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<meta name="color-scheme" content="{schemes}">
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
    return PAGE.format(title=html.escape(title), body=body, schemes="light dark" if dark else "light")


def _for_both_backgrounds(image: re.Match[str]) -> str:
    """Return an image element that selects the figure for the page's background."""
    text, name = image.groups()
    dark = f'<source srcset="{name}-dark.svg" media="(prefers-color-scheme: dark)">'
    return f'<picture>{dark}<img alt="{text}" src="{name}.svg"></picture>'
