"""File formats of logs: JSON and tables, as people, pandas, R and spreadsheets write them.

`read_records` returns a file's records with their lines and the column names of a log, and describes how the file was
interpreted. A line that is no record is a `Broken`. Ambiguous values are not guessed: they are left as they are, and
become faults with their lines.
"""

from __future__ import annotations

import csv
import difflib
import json
import re
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE, BOM_UTF32_BE, BOM_UTF32_LE
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unicodedata import category

COLUMNS = ("person", "episode", "step", "action", "suggestion", "executed")
NEEDED = COLUMNS[:4]
NAMES = COLUMNS[:2]
ACTIONS = COLUMNS[3:]

MISSING = frozenset(
    (
        "#N/A", "#N/A N/A", "#NA", "-1.#IND", "-1.#QNAN", "-NaN", "-nan", "1.#IND", "1.#QNAN", "<NA>", "N/A", "NA",
        "NULL", "NaN", "NaT", "None", "n/a", "nan", "null",
    )
)  # fmt: skip
"""Notations of a missing value besides an empty cell; the list of pandas."""

BINARY = {
    b"\x1f\x8b": "a compressed file",
    b"PK\x03\x04": "a spreadsheet's own file, or an archive",
    b"\xd0\xcf\x11\xe0": "a spreadsheet's own file",
    b"PAR1": "a Parquet file",
}
"""First bytes of files that are no text."""

SEPARATORS = ",;\t| "

Names = tuple[str, str]
"""A person and one of their episodes."""

Row = tuple[int, Any]
"""Number of a line, from 1, and its content: a record, a `Broken`, or another value that is no record."""


@dataclass(frozen=True)
class Broken:
    """A line that is no record.

    Attributes
    ----------
    message : str
    owners : set of Names
        People and episodes that the rest of the line names; empty if unknown.
    ends : bool
        Whether the file ends within this line.
    """

    message: str
    owners: frozenset[Names] = frozenset()
    ends: bool = False


@dataclass
class Taken:
    """How a file was interpreted."""

    said: list[str] = field(default_factory=list)
    missing: dict[str, None] = field(default_factory=dict)
    steps: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        said = list(self.said)
        if self.missing:
            said.append(f"{' and '.join(map(repr, self.missing))} as a missing value")
        if self.steps:
            said.append(f"steps such as {self.steps[0]!r} as whole numbers")
        return f"read {', '.join(said)}" if said else ""


def read_records(file: Path, columns: Mapping[str, str]) -> tuple[list[Row], str]:
    """Return a file's records, and a description of how it was interpreted, which is empty for a plain file.

    Parameters
    ----------
    file : Path
    columns : mapping of str to str
        The file's name of each column of a log; checked by `own_names`.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        `columns` has a name that the file does not have.
    """
    taken, data = Taken(), file.read_bytes()
    for mark, kind in BINARY.items():
        if data.startswith(mark):
            return [(1, Broken(f"this is {kind}; expected a text file, CSV or JSON Lines"))], ""
    lines = _lines(data, taken)
    texts = [line for line in lines if isinstance(line, str) and line.strip()]
    head = texts[0].strip() if texts else ""
    if re.match(r"\[\s*(\{|$)", head):
        rows = list(_listed([line if isinstance(line, str) else "" for line in lines]))
    elif head.startswith(("{", "[")) or not _is_table(file, texts, columns):
        rows = list(_objects(lines))
    else:
        return tidy(list(_table(lines, columns, file, taken)), taken), str(taken)
    return tidy(_named(rows, columns, file), taken), str(taken)


def own_names(columns: Mapping[str, str] | None) -> dict[str, str]:
    """Return the columns that a user has named, in lower case.

    Raises
    ------
    ValueError
        A log has no such column, or two columns have the same name.
    """
    found: dict[str, str] = {}
    for name, own in (columns or {}).items():
        key = name.strip().lower()
        if key not in COLUMNS:
            near = difflib.get_close_matches(key, COLUMNS, n=1)
            meant = f"did you mean '{near[0]}'?" if near else f"it has {', '.join(COLUMNS)}"
            raise ValueError(f"columns {name}={own}: a log has no column '{name}'; {meant}")
        if own.strip().lower() in found.values():
            raise ValueError(f"columns {name}={own}: '{own}' stands for another column already")
        found[key] = own.strip().lower()
    return found


