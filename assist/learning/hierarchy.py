"""A hierarchical model of many people: expertise, influence and weights of terms, drawn from one population.

Each person's coordinates (`logit_likelihood`) are drawn from independent normal distributions. Their means and spreads
maximise the marginal likelihood of all choices (empirical Bayes; EM as in Lindstrom and Bates 1990). Integrals over
theta are sums over nodes, as trust that reaches 0 or 1 makes several maxima; those over a person's other coordinates
are Laplace approximations. A person's estimate is the mode of the posterior, which is near the population's mean if
there are few choices. A person's interval is that of the profile likelihood of their own choices. It is wider than a
posterior interval, but has its coverage for any population; a posterior interval has it on average over people of the
population only.

The learning rate eta is the same for all people, and maximises the same marginal likelihood. People's intervals are
those with this rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp

from planner.system.arrays import read_only
from planner.system.results import ByContent

from ..people.decision import NOTHING, Floats
from .intervals import end_of, largest_fall, outwards
from .likelihood import Method
from .logit_likelihood import BETA, FIRST_TERM, THETA, Likelihood, Prior, maximise
from .observations import Observations
from .person_estimate import Estimate, PersonEstimate

RATES = np.linspace(0.0, 1.0, 41)
"""Learning rates that are tried before the best is refined."""

WHOLE = 3
"""EM steps in which all `RATES` are tried."""


@dataclass(frozen=True, eq=False, repr=False)
class Hierarchy(ByContent):
    """An estimated population, and the estimates of its people.

    Attributes
    ----------
    likelihood : Likelihood
    mean, spread : float arrays, shape (P,)
        Mean and spread of each coordinate in the population; arbitrary where `Ranges.told_apart` is false.
    at : float array, shape (K, P)
        Mode of each person's posterior.
    deviation : float array, shape (K, P)
        Standard deviations of each person's posterior.
    evidence : float
        Marginal log-likelihood of all choices.
    rate : Estimate, optional
        Of the learning rate, which is that of the likelihood, with its likelihood-ratio interval; None if it is known.
    """

    likelihood: Likelihood
    mean: Floats
    spread: Floats
    at: Floats
    deviation: Floats
    evidence: float
    rate: Estimate | None = None

    def __post_init__(self) -> None:
        read_only(self)


def fit_hierarchy(
    likelihood: Likelihood, rounds: int = 60, *, known: bool = True, near: Hierarchy | None = None
) -> Hierarchy:
    """Return the estimates of a population and its people, after that many EM steps at most.

    Unless the learning rate is `known`, to be that of the likelihood, the one of largest marginal likelihood is found.
    The search begins with what is best for all people together, unless `near` is given.
    """
    people, size = len(likelihood.people), len(likelihood.ranges.low)
    third = (likelihood.ranges.high - likelihood.ranges.low) / 3
    told, known = likelihood.steps.told, known or not likelihood.steps.told
    if near is None:
        likelihood, together = pooled(likelihood, known=known)
        mean, spread, at = together[0], third / 2, np.repeat(together, people, axis=0)
    else:
        mean, spread, at = near.mean, near.spread, near.at
    fixed, width = fixed_of(likelihood, people), RATES[1]
    for number in range(rounds):
        before, rate = (mean, spread), likelihood.eta
        at, _, curvature = maximise(likelihood, at, fixed, Prior(mean, spread**-2), 20)
        if not known:
            tried = RATES if number < WHOLE else np.clip(rate + width * np.linspace(-1.0, 1.0, 5), 0.0, 1.0)
            logs = _over_theta(likelihood, at, mean, spread, tried)[0].sum(axis=0)
            likelihood = replace(likelihood, eta=float(tried[logs.argmax()]))
            width *= 0.5 if number >= WHOLE and logs.argmax() == 2 else 1.0
        centre, own = at, np.diagonal(np.linalg.inv(curvature), axis1=1, axis2=2)
        if told:
            centre, own = at.copy(), own.copy()
            _, mass = _over_theta(likelihood, at, mean, spread, np.array([likelihood.eta]))
            nodes = likelihood.ranges.thetas()
            centre[:, THETA] = mass[:, 0] @ nodes
            own[:, THETA] = mass[:, 0] @ nodes**2 - centre[:, THETA] ** 2
        # Weights are 0 rather than anything far from it, and as if one more person were near the others.
        towards = np.where(np.arange(size) >= FIRST_TERM, (spread / third) ** 2, 0.0)
        mean = centre.sum(axis=0) / (people + towards)
        # A population is never narrower than a twentieth of a third of the range.
        scatter = ((centre - mean) ** 2 + own).sum(axis=0) + (0.05 * third) ** 2
        spread = np.where(fixed[0], spread, np.sqrt(scatter / (people + 1)))
        same = np.allclose(np.concatenate(before), np.concatenate([mean, spread]), atol=1e-3)
        if same and (known or (number >= WHOLE and width < 1e-3)):
            break
    prior = Prior(mean, spread**-2)
    at, value, curvature = maximise(likelihood, at, fixed, prior)
    own = np.diagonal(np.linalg.inv(curvature), axis1=1, axis2=2)
    if told:  # theta on nodes, the other coordinates by Laplace's approximation
        value = _over_theta(likelihood, at, mean, spread, np.array([likelihood.eta]))[0][:, 0]
        others = np.arange(size) != THETA
        value = value - (prior.precision * (at - mean) ** 2)[:, others].sum(axis=1) / 2
        curvature, spreads = curvature[:, others][:, :, others], spread[others]
    else:
        spreads = spread
    evidence = value - np.linalg.slogdet(curvature)[1] / 2 - np.log(spreads).sum()
    return Hierarchy(likelihood, mean, spread, at, np.sqrt(own), float(evidence.sum()))


def _over_theta(
    likelihood: Likelihood, at: Floats, mean: Floats, spread: Floats, rates: Floats
) -> tuple[Floats, Floats]:
    """Return the mean likelihood of each person over theta, (K, E), as a logarithm, and the shares of nodes, (K, E, T).

    The other coordinates are those of `at`, shape (K, P). Theta is normal in the population.
    """
    nodes = likelihood.ranges.thetas()
    prior = -(((nodes - mean[THETA]) / spread[THETA]) ** 2) / 2
    logs = likelihood.by_trust(at, nodes, rates) + prior - logsumexp(prior)
    total = logsumexp(logs, axis=2)
    return total, np.exp(logs - total[:, :, None])


def pooled(
    likelihood: Likelihood, steps: NDArray[np.bool_] | None = None, near: Floats | None = None, *, known: bool = True,
    costs: bool = True,
) -> tuple[Likelihood, Floats]:  # fmt: skip
    """Return the coordinates of largest likelihood for all people together, and the likelihood with its learning rate.

    The coordinates, shape (1, P), are learned from `steps`, in whole episodes. The search begins at `near` or, unless
    given, without weights and with beta in the middle of its range. Unless the learning rate is `known`, to be that of
    the likelihood, the best one is found. `costs` says whether choices depend on costs.
    """
    together, fixed = likelihood.together(steps), fixed_of(likelihood, 1)
    fixed[:, BETA] = not costs
    if near is None:
        near = np.zeros((1, len(likelihood.ranges.low)))
        near[:, BETA] = likelihood.ranges.high[BETA] / 2
    at, _, _ = maximise(together, np.where(fixed, 0.0, near), fixed)
    if known or not likelihood.steps.told:
        return likelihood, at
    best = Maximum(-np.inf, likelihood.eta, at)

    def loss(rate: float) -> float:
        nonlocal best
        at, value, _ = maximise(replace(together, eta=rate), best.at, fixed)
        best = max(best, Maximum(float(value[0]), float(rate), at), key=lambda one: one.value)
        return -float(value[0])

    while True:  # the rates that are likely with the other coordinates as they are
        before = best.value
        values = together.by_trust(best.at, together.ranges.thetas(), RATES)[0].max(axis=1)
        padded = np.pad(values, 1, constant_values=-np.inf)
        peaks = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:]))
        for place in peaks[np.argsort(-values[peaks])][:3]:
            loss(float(RATES[place]))
        if best.value < before + 1e-3:
            break
    ends = np.clip([best.rate - RATES[1], best.rate + RATES[1]], 0.0, 1.0)
    minimize_scalar(loss, bounds=ends, method="bounded", options={"xatol": 1e-4})
    return replace(likelihood, eta=best.rate), best.at


class Maximum(NamedTuple):
    """The largest log-likelihood that was found, with the learning rate and the coordinates."""

    value: float
    rate: float
    at: Floats


def fixed_of(likelihood: Likelihood, people: int) -> NDArray[np.bool_]:
    """Return which coordinates are fixed at 0: theta (0.5) without suggestions, and weights of no effect in the log."""
    return np.repeat(~likelihood.ranges.told_apart[None], people, axis=0)


def intervals(likelihood: Likelihood, near: Floats, level: float) -> tuple[Floats, Floats, Floats]:
    """Return both ends of all people's profile-likelihood intervals, (K, P), and their largest log-likelihoods, (K,).

    An interval ends at the end of a coordinate's range if nothing up to it is rejected. Searches begin at `near`.
    """
    people, size = near.shape
    fixed = fixed_of(likelihood, people)
    at, best, curvature = maximise(likelihood, near, fixed)
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
    near = at  # of values that are not rejected: a search from far out may end on a lower maximum
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
        begin = near.copy()
        begin[:, axis] = value
        now, reached, _ = maximise(likelihood, begin, fixed)
        root = np.sqrt(np.maximum(2 * (best - reached), 0.0))
        over = root > wanted
        near = np.where(over[:, None], near, now)
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
    """Return the estimates of all people's parameters, whose observations have the same terms, and the population."""
    found = fit_hierarchy(Likelihood.of(observations, method), known=method.eta is not None)
    likelihood = found.likelihood
    if method.eta is None and likelihood.steps.told:
        found = replace(found, rate=_rate(found, method.level))
    low, high, _ = intervals(likelihood, found.at, method.level)
    value = likelihood.derivatives(found.at)[0]
    fits = []
    for k, o in enumerate(observations):
        every = [_estimate(likelihood, axis, found.at[k], low[k], high[k]) for axis in range(len(found.mean))]
        estimates = {"beta": every[BETA]}
        if (o.suggested != NOTHING).any():
            estimates |= {"theta": every[THETA]} | ({} if found.rate is None else {"eta": found.rate})
        estimates |= zip(o.terms, every[FIRST_TERM:], strict=True)
        fits.append(PersonEstimate(o, estimates, float(value[k]), method.eta, method))
    return fits, found


def _rate(found: Hierarchy, level: float) -> Estimate:
    """Return the learning rate of all people, with the interval of the profile of the marginal likelihood."""
    least, rate = found.evidence - largest_fall(level), found.likelihood.eta

    def margin(value: float) -> float:
        return fit_hierarchy(replace(found.likelihood, eta=value), 5, near=found).evidence - least

    (low, below), (high, above) = (end_of(margin, rate, outwards(rate, end), 1e-3, 1e-3) for end in (0.0, 1.0))
    return Estimate(rate, (low, high), below, above)


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
