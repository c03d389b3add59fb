"""Rows of a log's file, those that are broken, and how the file was interpreted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from planner.system.errors import changed, plain

Names = tuple[str, str]
"""A person and one of their episodes."""

Row = tuple[int, Any]
"""Number of a line, from 1, and its content: a record, a `Broken`, or another value that is no record."""

Record = tuple[int, dict[str, Any]]
"""Number of a line, and its values by the column names of a log."""


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
    """How a file was interpreted, and its lines that are no records."""

    broken: list[tuple[int, Broken]] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    missing: dict[str, None] = field(default_factory=dict)
    steps: list[str] = field(default_factory=list)
    times: str | None = None
    signs: dict[str, int] = field(default_factory=dict)
    idle: list[int] = field(default_factory=list)
    outside: list[int] = field(default_factory=list)
    heads: list[int] = field(default_factory=list)
    doubtful: list[int] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)
    simulated: bool = False
    goals: tuple[str, ...] = ()
    tasks: tuple[str, ...] = ()

    def __str__(self) -> str:
        said = list(self.said)
        if self.missing:
            said.append(f"{' and '.join(map(repr, self.missing))} as a missing value")
        if self.steps and self.times is None:
            said.append(f"steps such as {self.steps[0]!r} as whole numbers")
        if self.times is not None:
            said.append(f"steps such as {self.times!r} as times, in whose order actions are numbered")
        said += [f"{sign} (first on line {line})" for sign, line in self.signs.items()]
        said += _lines_as(self.idle, "without an action", "as nothing done")
        said += _lines_as(self.outside, "without an action in a step of an episode", "as no part of one")
        said += _lines_as(self.doubtful, "with an action that was seen with doubt (`uncertain`)", "as if it was done")
        said += _lines_as(self.heads, "with the names of the columns", "as the beginning of a further table")
        return "; ".join([*[f"read {', '.join(said)}"] * bool(said), *self.asked])

    def plain(self, text: str, line: int) -> str:
        """Return a text as `plain` does, and note what a reader would not have seen in it."""
        for sign in changed(text):
            self.signs.setdefault(sign, line)
        return plain(text)


def _lines_as(lines: Sequence[int], which: str, what: str) -> list[str]:
    others = f" and {len(lines) - 1:,} more" if len(lines) > 1 else ""
    return [f"line {lines[0]}{others}, {which}, {what}"] if lines else []
