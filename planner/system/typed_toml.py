"""Typed tables of TOML: what is missing, unknown or of the wrong kind is named with its place, and what would be right.

The types are msgspec's `Struct`, the descriptions those of their fields.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec
from msgspec import UNSET, Meta, Struct, UnsetType

from .errors import InputFileError
from .errors import expected as meant

T = TypeVar("T")

Text = Annotated[str, Meta(min_length=1, description="a text")]
Whole = Annotated[int, Meta(ge=1, description="a whole number of 1 or more")]
Seed = Annotated[int, Meta(ge=0, description="a whole number of 0 or more")]
Number = Annotated[float, Meta(description="a number")]
Truth = Annotated[bool, Meta(description="true or false")]
Texts = Annotated[tuple[Text, ...], Meta(min_length=1, description="a list of texts")]
Wholes = Annotated[tuple[Whole, ...], Meta(min_length=1, description="a list of whole numbers of 1 or more")]
Pair = Annotated[tuple[float, float], Meta(description="two numbers, [low, high]")]
AnyTable = Annotated[dict[str, Any], Meta(description="a table")]
Tables = Annotated[list[dict[str, Any]], Meta(min_length=1, description="one table or more")]

KINDS = {float: Number, int: Annotated[int, Meta(description="a whole number")], bool: Truth, str: Text}
FAULT = re.compile(r"(?P<what>.*?)(?: - at `\$(?P<path>.*)`)?", re.DOTALL)
NAMED = re.compile(r"Object (?P<fault>contains unknown|missing required) field `(?P<key>.*)`")


def load(file: Path) -> dict[str, Any]:
    """Read a TOML file; a byte order mark, as some editors write it, is left out.

    Raises
    ------
    InputFileError
    """
    try:
        data = file.read_bytes()
    except FileNotFoundError:
        raise InputFileError(f"{file}: no such file") from None
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        message = f"byte {error.start} is not UTF-8; expected a text file in that encoding"
        raise InputFileError(f"{file}:{line}: {message}") from None
    except tomllib.TOMLDecodeError as error:
        raise InputFileError(f"{file}: {error}") from None


def fault(file: Path, place: str, message: str) -> InputFileError:
    """Say what is wrong where."""
    return InputFileError(f"{file}: {place}: {message}")


@contextmanager
def located(file: Path) -> Iterator[None]:
    """Add the line to what is said of a place in a file."""
    try:
        yield
    except InputFileError as error:
        what = str(error).removeprefix(f"{file}: ")
        if what == str(error) or not file.is_file():
            raise
        raise InputFileError(f"{file}:{line_of(file, what)}: {what}") from error.__cause__


def line_of(file: Path, fault: str) -> int:
    """Find the line, from 1, in which what a fault is about begins, or else the table in which it should be."""
    said = re.search(r"\(at line (\d+), column \d+\)", fault)
    text = file.read_bytes().decode("utf-8-sig", errors="replace")
    if said or "end of document" in fault:
        return int(said[1]) if said else len(text.splitlines())
    path: list[Any] = [
        int(number) - 1 if number else name
        for name, number in re.findall(r"([^.\[\]]+)|\[(\d+)\]", fault.partition(": ")[0])
    ]
    lines = text.splitlines()
    parsed: list[tuple[int, dict[str, Any]]] = [(0, {})]
    for number in range(1, len(lines) + 1):  # what begins within a value of several lines is no document
        try:
            parsed.append((number, tomllib.loads("\n".join(lines[:number]))))
        except tomllib.TOMLDecodeError:
            continue
    while path:
        for (before, _), (_, content) in pairwise(parsed):
            if _has(content, path):
                return before + 1
        path.pop()
    return 1


def _has(content: Any, path: list[Any]) -> bool:
    try:
        for key in path:
            content = content[key]
    except (KeyError, IndexError, TypeError):
        return False
    return True


def convert(content: Any, kind: type[T], file: Path, place: str = "") -> T:
    """Give a table as a type.

    Parameters
    ----------
    content : dict
        What the file says.
    kind : type
        A `Struct` whose fields are described.
    file : Path
    place : str
        Where in it the table stands.

    Raises
    ------
    InputFileError
    """
    try:
        return msgspec.convert(content, kind)
    except msgspec.ValidationError as error:
        raise InputFileError(f"{file}: {_said(str(error), content, kind, place)}") from None


def partial_of(data: type) -> type[Struct]:
    """Give the type of tables that have some fields of a data class; others are `UNSET`."""
    hints = get_type_hints(data)
    fields: list[tuple[str, Any, Any]] = [
        (name, _described(kind) | UnsetType, UNSET) for name, kind in hints.items()
    ]  # fmt: skip
    return msgspec.defstruct(f"Partial{data.__name__}", fields, forbid_unknown_fields=True)


def given(table: Struct) -> dict[str, Any]:
    """Give the fields of a partial table that the file says something about."""
    return {name: value for name, value in msgspec.structs.asdict(table).items() if value is not UNSET}


def shown(value: Any) -> str:
    """Write a value as in the file."""
    return json.dumps(value, default=str, ensure_ascii=False)


def _described(kind: Any) -> Any:
    if get_origin(kind) is Literal:
        return Annotated[kind, Meta(description=" or ".join(map(shown, get_args(kind))))]
    return KINDS[kind]


def _said(message: str, content: Any, kind: Any, place: str) -> str:
    """Say what msgspec found in the words of the file: the place, what stands there, and what is expected."""
    found = FAULT.fullmatch(message)
    assert found is not None
    expected = "a table"
    for token in re.findall(r"\.([^.\[]+)|\[(\d+)\]", found["path"] or ""):
        name, number = token
        if isinstance(kind, type) and issubclass(kind, Struct):
            kind, expected = _field(kind, name)
            place, content = f"{place}.{name}".strip("."), content[name]
        elif number and (inner := _element(kind)) is not None:
            kind, content, expected = inner, content[int(number)], "a table"
            place = f"{place}[{int(number) + 1}]"
        else:
            break  # within a list of numbers or texts: it is described as a whole
    named = NAMED.fullmatch(found["what"])
    if named is None:
        return f"{place or 'the file'}: {shown(content)}; expected {expected}"
    where = f"{place}.{named['key']}".strip(".")
    if named["fault"] == "missing required":
        return f"{where}: is missing; expected {_field(kind, named['key'])[1]}"
    known = sorted(field.encode_name for field in msgspec.structs.fields(kind))
    return f"{where}: unknown; {meant(named['key'], known)}"


def _field(struct: type[Struct], name: str) -> tuple[Any, str]:
    """Give the type and the description of a field."""
    field = next(field for field in msgspec.structs.fields(struct) if field.encode_name == name)
    parts = [field.type, *get_args(field.type)]
    marked = [meta for part in parts for meta in getattr(part, "__metadata__", ()) if isinstance(meta, Meta)]
    known = () if get_origin(field.type) is list else parts  # of a list it is `_element`
    inner = next((part for part in known if isinstance(part, type) and issubclass(part, Struct)), field.type)
    return inner, next((meta.description for meta in marked if meta.description), "a table")


def _element(kind: Any) -> type[Struct] | None:
    """Give the type of a list's tables, None for lists of anything else."""
    for part in (kind, *get_args(kind)):
        for inner in get_args(part):
            if isinstance(inner, type) and issubclass(inner, Struct):
                return inner
    return None


def label(mapping: Mapping[str, Any]) -> str:
    """Name what a table says, in its order: the label of a setting."""
    return ", ".join(
        f"{key} {value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else f"{key} {value}"
        for key, value in mapping.items()
    )
