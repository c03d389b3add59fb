"""The distribution of expertise and influence over people that makes the answers to suggestions likeliest.

What follows from it is averaged over a sample of what its parameters may be: of their posterior, with a prior that is
flat on their ranges, by importance sampling around the values of largest likelihood.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import minimize
from scipy.special import logit, ndtri
from scipy.stats.qmc import Halton
from threadpoolctl import ThreadpoolController

from planner.system.jit import njit

from ..people.decision import Floats
from .intervals import Interval
from .likelihood_table import LikelihoodTable

Value = Callable[[Floats], float]
"""Returns the log likelihood of parameters, shape (P,), within their ranges."""


@dataclass(frozen=True)
class PosteriorSample:
    """N points of parameters, (N, P), their probabilities, (N,), and the log integral of the likelihood over them."""

    points: Floats
    shares: Floats
    log_integral: float

    @classmethod
    def around(
        cls, value: Value, best: Floats, ranges: Sequence[Interval], covariance: Floats, count: int = 32
    ) -> PosteriorSample:
        """Return a sample of quasi-random points, `count` for each parameter, without those beyond a range.

        The proposal is normal. Its deviations are one and a half times those of `covariance`, shape (P, P), since the
        posterior may have heavier tails.
        """
        low, high = np.array(ranges).T
        quasi = Halton(len(best), scramble=False)
        quasi.fast_forward(1)  # the first point is 0, which is at minus infinity
        z, factor = ndtri(quasi.random(count * len(best))), 1.5 * np.linalg.cholesky(covariance)
        points = best + z @ factor.T
        inside = ((points >= low) & (points <= high)).all(axis=1)
        logs = np.full(len(z), -np.inf)
        logs[inside] = np.array([value(point) for point in points[inside]]) + (z[inside] ** 2).sum(axis=1) / 2
        mass = np.exp(logs[inside] - logs.max())
        integral = logs.max() + np.log(mass.sum() / len(z)) + np.log(np.diag(factor)).sum()
        return cls(points[inside], mass / mass.sum(), float(integral + len(best) * np.log(2 * np.pi) / 2))


def posterior_covariance(value: Value, best: Floats, ranges: Sequence[Interval]) -> Floats:
    """Return the covariance of the parameters, (P, P), from differences of the likelihood at about two deviations.

    A parameter on which the likelihood does not depend, as the differences are below 0.1 nats, is taken to be
    independent of the others. So are all of them where the likelihood is not concave.
    """
    top, count = value(best), len(best)
    steps, unit = np.full(count, 0.05), np.eye(count)
    for j, (low, high) in enumerate(ranges):
        side = 1 if high - best[j] > best[j] - low else -1
        for _ in range(5):
            fall = max(top - value(best + side * steps[j] * unit[j]), 1e-3)
            if 0.5 < fall < 4:
                break
            steps[j] = min(steps[j] * np.clip(np.sqrt(2 / fall), 0.2, 5), (high - low) / 4)
    middle = np.array([np.clip(a, low + d, high - d) for a, d, (low, high) in zip(best, steps, ranges, strict=True)])
    moves = steps * unit
    center = value(middle)
    single = np.array([[value(middle + side * moves[j]) for side in (1, -1)] for j in range(count)])
    curvature = np.zeros((count, count))
    for i in range(count):
        curvature[i, i] = (single[i].sum() - 2 * center) / steps[i] ** 2
        for j in range(i):
            both = value(middle + moves[i] + moves[j]) + value(middle - moves[i] - moves[j])
            mixed = (both - single[i].sum() - single[j].sum() + 2 * center) / (2 * steps[i] * steps[j])
            curvature[i, j] = curvature[j, i] = mixed
    found = np.diag((steps / 2) ** 2)
    depends = -np.diag(curvature) * steps**2 > 0.1
    known = np.ix_(depends, depends)
    if (np.linalg.eigvalsh(curvature[known]) < 0).all():
        found[known] = np.linalg.inv(-curvature[known])
    return found


@dataclass(frozen=True)
class InfluencePopulation:
    """Distribution of beta and theta_0 over people.

    Attributes
    ----------
    log_beta, log_beta_spread : float
        Mean and standard deviation of log(beta).
    logit_theta, logit_theta_spread : float
        Mean and standard deviation of logit(theta_0).
    """

    log_beta: float
    log_beta_spread: float
    logit_theta: float
    logit_theta_spread: float

    def weights(self, log: LikelihoodTable) -> tuple[Floats, Floats]:
        """Return the probabilities of the nodes of beta and of theta_0, shapes (B,), (T,)."""
        return (
            _normal(np.log(log.beta), self.log_beta, self.log_beta_spread)[0],
            _normal(logit(log.theta), self.logit_theta, self.logit_theta_spread)[0],
        )

    def marginal(self, log: LikelihoodTable, logs: Floats) -> Floats:
        """Return the log probability of all that each person chose, shape (K,).

        `logs` are log likelihoods at the nodes of beta and theta_0, shape (K, B, T).
        """
        beta, theta = self.weights(log)
        top = logs.max(axis=(1, 2))
        return np.asarray(np.log(np.exp(logs - top[:, None, None]) @ theta @ beta) + top)

    def posteriors(self, log: LikelihoodTable, logs: Floats) -> tuple[Floats, float]:
        """Return each person's probabilities of beta and theta_0, and the log likelihood that they belong to.

        Probabilities have shape (K, B, T). They and the likelihood are averaged over what mean and spread of
        logit(theta_0) may be: with the best ones alone, intervals of theta_0 are too short where few suggestions tell
        about it, as under a rule that soon forgets theta_0. The parameters are those of `marginal`.
        """
        top = logs.max(axis=(1, 2))
        scaled = np.exp(logs - top[:, None, None]) * self.weights(log)[0][:, None]
        by_theta, nodes = scaled.sum(axis=1), np.asarray(logit(log.theta))

        def value(point: Floats) -> float:
            return float(np.log(by_theta @ _normal(nodes, *point)[0]).sum())

        best, ranges = np.array([self.logit_theta, self.logit_theta_spread]), _ranges(log)[2:]
        sample = PosteriorSample.around(value, best, ranges, posterior_covariance(value, best, ranges))
        weights = np.array([_normal(nodes, *point)[0] for point in sample.points])
        # Bayes' rule for each person with each point; the points' probabilities hold for all people together.
        theta = (sample.shares / (by_theta @ weights.T)) @ weights
        return scaled * theta[:, None, :], float(top.sum()) + sample.log_integral

    @classmethod
    def fit(
        cls, log: LikelihoodTable, logs: Floats, near: InfluencePopulation | None = None
    ) -> tuple[InfluencePopulation, float]:
        """Return the population of largest marginal likelihood, and the logarithm of that likelihood.

        Parameters
        ----------
        log : LikelihoodTable
            Of which only the nodes are read.
        logs : float array, shape (K, B, T)
            From `LikelihoodTable.log_likelihood`, of some people or all.
        near : InfluencePopulation, optional
            Where the search begins.
        """
        top = logs.max(axis=(1, 2))
        scaled = np.exp(logs - top[:, None, None])
        x, y = np.log(log.beta), np.asarray(logit(log.theta))

        def loss(point: Floats) -> tuple[float, Floats]:
            beta, theta = _normal(x, *point[:2]), _normal(y, *point[2:])
            found = _sums(scaled, beta, theta)
            return -float(np.log(found[:, 0]).sum()), -np.asarray((found[:, 1:] / found[:, :1]).sum(axis=0))

        start = [x[-1] - 2.0, 1.0, 1.0, 1.5] if near is None else list(vars(near).values())
        with _libraries().limit(limits=1, user_api="blas"):  # threads wait longer than these small matrices take
            # Nearly flat in the spreads: a looser end would depend on where the search begins.
            best = minimize(
                loss, start, jac=True, method="L-BFGS-B", bounds=_ranges(log), options={"ftol": 1e-15, "gtol": 1e-8}
            )
        return cls(*best.x.tolist()), float(top.sum()) - float(best.fun)


@cache
def _libraries() -> ThreadpoolController:
    """Return the loaded libraries that have threads. To find them takes 5 ms, as long as the fit of one population."""
    return ThreadpoolController()


def _ranges(log: LikelihoodTable) -> tuple[Interval, ...]:
    """Return the ranges of mean and spread of log(beta) and of logit(theta_0), in the order of the attributes."""
    x, y = np.log(log.beta), np.asarray(logit(log.theta))
    # A distribution narrower than the distance of two nodes would lie between them.
    return ((x[0], x[-1]), (x[1] - x[0], 3.0), (y[0], y[-1]), (y[1] - y[0], 4.0))


def _normal(nodes: Floats, mean: float, spread: float) -> Floats:
    """Return the weights of a normal distribution at nodes, and their derivatives by mean and spread, (3, nodes)."""
    z = (nodes - mean) / spread
    weights = np.exp(-0.5 * (z * z - (z * z).min()))
    weights /= weights.sum()
    return np.stack([weights, weights * (z - weights @ z) / spread, weights * (z * z - weights @ (z * z)) / spread])


@njit()
def _sums(scaled: Floats, beta: Floats, theta: Floats) -> Floats:
    """Return the likelihood of each person under weights of the nodes, and its derivatives, shape (K, 5).

    `beta` and `theta` are of `_normal`. Compiled, since threads of a matrix product wait for each other on small ones.
    """
    people, betas, thetas = scaled.shape
    found = np.zeros((people, 5))
    for k in range(people):
        for b in range(betas):
            value = by_mean = by_spread = 0.0
            for t in range(thetas):
                value += scaled[k, b, t] * theta[0, t]
                by_mean += scaled[k, b, t] * theta[1, t]
                by_spread += scaled[k, b, t] * theta[2, t]
            found[k, 0] += beta[0, b] * value
            found[k, 1] += beta[1, b] * value
            found[k, 2] += beta[2, b] * value
            found[k, 3] += beta[0, b] * by_mean
            found[k, 4] += beta[0, b] * by_spread
    return found
