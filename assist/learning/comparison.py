"""Which choice model predicts people best: each is fitted to some people, and asked about others.

Parameters are those that fit the people of the other folds best, all together (maximum likelihood, Newton's method),
so that nothing that is predicted was seen. Models differ in what may speak for a choice: cost alone (`boltzmann`),
cost and one term, cost and all terms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo
from planner.system.arrays import read_only
from planner.system.progress import Wanted, adding, shows_progress

from ..people.decision import Floats
from ..people.terms import TERMS, Term
from .fit import LogError, observed, replayed
from .hierarchy import RATES, fixed_of, start_of
from .likelihood import Method
from .log import Log
from .logit_likelihood import BETA, FIRST_TERM, Likelihood, maximise
from .observations import Observations

FOLDS = 8
BOLTZMANN = "boltzmann"
ALL_TERMS = "terms"

Fold = tuple[NDArray[np.bool_], NDArray[np.bool_]]
"""Which steps, shape (N,), are learned from, and which are predicted; of an episode all or none."""


@dataclass(frozen=True)
class Predictions:
    """How well a choice model predicts people whom it was not fitted to.

    Attributes
    ----------
    model : str
    parameters : int
    nats_per_choice : float
        Minus the mean log-probability of what was chosen.
    stderr : float
        Its standard error, over people.
    better_for : int or None
        For how many people it is better than `boltzmann`; None for that model itself.
    of_people : float array, shape (K,)
        Nats per choice of each person.
    beta : float
        That fits all people best.
    weights : dict of str to float
        Likewise.
    """

    model: str
    parameters: int
    nats_per_choice: float
    stderr: float
    better_for: int | None
    of_people: Floats
    beta: float
    weights: dict[str, float]

    def __post_init__(self) -> None:
        read_only(self)

    def as_dict(self) -> dict[str, Any]:
        """Give it as plain data, a row of a table."""
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
        How many choices each of them made.
    models : tuple of Predictions
    """

    people: tuple[str, ...]
    actions: NDArray[np.int64]
    models: tuple[Predictions, ...]

    def __post_init__(self) -> None:
        read_only(self)

    def __getitem__(self, model: str) -> Predictions:
        for row in self.models:
            if row.model == model:
                return row
        raise KeyError(model)

    def as_dict(self) -> dict[str, Any]:
        """Give all of it as plain data."""
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
    costs: CostToGo,
    log: Log,
    *,
    terms: Mapping[str, Term] = TERMS,
    folds: int = FOLDS,
    drop: Sequence[str] = (),
    rename: Mapping[str, str] | None = None,
    method: Method | None = None,
    strict: bool = False,
    progress: Wanted = None,
) -> Comparison:
    """Compare choice models by how well they predict people whom they were not fitted to.

    Parameters
    ----------
    costs, log, drop, rename, method, strict
        As for `fit`.
    terms : mapping of str to callable
        Those that are given, or one's own as well.
    folds : int
        Groups of people that are left out in turn.
    progress : callable or bool, optional
        Who is told how far it is, as in `planner.system.progress`: how many models have been compared.

    Raises
    ------
    LogError
        As from `fit`; or there are not two people to learn from one about the other.
    """
    assert callable(progress)
    progress("evaluating states", 0, None)
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
    """Compare choice models on observations, of one task or of several; parameters as of `compare`.

    `progress` is called with how many models have been finished since the last call.
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
    """Leave every so many-th person out in turn."""
    group = likelihood.steps.person % min(folds, len(likelihood.steps.people))
    return [(group != fold, group == fold) for fold in range(int(group.max()) + 1)]


def held_out(likelihood: Likelihood, folds: Iterable[Fold], *, known: bool = True, costs: bool = True) -> Floats:
    """Give the log-probability of each choice, shape (N,), under what fits the choices that are learned from best.

    Parameters
    ----------
    likelihood : Likelihood
    folds : iterable of pairs of bool arrays, shape (N,)
        Together they predict each step once; where they do not, there is NaN.
    known : bool
        Whether the rate of the trust update is the likelihood's; otherwise that of `RATES` is taken that fits best.
    costs : bool
        Whether costs speak for choices.
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
    """Find the coordinates, shape (1, P), that fit all people together best, and the likelihood in which they do.

    Parameters
    ----------
    likelihood : Likelihood
    near : float array, shape (1, P), optional
        Where to begin.
    known, costs
        As of `held_out`.
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
    """Sum up what a model says of the choices, `logs`, beside a model of reference."""
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
    """Give nats per choice, their standard error over people, and those of each person, shape (K,).

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
