"""PDDL text as nested lists of words, each with its line and column: enough to say where something is.

What the words mean is not known here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

SECTIONS = {
    ":requirements", ":types", ":constants", ":predicates", ":functions", ":action", ":derived",
    ":domain", ":objects", ":init", ":goal", ":metric",
}  # fmt: skip


class UnbalancedError(ValueError):
    """Parentheses that do not match; `line` is where."""

    def __init__(self, line: int, message: str) -> None:
        self.line = line
        super().__init__(message)


class Place(NamedTuple):
    """Where something begins in a file; both are counted from 1."""

    line: int
    column: int


class Expression(NamedTuple):
    """A word, or a list in parentheses.

    Attributes
    ----------
    line : int
        Where it begins, counted from 1.
    word : str
        Empty for a list.
    parts : tuple of Expression
        What a list consists of.
    column : int
        Of its first character, counted from 1.
    """

    line: int
    word: str
    parts: tuple[Expression, ...] = ()
    column: int = 1

    def __str__(self) -> str:
        return self.word or f"({' '.join(map(str, self.parts))})"

    @property
    def place(self) -> Place:
        """Where it begins."""
        return Place(self.line, self.column)

    @property
    def head(self) -> str:
        """The first word of a list; empty where it does not begin with a word."""
        return self.parts[0].word if self.parts else ""

    @property
    def words(self) -> list[str]:
        """All words in it, in their order."""
        return [each.word for each in self.walk() if each.word]

    def walk(self) -> Iterator[Expression]:
        """Give the expression and all that it consists of, in the order of the text."""
        waiting = [self]
        while waiting:
            expression = waiting.pop()
            yield expression
            waiting.extend(reversed(expression.parts))

    def lists(self, head: str) -> Iterator[Expression]:
        """Give the lists within it, itself included, that begin with a word."""
        return (each for each in self.walk() if each.head == head)

    def section(self, head: str) -> Expression | None:
        """Give its first part that begins with a word."""
        return next((part for part in self.parts if part.head == head), None)


_TOKEN = re.compile(r"[()]|\?[^()\s?]*|[^()\s?]+")


def tokens(text: str) -> Iterator[tuple[str, Place]]:
    """Parentheses and words with their places, comments left out; a variable begins at its question mark."""
    for line, content in enumerate(text.split("\n"), start=1):
        for match in _TOKEN.finditer(content.partition(";")[0]):
            yield match[0], Place(line, match.start() + 1)


DEEPEST = 200
"""Lists may be nested so deep: readers call themselves for each."""


def parse(text: str) -> Expression:
    """Read the first list of a text.

    Raises
    ------
    UnbalancedError
        Parentheses are missing, or too many.
    """
    opened: list[tuple[Place, list[Expression]]] = []
    whole: Expression | None = None
    section, previous = 1, ""
    for token, (line, column) in tokens(text):
        if token == "(":
            opened.append((Place(line, column), []))
            if len(opened) > DEEPEST:
                raise UnbalancedError(line, f"more than {DEEPEST} parentheses are open here; expected fewer")
        elif token == ")":
            if not opened:
                raise UnbalancedError(line, "')' without a '(' that it closes")
            begin, parts = opened.pop()
            closed = Expression(begin.line, "", tuple(parts), begin.column)
            if opened:
                opened[-1][1].append(closed)
            elif whole is None:
                whole = closed
            else:
                raise UnbalancedError(begin.line, "nothing is expected after the end of (define ...)")
        else:
            if previous == "(" and token in SECTIONS:
                if len(opened) > 2:
                    raise UnbalancedError(opened[-2][0].line, f"'(' is not closed before ({token} on line {line}")
                section = line
            if not opened:
                raise UnbalancedError(line, f"'{token}' is not within (define ...)")
            opened[-1][1].append(Expression(line, token, (), column))
        previous = token
    if opened:
        raise UnbalancedError(section, "')' is missing between here and the end of the file")
    return whole or Expression(1, "")
