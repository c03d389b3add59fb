"""Comparison of choice models by cross-validation over people.

A model's parameters are those of largest likelihood for the people of the other folds together, so that predicted
choices were never seen. The models are cost alone (`boltzmann`), cost and one term, and cost and all terms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo, known_costs
from planner.system.arrays import outline, read_only
from planner.system.progress import Wanted, adding, shows_progress

from ..people.decision import Floats
from ..people.terms import TERMS, Term
from .fit import LogError, observed, replayed
from .hierarchy import RATES, fixed_of, start_of
from .likelihood import Method
from .log import Log, log_of
from .logit_likelihood import BETA, FIRST_TERM, Likelihood, maximise
from .observations import Observations

if TYPE_CHECKING:
    from planner import AnyTask

FOLDS = 8
BOLTZMANN = "boltzmann"
ALL_TERMS = "terms"

Fold = tuple[NDArray[np.bool_], NDArray[np.bool_]]
"""Steps, shape (N,), that are learned from, and those that are predicted; always whole episodes."""


@dataclass(frozen=True)
class Predictions:
    """The accuracy of a choice model for people to whom it was not fitted.

    Attributes
    ----------
    model : str
    parameters : int
    nats_per_choice : float
        Minus the mean log-probability of the choices.
    stderr : float
        Its standard error, over people.
    better_for : int or None
        Number of people for whom it is better than `boltzmann`; None for that model itself.
    of_people : float array, shape (K,)
        Nats per choice of each person.
    beta : float
        Estimate for all people together.
    weights : dict of str to float
        Estimates for all people together.
    """

    model: str
    parameters: int
    nats_per_choice: float
    stderr: float
    better_for: int | None
    of_people: Floats
    beta: float
    weights: dict[str, float]

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    def as_dict(self) -> dict[str, Any]:
        """Return the row of a table as plain data."""
        return {
            "model": self.model, "parameters": self.parameters, "nats_per_choice": self.nats_per_choice,
            "stderr": self.stderr, "better_for": self.better_for, "people": len(self.of_people), "beta": self.beta,
            "weights": self.weights,
        }  # fmt: skip


@dataclass(frozen=True)
class Comparison:
    """Several choice models, compared on the same people.

    Attributes
    ----------
    people : tuple of str
    actions : int array, shape (K,)
        Number of choices of each person.
    models : tuple of Predictions
    """

    people: tuple[str, ...]
    actions: NDArray[np.int64]
    models: tuple[Predictions, ...]

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    def __getitem__(self, model: str) -> Predictions:
        for row in self.models:
            if row.model == model:
                return row
        raise KeyError(model)

    def as_dict(self) -> dict[str, Any]:
        """Return the comparison as plain data."""
        people = [
            {
                "person": person,
                "actions": int(self.actions[k]),
                "nats_per_choice": {row.model: float(row.of_people[k]) for row in self.models},
            }
            for k, person in enumerate(self.people)
        ]
        return {"comparison": [row.as_dict() for row in self.models], "people": people}


@shows_progress
def compare(
    costs: CostToGo | AnyTask,
    log: Log | str | PathLike[str] | Iterable[Mapping[str, Any]],
    *,
    terms: Mapping[str, Term] = TERMS,
    folds: int = FOLDS,
    drop: Sequence[str] = (),
    rename: Mapping[str, str] | None = None,
    method: Method | None = None,
    strict: bool = False,
    progress: Wanted = None,
) -> Comparison:
    """Return a comparison of choice models by their predictions for people to whom they were not fitted.

    Parameters
    ----------
    costs, log, drop, rename, method, strict
        As in `fit`.
    terms : mapping of str to callable
        The terms; by default `TERMS`.
    folds : int
        Number of groups of people, each of which is held out once.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes: the number of compared models.

    Raises
    ------
    LogError
        As in `fit`, or there are fewer than two people.
    """
    assert callable(progress)
    progress("evaluating states", 0, None)
    costs, log = known_costs(costs), log_of(log)
    recording, known, _ = replayed(costs, log, drop=drop, rename=rename, strict=strict)
    observations = observed(log, costs, recording, known, terms)[0]
    advance = adding(progress, "comparing models", len(terms) + 1 + (len(terms) > 1))
    return compare_observed(observations, method, folds=folds, name=log.name, progress=advance)


def compare_observed(
    observations: Sequence[Observations],
    method: Method | None = None,
    *,
    folds: int = FOLDS,
    name: str = "log",
    progress: Callable[[int], None] | None = None,
) -> Comparison:
    """Return a comparison of choice models on observations of one or several tasks; parameters as in `compare`.

    `progress` is called with the number of models that have been finished since the last call.
    """
    if folds < 2:
        raise ValueError(f"folds {folds}: expected 2 or more")
    likelihood = Likelihood.of(observations, method or Method())
    people = likelihood.steps.people
    if len(people) < 2:
        raise LogError(f"{name}: one person; a comparison needs two or more, to learn from some about others")
    known = method is not None and method.eta is not None
    terms = likelihood.steps.terms
    several = {ALL_TERMS: terms} if len(terms) > 1 else {}
    sets: dict[str, tuple[str, ...]] = {BOLTZMANN: (), **{term: (term,) for term in terms}, **several}
    models: list[Predictions] = []
    for model, chosen in sets.items():
        own = likelihood.with_terms(chosen)
        logs = held_out(own, by_person(own, folds), known=known)
        models.append(_predictions(own, model, logs, models[0] if models else None, known=known))
        if progress is not None:
            progress(1)
    return Comparison(people, np.bincount(likelihood.steps.person), tuple(models))


def by_person(likelihood: Likelihood, folds: int) -> list[Fold]:
    """Return the folds, in each of which every `folds`-th person is held out."""
    group = likelihood.steps.person % min(folds, len(likelihood.steps.people))
    return [(group != fold, group == fold) for fold in range(int(group.max()) + 1)]


def held_out(likelihood: Likelihood, folds: Iterable[Fold], *, known: bool = True, costs: bool = True) -> Floats:
    """Return the log-probability of each choice, shape (N,), under the estimates from the other folds.

    Parameters
    ----------
    likelihood : Likelihood
    folds : iterable of pairs of bool arrays, shape (N,)
        Steps that are learned from, and steps that are predicted; NaN for steps that no fold predicts.
    known : bool
        Whether the learning rate is the likelihood's; otherwise the best of `RATES` is used.
    costs : bool
        Whether choices depend on costs.
    """
    result, at = np.full(len(likelihood.steps), np.nan), None
    for learned, predicted in folds:
        some = replace(likelihood, steps=likelihood.steps.only(learned))
        fitted, at = pooled(some, at, known=known, costs=costs)
        steps = likelihood.steps.only(predicted).together()
        result[predicted] = replace(fitted, steps=steps).log_probability(at)
    return result


def pooled(
    likelihood: Likelihood, near: Floats | None = None, *, known: bool = True, costs: bool = True
) -> tuple[Likelihood, Floats]:
    """Return the coordinates of largest likelihood for all people together, shape (1, P), and that likelihood.

    Parameters
    ----------
    likelihood : Likelihood
    near : float array, shape (1, P), optional
        Starting values.
    known, costs
        As in `held_out`.
    """
    together = replace(likelihood, steps=likelihood.steps.together())
    fixed = fixed_of(likelihood, 1)
    fixed[:, BETA] = not costs
    at = np.where(fixed, 0.0, start_of(likelihood, 1) if near is None else near)
    found: list[tuple[float, Likelihood, Floats]] = []
    for rate in [likelihood.eta] if known or not likelihood.steps.told else RATES.tolist():
        tried = replace(together, eta=rate)
        at, value, _ = maximise(tried, at, fixed)
        found.append((float(value[0]), tried, at))
    _, best, at = max(found, key=lambda one: one[0])
    return best, at


def _predictions(
    likelihood: Likelihood, model: str, logs: Floats, reference: Predictions | None, *, known: bool
) -> Predictions:
    """Return the summary of a model's log-probabilities `logs`, and those of a reference model."""
    steps = likelihood.steps
    _, at = pooled(likelihood, known=known)
    mean, error, each = summed_up(likelihood, logs)
    return Predictions(
        model, 1 + len(steps.terms) + steps.told * (2 - known), mean, error,
        None if reference is None else int((each < reference.of_people).sum()), each,
        float(likelihood.ranges.beta(at[0, BETA])),
        {term: float(at[0, FIRST_TERM + j]) for j, term in enumerate(steps.terms)},
    )  # fmt: skip


def summed_up(likelihood: Likelihood, logs: Floats) -> tuple[float, float, Floats]:
    """Return nats per choice, their standard error over people, and those of each person, shape (K,).

    Parameters
    ----------
    likelihood : Likelihood
    logs : float array, shape (N,)
        Log-probabilities of the choices.
    """
    people = len(likelihood.steps.people)
    count = np.bincount(likelihood.steps.person, minlength=people)
    total = np.bincount(likelihood.steps.person, -logs, people)
    mean = total.sum() / count.sum()
    spread = ((total - mean * count) ** 2).sum() * people / max(people - 1, 1)  # of a ratio, by the delta method
    return float(mean), float(np.sqrt(spread) / count.sum()), total / np.maximum(count, 1)
