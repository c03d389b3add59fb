"""Tables of declared columns in CSV, which spreadsheets open as text, and from which the same rows are read."""

from __future__ import annotations

import csv
import io
import math
import re
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from planner.system.errors import InputFileError

CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff]")
"""Signs that are no text; some readers end a file at them. U+FFFD stands for them in CSV."""


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    about : str
        Its meaning.
    kind : type
        str, float or bool; an empty cell has no value.
    later : bool
        Whether exports of earlier versions may lack it.
    """

    about: str
    kind: type = str
    later: bool = False

    def value(self, cell: str) -> Any:
        """Return the value of a cell.

        Raises
        ------
        ValueError
            It is not of this kind; the message says what is expected.
        """
        if cell == "":
            return None
        if self.kind is bool:
            if cell not in ("true", "false"):
                raise ValueError("expected true or false")
            return cell == "true"
        if self.kind is str:
            return text_of(cell)
        try:
            number = float(cell)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise ValueError("expected a number")
        return number


def written(columns: Iterable[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """Return rows as CSV with the given columns. None is an empty cell; truth values are `true` and `false`."""
    content = io.StringIO()
    writer = csv.writer(content, lineterminator="\n")
    columns = list(columns)
    writer.writerow(columns)
    for row in rows:
        writer.writerow([_plain(row[name]) for name in columns])
    return content.getvalue()


def _plain(cell: Any) -> Any:
    if isinstance(cell, bool):
        return str(cell).lower()
    if isinstance(cell, str):
        # Some readers take a carriage return for the end of a row.
        text = CONTROL.sub("\ufffd", cell.replace("\r\n", "\n").replace("\r", "\n"))
        return f"'{text}" if is_formula(text) else text
    return cell


def is_formula(text: str) -> bool:
    """Whether a spreadsheet may evaluate a text, unless an apostrophe precedes it; or the same behind apostrophes.

    Spreadsheets skip blanks and invisible signs, and take full-width signs for the usual ones.
    """
    for place, sign in enumerate(text):
        if sign in "\t\n" and not text[:place].strip("'"):
            return True
        if sign != "'" and not sign.isspace() and unicodedata.category(sign) != "Cf":
            return unicodedata.normalize("NFKC", sign) in ("=", "+", "-", "@", "\u2212")
    return False


def text_of(cell: str) -> str:
    """Return the text of a cell that `written` wrote: without the apostrophe before what looks like a formula."""
    return cell[1:] if cell.startswith("'") and is_formula(cell) else cell


def rows(
    file: Path, columns: Mapping[str, Column], fault: Callable[[dict[str, Any]], str | None] = lambda _: None
) -> Iterator[dict[str, Any]]:
    """Yield the rows that `written` wrote to a file, with all columns.

    Parameters
    ----------
    file : Path
    columns : mapping of Column
        By name.
    fault : callable, optional
        Returns what is wrong in a row; None if nothing is.

    Raises
    ------
    InputFileError, OSError
        The file is damaged, has other columns, or cannot be read.
    """
    with file.open(newline="", encoding="utf-8") as stream:
        reader = csv.DictReader(stream)
        known = list(reader.fieldnames or ())
        needed = {name for name, column in columns.items() if not column.later}
        if len(known) > len({*known}) or not needed <= {*known} <= {*columns}:
            raise InputFileError.of(file, 1, f"expected the columns {', '.join(columns)}")
        for row in reader:
            if None in row or None in row.values():
                raise InputFileError.of(file, reader.line_num, f"expected {len(known)} columns, as in line 1")
            try:
                found = dict.fromkeys(columns) | {name: columns[name].value(cell) for name, cell in row.items()}
            except ValueError as error:
                raise InputFileError.of(file, reader.line_num, str(error)) from None
            if (wrong := fault(found)) is not None:
                raise InputFileError.of(file, reader.line_num, wrong)
            yield found
