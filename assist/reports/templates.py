"""Templates of reports in Jinja2: of HTML, in which content is escaped, and of Markdown, in which it is not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from planner.system.results import markdown_cell, markdown_table

from . import wording


def rendered(template: str, **content: Any) -> str:
    """Return the text that a template of this folder makes of the content."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=jinja2.select_autoescape(["html.jinja"], default=False),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    words = (wording.number, wording.prior, wording.short, wording.value)
    environment.filters |= {word.__name__: word for word in words}
    environment.filters |= {"table": markdown_table, "cell": markdown_cell}
    return environment.get_template(template).render(content).rstrip() + "\n"
