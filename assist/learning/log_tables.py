"""Tables in text files, as spreadsheets, R, databases and people write them: any separator, with or without a frame."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

from planner.system.errors import plain

from .log_rows import Broken, Names, Row, Taken

SEPARATORS = ",;\t| "

RULE = re.compile(r"[\s|+:=-]*-{2}[\s|+:=-]*|\(\d+ rows?\)")
"""Lines that only frame a table, or count its rows, as databases print them."""

Line = tuple[int, list[str]]
"""Number of a line, and its cells."""


def read_table(
    lines: Sequence[str | Broken], sought: Collection[str], owners: Callable[[Mapping[str, str]], frozenset[Names]],
    taken: Taken,
) -> tuple[Line, list[Row]]:  # fmt: skip
    """Return the line with the names of a table's columns, and its rows: texts by the name of their column.

    Parameters
    ----------
    lines : sequence of str or Broken
    sought : collection of str
        Names, in lower case, that columns may have; each is there once at most.
    owners : function
        Returns whose a row is of which only the first cells are there, by name in lower case.
    taken : Taken
        Notes how the table was interpreted.
    """
    found: list[Row] = [(number, line) for number, line in enumerate(lines, start=1) if isinstance(line, Broken)]
    texts = [line if isinstance(line, str) else "" for line in lines]
    there = [text for text in texts if text.strip()]
    separator = _separator(there, sought)
    if there and _declared(there[0]) is not None:
        texts[texts.index(there[0])] = ""
    rows, end = _split(_without_rules(texts) if separator == "|" else _without_blanks(texts, separator), separator)
    head = rows[0] if rows else (1, [])
    if rows:
        found += _records(head, rows[1:], sought, owners, len(lines), taken)
    return head, found + end


def has_columns(texts: Sequence[str], sought: Collection[str]) -> bool:
    """Return whether the first of some lines has the name of a column."""
    head = texts[1 if _declared(texts[0]) and len(texts) > 1 else 0]
    return not set(sought).isdisjoint(_cells(head, _separator(texts, sought)))


def _declared(line: str) -> str | None:
    """Return the separator that a first line such as `sep=;` declares, as spreadsheets write it."""
    found = re.fullmatch(r'"?sep=(.)"?', line.rstrip("\r\n "), re.IGNORECASE)
    return found[1] if found else "\t" if line.rstrip(" ").lower() == "sep=\t" else None


def _separator(texts: Sequence[str], sought: Collection[str]) -> str:
    """Return the separator of the columns in the first line that is not blank."""
    declared = _declared(texts[0]) if texts else ","
    if declared is not None:
        return declared
    head = next((text for text in texts if not RULE.fullmatch(text.strip())), "")
    cells = {separator: _cells(head, separator) for separator in SEPARATORS}
    # Blanks stand around other separators, too.
    return max(cells, key=lambda sign: (len(set(sought).intersection(cells[sign])), sign != " ", len(cells[sign])))


def _cells(head: str, separator: str) -> list[str]:
    try:
        return [plain(cell).lower() for cell in next(csv.reader([head], delimiter=separator, skipinitialspace=True))]
    except csv.Error:
        return []


def _without_rules(texts: Sequence[str]) -> list[str]:
    """Return lines of a table with bars without its rules, its frame and the count of its rows."""
    lines = ["" if RULE.fullmatch(text.strip()) else text.strip() for text in texts]
    framed = all(line[0] == line[-1] == "|" for line in lines if line)
    return [line[1:-1] for line in lines] if framed else lines


def _without_blanks(texts: Sequence[str], separator: str) -> list[str]:
    """Return lines without blanks between a cell's closing quotation mark and a separator."""
    if separator == " ":
        return list(texts)
    blanks, end = " *" if separator == "\t" else "[ \\t]*", re.escape(separator)
    quoted = re.compile(rf'((?:^|{end}){blanks}"(?:[^"]|"")*"){blanks}(?={end}|$)', re.MULTILINE)
    return quoted.sub(r"\1", "\n".join(texts)).split("\n")


def _split(texts: Sequence[str], separator: str) -> tuple[list[Line], list[Row]]:
    """Return the cells of each row with its line, and the row at which the table ends early, if there is one."""
    reader = csv.reader((f"{text}\n" for text in texts), delimiter=separator, strict=True, skipinitialspace=True)
    rows: list[Line] = []
    while True:
        number = reader.line_num + 1
        try:
            cells = next(reader, None)
        except csv.Error as error:
            return rows, [(number, Broken(f"not CSV ({error}); what comes after it is not read"))]
        if cells is None:
            return rows, []
        if any(cell.strip() for cell in cells):
            rows.append((number, [cell.strip() for cell in cells]))


def _records(
    head: Line, rows: Sequence[Line], sought: Collection[str], owners: Callable[[Mapping[str, str]], frozenset[Names]],
    last: int, taken: Taken,
) -> Iterator[Row]:  # fmt: skip
    """Yield rows as records, by the names in the first of them."""
    shown, names = head[1], [plain(cell).lower() for cell in head[1]]
    if twice := [name for name in names if name in sought and names.count(name) > 1]:
        yield head[0], Broken(f"{names.count(twice[0])} columns are called {twice[0]}; expected one")
        return
    if _have_an_index(len(names), rows):
        shown, names = ["", *shown], ["", *names]
        taken.said.append("the first column, which has no name, as numbers of rows")
    repeated = [number for number, cells in rows if [plain(cell).lower() for cell in cells] == names]
    taken.heads += repeated
    least = max(k for k, name in enumerate(names) if name) + 1  # spreadsheets add empty columns at the end
    for number, cells in rows:
        if number in repeated:
            continue
        while len(cells) > len(names) and not cells[-1]:
            cells = cells[:-1]
        if least <= len(cells) <= len(names):
            yield number, {name: cell for name, cell in zip(shown, cells, strict=False) if name}
            continue
        unhurt = dict(zip(names, cells[:-1], strict=False))  # the last cell may be cut off
        message = f"{len(cells)} cells; expected {len(names)}, as in the first line"
        cut = "the last line is cut off; the lines before it are used"
        whose = owners(unhurt) if len(cells) < least else frozenset[Names]()
        yield number, Broken(cut if number == last else message, whose, number == last)


def _have_an_index(width: int, rows: Sequence[Line]) -> bool:
    """Return whether rows begin with a number that has no column name, as R's `write.table` writes them."""
    wide = [cells for _, cells in rows if len(cells) == width + 1]
    if not any(cells[-1] for cells in wide):  # an empty column at the end, as spreadsheets add
        return False
    numbers = [cells[0] for cells in wide if re.fullmatch(r"\d+", cells[0])]
    return len(numbers) > 1 and 2 * len(wide) > len(rows) and len(numbers) == len(wide) == len(set(numbers))
