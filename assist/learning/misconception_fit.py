"""What a person takes for the cost-to-go, from the mistakes that they repeat.

A hierarchical model: h(x) = h*(x) + sigma eps(x), with eps(x) standard normal for each state and the same whenever
the person comes by (`human.perceived_cost_to_go`), and Boltzmann choices given h. The eps are integrated out by
Laplace's approximation at their most likely values, which are also the smoothed h; beta and sigma maximise what
remains, the marginal likelihood (Tierney and Kadane 1986).

Beta and sigma are told apart by repetition alone. Who passes each state once gives the same actions for a large
beta with misconceptions as for a smaller one without. Theta and its changes are taken as given, with h* in the
trust update; lapses are only where a person walks into a dead end that they could avoid.

The curvature is a matrix of as many rows as there are uncertain states, and nonzero only where two of them could be
chosen in one step. States are put into an order in which these are near each other (reverse Cuthill-McKee), so that it
is a narrow band along the diagonal: the memory is known before it is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, cho_solve_banded, cholesky_banded
from scipy.optimize import brentq, minimize_scalar
from scipy.sparse import coo_array
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.special import chdtri

from planner.system.jit import njit

from ..people.decision import NOTHING, Floats
from .maximum_likelihood import Fit
from .observations import Ints, Observations

WHOLE = 1000
"""Up to so many states the curvature is a whole matrix: as fast as a band, or faster."""

MEMORY_LIMIT_MB = 500
"""What the curvature may take for one person."""

LARGEST_SIGMA = 5.0
"""Where the search for sigma ends, in units of the smallest mistake that the person could make."""


@dataclass(frozen=True)
class MisconceptionFit:
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


def fit_misconception(fitted: Fit) -> MisconceptionFit:
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
    order = np.argsort(model.states)
    interval = (0.0 if sigma == 0 else end(-1), top if sigma >= top else end(1))
    return MisconceptionFit(
        float(sigma),
        interval,
        interval[1] >= top,
        beta,
        float(best),
        float(values[0]),
        model.states[order],
        model.h[order],
        perceived[order],
        model.seen[order],
    )


@dataclass(frozen=True)
class Uncertain:
    """What a person's choices depend on whose cost they may be mistaken about.

    Attributes
    ----------
    kept : bool array, shape (N,)
        Which choices say something.
    possible : bool array, shape (N, A)
        Which alternatives they have, but for needless ways into dead ends.
    index : int array, shape (N, A)
        The place of each alternative in the next three; M for goals, about which nobody is mistaken.
    states : int array, shape (M,)
    cost_to_go : float array, shape (M,)
        h* of them.
    seen : int array, shape (M,)
        In how many of the choices each could have been chosen.
    band : int or None
        How far apart the alternatives of one choice are, at most; None where a whole matrix is no larger or no slower.
    """

    kept: NDArray[np.bool_]
    possible: NDArray[np.bool_]
    index: Ints
    states: Ints
    cost_to_go: Floats
    seen: Ints
    band: int | None

    @classmethod
    def of(cls, o: Observations, whole: int = WHOLE) -> Uncertain:
        """Find them; up to `whole` states are kept in ascending order."""
        # A needless way into a dead end is a lapse, and a choice that is none says nothing.
        kept = np.isfinite(o.regret) & np.isfinite(o.cost_to_go) & (o.applicable.sum(axis=1) > 1)
        possible = o.applicable & np.isfinite(o.excess)
        uncertain = possible & ~o.goal & kept[:, None]
        states, first, inverse, seen = np.unique(
            o.targets[uncertain], return_index=True, return_inverse=True, return_counts=True
        )
        index = np.full(o.targets.shape, len(states))  # goal states share a last place, which stays 0
        index[uncertain] = inverse
        h, band = o.ahead[uncertain][first], None
        if len(states) > whole:
            order = _near_each_other(index, len(states))
            states, h, seen = states[order], h[order], seen[order]
            index = np.append(np.argsort(order), len(order))[index]
            low = np.where(uncertain, index, len(order)).min(axis=1)
            band = int((np.where(uncertain, index, -1).max(axis=1) - low)[uncertain.any(axis=1)].max())
        return cls(kept, possible[kept], index[kept], states, h, seen, band)

    @property
    def megabytes(self) -> float:
        """The memory that the curvature and its factor take."""
        return 2 * 8e-6 * len(self.states) * (len(self.states) if self.band is None else self.band + 1)


def _near_each_other(index: Ints, size: int) -> Ints:
    """Order so many states such that those between which somebody could choose are near each other."""
    ascending = np.sort(index, axis=1)  # a chain through each choice's alternatives joins them well enough
    one, other = ascending[:, :-1].ravel(), ascending[:, 1:].ravel()
    joined = (one != other) & (other < size)
    pairs = coo_array((np.ones(joined.sum()), (one[joined], other[joined])), shape=(size, size)).tocsr()
    return np.asarray(reverse_cuthill_mckee((pairs + pairs.T).tocsr(), symmetric_mode=True), dtype=np.int64)


def require_memory(observations: Sequence[Observations]) -> None:
    """Refuse people whose misconceptions would take too much memory, before any is taken.

    Raises
    ------
    MemoryError
    """
    for o in observations:
        uncertain = Uncertain.of(o)
        if uncertain.megabytes > MEMORY_LIMIT_MB:
            raise MemoryError(
                f"person '{o.person}': misconceptions about {len(uncertain.states):,} states take about "
                f"{uncertain.megabytes:,.0f} MB, and {MEMORY_LIMIT_MB:,} are allowed; fit fewer of their episodes at a "
                "time, or no misconceptions"
            )


class MarginalLikelihood:
    """Choices among alternatives whose costs are uncertain, each state's by one number z = beta sigma eps."""

    def __init__(self, fitted: Fit, whole: int = WHOLE) -> None:
        o: Observations = fitted.observations
        uncertain = Uncertain.of(o, whole)
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
        """Solve (curvature + 1 / variance) x = b; give x, shape (M,), and the logarithm of the determinant."""
        m = len(self.states)
        if self.band is None:
            factor = cho_factor(_curvature(p, self.index, m) + np.eye(m) / variance)
            return cho_solve(factor, b), 2 * float(np.log(np.diag(factor[0])).sum())
        rows = _band(p, self.index, m, self.band)
        rows[0] += 1 / variance
        lower = cholesky_banded(rows, overwrite_ab=True, lower=True, check_finite=False)
        return cho_solve_banded((lower, True), b, check_finite=False), 2 * float(np.log(lower[0]).sum())


@njit(nogil=True)
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


@njit(nogil=True)
def _band(p: Floats, index: Ints, m: int, band: int) -> Floats:
    """The same, the diagonal and what is below it: entry (i, j) in row i - j and column j of shape (band + 1, M)."""
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