def tidy(rows: Iterable[Row], taken: Taken) -> list[Row]:
    """Return records with None for missing values, and integers for steps in any notation."""
    rows = [(number, dict(record) if isinstance(record, Mapping) else record) for number, record in rows]
    records = [record for _, record in rows if isinstance(record, dict)]
    for record in records:
        for key in ("step", *ACTIONS):
            if key in record and _is_missing(record[key], taken):
                record[key] = None
        for key in NAMES:
            if isinstance(record.get(key), str) and not record[key].strip():
                record[key] = None
            elif isinstance(record.get(key), float) and record[key] == record[key]:
                record[key] = str(record[key])
    plain = any(_digits(record.get("step")) for record in records)
    for record in records:
        step = record.get("step")
        whole = _whole(step, thousands=plain)
        if whole is not None:
            record["step"] = whole
            taken.steps += [str(step)] * (not _digits(step))
    return rows


def is_hidden(text: str) -> bool:
    """Return whether a text has characters that cannot be shown or written."""
    return any(category(sign) in ("Cc", "Cs") for sign in " ".join(text.split()))


def _is_missing(value: object, taken: Taken) -> bool:
    if value is None or (isinstance(value, str) and not value.strip()):
        return True
    word = str(value).strip() if not isinstance(value, int) else ""
    if word in MISSING:
        taken.missing.setdefault(word)
    return word in MISSING


def _digits(value: object) -> bool:
    return type(value) is int or (isinstance(value, str) and re.fullmatch(r"[+-]?\d+", value.strip()) is not None)


def _whole(value: object, *, thousands: bool) -> int | None:
    """Return a step as an integer; None if it is none, or ambiguous, such as 1,000.

    Parameters
    ----------
    value : object
    thousands : bool
        Whether other steps have no decimals, so that in 1,000 the comma may separate thousands.
    """
    if isinstance(value, float):
        return int(value) if value.is_integer() else None
    if not isinstance(value, str):
        return None
    text = value.strip()
    if re.fullmatch(r"[+-]?\d{1,20}", text):
        return int(text)
    if found := re.fullmatch(r"([+-]?\d{1,20})[.,](0*)", text):
        return None if thousands and len(found[2]) == 3 and len(found[1].lstrip("+-")) <= 3 else int(found[1])
    if re.fullmatch(r"\d([.,]\d{1,14})?[eE]\+?\d\d?", text):  # as R writes 100000
        number = float(text.replace(",", "."))
        return int(number) if number.is_integer() else None
    return None


def _lines(data: bytes, taken: Taken) -> list[str | Broken]:
    """Return the lines of a file; the last one is empty if the file ends with a line break."""
    encoding = _foreign(data)
    if encoding is None:
        return [_decoded(line) for line in re.split(rb"\r\n|\r|\n", data.removeprefix(BOM_UTF8))]
    taken.said.append(f"as {encoding[:6].upper()}")
    try:
        text, damaged = data.decode(encoding), False
    except UnicodeDecodeError:
        text, damaged = data.decode(encoding, errors="replace"), True
    lines = re.split(r"\r\n|\r|\n", text.removeprefix("\ufeff"))
    message = f"its bytes are not {encoding[:6].upper()}, as those of other lines are"
    return [Broken(message, _owners_but_damaged(line)) if damaged and "\ufffd" in line else line for line in lines]


def _foreign(data: bytes) -> str | None:
    """Return the likely encoding of a text that is not UTF-8."""
    for mark, name in (
        (BOM_UTF32_LE, "utf-32"), (BOM_UTF32_BE, "utf-32"), (BOM_UTF16_LE, "utf-16"), (BOM_UTF16_BE, "utf-16"),
    ):  # fmt: skip
        if data.startswith(mark):
            return name
    zeros = tuple(k for k, byte in enumerate(data[:4]) if byte == 0)
    return {(1, 3): "utf-16-le", (0, 2): "utf-16-be", (1, 2, 3): "utf-32-le", (0, 1, 2): "utf-32-be"}.get(zeros)


def _decoded(line: bytes) -> str | Broken:
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        text = line.decode("utf-8", errors="replace")
        return Broken("its bytes are not UTF-8; expected a file in that encoding", _owners_but_damaged(text))


def _owners_but_damaged(text: str) -> frozenset[Names]:
    return frozenset(names for names in _owners(text) if "\ufffd" not in "".join(names))


# JSON


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any] | Broken:
    """Return a JSON object; raise an error if two of its fields have the same name."""
    record = dict(pairs)
    if len(record) == len(pairs):
        return record
    twice = next(name for name, count in Counter(name for name, _ in pairs).items() if count > 1)
    return Broken(f"two fields are called {twice}")


