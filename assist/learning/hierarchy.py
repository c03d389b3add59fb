"""A hierarchical model of many people: expertise, influence and weights of terms, drawn from one population.

Each person's coordinates (`logit_likelihood`) are drawn from independent normal distributions. Their means and spreads
maximise the marginal likelihood of all choices; integrals over a person's coordinates are Laplace approximations
(empirical Bayes; EM as in Lindstrom and Bates 1990). A person's estimate is the mode of the posterior, which is near
the population's mean if there are few choices. A person's interval is that of the profile likelihood of their own
choices. It is wider than a posterior interval, but has its coverage for any population; a posterior interval has it on
average over people of the population only.

The learning rate eta is the same for all people.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import read_only
from planner.system.results import ByContent

from ..people.decision import NOTHING, Floats
from .intervals import largest_fall
from .likelihood import Method
from .logit_likelihood import BETA, FIRST_TERM, THETA, Likelihood, Prior, maximise
from .observations import Observations
from .person_estimate import Estimate, PersonEstimate

RATES = np.linspace(0.0, 1.0, 11)  # of trust that are tried


@dataclass(frozen=True, eq=False, repr=False)
class Hierarchy(ByContent):
    """An estimated population, and the estimates of its people.

    Attributes
    ----------
    likelihood : Likelihood
    mean, spread : float arrays, shape (P,)
        Mean and spread of each coordinate in the population.
    at : float array, shape (K, P)
        Mode of each person's posterior.
    deviation : float array, shape (K, P)
        Standard deviations of each person's posterior.
    evidence : float
        Marginal log-likelihood of all choices.
    """

    likelihood: Likelihood
    mean: Floats
    spread: Floats
    at: Floats
    deviation: Floats
    evidence: float

    def __post_init__(self) -> None:
        read_only(self)


def fit_hierarchy(likelihood: Likelihood, rounds: int = 60) -> Hierarchy:
    """Return the estimates of a population and its people.

    Parameters
    ----------
    likelihood : Likelihood
    rounds : int
        Largest number of EM steps.
    """
    low, high = likelihood.ranges.low, likelihood.ranges.high
    people, size = len(likelihood.people), len(low)
    third = (high - low) / 3
    _, together = pooled(likelihood)
    mean, spread = together[0], third / 2
    at, fixed = np.repeat(together, people, axis=0), fixed_of(likelihood, people)
    for _ in range(rounds):
        prior = Prior(mean, spread**-2)
        at, value, curvature = maximise(likelihood, at, fixed, prior, 20)
        variance = np.linalg.inv(curvature)
        own = np.diagonal(variance, axis1=1, axis2=2)
        before = mean, spread
        # Weights are 0 rather than anything far from it, and as if one more person were near the others.
        towards = np.where(np.arange(size) >= FIRST_TERM, (spread / third) ** 2, 0.0)
        mean = at.sum(axis=0) / (people + towards)
        # A population is never narrower than a twentieth of a third of the range.
        scatter = ((at - mean) ** 2 + own).sum(axis=0) + (0.05 * third) ** 2
        spread = np.sqrt(scatter / (people + 1))
        if np.allclose(np.concatenate(before), np.concatenate([mean, spread]), atol=1e-3):
            break
    prior = Prior(mean, spread**-2)
    at, value, curvature = maximise(likelihood, at, fixed, prior)
    _, logarithm = np.linalg.slogdet(curvature)
    evidence = value - logarithm / 2 - np.log(spread).sum()
    own = np.diagonal(np.linalg.inv(curvature), axis1=1, axis2=2)
    return Hierarchy(likelihood, mean, spread, at, np.sqrt(own), float(evidence.sum()))


def pooled(
    likelihood: Likelihood, steps: NDArray[np.bool_] | None = None, near: Floats | None = None, *, known: bool = True,
    costs: bool = True,
) -> tuple[Likelihood, Floats]:  # fmt: skip
    """Return the coordinates of largest likelihood for all people together, and the likelihood with its learning rate.

    Parameters
    ----------
    likelihood : Likelihood
    steps : bool array, shape (N,), optional
        Steps that are learned from, in whole episodes; all unless given.
    near : float array, shape (1, P), optional
        Starting values; no weights, and beta in the middle of its range, unless given.
    known : bool
        Whether the learning rate is the likelihood's; otherwise the best of `RATES` is used.
    costs : bool
        Whether choices depend on costs.

    Returns
    -------
    likelihood : Likelihood
    at : float array, shape (1, P)
    """
    together, fixed = likelihood.together(steps), fixed_of(likelihood, 1)
    fixed[:, BETA] = not costs
    if near is None:
        near = np.zeros((1, len(likelihood.ranges.low)))
        near[:, BETA] = likelihood.ranges.high[BETA] / 2
    at = np.where(fixed, 0.0, near)
    found: list[tuple[float, float, Floats]] = []
    for rate in [likelihood.eta] if known or not likelihood.steps.told else RATES.tolist():
        at, value, _ = maximise(replace(together, eta=rate), at, fixed)
        found.append((float(value[0]), rate, at))
    _, rate, at = max(found, key=lambda one: one[0])
    return replace(likelihood, eta=rate), at


def fixed_of(likelihood: Likelihood, people: int) -> NDArray[np.bool_]:
    """Return which coordinates are fixed: theta, at 0.5, without suggestions."""
    fixed = np.zeros((people, len(likelihood.ranges.low)), dtype=bool)
    fixed[:, THETA] = not likelihood.steps.told
    return fixed


def with_rate(likelihood: Likelihood, method: Method) -> Likelihood:
    """Return the likelihood with the best learning rate of `RATES` for all people, unless it is known."""
    if method.eta is not None or not likelihood.steps.told:
        return likelihood
    found = [fit_hierarchy(replace(likelihood, eta=rate), 5).evidence for rate in RATES.tolist()]
    return replace(likelihood, eta=float(RATES[int(np.argmax(found))]))


def intervals(likelihood: Likelihood, near: Floats, level: float) -> tuple[Floats, Floats, Floats]:
    """Return the ends of all people's profile-likelihood intervals.

    Parameters
    ----------
    likelihood : Likelihood
    near : float array, shape (K, P)
        Starting values.
    level : float

    Returns
    -------
    low, high : float arrays, shape (K, P)
        Ends of the intervals; the end of a coordinate's range if nothing up to it is rejected.
    value : float array, shape (K,)
        The largest log-likelihood.
    """
    people, size = near.shape
    fixed = fixed_of(likelihood, people)
    at, best, curvature = maximise(likelihood, near, fixed)
    for other in (-3.0, 3.0) if likelihood.steps.told else ():  # trust that reaches 0 or 1 may make several maxima
        begin = near.copy()
        begin[:, THETA] = other
        tried = maximise(likelihood, begin, fixed)
        better = tried[1] > best
        at, best = np.where(better[:, None], tried[0], at), np.where(better, tried[1], best)
        curvature = np.where(better[:, None, None], tried[2], curvature)
    wanted = float(np.sqrt(2 * largest_fall(level)))
    width = np.sqrt(np.diagonal(np.linalg.pinv(curvature + 1e-9 * np.eye(size)), axis1=1, axis2=2))
    ends = [
        np.stack([_end(likelihood, at, best, axis, side, wanted, width[:, axis]) for axis in range(size)], axis=1)
        for side in (-1, 1)
    ]
    return ends[0], ends[1], best


def _end(
    likelihood: Likelihood, at: Floats, best: Floats, axis: int, side: int, wanted: float, width: Floats
) -> Floats:
    """Return the value of one coordinate at which the root of the likelihood ratio is `wanted`, shape (K,)."""
    end = (likelihood.ranges.high if side > 0 else likelihood.ranges.low)[axis]
    fixed = fixed_of(likelihood, len(at))
    if fixed[0, axis]:
        return np.full(len(at), end)
    fixed[:, axis] = True
    inside, root_inside = at[:, axis].copy(), np.zeros(len(at))
    outside, root_outside = np.full(len(at), end), np.full(len(at), np.nan)
    now = at.copy()
    span = np.abs(end - inside)
    step = np.minimum(wanted * np.maximum(width, 1e-3 * span), span)
    done = span <= 1e-9
    for _ in range(20):  # usually fewer: each step doubles, or shrinks a bracket
        bracketed = np.isfinite(root_outside)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.where(bracketed, (wanted - root_inside) / (root_outside - root_inside), np.nan)
        # Roots are almost linear in the coordinate; where they are not, a bracket still shrinks.
        next_in = inside + np.clip(share, 0.2, 0.8) * (outside - inside)
        next_out = np.clip(inside + side * step, likelihood.ranges.low[axis], likelihood.ranges.high[axis])
        value = np.where(done, inside, np.where(bracketed, next_in, next_out))
        now[:, axis] = value
        now, reached, _ = maximise(likelihood, now, fixed)
        root = np.sqrt(np.maximum(2 * (best - reached), 0.0))
        over = root > wanted
        inside, root_inside = np.where(over, inside, value), np.where(over, root_inside, root)
        outside, root_outside = np.where(over, value, outside), np.where(over, root, root_outside)
        step = np.where(over, step, 2 * step)
        done |= ~over & (np.abs(value - end) <= 1e-9)
        done |= np.isfinite(root_outside) & (np.abs(outside - inside) <= 1e-3 * span)
        done |= np.abs(root - wanted) <= 1e-3
        if done.all():
            break
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (wanted - root_inside) / (root_outside - root_inside)
    return np.where(np.isfinite(root_outside), inside + np.clip(share, 0.0, 1.0) * (outside - inside), end)


def fit_terms(observations: Sequence[Observations], method: Method) -> tuple[list[PersonEstimate], Hierarchy]:
    """Return the estimates of all people's parameters with terms, and the population.

    Parameters
    ----------
    observations : sequence of Observations
        Observations of each person, all with the same terms.
    method : Method
    """
    likelihood = with_rate(Likelihood.of(observations, method), method)
    found = fit_hierarchy(likelihood)
    low, high, _ = intervals(likelihood, found.at, method.level)
    value = likelihood.derivatives(found.at)[0]
    fits = []
    for k, o in enumerate(observations):
        every = [_estimate(likelihood, axis, found.at[k], low[k], high[k]) for axis in range(len(found.mean))]
        estimates = {"beta": every[BETA]} | ({"theta": every[THETA]} if (o.suggested != NOTHING).any() else {})
        estimates |= zip(o.terms, every[FIRST_TERM:], strict=True)
        fits.append(PersonEstimate(o, estimates, float(value[k]), likelihood.eta, method))
    return fits, found


def _estimate(likelihood: Likelihood, axis: int, at: Floats, low: Floats, high: Floats) -> Estimate:
    """Return an estimate with an interval that contains it."""
    ranges = likelihood.ranges
    ends = min(low[axis], at[axis]), max(high[axis], at[axis])
    points = np.array([at[axis], *ends])
    shown = ranges.beta(points) if axis == BETA else ranges.theta(points) if axis == THETA else points
    value, first, last = shown.tolist()
    return Estimate(
        value, (first, last), bool(ends[0] <= ranges.low[axis] + 1e-9), bool(ends[1] >= ranges.high[axis] - 1e-9)
    )
