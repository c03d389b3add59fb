"""PDDL text as nested lists of words, each with its line and column.

This module does not interpret the words.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

SECTIONS = {
    ":requirements", ":types", ":constants", ":predicates", ":functions", ":action", ":durative-action", ":derived",
    ":domain", ":objects", ":init", ":goal", ":metric",
}  # fmt: skip


class UnbalancedError(ValueError):
    """Parentheses do not match; `line` is the line of the fault."""

    def __init__(self, line: int, message: str) -> None:
        self.line = line
        super().__init__(message)


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


def parse(text: str) -> Expression:
    """Parse the only list of a text; raise `UnbalancedError` if parentheses do not match or are nested too deep."""
    deepest = 200  # largest depth of nested lists. Recursive readers would otherwise exceed Python's recursion limit
    opened: list[tuple[Place, list[Expression]]] = []
    whole: Expression | None = None
    section, previous = 1, ""
    for token, place in tokens(text):
        line = place.line
        if token == "(":
            opened.append((place, []))
            if len(opened) > deepest:
                raise UnbalancedError(line, f"more than {deepest} parentheses are open here; expected fewer")
        elif token == ")":
            if not opened:
                raise UnbalancedError(line, "')' without a '(' that it closes")
            begin, parts = opened.pop()
            closed = Expression("", tuple(parts), begin)
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
            opened[-1][1].append(Expression(token, (), place))
        previous = token
    if opened:
        raise UnbalancedError(section, "')' is missing between here and the end of the file")
    return whole or Expression("", (), Place(1, 1))
