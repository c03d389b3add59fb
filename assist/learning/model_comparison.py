"""Comparison of choice models: cost alone (`boltzmann`), cost and one term, and cost and all terms.

A model's parameters are those of largest likelihood for people together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planner.system.progress import Wanted, adding, shows_progress

from ..people.decision import Floats
from ..people.terms import TERMS
from .comparison import FOLDS, Comparison, compared, folds_of
from .evidence import Evidence, observations_of
from .hierarchy import RATES, fixed_of, start_of
from .likelihood import Method
from .logit_likelihood import BETA, FIRST_TERM, THETA, Likelihood, maximise
from .observations import Observations

BOLTZMANN = "boltzmann"
ALL_TERMS = "terms"
COMPARING = "comparing models"


@shows_progress
def compare_models(
    people: Evidence | Sequence[Observations], method: Method | None = None, *, folds: int = FOLDS,
    time_limit: float | None = None, progress: Wanted = None,
) -> Comparison:  # fmt: skip
    """Return a comparison of choice models by their predictions for people to whom they were not fitted.

    Parameters
    ----------
    people : Evidence, or sequence of Observations
        A log that was replayed, compared with all `TERMS`; or observations with terms, such as those of `observed(task,
        log, terms=TERMS)`, of one task or of several.
    method : Method, optional
    folds : int
        Number of groups of people, each of which is held out once.
    time_limit : float, optional
        Seconds after which no further model is begun; those without a result are in `Comparison.left_out`.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes: the number of models that have been compared.

    Raises
    ------
    InputFileError
        There are fewer than two people.
    """
    assert callable(progress)
    method = method or Method()
    likelihood = Likelihood.of(observations_of(people, TERMS), method)
    steps = likelihood.steps
    several = {ALL_TERMS: steps.terms} if len(steps.terms) > 1 else {}
    sets: dict[str, tuple[str, ...]] = {BOLTZMANN: (), **{term: (term,) for term in steps.terms}, **several}
    known = method.eta is not None
    fits = {model: partial(_fit_to, likelihood.with_terms(chosen), known) for model, chosen in sets.items()}
    return compared(
        fits, steps.people, np.bincount(steps.person), BOLTZMANN, fold=folds_of(len(steps.people), folds),
        level=method.level, time_limit=time_limit, progress=adding(progress, COMPARING, len(fits)),
    )  # fmt: skip


@dataclass(frozen=True)
class Pooled:
    """A model with terms whose parameters are the same for all people.

    Attributes
    ----------
    likelihood : Likelihood
        Of all people, with the estimated learning rate.
    at : float array, shape (1, P)
        The coordinates.
    """

    likelihood: Likelihood
    at: Floats

    @property
    def parameters(self) -> dict[str, float]:
        """Beta, the weights of terms, and with suggestions theta and eta."""
        steps, ranges = self.likelihood.steps, self.likelihood.ranges
        found = {"beta": float(ranges.beta(self.at[0, BETA]))}
        found |= {term: float(self.at[0, FIRST_TERM + j]) for j, term in enumerate(steps.terms)}
        if steps.told:
            found |= {"theta": float(ranges.theta(self.at[0, THETA])), "eta": self.likelihood.eta}
        return found

    def log_probabilities(self, steps: NDArray[np.bool_]) -> Floats:
        """Return the log-probability of each of some steps, given by an array of shape (N,)."""
        of_all = self.likelihood.steps.only(steps).together()
        return replace(self.likelihood, steps=of_all).log_probability(self.at)

    def log_probability(self, people: NDArray[np.bool_]) -> Floats:
        """Return the log-probability of all that each of some people chose; `people` has shape (K,)."""
        person = self.likelihood.steps.person
        of_steps = self.log_probabilities(people[person])
        return np.bincount(person[people[person]], of_steps, len(people))[people].astype(np.float64)


def _fit_to(likelihood: Likelihood, known: bool, people: NDArray[np.bool_], fits: Sequence[Pooled]) -> Pooled:
    near = fits[-1].at if len(fits) > 1 else None
    return pooled(likelihood, people[likelihood.steps.person], near, known=known)


def pooled(
    likelihood: Likelihood, steps: NDArray[np.bool_], near: Floats | None = None, *, known: bool = True,
    costs: bool = True,
) -> Pooled:  # fmt: skip
    """Return the model of largest likelihood for all people together.

    Parameters
    ----------
    likelihood : Likelihood
    steps : bool array, shape (N,)
        Steps that are learned from, in whole episodes.
    near : float array, shape (1, P), optional
        Starting values.
    known : bool
        Whether the learning rate is the likelihood's; otherwise the best of `RATES` is used.
    costs : bool
        Whether choices depend on costs.
    """
    together = replace(likelihood, steps=likelihood.steps.only(steps).together())
    fixed = fixed_of(likelihood, 1)
    fixed[:, BETA] = not costs
    at = np.where(fixed, 0.0, start_of(likelihood, 1) if near is None else near)
    found: list[tuple[float, float, Floats]] = []
    for rate in [likelihood.eta] if known or not likelihood.steps.told else RATES.tolist():
        at, value, _ = maximise(replace(together, eta=rate), at, fixed)
        found.append((float(value[0]), rate, at))
    _, rate, at = max(found, key=lambda one: one[0])
    return Pooled(replace(likelihood, eta=rate), at)
