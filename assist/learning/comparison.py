"""Models compared by how well they predict people to whom they were not fitted.

Each model is fitted to the people of all folds but one, and predicts those of that fold. Differences from a reference
are paired by person, with a correction for the number of models.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import scipy
from numpy.typing import NDArray

from planner.system.arrays import read_only
from planner.system.errors import InputFileError, expected
from planner.system.limits import Deadline
from planner.system.results import Result

from ..people.decision import Floats
from .intervals import IntervalEstimate, holm

FOLDS = 8

Some: TypeAlias = NDArray[np.bool_]
"""Who some people are among all, shape (K,)."""


@dataclass(frozen=True, eq=False, repr=False)
class Score(Result):
    """How well a model predicts people to whom it was not fitted.

    Attributes
    ----------
    model : str
    parameters : dict of str to float
        Those that fit all people together best.
    nats_per_choice : float
        Minus the mean held-out log probability of what was chosen.
    stderr : float
        Its standard error over people.
    of_people : float array, shape (K,)
        Nats per choice of each person.
    difference : float or None
        Nats per choice minus those of the reference, paired by person; None for the reference itself.
    interval : tuple of float, or None
        Interval of the difference over people, by Student's t; None where it is the same for all people.
    p, p_corrected : float or None
        Two-sided p-value of no difference, and the same corrected for the number of models (Holm's method).
    better_for : int or None
        Number of people for whom the model is better than the reference.
    """

    model: str
    parameters: dict[str, float]
    nats_per_choice: float
    stderr: float
    of_people: Floats
    difference: float | None = None
    interval: tuple[float, float] | None = None
    p: float | None = None
    p_corrected: float | None = None
    better_for: int | None = None

    def __post_init__(self) -> None:
        read_only(self)

    def records(self) -> list[dict[str, Any]]:
        """Return one row: how well the model predicts, its difference from the reference, and its parameters."""
        low, high = self.interval or (None, None)
        return [{
            "model": self.model, "nats_per_choice": self.nats_per_choice, "stderr": self.stderr,
            "difference": self.difference, "difference_low": low, "difference_high": high, "p": self.p,
            "p_corrected": self.p_corrected, "better_for": self.better_for, **self.parameters,
        }]  # fmt: skip

    def as_dict(self) -> dict[str, Any]:
        """Return the row of a table as plain data."""
        return {name: value for name, value in vars(self).items() if name != "of_people"}


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Result):
    """Models compared on the same people.

    Attributes
    ----------
    people : tuple of str
    choices : int array, shape (K,)
        Number of choices of each person.
    level : float
        Level of the intervals.
    scores : tuple of Score
        The first is that of the reference.
    left_out : tuple of str
        Models for which the time was up.
    """

    people: tuple[str, ...]
    choices: NDArray[np.int64]
    level: float
    scores: tuple[Score, ...]
    left_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        read_only(self)

    def __repr__(self) -> str:
        without = f"; no time for {', '.join(self.left_out)}" if self.left_out else ""
        of = f"{len(self.scores)} models for {len(self.people)} people"
        return f"<Comparison of {of}: best {self.best.model}{without}>"

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each model, as `Score.records` does."""
        return [row for score in self.scores for row in score.records()]

    def __getitem__(self, model: str) -> Score:
        for row in self.scores:
            if row.model == model:
                return row
        raise KeyError(model)

    @classmethod
    def of(
        cls, people: Sequence[str], choices: NDArray[np.int64], logs: Mapping[str, Floats],
        parameters: Mapping[str, dict[str, float]], reference: str, level: float = 0.95,
    ) -> Comparison:  # fmt: skip
        """Compare held-out log probabilities.

        Parameters
        ----------
        people, choices, level
            See above.
        logs : mapping of str to float array, shape (K,)
            By model, the log probability of all that each person chose.
        parameters : mapping of str to dict
            Estimates of each model, for the result.
        reference : str
            The model with which the others are compared.
        """
        count, of_reference, rows = len(people), logs[reference], []
        for name in [reference, *(name for name in logs if name != reference)]:
            nats, stderr = ratio(-logs[name], choices)
            row = Score(name, parameters[name], nats, stderr, -logs[name] / choices)
            if name != reference:
                mean, error = ratio(of_reference - logs[name], choices)
                ends = IntervalEstimate.of(mean, error, count - 1, level)
                p = 2 * float(scipy.special.stdtr(count - 1, -abs(mean / error))) if error > 0 else 1.0
                better = int((logs[name] > of_reference).sum())
                interval = None if math.isnan(ends.low) else (ends.low, ends.high)
                row = replace(row, difference=mean, interval=interval, p=p, better_for=better)
            rows.append(row)
        corrected = iter(holm([row.p for row in rows if row.p is not None]))
        scores = [row if row.p is None else replace(row, p_corrected=next(corrected)) for row in rows]
        return cls(tuple(people), choices, level, tuple(scores))

    def against(self, reference: str) -> Comparison:
        """Return the comparison of the same predictions with another reference.

        Raises
        ------
        ValueError
            It is not among the models.
        """
        logs = {row.model: -row.of_people * self.choices for row in self.scores}
        if reference not in logs:
            raise ValueError(f"{reference!r}; {expected(reference, logs)}")
        found = Comparison.of(
            self.people, self.choices, logs, {row.model: row.parameters for row in self.scores}, reference, self.level
        )
        return replace(found, left_out=self.left_out)

    @property
    def best(self) -> Score:
        """The model that predicts best among those that predict better than the reference, by corrected p-values.

        The reference if there is none: a model whose further parameters are estimated as 0 predicts as well.
        """
        better = [row for row in self.scores[1:] if row.difference is not None and row.difference < 0]
        sure = [row for row in better if row.p_corrected is not None and row.p_corrected <= 1 - self.level]
        return min(sure, key=lambda row: row.nats_per_choice, default=self.scores[0])

    def of_people(self) -> list[dict[str, Any]]:
        """Return each person's nats per choice under each model as plain data."""
        return [
            {
                "person": person,
                "choices": int(self.choices[k]),
                "nats_per_choice": {row.model: float(row.of_people[k]) for row in self.scores},
            }
            for k, person in enumerate(self.people)
        ]

    def as_dict(self) -> dict[str, Any]:
        """Return the comparison as plain data."""
        return {
            "choices": int(self.choices.sum()), "level": self.level, "best": self.best.model,
            "models": [row.as_dict() for row in self.scores], "people": self.of_people(),
        }  # fmt: skip


class Fitted(NamedTuple):
    """A model that was fitted to some people.

    `log_probability` returns the log probability of all that each of some people chose, shape (n,), given who they are
    among all, shape (K,). A fit to other people can begin at `start`.
    """

    parameters: dict[str, float]
    log_probability: Callable[[Some], Floats]
    start: Any = None


FitTo = Callable[[Some, Sequence[Fitted]], Fitted]
"""Fits a model to some people, shape (K,), given its fits so far: to all people, and to those of other folds."""


def compared(
    models: Mapping[str, FitTo], people: Sequence[str], choices: NDArray[np.int64], reference: str, *,
    fold: NDArray[np.int64], level: float, time_limit: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> Comparison:  # fmt: skip
    """Compare models on held-out people; `fold`, shape (K,), has that of each person, and the others are as above.

    After the time limit no further model is begun; the reference is the first.
    """
    ends, logs, parameters = Deadline.after(time_limit), dict[str, Floats](), dict[str, dict[str, float]]()
    for name, fit_to in sorted(models.items(), key=lambda model: model[0] != reference):
        if logs and ends.passed:
            break
        fits = [fit_to(np.ones(len(people), dtype=bool), [])]
        parameters[name], logs[name] = fits[0].parameters, np.empty(len(people))
        for each in np.unique(fold).tolist():
            inside = fold == each
            fits.append(fit_to(~inside, fits))
            logs[name][inside] = fits[-1].log_probability(inside)
        if progress is not None:
            progress(1)
    ordered = {name: logs[name] for name in models if name in logs}
    found = Comparison.of(people, choices, ordered, parameters, reference, level)
    return replace(found, left_out=tuple(name for name in models if name not in logs))


def ratio(sums: Floats, counts: Floats | NDArray[np.int64]) -> tuple[float, float]:
    """Return the mean per choice and its standard error over people (ratio estimator, by the delta method).

    `sums` and `counts`, shape (K,), are each person's total and number of choices.
    """
    found, people = sums.sum() / counts.sum(), len(counts)
    spread = ((sums - found * counts) ** 2).sum() * people / (people - 1)
    return float(found), float(math.sqrt(spread) / counts.sum())


def folds_of(people: int, folds: int) -> NDArray[np.int64]:
    """Return the fold of each person, shape (K,), in turn."""
    if folds < 2:
        raise ValueError(f"folds {folds}: expected 2 or more")
    if people < 2:
        raise InputFileError("one person; a comparison needs two or more, to learn from some about others")
    return np.arange(people) % min(folds, people)
