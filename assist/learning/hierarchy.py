"""Expertise, influence and weights of terms, of many people at once: each is taken for one of a population.

Everybody's coordinates (see `weighing`) are drawn from independent normal distributions, whose means and spreads are
those under which all choices are most likely; integrals over a person's coordinates are Laplace's approximations
(empirical Bayes; EM as in Lindstrom and Bates 1990). An estimate is the mode of a person's posterior: where their own
choices say little it is what people are like in general. An interval is that of the profile likelihood of their own
choices alone. It is wider, but covers the truth as often as it says whatever the population is; posterior intervals do
so on average over people who are like the population, and not for those who are unlike it.

The rate eta of the trust update is the same for all people.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from planner.system.arrays import read_only

from ..people.decision import NOTHING, Floats
from .likelihood import Method
from .logit_likelihood import BETA, FIRST_TERM, THETA, Likelihood, Prior, maximise
from .maximum_likelihood import Estimate, Fit
from .observations import Observations

ROUNDS = 60  # of EM
NARROWEST = 0.05
"""The least spread that a population is taken to have, as a share of a third of a coordinate's range."""
RATES = np.linspace(0.0, 1.0, 11)  # of trust that are tried
ENDS = 20  # steps to the end of an interval, at most


@dataclass(frozen=True)
class Hierarchy:
    """A population of people, and each of them.

    Attributes
    ----------
    likelihood : Likelihood
    mean, spread : float arrays, shape (P,)
        Of the population's coordinates.
    at : float array, shape (K, P)
        Each person's most likely ones.
    deviation : float array, shape (K, P)
        Standard deviations of each person's posterior.
    evidence : float
        The log-likelihood of all choices, people's coordinates being integrated out.
    """

    likelihood: Likelihood
    mean: Floats
    spread: Floats
    at: Floats
    deviation: Floats
    evidence: float

    def __post_init__(self) -> None:
        read_only(self)


def fit_hierarchy(likelihood: Likelihood, rounds: int = ROUNDS) -> Hierarchy:
    """Estimate a population and each of its people.

    Parameters
    ----------
    likelihood : Likelihood
    rounds : int
        The most steps of the EM algorithm.
    """
    low, high = likelihood.ranges.low, likelihood.ranges.high
    people, size = len(likelihood.steps.people), len(low)
    third = (high - low) / 3
    pooled, _, _ = maximise(
        replace(likelihood, steps=likelihood.steps.together()), start_of(likelihood, 1), fixed_of(likelihood, 1)
    )
    mean, spread = pooled[0], third / 2
    at, fixed = np.repeat(pooled, people, axis=0), fixed_of(likelihood, people)
    for _ in range(rounds):
        prior = Prior(mean, spread**-2)
        at, value, curvature = maximise(likelihood, at, fixed, prior, 20)
        variance = np.linalg.inv(curvature)
        own = np.diagonal(variance, axis1=1, axis2=2)
        before = mean, spread
        # Weights are 0 rather than anything far from it, and as if one more person were near the others.
        towards = np.where(np.arange(size) >= FIRST_TERM, (spread / third) ** 2, 0.0)
        mean = at.sum(axis=0) / (people + towards)
        scatter = ((at - mean) ** 2 + own).sum(axis=0) + (NARROWEST * third) ** 2
        spread = np.sqrt(scatter / (people + 1))
        if np.allclose(np.concatenate(before), np.concatenate([mean, spread]), atol=1e-3):
            break
    prior = Prior(mean, spread**-2)
    at, value, curvature = maximise(likelihood, at, fixed, prior)
    _, logarithm = np.linalg.slogdet(curvature)
    evidence = value - logarithm / 2 - np.log(spread).sum()
    own = np.diagonal(np.linalg.inv(curvature), axis1=1, axis2=2)
    return Hierarchy(likelihood, mean, spread, at, np.sqrt(own), float(evidence.sum()))


def start_of(likelihood: Likelihood, people: int) -> Floats:
    """Begin with no weights and a beta in the middle of its range."""
    start = np.zeros((people, len(likelihood.ranges.low)))
    start[:, BETA] = likelihood.ranges.high[BETA] / 2
    return start


