"""Declared classes in TOML files: an error has the file, the line and the place of the fault, and what is expected.

What a command does with such a file is in `options` (`--setting`) and `cli/options/config.py` (`serve --config`).
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from planner.system.errors import InputFileError
from planner.system.files import bytes_of

from .declared import Beside, DeclarationError, annotation_of, bare, is_declared, marks, names_of, shown, spelt

T = TypeVar("T")


def load(file: Path) -> dict[str, Any]:
    """Read a TOML file, or raise an `InputFileError`. A byte order mark, as some editors write it, is ignored."""
    data = bytes_of(file)
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        message = f"byte {error.start} is not UTF-8; expected a text file in that encoding"
        raise InputFileError.of(file, line, message) from None
    except tomllib.TOMLDecodeError as error:  # whose fields with the place are of Python 3.14
        what, _, where = str(error).removesuffix(")").partition(" (at ")
        line, column = re.findall(r"\d+", where) or (len(data.splitlines()), None)
        at = where if column is None else f"column {column}"
        raise InputFileError.of(file, int(line), f"not TOML ({at}: {what})") from None


def fault(file: Path, place: str, message: str, fields: Sequence[str] = ()) -> InputFileError:
    """Return an error with the file, the line and the place of the fault, which may be one of these fields of it."""
    line = line_of(file, place, fields) if file.is_file() else None
    return InputFileError.of(file, line, f"{place}: {message}")


def line_of(file: Path, place: str, fields: Sequence[str] = ()) -> int:
    """Return the line, counted from 1, where a value begins, or the table that should contain it.

    Of a table it is the line of the first of the given fields that stands there.
    """
    text = file.read_bytes().decode("utf-8-sig", errors="replace").replace("\r\n", "\n")
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return 1
    path = _path(content, place)
    path += [name for name in fields if _has(content, [*path, name])][:1]
    lines = text.split("\n")
    before, until = 0, len(lines) if path else 1  # what is in the first `until` lines, and not in the first `before`
    while until > before + 1:
        middle = (before + until) // 2
        for number in (*range(middle, until), *range(middle - 1, before, -1)):
            try:
                there = _has(tomllib.loads("\n".join(lines[:number])), path)
            except tomllib.TOMLDecodeError:  # they end within a value of several lines
                continue
            before, until = (before, number) if there else (number, until)
            break
        else:
            break
    return before + 1


def _path(content: Any, place: str) -> list[Any]:
    """Return the way to a place as messages say it, as far as it is there; names may have dots and brackets."""
    path, rest = list[Any](), f".{place}"
    while rest:
        keys = {f".{key}": key for key in content} if isinstance(content, Mapping) else {}
        keys |= {f"[{number + 1}]": number for number in range(len(content))} if isinstance(content, list) else {}
        fits = [said for said in keys if rest == said or rest.startswith((f"{said}.", f"{said}["))]
        if not fits:
            break
        said = max(fits, key=len)
        content, rest = content[keys[said]], rest.removeprefix(said)
        path.append(keys[said])
    return path


def _has(content: Any, path: list[Any]) -> bool:
    try:
        for key in path:
            content = content[key]
    except (KeyError, IndexError, TypeError):
        return False
    return True


def convert(content: Any, kind: type[T], file: Path, place: str = "") -> T:
    """Convert the table at a place of a file, or the whole file, to a declared class.

    Raises
    ------
    InputFileError
        A field does not fit.
    """
    with told(file, place):
        if not isinstance(content, Mapping):
            raise fault(file, place or "the file", f"{shown(content)}; expected a table")
        return kind(**beside(kind, content, file.parent))


def replaced(base: T, content: Mapping[str, Any], file: Path, place: str) -> T:
    """Return an object of a declared class with the fields that the table at a place of a file sets.

    Raises
    ------
    InputFileError
        A field does not fit.
    """
    with told(file, place):
        return replace(base, **beside(type(base), content, file.parent))  # type: ignore[type-var]


def beside(kind: Any, content: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return a table of a declared class in which paths begin in a folder."""
    known = names_of(kind)
    found = dict(content)
    for name, value in content.items():
        annotation = annotation_of(kind, name) if name in known else None
        mark = next((one for one in marks(annotation) if isinstance(one, Beside)), None)
        if mark is not None and isinstance(value, str):
            found[name] = mark.found(folder, value)
        elif isinstance(value, Mapping) and is_declared(bare(annotation)):
            found[name] = beside(bare(annotation), value, folder)
    return found


@contextmanager
def told(file: Path, place: str = "") -> Iterator[None]:
    """Tell errors of declared classes with the file and the place of the fault."""
    try:
        yield
    except DeclarationError as error:
        within = f"{place}.{spelt(error.place)}".strip(".") if error.place else place
        raise fault(file, within or "the file", error.told, error.fields) from None


def label(mapping: Mapping[str, Any]) -> str:
    """Return the label of a setting: its keys and values in their order, those of a table in parentheses."""

    def said(value: Any) -> str:
        if isinstance(value, Mapping):
            return f"({label(value)})"
        short = f"{value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else None
        return str(value) if short is None or float(short) != value else short

    return ", ".join(f"{key} {said(value)}" for key, value in mapping.items())
