"""Wording of reports: tables, intervals, and conclusions from intervals; in English unless texts are given."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from ...declare.catalogue import Catalogue, catalogue
from ..study import OWN

Record = dict[str, Any]

ENDS = ("mean", "low", "high")


def short(text: str, most: int = 48) -> str:
    """Return the beginning of a text if it is long."""
    return text if len(text) <= most else f"{text[: most - 1].rstrip()}…"


@dataclass(frozen=True)
class Wording:
    """Numbers, intervals and p-values in a language.

    Attributes
    ----------
    texts : Catalogue
    """

    texts: Catalogue = field(default_factory=catalogue)

    def number(self, estimate: float | None, missing: str | None = None) -> str:
        """Return a number with two decimals, or what stands for a missing one."""
        if estimate is None:
            return self.texts.phrase("report.undefined") if missing is None else missing
        return self.texts.decimal(estimate, 2)

    def plain(self, given: float) -> str:
        """Return a number with the digits that it has."""
        return f"{given:g}".replace(".", self.texts.texts["decimal"])

    def p_value(self, p: float | None) -> str:
        """Return a p-value as journals print it."""
        if p is None:
            return self.texts.phrase("report.undefined")
        return f"< {self.texts.decimal(0.001, 3).removeprefix('0')}" if p < 0.001 else self.texts.decimal(p, 3)

    def interval(self, estimate: Record, digits: int = 1) -> str:
        """Return a number with its interval, if it has one."""
        if estimate["mean"] is None:
            return self.texts.phrase("report.no_others")
        ends = (None if estimate[key] is None else self.texts.decimal(estimate[key], digits) for key in ENDS)
        mean, low, high = ends
        return str(mean) if low is None else self.texts.phrase("report.between", mean=mean, low=low, high=high)

    def value(self, cell: Record) -> str:
        """Return the mean of a cell with its interval, or a dash for a cell without values."""
        return self.interval(cell) if cell["n"] else "-"


ENGLISH = Wording()
interval, number = ENGLISH.interval, ENGLISH.number


def with_deviation(cell: Record) -> str:
    """Return a mean with its standard deviation over episodes and its interval over pools, as far as they exist."""
    deviation = "" if cell["sd"] is None else f" ± {cell['sd']:.1f}"
    ends = "" if cell["low"] is None else f" ({cell['low']:.1f} to {cell['high']:.1f})"
    return f"{cell['mean']:.1f}{deviation}{ends}"


def sign(estimate: Record, at: float = 0.0) -> str:
    """Return whether an interval shows that a number exceeds `at`."""
    if estimate["mean"] is None:
        return "yes"
    if estimate["low"] is not None and estimate["low"] > at:
        return "yes"
    if estimate["high"] is not None and estimate["high"] < at:
        return "no, the opposite"
    return "not shown"


def beside(estimate: Record, published: float) -> str:
    """Return the comparison of a saving with a published one."""
    if estimate["low"] is None:
        return f"{'better' if estimate['mean'] > published else 'worse'}, without an interval"
    if estimate["low"] > published:
        return "better, the whole interval"
    if estimate["high"] < published:
        return "worse, the whole interval"
    return "better, not the whole interval" if estimate["mean"] > published else "worse, not the whole interval"


def named(key: str) -> str:
    """Return the name of a saving in words: `actions_vs_none` is "actions against none"."""
    return key.replace("_vs_", " against ").replace("_", " ")


def prior(name: str) -> str:
    """Return the description of the robot's prior."""
    return "its population" if name == OWN else name


def varying(rows: Sequence[Record], columns: Iterable[str]) -> list[str]:
    """Return the columns in which rows differ."""
    return [column for column in columns if len({row[column] for row in rows}) > 1]