def fixed_of(likelihood: Likelihood, people: int) -> NDArray[np.bool_]:
    """Keep theta at 0.5 where nothing was ever suggested."""
    fixed = np.zeros((people, len(likelihood.ranges.low)), dtype=bool)
    fixed[:, THETA] = not likelihood.steps.told
    return fixed


def with_rate(likelihood: Likelihood, method: Method, progress: Callable[[int], None] | None = None) -> Likelihood:
    """Give the rate of the trust update that fits all people together best, of `RATES`, unless it is known."""
    if method.eta is not None or not likelihood.steps.told:
        return likelihood
    found = []
    for rate in RATES:
        found.append(fit_hierarchy(replace(likelihood, eta=float(rate)), 5).evidence)
        if progress is not None:
            progress(1)
    return replace(likelihood, eta=float(RATES[int(np.argmax(found))]))


def intervals(likelihood: Likelihood, near: Floats, level: float) -> tuple[Floats, Floats, Floats]:
    """Find the ends of everybody's profile-likelihood intervals.

    Parameters
    ----------
    likelihood : Likelihood
    near : float array, shape (K, P)
        Where to begin.
    level : float

    Returns
    -------
    low, high : float arrays, shape (K, P)
        Where nothing is rejected up to the end of a coordinate's range, its end.
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
    wanted = float(np.sqrt(chdtri(1, 1 - level)))
    width = np.sqrt(np.diagonal(np.linalg.pinv(curvature + 1e-9 * np.eye(size)), axis1=1, axis2=2))
    ends = [
        np.stack([_end(likelihood, at, best, axis, side, wanted, width[:, axis]) for axis in range(size)], axis=1)
        for side in (-1, 1)
    ]
    return ends[0], ends[1], best


def _end(
    likelihood: Likelihood, at: Floats, best: Floats, axis: int, side: int, wanted: float, width: Floats
) -> Floats:
    """Find how far one coordinate can go before the root of the likelihood ratio is `wanted`, shape (K,)."""
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
    for _ in range(ENDS):
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


def fit_terms(
    observations: Sequence[Observations], method: Method, *, progress: Callable[[int], None] | None = None
) -> tuple[list[Fit], Hierarchy]:
    """Estimate everybody's parameters where terms speak for choices besides cost.

    Parameters
    ----------
    observations : sequence of Observations
        One for each person, all with the same terms.
    method : Method
    progress : callable, optional
        Called with how many of `RATES` have been tried since the last call; they are only tried where the rate of the
        trust update is not known and something was suggested.
    """
    likelihood = with_rate(Likelihood.of(observations, method), method, progress)
    found = fit_hierarchy(likelihood)
    low, high, _ = intervals(likelihood, found.at, method.level)
    value = likelihood.derivatives(found.at)[0]
    fits = []
    for k, o in enumerate(observations):
        estimates = [_estimate(likelihood, axis, found.at[k], low[k], high[k]) for axis in range(len(found.mean))]
        told = bool((o.suggested != NOTHING).any())
        fits.append(
            Fit(
                o, estimates[BETA], estimates[THETA] if told else None, None, float(value[k]), likelihood.eta, method,
                dict(zip(o.terms, estimates[FIRST_TERM:], strict=True)),
            )
        )  # fmt: skip
    return fits, found


def _estimate(likelihood: Likelihood, axis: int, at: Floats, low: Floats, high: Floats) -> Estimate:
    """Give an estimate, and an interval that holds it."""
    ranges = likelihood.ranges
    ends = min(low[axis], at[axis]), max(high[axis], at[axis])
    points = np.array([at[axis], *ends])
    shown = ranges.beta(points) if axis == BETA else ranges.theta(points) if axis == THETA else points
    value, first, last = shown.tolist()
    return Estimate(
        value, (first, last), bool(ends[0] <= ranges.low[axis] + 1e-9), bool(ends[1] >= ranges.high[axis] - 1e-9)
    )
