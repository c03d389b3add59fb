"""JSON files of logs: one object a line, a list, or a table as pandas, R and others write it."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import zip_longest
from typing import Any

from .log_rows import Broken, Names, Row


def read_json(
    lines: Sequence[str | Broken], is_column: Callable[[object], bool], owners: Callable[[str], frozenset[Names]]
) -> list[Row]:
    """Return the records in the lines of a JSON file.

    Parameters
    ----------
    lines : sequence of str or Broken
    is_column : function
        Returns whether a name is that of a column of the log.
    owners : function
        Returns whom a damaged line names.
    """
    texts = [line if isinstance(line, str) else "" for line in lines]
    first, *others = [text.strip() for text in texts if text.strip()] or [""]
    pretty = first in ("{", "[") and not (others and first == others[0][:1] == "{")
    stream = pretty or re.match(r"\[\s*\{", first)
    rows = _documents(texts) if stream else _by_line(lines, owners)
    found = [(number, each) for number, value in rows for each in _records(value, is_column)]
    return _with_names(found, is_column)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any] | Broken:
    """Return a JSON object; raise an error if two of its fields have the same name."""
    record = dict(pairs)
    if len(record) == len(pairs):
        return record
    twice = next(name for name, count in Counter(name for name, _ in pairs).items() if count > 1)
    return Broken(f"two fields are called {twice}")


def _by_line(lines: Sequence[str | Broken], owners: Callable[[str], frozenset[Names]]) -> Iterator[Row]:
    """Yield the document in each line."""
    for number, line in enumerate(lines, start=1):
        if isinstance(line, Broken):
            yield number, line
        elif line.strip():
            try:
                yield number, json.loads(line, object_pairs_hook=_once)
            except (ValueError, RecursionError):
                if number == len(lines):  # a whole last line ends with a line feed
                    cut = "the last line is cut off; the lines before it are used"
                    yield number, Broken(cut, owners(line), ends=True)
                else:
                    yield number, Broken("not JSON; expected one object in every line", owners(line))


def _documents(lines: Sequence[str]) -> Iterator[Row]:
    """Yield the objects in documents of several lines, also those in lists, each with the line where it begins."""
    text, decoder = "\n".join(lines), json.JSONDecoder(object_pairs_hook=_once)
    at, number, counted, listed, ended = 0, 1, 0, False, False
    blanks = re.compile(r"[\s,]*")
    while True:
        at = blanks.match(text, at).end()  # type: ignore[union-attr]  # it matches everywhere
        number, counted = number + text.count("\n", counted, at), at
        sign = text[at : at + 1]
        if not sign and not listed:
            return
        if (sign == "[" and not listed) or (sign == "]" and listed):
            listed, ended, at = not listed, listed, at + 1
            continue
        try:
            value, at = decoder.raw_decode(text, at)
        except (ValueError, RecursionError):
            what = "there is more after the list" if ended else "not JSON; expected a list of objects"
            yield number, Broken(f"{what}; what comes after it is not read")
            return
        yield number, value


def _records(value: Any, is_column: Callable[[object], bool], depth: int = 3) -> Iterator[Any]:
    """Yield the records of a document: itself, or those in a list or in a table that it holds, up to a depth."""
    if isinstance(value, list) and depth:
        if all(isinstance(each, list | dict | Broken) for each in value):
            for each in value:
                yield from _records(each, is_column, depth - 1)
            return
    elif isinstance(value, dict) and depth:
        if broken := [each for each in value.values() if isinstance(each, Broken)]:
            yield broken[0]
            return
        if any(map(is_column, value)):
            yield from _of_columns(value)
            return
        names, rows = value.get("columns"), value.get("data")
        if isinstance(names, list) and isinstance(rows, list) and any(map(is_column, names)):
            yield names
            yield from rows
            return
        lists = [each for each in value.values() if isinstance(each, list) and any(isinstance(e, dict) for e in each)]
        lists = lists if len(lists) < 2 or "data" not in value else [value["data"]]  # beside its schema
        if len(lists) == 1:
            yield from _records(lists[0], is_column, depth - 1)
            return
        if value and all(isinstance(each, dict) and any(map(is_column, each)) for each in value.values()):
            yield from value.values()
            return
    yield value


def _of_columns(value: dict[str, Any]) -> Iterator[Any]:
    """Yield the records of a table whose columns are objects by row, or lists; a plain object is its own record."""
    columns = list(value.values())
    if all(isinstance(column, dict) for column in columns):
        for row in dict.fromkeys(row for column in columns for row in column):
            yield {name: column.get(row) for name, column in value.items()}
    elif all(isinstance(column, list) for column in columns):
        if len({len(column) for column in columns}) > 1:
            sizes = ", ".join(f"{name} {len(column)}" for name, column in value.items())
            yield Broken(f"columns of different lengths: {sizes}")
            return
        for row in zip_longest(*columns):
            yield dict(zip(value, row, strict=True))
    else:
        yield value


def _with_names(rows: Sequence[Row], is_column: Callable[[object], bool]) -> list[Row]:
    """Return rows that are lists as records, if the first of them has the names of the columns."""
    names: list[str] | None = None
    found: list[Row] = []
    for number, value in rows:
        if not isinstance(value, list):
            found.append((number, value))
        elif any(isinstance(each, str) and is_column(each) for each in value) and (names is None or names == value):
            names = [str(each) for each in value]
        elif names is None:
            found.append((number, value))
        elif len(value) == len(names):
            found.append((number, dict(zip(names, value, strict=True))))
        else:
            found.append((number, Broken(f"a list of {len(value)}; expected {len(names)}, as in the first")))
    return found
