"""Logs of judgements with advice: people choose, see advice, and choose again.

Such data tell how people take advice where no task in PDDL is involved. A log is a CSV file with a line for each
judgement and the columns of `COLUMNS`; `OPTIONAL` is used where confidences are about choice 1, and other columns are
ignored. Choices are 0 or 1.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import read_only
from planner.system.errors import InputFileError
from planner.system.results import Result

from ..people.decision import Floats

COLUMNS = (
    "person", "sequence", "trial", "own_choice", "own_confidence", "advice", "final_choice", "outcome",
    "feedback_shown",
)  # fmt: skip
OPTIONAL = "advice_confidence"
OTHER_NAMES = {"feedback_shown": "feedback"}
"""Names that columns may have instead."""
ONE_ADVISOR = "sequence"
"""A column that may be missing where each person has one advisor."""

Confidence = Literal["own", "one"]


@dataclass(frozen=True, eq=False, repr=False)
class AdviceLog(Result):
    """Judgements with advice, ordered by person and trial; arrays of shape (N,).

    Attributes
    ----------
    person : str array
    first : bool array
        Whether a row is its person's first.
    sequence : int array
        Number of the row's advisor among those of the person, from 0.
    agrees : bool array
        The advice is the person's own choice.
    follows : bool array
        The final choice is the advice.
    right : bool array
        The advice is the outcome.
    shown : bool array
        The outcome was shown after the judgement.
    confidence : float array
        Confidence in the own choice, at most 1; below 0 where the stated confidence contradicts the choice.
    advice_confidence : float array
        Distance of the advisor's confidence from even odds, minus a half, from -0.5 to 0.5; 0 where none was given.
    """

    person: NDArray[np.str_]
    first: NDArray[np.bool_]
    sequence: NDArray[np.int64]
    agrees: NDArray[np.bool_]
    follows: NDArray[np.bool_]
    right: NDArray[np.bool_]
    shown: NDArray[np.bool_]
    confidence: Floats
    advice_confidence: Floats

    def __post_init__(self) -> None:
        read_only(self)

    def __len__(self) -> int:
        return len(self.person)

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each judgement, with a column for each attribute."""
        columns = {name: array.tolist() for name, array in vars(self).items()}
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]

    @property
    def people(self) -> list[str]:
        """The names of the K people."""
        return self.person[self.first].tolist()

    @property
    def counts(self) -> NDArray[np.int64]:
        """The number of judgements of each person, shape (K,)."""
        return np.diff(np.append(np.flatnonzero(self.first), len(self)))

    def of(self, people: NDArray[np.bool_]) -> AdviceLog:
        """Return the log of some people, shape (K,)."""
        rows = np.repeat(people, self.counts)
        return AdviceLog(**{name: array[rows] for name, array in vars(self).items()})


