"""The distribution of expertise and influence over people that makes the answers to suggestions likeliest."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import minimize
from scipy.special import logit
from threadpoolctl import ThreadpoolController

from planner.system.jit import njit

from ..people.decision import Floats
from .intervals import Interval
from .likelihood_table import LikelihoodTable
from .posterior_sample import PosteriorSample, posterior_covariance


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