def _objects(lines: Sequence[str | Broken]) -> Iterator[Row]:
    """Yield the records of JSON Lines."""
    for number, line in enumerate(lines, start=1):
        if isinstance(line, Broken):
            yield number, line
        elif line.strip():
            try:
                yield number, json.loads(line, object_pairs_hook=_once)
            except (ValueError, RecursionError):
                if number == len(lines):  # a whole last line ends with a line feed
                    cut = "the last line is cut off; the lines before it are used"
                    yield number, Broken(cut, _owners(line), ends=True)
                else:
                    yield number, Broken("not JSON; expected one object in every line", _owners(line))


def _listed(lines: Sequence[str]) -> Iterator[Row]:
    """Yield the records of a JSON list, as pandas and R write tables."""
    text, decoder = "\n".join(lines), json.JSONDecoder(object_pairs_hook=_once)
    at, number, counted = text.index("[") + 1, 1, 0
    blanks = re.compile(r"[\s,]*")
    while True:
        at = blanks.match(text, at).end()  # type: ignore[union-attr]  # it matches everywhere
        number, counted = number + text.count("\n", counted, at), at
        if text[at : at + 1] == "]":
            if text[at + 1 :].strip():
                yield number, Broken("there is more after the list; what comes after it is not read")
            return
        try:
            record, at = decoder.raw_decode(text, at)
        except (ValueError, RecursionError):
            yield number, Broken("not JSON; expected a list of objects; what comes after it is not read")
            return
        yield number, record


NAMED = re.compile(r'"(person|episode)"\s*:\s*(?:("(?:[^"\\]|\\.)*")|(-?\d+)(?=\s*[,}]))')


def _owners(text: str) -> frozenset[Names]:
    """Return the people and episodes that a broken line names; it may hold several records or parts of them."""
    found: dict[str, list[str]] = {"person": [], "episode": []}
    for key, quoted, number in NAMED.findall(text):
        try:
            found[key].append(json.loads(quoted) if quoted else number)
        except ValueError:
            return frozenset()
    known = len(found["person"]) == len(found["episode"]) and not any(
        map(is_hidden, found["person"] + found["episode"])
    )
    return frozenset(zip(found["person"], found["episode"], strict=True)) if known else frozenset()


def _named(rows: Sequence[Row], columns: Mapping[str, str], file: Path) -> list[Row]:
    """Yield records with the column names of a log, from the user's names in any case."""
    keys = Counter(key for _, record in rows if isinstance(record, dict) for key in record)
    _check(columns, [key.lower() for key in keys], file)
    source = {name: columns.get(name, name) for name in COLUMNS}
    renamed = {key: name for name, own in source.items() for key in keys if key.lower() == own}
    found: list[Row] = []
    for number, record in rows:
        if not isinstance(record, dict):
            found.append((number, record))
            continue
        mine = {renamed[key]: value for key, value in record.items() if key in renamed}
        twice = next((name for name, n in Counter(renamed[k] for k in record if k in renamed).items() if n > 1), None)
        found.append((number, mine if twice is None else Broken(f"two fields are called {source[twice]}")))
    return found


# Tables


def _is_table(file: Path, texts: Sequence[str], columns: Mapping[str, str]) -> bool:
    """Return whether a file whose first line is no JSON is a table."""
    if file.suffix.lower() in (".csv", ".tsv", ".txt"):
        return True
    if any(line.lstrip().startswith("{") for line in texts) or not texts:
        return False
    head = texts[1 if _declared(texts[0]) and len(texts) > 1 else 0]
    return bool(_known(_cells(head, _separator(texts, columns)), columns)) or file.suffix.lower() not in (
        ".jsonl",
        ".json",
    )


def _declared(line: str) -> str | None:
    """Return the separator that a first line such as `sep=;` declares, as spreadsheets write it."""
    found = re.fullmatch(r'"?sep=(.)"?', line.rstrip("\r\n "), re.IGNORECASE) if line.strip() else None
    return found[1] if found else "\t" if line.rstrip(" ").lower() == "sep=\t" else None


def _separator(texts: Sequence[str], columns: Mapping[str, str]) -> str:
    """Return the separator of the columns in the first line."""
    if not texts:
        return ","
    declared = _declared(texts[0])
    if declared is not None:
        return declared
    cells = {separator: _cells(texts[0], separator) for separator in SEPARATORS}
    return max(cells, key=lambda separator: (len(_known(cells[separator], columns)), len(cells[separator])))


def _known(cells: Sequence[str], columns: Mapping[str, str]) -> set[str]:
    return {name for name in COLUMNS if columns.get(name, name) in cells}


def _cells(head: str, separator: str) -> list[str]:
    try:
        return [cell.strip().lower() for cell in next(csv.reader([head], delimiter=separator, skipinitialspace=True))]
    except csv.Error:
        return []