def read_advice(
    file: str | PathLike[str], *, confidence: Confidence = "own", rows: Mapping[str, str] | None = None
) -> AdviceLog:
    """Read a log of judgements with advice.

    Parameters
    ----------
    file : path
    confidence : "own" or "one"
        What confidences, from 0 to 100, are about: the person's own choice, or the chance that choice 1 is right.
    rows : mapping of str to str, optional
        Values of columns; other rows are left out. `{"attention_fail": "0"}` leaves out who failed checks of attention.

    Raises
    ------
    InputFileError
        A column is missing or there twice, a line has no number where one is expected, a trial is there twice, or no
        confidence exceeds 1; with the file and the line.
    """
    path = Path(file)
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream)
            header = reader.fieldnames or ()
            names = {name: name if name in header else OTHER_NAMES.get(name, name) for name in COLUMNS}
            missing = [name for name, own in names.items() if own not in header and name != ONE_ADVISOR]
            if missing:
                raise InputFileError(f"{path}:1: no column '{missing[0]}'; expected {', '.join(COLUMNS)}")
            twice = next((name for name in (*names.values(), OPTIONAL) if list(header).count(name) > 1), None)
            if twice is not None:
                raise InputFileError(f"{path}:1: two columns '{twice}'; expected one")
            wanted = dict(rows or {})
            unknown = next((name for name in wanted if name not in header), None)
            if unknown is not None:
                raise InputFileError(
                    f"{path}:1: no column '{unknown}' to choose rows by; there are {', '.join(header)}"
                )
            every = [
                (reader.line_num, row | {name: row.get(own) or "" for name, own in names.items()}) for row in reader
            ]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputFileError(f"{path}: {error}") from None
    found = [
        (line, row) for line, row in every if all((row[name] or "").strip() == value for name, value in wanted.items())
    ]
    if not found:
        raise InputFileError(f"{path}: {_nothing_left(every, wanted)}")

    def number(line: int, row: dict[str, str], name: str, most: float) -> float:
        try:
            value = float(row[name])
        except (TypeError, ValueError):
            raise InputFileError(f"{path}:{line}: {name} '{row[name]}'; expected a number") from None
        if not 0 <= value <= most:
            raise InputFileError(f"{path}:{line}: {name} {value:g}; expected 0 to {most:g}")
        return value

    if confidence == "own" and any(row.get(OPTIONAL) for _, row in found):
        expected = "confidences about choice 1 (confidence 'one'), or no such column"
        raise InputFileError(
            f"{path}:1: {OPTIONAL} is not used with confidences about the own choice; expected {expected}"
        )
    seen: dict[tuple[str, str, float], int] = {}
    for line, row in found:
        if not row["person"].strip():
            raise InputFileError(f"{path}:{line}: person ''; expected a name")
        trial = number(line, row, "trial", np.inf)
        first_line = seen.setdefault((row["person"], row["sequence"], trial), line)
        if first_line != line:
            raise InputFileError(f"{path}:{line}: trial {trial:g} of {row['person']} is on line {first_line} already")
    found.sort(key=lambda entry: (entry[1]["person"], number(entry[0], entry[1], "trial", np.inf)))

    def flag(line: int, row: dict[str, str], name: str) -> bool:
        value = number(line, row, name, 1)
        if value not in (0, 1):
            raise InputFileError(f"{path}:{line}: {name} {value:g}; expected 0 or 1")
        return value == 1

    flags = ("own_choice", "advice", "final_choice", "outcome", "feedback_shown")
    own, advice, final, outcome, shown = (
        np.array([flag(line, row, name) for line, row in found], dtype=bool) for name in flags
    )
    stated = np.array([number(line, row, "own_confidence", 100) for line, row in found])
    if 0 < stated.max() <= 1:
        raise InputFileError(f"{path}: own_confidence is at most {stated.max():g} in all lines; expected 0 to 100")
    sure = stated / 100 if confidence == "own" else np.where(own, 1, -1) * (stated - 50) / 50
    advised = np.array(
        [
            abs(number(line, row, OPTIONAL, 100) - 50) / 50 - 0.5 if row.get(OPTIONAL) and confidence == "one" else 0.0
            for line, row in found
        ]
    )
    person = np.array([row["person"] for _, row in found])
    first = np.append(True, person[1:] != person[:-1])
    numbers: list[int] = []
    known: dict[str, int] = {}
    for begins, (_, row) in zip(first.tolist(), found, strict=True):
        known = {} if begins else known
        numbers.append(known.setdefault(row["sequence"], len(known)))
    return AdviceLog(
        person, first, np.array(numbers), own == advice, final == advice, advice == outcome, shown, sure, advised
    )


def _nothing_left(every: list[tuple[int, dict[str, str]]], wanted: Mapping[str, str]) -> str:
    """Return why no judgement is left: there is none, or none with the wanted values of columns."""
    for name, value in wanted.items():
        there = sorted({(row[name] or "").strip() for _, row in every})
        if value not in there:
            return f"no judgement has {name} {value}; there are {', '.join(there[:10])}{', ...' * (len(there) > 10)}"
    return f"no judgement {'has all of the chosen values' if every else 'is there'}; expected a line for each"
