"""Estimates of a person's perceived cost-to-go from repeated mistakes.

The model is hierarchical: h(x) = h*(x) + sigma eps(x), where eps(x) is standard normal for each state and lasting
(`misconception.perceived_cost_to_go`), and choices given h are Boltzmann (5). The eps are integrated out by Laplace's
approximation at their mode, which also gives the estimate of h. Beta and sigma maximise the marginal likelihood
(Tierney and Kadane 1986).

Only repetition distinguishes beta and sigma: for a person who visits each state once, a large beta with misconceptions
gives the same actions as a smaller beta without. Theta and its changes are taken from the plain estimates, with h* in
the trust update. Only an avoidable action into a dead end counts as a lapse.

The curvature is a matrix with one row per uncertain state. It is nonzero only for two states that were alternatives in
one step. Ordering the states by reverse Cuthill-McKee makes it a narrow band, whose memory is known before it is
allocated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import minimize_scalar
from scipy.sparse import coo_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from planner.system.jit import njit

from ..people.decision import NOTHING, Floats
from .intervals import end_of, largest_fall
from .observations import Ints, Observations
from .person_estimate import MisconceptionFit, PersonEstimate


def fit_misconception(fitted: PersonEstimate) -> MisconceptionFit:
    """Return the estimates of a person's sigma and h.

    Parameters
    ----------
    fitted : PersonEstimate
        The person's estimates without misconceptions.
    """
    model = MarginalLikelihood(fitted)
    sizes = fitted.observations.excess
    sizes = sizes[(sizes > 0) & np.isfinite(sizes)]
    unit = float(sizes.min()) if len(sizes) else 1.0
    largest = 10.0 / unit
    start = float(np.clip(fitted.estimates["beta"].value, 1e-3 * largest, largest))

    def best_beta(sigma: float) -> tuple[float, float]:
        """Return the best beta for a sigma, and the marginal log-likelihood."""
        low, high = np.log(start / 20), np.log(min(start * 20, 4 * largest))
        found = minimize_scalar(
            lambda x: -model.marginal(float(np.exp(x)), sigma)[0], bounds=(low, high), method="bounded",
            options={"xatol": 1e-2},
        )  # fmt: skip
        return float(np.exp(found.x)), -float(found.fun)

    tried = unit * (fitted.method.largest_sigma / 5.0) * np.array([0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0])
    top = float(tried[-1])
    values = np.array([best_beta(sigma)[1] for sigma in tried])
    place = int(values.argmax())
    low, high = tried[max(place - 1, 0)], tried[min(place + 1, len(tried) - 1)]
    found = minimize_scalar(
        lambda sigma: -best_beta(float(sigma))[1], bounds=(low, high), method="bounded", options={"xatol": 0.02 * unit}
    )
    sigma, best = (float(found.x), -float(found.fun)) if -found.fun > values[place] else (tried[place], values[place])
    drop = largest_fall(fitted.method.level)

    def margin(sigma: float) -> float:
        return float(best_beta(sigma)[1] - best + drop)

    def end(side: int) -> float:
        outwards = tried[(tried - sigma) * side > 1e-9][::side].tolist()
        return end_of(margin, float(sigma), outwards, 0.02 * unit)[0]

    beta = best_beta(float(sigma))[0]
    _, z = model.marginal(beta, float(sigma))
    perceived = model.h + (z / beta if sigma > 0 else 0.0)
    order = np.argsort(model.states)
    interval = (0.0 if sigma == 0 else end(-1), top if sigma >= top else end(1))
    return MisconceptionFit(
        float(sigma), interval, interval[1] >= top, beta, float(best), float(values[0]), model.states[order],
        model.h[order], perceived[order], model.seen[order],
    )  # fmt: skip


@dataclass(frozen=True)
class Uncertain:
    """The alternatives of a person's choices whose perceived cost is uncertain.

    `kept` is whether each choice depends on uncertain costs, and `possible`, shape (N, A), whether each of its slots is
    an alternative; avoidable actions into dead ends are not. `index` has each alternative's place in the next three
    arrays, shape (M,), or M for goals, which are recognised. `seen` counts the steps in which each state was an
    alternative, and `band` is the largest difference of two indices in one choice.
    """

    kept: NDArray[np.bool_]
    possible: NDArray[np.bool_]
    index: Ints
    states: Ints
    cost_to_go: Floats
    seen: Ints
    band: int

    @classmethod
    def of(cls, o: Observations) -> Uncertain:
        """Return the uncertain alternatives; states are in an order in which those of one choice are near."""
        # An avoidable action into a dead end is a lapse, and a single alternative carries no information.
        kept = np.isfinite(o.regret) & np.isfinite(o.cost_to_go) & (o.applicable.sum(axis=1) > 1)
        possible = o.applicable & np.isfinite(o.excess)
        uncertain = possible & ~o.goal & kept[:, None]
        states, first, inverse, seen = np.unique(
            o.targets[uncertain], return_index=True, return_inverse=True, return_counts=True
        )
        index = np.full(o.targets.shape, len(states))  # goal states share the last index, whose z stays 0
        index[uncertain] = inverse
        order = _near_each_other(index, len(states))
        index = np.append(np.argsort(order), len(order))[index]
        low = np.where(uncertain, index, len(order)).min(axis=1)
        band = (np.where(uncertain, index, -1).max(axis=1) - low)[uncertain.any(axis=1)].max(initial=0)
        h = o.ahead[uncertain][first]
        return cls(kept, possible[kept], index[kept], states[order], h[order], seen[order], int(band))

    @property
    def megabytes(self) -> float:
        """The memory that the curvature and its factor take."""
        return 2 * 8e-6 * len(self.states) * (self.band + 1)


def _near_each_other(index: Ints, size: int) -> Ints:
    """Return an order of states in which the alternatives of one choice are near each other."""
    ascending = np.sort(index, axis=1)  # a chain through each choice's alternatives is a sufficient graph
    one, other = ascending[:, :-1].ravel(), ascending[:, 1:].ravel()
    joined = (one != other) & (other < size)
    pairs = coo_array((np.ones(joined.sum()), (one[joined], other[joined])), shape=(size, size)).tocsr()
    return np.asarray(reverse_cuthill_mckee((pairs + pairs.T).tocsr(), symmetric_mode=True), dtype=np.int64)


def require_memory(observations: Sequence[Observations], limit_mb: float) -> None:
    """Check the memory that people's misconceptions would take, before it is allocated."""
    for o in observations:
        uncertain = Uncertain.of(o)
        if uncertain.megabytes > limit_mb:
            raise MemoryError(
                f"person '{o.person}': misconceptions about {len(uncertain.states):,} states take about "
                f"{uncertain.megabytes:,.0f} MB, and {limit_mb:,.0f} are allowed; fit fewer of their episodes at a "
                "time, or no misconceptions"
            )