def _check(columns: Mapping[str, str], there: Sequence[str], file: Path) -> None:
    for name, own in columns.items():
        if there and own not in there:
            near = difflib.get_close_matches(own, there, n=1)
            meant = f"; did you mean '{near[0]}'?" if near else f"; it has {', '.join(filter(None, there))}"
            raise ValueError(f"columns {name}={own}: {file} has no column '{own}'{meant}")


def _table(lines: Sequence[str | Broken], columns: Mapping[str, str], file: Path, taken: Taken) -> Iterator[Row]:
    """Yield the records of a table whose first line has the column names; an empty cell is None."""
    yield from ((number, line) for number, line in enumerate(lines, start=1) if isinstance(line, Broken))
    texts = [line if isinstance(line, str) else "" for line in lines]
    first = next((k for k, text in enumerate(texts) if text.strip()), 0)
    separator = _separator([text for text in texts if text.strip()], columns)
    if texts and _declared(texts[first]) is not None:
        texts[first] = ""
    rows, broken = _split(texts, separator)
    if rows:
        yield from _matched(rows[0], rows[1:], columns, file, len(lines), taken)
    yield from broken


def _split(texts: Sequence[str], separator: str) -> tuple[list[tuple[int, list[str]]], list[Row]]:
    """Return the cells of each row with its line, and the row at which the table ends early, if there is one."""
    reader = csv.reader((f"{text}\n" for text in texts), delimiter=separator, strict=True, skipinitialspace=True)
    rows: list[tuple[int, list[str]]] = []
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


def _matched(
    head: tuple[int, list[str]], rows: Sequence[tuple[int, list[str]]], columns: Mapping[str, str], file: Path,
    last: int, taken: Taken,
) -> Iterator[Row]:  # fmt: skip
    """Return rows as records, by the names in the first of them."""
    number, names = head[0], [cell.strip("\ufeff ").lower() for cell in head[1]]
    _check(columns, names, file)
    for name in COLUMNS:
        own = columns.get(name, name)
        if names.count(own) > 1:
            yield number, Broken(f"{names.count(own)} columns are called {own}; expected one")
            return
    missing = [name for name in NEEDED if columns.get(name, name) not in names]
    if missing:
        there = ", ".join(filter(None, names))
        yield (
            number,
            Broken(
                f"no column is called {' or '.join(missing)}; expected {', '.join(COLUMNS[:5])}, or --columns "
                f"{missing[0]}=NAME with one of {there}"
            ),
        )
        return
    if _have_an_index(len(names), rows):
        names = ["", *names]
        taken.said.append("the first column, which has no name, as numbers of rows")
    least = max(k for k, name in enumerate(names) if name) + 1  # spreadsheets add empty columns at the end
    place = {name: names.index(columns.get(name, name)) for name in COLUMNS if columns.get(name, name) in names}
    for number, cells in rows:
        while len(cells) > len(names) and not cells[-1]:
            cells = cells[:-1]
        if least <= len(cells) <= len(names):
            yield number, {name: _cell(name, cells[k], taken) for name, k in place.items()}
            continue
        whole = dict(zip(names, cells[:-1], strict=False))  # the last cell may be cut off
        owner = tuple(whole.get(columns.get(name, name), "") for name in NAMES)
        owners = frozenset({(owner[0], owner[1])}) if all(owner) and len(cells) < least else frozenset()
        ends = number == last
        message = f"{len(cells)} cells; expected {len(names)}, as in the first line"
        yield (
            number,
            Broken("the last line is cut off; the lines before it are used" if ends else message, owners, ends),
        )


def _have_an_index(width: int, rows: Sequence[tuple[int, list[str]]]) -> bool:
    """Return whether rows begin with a number that has no column name, as R's `write.table` writes them."""
    wide = [cells for _, cells in rows if len(cells) == width + 1]
    if not any(cells[-1] for cells in wide):  # an empty column at the end, as spreadsheets add
        return False
    numbers = [cells[0] for cells in wide if re.fullmatch(r"\d+", cells[0])]
    return len(numbers) > 1 and 2 * len(wide) > len(rows) and len(numbers) == len(wide) == len(set(numbers))


def _cell(name: str, cell: str, taken: Taken) -> Any:
    if not cell or (name in NAMES and cell in MISSING - {"NA"}):
        return None
    if name in ACTIONS and cell.upper() in ("TRUE", "FALSE"):
        return cell.upper() == "TRUE"
    if name in NAMES and cell == "NA" and (note := f"NA as the name of a {name}") not in taken.said:
        taken.said.append(note)
    return cell
