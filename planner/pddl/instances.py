"""The PDDL files of an instance: their text, and the nested lists of words in it, each with its line and column.

A faulty file raises a `PDDLError`, whose one-line message states the fault, the file and the line. Words are not
interpreted here.
"""

from __future__ import annotations

import codecs
import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from ..system.files import no_such


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
        raise PDDLError(file, None, no_such(file, f"no such {kind} file")) from None
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


SECTIONS = {
    ":requirements", ":types", ":constants", ":predicates", ":functions", ":action", ":durative-action", ":derived",
    ":domain", ":objects", ":init", ":goal", ":metric",
}  # fmt: skip


class Place(NamedTuple):
    """Position at which something begins in a file; both are counted from 1."""

    line: int
    column: int


class Expression(NamedTuple):
    """A word, or a list in parentheses, with the place where it begins.

    `word` is empty for a list, and `parts`, the elements of the list, for a word.
    """

    word: str
    parts: tuple[Expression, ...] = ()
    place: Place = Place(0, 1)

    def __str__(self) -> str:
        return self.word or f"({' '.join(map(str, self.parts))})"

    @property
    def head(self) -> str:
        """First element of a list if that is a word, else an empty text."""
        return self.parts[0].word if self.parts else ""

    @property
    def words(self) -> list[str]:
        """All words in the expression, in the order of the text."""
        return [each.word for each in self.walk() if each.word]

    def walk(self) -> Iterator[Expression]:
        """Yield the expression and all its subexpressions, in the order of the text."""
        waiting = [self]
        while waiting:
            expression = waiting.pop()
            yield expression
            waiting.extend(reversed(expression.parts))

    def section(self, head: str) -> Expression | None:
        """Return the first element that is a list beginning with the word; None if there is none."""
        return next((part for part in self.parts if part.head == head), None)


_TOKEN = re.compile(r"[()]|\?[^()\s?]*|[^()\s?]+")


def tokens(text: str) -> Iterator[tuple[str, Place]]:
    """Yield parentheses and words with their positions, without comments. A question mark begins a new word."""
    for line, content in enumerate(text.split("\n"), start=1):
        for match in _TOKEN.finditer(content.partition(";")[0]):
            yield match[0], Place(line, match.start() + 1)


def nested(file: Path, text: str) -> Expression:
    """Return the only list of a file's text.

    If parentheses do not match, or are nested too deep, the `PDDLError` has the line where this probably began, not the
    end of the file.
    """
    deepest = 200  # largest depth of nested lists. Recursive readers would otherwise exceed Python's recursion limit
    opened: list[tuple[Place, list[Expression]]] = []
    whole: Expression | None = None
    section, previous = 1, ""
    for token, place in tokens(text):
        line = place.line
        if token == "(":
            opened.append((place, []))
            if len(opened) > deepest:
                raise PDDLError(file, line, f"more than {deepest} parentheses are open here; expected fewer")
        elif token == ")":
            if not opened:
                raise PDDLError(file, line, "')' without a '(' that it closes")
            begin, parts = opened.pop()
            closed = Expression("", tuple(parts), begin)
            if opened:
                opened[-1][1].append(closed)
            elif whole is None:
                whole = closed
            else:
                raise PDDLError(file, begin.line, "nothing is expected after the end of (define ...)")
        else:
            if previous == "(" and token in SECTIONS:
                if len(opened) > 2:
                    raise PDDLError(file, opened[-2][0].line, f"'(' is not closed before ({token} on line {line}")
                section = line
            if not opened:
                raise PDDLError(file, line, f"'{token}' is not within (define ...)")
            opened[-1][1].append(Expression(token, (), place))
        previous = token
    if opened:
        raise PDDLError(file, section, "')' is missing between here and the end of the file")
    return whole or Expression("", (), Place(1, 1))
