"""The PDDL files of an instance, and reading them as text.

A faulty file raises a `PDDLError`, whose one-line message states the fault, the file and the line.
"""

from __future__ import annotations

import codecs
import re
import unicodedata
from dataclasses import dataclass
from pathlib import Path

from . import s_expressions
from .s_expressions import Expression, UnbalancedError


class PDDLError(ValueError):
    """A PDDL file is invalid or not supported.

    Attributes
    ----------
    file : Path
        The file at fault.
    line : int or None
        Line of the fault, counted from 1, if it is known.
    message : str
        The fault, and what is expected.
    column : int or None
        Column of the fault, counted from 1, if it is known.
    """

    def __init__(self, file: Path, line: int | None, message: str, column: int | None = None) -> None:
        self.file = file
        self.line = line
        self.message = message
        self.column = column
        super().__init__(f"{file}:{line}: {message}" if line else f"{file}: {message}")

    def __reduce__(self) -> tuple[type[PDDLError], tuple[Path, int | None, str, int | None]]:
        """Keep all fields when the error crosses a process boundary."""
        return type(self), (self.file, self.line, self.message, self.column)


@dataclass(frozen=True, order=True)
class Instance:
    """The two files of a planning instance.

    Attributes
    ----------
    problem, domain : Path
    """

    problem: Path
    domain: Path

    def __post_init__(self) -> None:
        for name in ("problem", "domain"):
            object.__setattr__(self, name, Path(getattr(self, name)))

    def __str__(self) -> str:
        return str(self.problem)


MARKS = {  # the longer ones first
    "UTF-32": (codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE),
    "UTF-16": (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE),
}
"""Byte order marks of encodings other than UTF-8."""

STRANGE = re.compile(r"[^\t\v\f -~]")
"""Characters that may occur in comments only."""


def text(file: Path, kind: str) -> str:
    """Return the text of a PDDL file in lower case, since PDDL ignores case and unified-planning does not.

    A file that does not exist, is empty, or is not ASCII text outside of its comments raises a `PDDLError`.
    """
    try:
        raw = file.read_bytes()
    except FileNotFoundError:
        raise PDDLError(file, None, f"no such {kind} file") from None
    except OSError as error:
        raise PDDLError(file, None, f"cannot be read: {error.strerror}") from None
    for name, marks in MARKS.items():
        if raw.startswith(marks):
            raise PDDLError(file, 1, f"this is {name}; save it as UTF-8")
    try:
        content = raw.decode("utf-8-sig")
        encoding = "UTF-8"
    except UnicodeDecodeError:
        content = raw.decode("latin-1")  # old files have comments in this encoding
        encoding = "unknown encoding"
    content = content.replace("\r\n", "\n").replace("\r", "\n")
    for number, line in enumerate(content.split("\n"), start=1):
        if "\0" in line:
            raise PDDLError(file, number, "not a text file (it has NUL bytes)")
        words = line.partition(";")[0]
        if (found := STRANGE.search(words)) is not None:
            if encoding != "UTF-8":
                raise PDDLError(file, number, "not a text file in UTF-8")
            strange = found[0]
            shown = (
                f"'{strange}'" if strange.isprintable() else unicodedata.name(strange, "a control character").lower()
            )
            what = "no PDDL" if strange.isascii() else "not ASCII"
            where = f"(U+{ord(strange):04X}, column {found.start() + 1})"
            raise PDDLError(file, number, f"{shown} is {what} {where}; only comments may have such characters")
    if not re.sub(r";[^\n]*", "", content).strip():
        raise PDDLError(file, None, f"the file is empty; expected (define ({kind} ...) ...)")
    return content.lower()


def parse(file: Path, content: str) -> Expression:
    """Read a file's text as nested lists.

    If parentheses do not match, the `PDDLError` has the line where this probably began, not the end of the file.
    """
    try:
        return s_expressions.parse(content)
    except UnbalancedError as error:
        raise PDDLError(file, error.line, str(error)) from None
