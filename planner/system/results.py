"""What every result offers: one line, a table or a picture in a notebook, a frame, and comparison by content."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from .arrays import outline
from .errors import require_package

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

MOST_ROWS = 20
"""Rows of a result that a notebook shows; a frame has all."""
MARKUP = re.compile(r"<(?=[!/?a-zA-Z])")
"""Signs with which HTML begins a tag or a comment."""


class ByContent:
    """A mixin of frozen dataclasses that hold arrays, which are made with `eq=False, repr=False`.

    Two are equal if their fields are: arrays by shape and entries, where NaN equals NaN. They are not hashed, as their
    arrays are not.
    """

    __hash__: ClassVar[None]  # type: ignore[assignment]

    def __repr__(self) -> str:
        return outline(self)

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and _same_fields(self, other)


class Result(ByContent):
    """A result with rows: a table in a notebook, and a frame."""

    def records(self) -> Sequence[Mapping[str, Any]]:
        """Return the rows of the table, each as a mapping of columns to values."""
        return [{field.name: getattr(self, field.name) for field in fields(self)}]  # type: ignore[arg-type]

    def to_frame(self) -> Any:
        """Return the table as a `pandas.DataFrame`.

        Raises
        ------
        MissingExtraError
            pandas is not installed.
        """
        require_package("a frame needs", "pandas", "study")
        import pandas

        return pandas.DataFrame.from_records(list(self.records()))

    def _repr_html_(self) -> str:
        """Return the first rows as a table."""
        rows = self.records()
        return html_table(rows[:MOST_ROWS]) + (f"<p>{len(rows):,} rows</p>" if len(rows) > MOST_ROWS else "")


def same(one: Any, other: Any) -> bool:
    """Return whether two values are equal; arrays, and dataclasses and containers of them, are compared by content."""
    if one is other:
        return True
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        if not (isinstance(one, np.ndarray) and isinstance(other, np.ndarray)) or one.dtype != other.dtype:
            return False
        return np.array_equal(one, other, equal_nan=one.dtype.kind in "fc")
    if type(one) is not type(other):
        return False
    if isinstance(one, ByContent):
        return bool(one == other)
    if is_dataclass(one) and not isinstance(one, type):
        return _same_fields(one, other)
    if isinstance(one, Mapping):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float | np.floating) and one != one:
        return bool(other != other)  # both are NaN
    return bool(one == other)


def _same_fields(one: Any, other: Any) -> bool:
    return all(same(getattr(one, field.name), getattr(other, field.name)) for field in fields(one))


def html_table(rows: Sequence[Mapping[Any, Any]], head: Sequence[str] = ()) -> str:
    """Return rows as a table of HTML, below a head or the names of columns; numbers have four significant digits.

    Columns without any entry are left out.
    """
    filled = {name for row in rows for name, value in row.items() if head or value is not None}
    columns = [name for name in dict.fromkeys(name for row in rows for name in row) if name in filled]
    top = "".join(f"<th>{html.escape(str(name))}</th>" for name in head or columns)
    body = "".join(f"<tr>{''.join(f'<td>{_cell(row.get(name))}</td>' for name in columns)}</tr>" for row in rows)
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table in Markdown without the columns that are empty in every row."""
    lines = [[markdown_cell(each) for each in row] for row in rows]
    kept = [place for place in range(len(head)) if not lines or any(line[place] for line in lines)]
    shown = [[line[place] for place in kept] for line in ([*head], ["---"] * len(head), *lines)]
    return "\n".join("| " + " | ".join(line) + " |" for line in shown)


def markdown_cell(content: object) -> str:
    """Return the text of a cell of such a table: on one line, with markup shown as it is written."""
    return MARKUP.sub("&lt;", " ".join(str(content).split()).replace("|", "\\|"))


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float | np.floating):
        return f"{value:.4g}"
    if isinstance(value, int | np.integer) and not isinstance(value, bool):
        return f"{value:,}"
    return html.escape(str(value))


GROUP = "planner.pictures"


@cache
def _drawers() -> tuple[EntryPoint, ...]:
    """Return the installed functions that draw. To find them takes some milliseconds."""
    from importlib.metadata import entry_points  # slow to import

    return tuple(entry_points(group=GROUP))


class Pictured:
    """An object that is a picture in a notebook if an installed package draws it, and else a line.

    The planner draws nothing. A package that draws declares a function in the entry point group `planner.pictures`. The
    function gets an object and returns an SVG document, or None if it has no picture of it. So neither package imports
    the other by name, and users need not import the one that draws.
    """

    def _repr_svg_(self) -> str | None:
        return next((svg for drawer in _drawers() if (svg := drawer.load()(self)) is not None), None)
