"""What a person takes for the cost-to-go, from the mistakes that they repeat.

A hierarchical model: h(x) = h*(x) + sigma eps(x), with eps(x) standard normal for each state and the same whenever
the person comes by (`human.perceived_cost_to_go`), and Boltzmann choices given h. The eps are integrated out by
Laplace's approximation at their most likely values, which are also the smoothed h; beta and sigma maximise what
remains, the marginal likelihood (Tierney and Kadane 1986).

Beta and sigma are told apart by repetition alone. Who passes each state once gives the same actions for a large
beta with misconceptions as for a smaller one without. Theta and its changes are taken as given, with h* in the
trust update; lapses are only where a person walks into a dead end that they could avoid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import brentq, minimize_scalar
from scipy.special import chdtri

from ..people.decision import NOTHING, Floats
from .estimates import Fit
from .observations import Ints, Observations

LARGEST_SIGMA = 5.0
"""Where the search for sigma ends, in units of the smallest mistake that the person could make."""


@dataclass(frozen=True)
class Misconception:
    """A person's misconception.

    Attributes
    ----------
    sigma : float
        Standard deviation, in cost units.
    interval : (float, float)
        By the profile likelihood.
    open_above : bool
        Whether the interval ends where the search does, at `LARGEST_SIGMA`.
    beta : float
        Expertise where mistakes may come from misconceptions: no smaller than that of the plain model.
    log_likelihood, without : float
        Marginal log-likelihood at these values, and the largest one for sigma = 0.
    states : int array, shape (M,)
        The states about which the person's choices say something, ascending.
    cost_to_go, perceived : float arrays, shape (M,)
        h* of them, and the most likely h.
    seen : int array, shape (M,)
        In how many of the person's choices each could have been chosen.
    """

    sigma: float
    interval: tuple[float, float]
    open_above: bool
    beta: float
    log_likelihood: float
    without: float
    states: Ints
    cost_to_go: Floats
    perceived: Floats
    seen: Ints

    def __post_init__(self) -> None:
        for array in (self.states, self.cost_to_go, self.perceived, self.seen):
            array.flags.writeable = False


def fit_misconception(fitted: Fit) -> Misconception:
    """Estimate sigma and h of a person.

    Parameters
    ----------
    fitted : Fit
        The person's estimates without misconceptions.
    """
    model = MarginalLikelihood(fitted)
    sizes = fitted.observations.excess
    sizes = sizes[(sizes > 0) & np.isfinite(sizes)]
    unit = float(sizes.min()) if len(sizes) else 1.0
    top = LARGEST_SIGMA * unit
    largest = 10.0 / unit
    start = float(np.clip(fitted.beta.value, 1e-3 * largest, largest))

    def best_beta(sigma: float) -> tuple[float, float]:
        """Give the best beta for a sigma, and the marginal log-likelihood."""
        low, high = np.log(start / 20), np.log(min(start * 20, 4 * largest))
        found = minimize_scalar(
            lambda x: -model.marginal(float(np.exp(x)), sigma)[0], bounds=(low, high), method="bounded",
            options={"xatol": 1e-2},
        )  # fmt: skip
        return float(np.exp(found.x)), -float(found.fun)

    tried = unit * np.array([0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, LARGEST_SIGMA])
    values = np.array([best_beta(sigma)[1] for sigma in tried])
    place = int(values.argmax())
    low, high = tried[max(place - 1, 0)], tried[min(place + 1, len(tried) - 1)]
    found = minimize_scalar(
        lambda sigma: -best_beta(float(sigma))[1], bounds=(low, high), method="bounded", options={"xatol": 0.02 * unit}
    )
    sigma, best = (float(found.x), -float(found.fun)) if -found.fun > values[place] else (tried[place], values[place])
    drop = chdtri(1, 1 - fitted.method.level) / 2

    def margin(sigma: float) -> float:
        return float(best_beta(sigma)[1] - best + drop)

    def end(side: int) -> float:
        outside = tried[(tried - sigma) * side > 1e-9][::side]
        inside = sigma
        for value in outside:
            if margin(float(value)) < 0:
                return float(brentq(margin, inside, value, xtol=0.02 * unit)) if margin(inside) > 0 else float(inside)
            inside = value
        return float(outside[-1]) if len(outside) else float(sigma)

    beta = best_beta(float(sigma))[0]
    _, z = model.marginal(beta, float(sigma))
    perceived = model.h + (z / beta if sigma > 0 else 0.0)
    interval = (0.0 if sigma == 0 else end(-1), top if sigma >= top else end(1))
    return Misconception(
        float(sigma),
        interval,
        interval[1] >= top,
        beta,
        float(best),
        float(values[0]),
        model.states,
        model.h,
        perceived,
        model.seen,
    )


class MarginalLikelihood:
    """Choices among alternatives whose costs are uncertain, each state's by one number z = beta sigma eps."""

    def __init__(self, fitted: Fit) -> None:
        o: Observations = fitted.observations
        rows = np.arange(len(o))
        # A needless way into a dead end is a lapse, and a choice that is none says nothing.
        kept = np.isfinite(o.regret) & np.isfinite(o.cost_to_go) & (o.applicable.sum(axis=1) > 1)
        possible = o.applicable & np.isfinite(o.excess)
        uncertain = possible & ~o.goal & kept[:, None]
        self.states, first, inverse, self.seen = np.unique(
            o.targets[uncertain], return_index=True, return_inverse=True, return_counts=True
        )
        self.h = o.ahead[uncertain][first]
        index = np.full(o.targets.shape, len(self.states))  # goal states share a last place, which stays 0
        index[uncertain] = inverse
        theta = np.clip(fitted.thetas(), fitted.method.lapse, 1 - fitted.method.lapse)
        offset = np.zeros(o.excess.shape)
        told = o.suggested != NOTHING
        offset[rows[told], o.suggested[told]] = np.log(theta[told] / (1 - theta[told]))
        self.index, self.possible = index[kept], possible[kept]
        self.excess, self.offset, self.chosen = o.excess[kept], offset[kept], o.chosen[kept]
        self.z = np.zeros(len(self.states) + 1)

    def _terms(self, beta: float, z: Floats) -> tuple[float, Floats]:
        """Log-likelihood of the choices given z, and the probability of each, shape (N, A)."""
        with np.errstate(invalid="ignore"):
            u = np.where(self.possible, -beta * self.excess + self.offset - z[self.index], -np.inf)
        top = u.max(axis=1, keepdims=True)
        weights = np.exp(u - top)
        total = weights.sum(axis=1, keepdims=True)
        picked = u[np.arange(len(u)), self.chosen] - top[:, 0] - np.log(total[:, 0])
        return float(picked.sum()), weights / total

    def marginal(self, beta: float, sigma: float) -> tuple[float, Floats]:
        """Give the marginal log-likelihood, and the most likely z, shape (M,)."""
        m = len(self.states)
        if not len(self.chosen):
            return 0.0, np.zeros(m)
        if sigma == 0:
            return self._terms(beta, np.zeros(m + 1))[0], np.zeros(m)
        variance = (beta * sigma) ** 2
        z = self.z.copy()  # of the last call: parameters change little from one to the next
        value, p = self._terms(beta, z)
        value -= float(z @ z) / (2 * variance)
        for _ in range(50):
            gradient: Floats = np.bincount(self.index.ravel(), p.ravel(), m + 1).astype(float)
            gradient -= np.bincount(self.index[np.arange(len(p)), self.chosen], minlength=m + 1)
            gradient = (gradient - z / variance)[:m]
            factor = cho_factor(_curvature(p, self.index, m) + np.eye(m) / variance)
            step = cho_solve(factor, gradient)
            size = 1.0
            while True:  # the function is concave, so that a short enough step improves it
                moved = z.copy()
                moved[:m] += size * step
                after, q = self._terms(beta, moved)
                after -= float(moved @ moved) / (2 * variance)
                if after >= value - 1e-12 or size < 1e-4:
                    break
                size /= 2
            gain, z, value, p = after - value, moved, after, q
            if gain < 1e-7:
                break
        self.z = z
        factor = cho_factor(_curvature(p, self.index, m) + np.eye(m) / variance)
        determinant = 2 * float(np.log(np.diag(factor[0])).sum()) + m * float(np.log(variance))
        return value - determinant / 2, z[:m]


@numba.njit(cache=True, nogil=True)
def _curvature(p: Floats, index: Ints, m: int) -> Floats:
    """Minus the second derivatives of the choices' log-likelihood by z, shape (M, M)."""
    result = np.zeros((m + 1, m + 1))
    for i in range(p.shape[0]):
        for a in range(p.shape[1]):
            if p[i, a] > 0.0:
                result[index[i, a], index[i, a]] += p[i, a]
                for b in range(p.shape[1]):
                    result[index[i, a], index[i, b]] -= p[i, a] * p[i, b]
    return result[:m, :m]
