"""Typed TOML tables: errors state the place of a missing, unknown or ill-typed field, and what is expected.

The types are `Struct`s of msgspec. Messages use the descriptions of their fields.
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

from planner.system.errors import InputFileError
from planner.system.errors import expected as meant

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
WholeOrTables = Annotated[
    int | list[dict[str, Any]], Meta(description="a whole number of 1 or more, or one table or more")
]
Tables = Annotated[list[dict[str, Any]], Meta(min_length=1, description="one table or more")]

KINDS = {float: Number, int: Annotated[int, Meta(description="a whole number")], bool: Truth, str: Text}
FAULT = re.compile(r"(?P<what>.*?)(?: - at `\$(?P<path>.*)`)?", re.DOTALL)
NAMED = re.compile(r"Object (?P<fault>contains unknown|missing required) field `(?P<key>.*)`")


def load(file: Path) -> dict[str, Any]:
    """Read a TOML file, or raise an `InputFileError`. A byte order mark, as some editors write it, is ignored."""
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
    """Return an error with the file and the place of the fault."""
    return InputFileError(f"{file}: {place}: {message}")


def regular_expression(text: str | None, file: Path, place: str) -> re.Pattern[str] | None:
    """Return a compiled regular expression, None if there is none; raise `InputFileError` if the text is not one."""
    try:
        return None if text is None else re.compile(text)
    except re.error as error:
        raise fault(file, place, f"{text!r} is no regular expression: {error}") from None


@contextmanager
def located(file: Path) -> Iterator[None]:
    """Add the line number to errors about a place in a file."""
    try:
        yield
    except InputFileError as error:
        what = str(error).removeprefix(f"{file}: ")
        if what == str(error) or not file.is_file():
            raise
        raise InputFileError(f"{file}:{line_of(file, what)}: {what}") from error.__cause__


def line_of(file: Path, fault: str) -> int:
    """Return the line, counted from 1, where the value at fault begins, or the table that should contain it."""
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
    for number in range(1, len(lines) + 1):  # a prefix that ends within a multi-line value does not parse
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
    """Convert the table at a place of a file to a type, a `Struct` whose fields have descriptions.

    The place is empty for the whole file. Fields that do not fit the type raise an `InputFileError`.
    """
    try:
        return msgspec.convert(content, kind)
    except msgspec.ValidationError as error:
        raise InputFileError(f"{file}: {_said(str(error), content, kind, place)}") from None


def partial_of(data: type, **written: Any) -> type[Struct]:
    """Return the type of tables that have some of the fields of a data class; the other fields are `UNSET`.

    Fields whose own type a file cannot hold get the type that `written` has for them.
    """
    hints = get_type_hints(data)
    fields: list[tuple[str, Any, Any]] = [
        (name, (written[name] if name in written else _described(kind)) | UnsetType, UNSET)
        for name, kind in hints.items()
    ]  # fmt: skip
    return msgspec.defstruct(f"Partial{data.__name__}", fields, forbid_unknown_fields=True)


def given(table: Struct) -> dict[str, Any]:
    """Return the fields of a partial table that the file sets."""
    return {name: value for name, value in msgspec.structs.asdict(table).items() if value is not UNSET}


def shown(value: Any) -> str:
    """Return a value as JSON text, for messages."""
    return json.dumps(value, default=str, ensure_ascii=False)


def _described(kind: Any) -> Any:
    if get_origin(kind) is Literal:
        return Annotated[kind, Meta(description=" or ".join(map(shown, get_args(kind))))]
    return KINDS[kind]


def _said(message: str, content: Any, kind: Any, place: str) -> str:
    """Return msgspec's error message with the place, the value found and the description of what is expected."""
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
            break  # a list of numbers or texts has one description for all its elements
    named = NAMED.fullmatch(found["what"])
    if named is None:
        return f"{place or 'the file'}: {shown(content)}; expected {expected}"
    where = f"{place}.{named['key']}".strip(".")
    if named["fault"] == "missing required":
        return f"{where}: is missing; expected {_field(kind, named['key'])[1]}"
    known = sorted(field.encode_name for field in msgspec.structs.fields(kind))
    return f"{where}: unknown; {meant(named['key'], known)}"


def _field(struct: type[Struct], name: str) -> tuple[Any, str]:
    """Return the type and the description of a field."""
    field = next(field for field in msgspec.structs.fields(struct) if field.encode_name == name)
    parts = [field.type, *get_args(field.type)]
    marked = [meta for part in parts for meta in getattr(part, "__metadata__", ()) if isinstance(meta, Meta)]
    known = () if get_origin(field.type) is list else parts  # for a list, `_element` returns the inner type
    inner = next((part for part in known if isinstance(part, type) and issubclass(part, Struct)), field.type)
    return inner, next((meta.description for meta in marked if meta.description), "a table")


def _element(kind: Any) -> type[Struct] | None:
    """Return the `Struct` type of a list's elements; None for lists of anything else."""
    for part in (kind, *get_args(kind)):
        for inner in get_args(part):
            if isinstance(inner, type) and issubclass(inner, Struct):
                return inner
    return None


def label(mapping: Mapping[str, Any]) -> str:
    """Return the label of a setting: its keys and values in their order."""
    return ", ".join(
        f"{key} {value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else f"{key} {value}"
        for key, value in mapping.items()
    )
