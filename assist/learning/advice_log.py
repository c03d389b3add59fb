"""Logs of judgements with advice: people choose, see advice, and choose again.

Such data tell how people take advice where no task in PDDL is involved. A log is a CSV file with a line for each
judgement (`Judgement`); the advisor's confidence is used where confidences are about choice 1, and other columns are
ignored. Choices are 0 or 1.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from planner.system.arrays import read_only
from planner.system.errors import InputFileError, plain
from planner.system.files import bytes_of
from planner.system.results import Result

from ..declare.declared import AnyText, DeclarationError, Expected, Number, Text, declared, sentences
from ..people.decision import Floats
from .log_files import lines_of
from .log_rows import Broken, Taken
from .log_tables import read_table

Confidence = Literal["own", "one"]


def _flag(value: float) -> float:
    if value not in (0, 1):
        raise PydanticCustomError("kind", "0 or 1")
    return value


Flag = Annotated[Number, AfterValidator(_flag), Expected("0 or 1")]
Percent = Annotated[Number, Field(ge=0, le=100)]


@declared
class Judgement:
    """A line of a log of advice."""

    person: Annotated[Text, Expected("a name"), Field(description="Name of the person.")]
    sequence: Annotated[AnyText, Field(description="Name of the advisor; may be missing where each person has one.")]
    trial: Annotated[Number, Field(ge=0, description="Number of the judgement among those of the person.")]
    own_choice: Annotated[Flag, Field(description="The first choice.")]
    own_confidence: Annotated[Percent, Field(description="Confidence in it, or in choice 1.")]
    advice: Annotated[Flag, Field(description="The choice that is advised.")]
    final_choice: Annotated[Flag, Field(description="The choice after the advice.")]
    outcome: Annotated[Flag, Field(description="The choice that was right.")]
    feedback_shown: Annotated[Flag, Field(description="Whether the person saw that; or `feedback`.")]
    advice_confidence: Annotated[Percent | None, Field(description="The advisor's confidence in choice 1.")] = None


*COLUMNS, OPTIONAL = sentences(Judgement)
OTHER_NAMES = {"feedback_shown": "feedback"}
"""Names that columns may have instead."""


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
    path, wanted = Path(file), dict(rows or {})
    every = _lines(path, wanted)
    found = [(line, row) for line, row in every if all(row[name] == value for name, value in wanted.items())]
    if not found:
        raise InputFileError(f"{path}: {_nothing_left([row for _, row in every], wanted)}")
    judged, seen = [], dict[tuple[str, str, float], int]()
    for line, row in found:
        one = _judgement(row, f"{path}:{line}")
        first_line = seen.setdefault((one.person, one.sequence, one.trial), line)
        if first_line != line:
            raise InputFileError(f"{path}:{line}: trial {one.trial:g} of {one.person} is on line {first_line} already")
        judged.append(one)
    if confidence == "own" and any(one.advice_confidence is not None for one in judged):
        expected = "confidences about choice 1 (confidence 'one'), or no such column"
        told = f"{OPTIONAL} is not used with confidences about the own choice; expected {expected}"
        raise InputFileError(f"{path}:1: {told}")
    judged.sort(key=lambda one: (one.person, one.trial))
    own, advice, final, outcome, shown, stated = (
        np.array([getattr(one, name) for one in judged])
        for name in ("own_choice", "advice", "final_choice", "outcome", "feedback_shown", "own_confidence")
    )
    if 0 < stated.max() <= 1:
        raise InputFileError(f"{path}: own_confidence is at most {stated.max():g} in all lines; expected 0 to 100")
    sure = stated / 100 if confidence == "own" else np.where(own, 1, -1) * (stated - 50) / 50
    advised = [0.0 if one.advice_confidence is None else abs(one.advice_confidence - 50) / 50 - 0.5 for one in judged]
    person = np.array([one.person for one in judged])
    first = np.append(True, person[1:] != person[:-1])
    advisors: dict[str, dict[str, int]] = {}
    numbers = [(known := advisors.setdefault(one.person, {})).setdefault(one.sequence, len(known)) for one in judged]
    return AdviceLog(
        person, first, np.array(numbers), own == advice, final == advice, advice == outcome, shown == 1, sure,
        np.array(advised),
    )  # fmt: skip


def _lines(path: Path, wanted: Iterable[str]) -> list[tuple[int, dict[str, str]]]:
    """Return the cells of each line by the names of columns; those of `Judgement` have their own name there."""
    lines = lines_of(bytes_of(path), Taken())
    (number, head), rows = read_table(lines, (*COLUMNS, OPTIONAL), lambda _: frozenset(), Taken())
    broken = next(((line, row) for line, row in rows if isinstance(row, Broken)), None)
    if broken is not None:
        raise InputFileError(f"{path}:{broken[0]}: {broken[1].message}")
    named = {plain(name).lower(): name for name in head}
    names = {name: named.get(name, named.get(OTHER_NAMES.get(name, ""))) for name in (*COLUMNS, OPTIONAL)}
    for name in COLUMNS:
        if names[name] is None and name != "sequence":
            raise InputFileError(f"{path}:{number}: no column '{name}'; expected {', '.join(COLUMNS)}")
    for name in wanted:
        if name not in head:
            raise InputFileError(f"{path}:1: no column '{name}' to choose rows by; there are {', '.join(head)}")
    return [(line, row | {name: row.get(own or "", "") for name, own in names.items()}) for line, row in rows]


def _judgement(row: Mapping[str, str], place: str) -> Judgement:
    """Return the judgement in a line; numbers are written as texts there."""
    given: dict[str, Any] = {name: row[name] for name in (*COLUMNS, OPTIONAL)}
    for name in COLUMNS[2:]:
        given[name] = _number(row[name])
    given[OPTIONAL] = _number(row[OPTIONAL]) if row[OPTIONAL] else None
    try:
        return Judgement(**given)
    except DeclarationError as error:
        raise InputFileError(f"{place}: {error}") from None


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _nothing_left(every: list[dict[str, str]], wanted: Mapping[str, str]) -> str:
    """Return why no judgement is left: there is none, or none with the wanted values of columns."""
    for name, value in wanted.items():
        there = sorted({row[name] for row in every})
        if value not in there:
            return f"no judgement has {name} {value}; there are {', '.join(there[:10])}{', ...' * (len(there) > 10)}"
    return f"no judgement {'has all of the chosen values' if every else 'is there'}; expected a line for each"