class MarginalLikelihood:
    """The marginal likelihood of choices with uncertain costs: z = beta sigma eps for each state."""

    def __init__(self, fitted: PersonEstimate) -> None:
        o: Observations = fitted.observations
        uncertain = Uncertain.of(o)
        self.states, self.h, self.seen = uncertain.states, uncertain.cost_to_go, uncertain.seen
        self.index, self.possible, self.band = uncertain.index, uncertain.possible, uncertain.band
        theta = np.clip(fitted.thetas(), fitted.method.lapse, 1 - fitted.method.lapse)
        offset = np.zeros(o.excess.shape)
        told = np.flatnonzero(o.suggested != NOTHING)
        offset[told, o.suggested[told]] = np.log(theta[told] / (1 - theta[told]))
        kept = uncertain.kept
        self.excess, self.offset, self.chosen = o.excess[kept], offset[kept], o.chosen[kept]
        self.z = np.zeros(len(self.states) + 1)

    def _terms(self, beta: float, z: Floats) -> tuple[float, Floats]:
        """Return the log-likelihood of the choices given z, and the probability of each alternative, shape (N, A)."""
        with np.errstate(invalid="ignore"):
            u = np.where(self.possible, -beta * self.excess + self.offset - z[self.index], -np.inf)
        top = u.max(axis=1, keepdims=True)
        weights = np.exp(u - top)
        total = weights.sum(axis=1, keepdims=True)
        picked = u[np.arange(len(u)), self.chosen] - top[:, 0] - np.log(total[:, 0])
        return float(picked.sum()), weights / total

    def marginal(self, beta: float, sigma: float) -> tuple[float, Floats]:
        """Return the marginal log-likelihood, and the mode of z, shape (M,)."""
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
            step = self._solved(p, variance, gradient)[0]
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
        determinant = self._solved(p, variance, z[:m])[1] + m * float(np.log(variance))
        return value - determinant / 2, z[:m]

    def _solved(self, p: Floats, variance: float, b: Floats) -> tuple[Floats, float]:
        """Return the solution of (curvature + 1 / variance) x = b, shape (M,), and the logarithm of the determinant."""
        rows = _band(p, self.index, len(self.states), self.band)
        rows[0] += 1 / variance
        lower = cholesky_banded(rows, overwrite_ab=True, lower=True, check_finite=False)
        return cho_solve_banded((lower, True), b, check_finite=False), 2 * float(np.log(lower[0]).sum())


@njit(nogil=True)
def _band(p: Floats, index: Ints, m: int, band: int) -> Floats:
    """Return the lower band of minus the second derivatives of the log-likelihood by z, shape (band + 1, M).

    Entry (i, j) of the matrix is in row i - j and column j.
    """
    result = np.zeros((band + 1, m))
    for i in range(p.shape[0]):
        for a in range(p.shape[1]):
            row = index[i, a]
            if p[i, a] > 0.0 and row < m:
                result[0, row] += p[i, a]
                for b in range(p.shape[1]):
                    column = index[i, b]
                    if column <= row:
                        result[row - column, column] -= p[i, a] * p[i, b]
    return result
