"""Lines of text that pages show of a view and of a person's events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Line:
    """Marks a field of a view, or a kind of event, that pages show as a line of text while it has a value.

    No line is shown of what is empty, zero or false.

    Attributes
    ----------
    person : str, optional
        Key of the text on the person's page, in which {value} stands for the value.
    operator : str, optional
        The text on the operator's page.
    """

    person: str | None = None
    operator: str | None = None


def line_of(field: Any) -> Line:
    """Return the line of a declared field, which is empty unless it is marked so."""
    return next((one for one in field.metadata if isinstance(one, Line)), Line())
