"""The search for the parameters of a trust rule that make a log likeliest, their covariance and intervals."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from scipy.optimize import brentq, minimize
from scipy.special import chdtri

from ..people.decision import Floats
from .influence_population import InfluencePopulation
from .rule_families import Interval, RuleFamily
from .trust_log import TrustLog


class RuleSearch:
    """The search for the parameters of a rule; the population that fits best is found for each."""

    def __init__(
        self, log: TrustLog, family: RuleFamily, carry: bool, near: InfluencePopulation | None = None
    ) -> None:  # fmt: skip
        self.log, self.family, self.carry, self.near = log, family, carry, near

    def at(self, values: Sequence[float]) -> tuple[float, InfluencePopulation, Floats]:
        """Return the log likelihood, the population, and the table of `TrustLog.log_likelihood`."""
        logs = self.log.log_likelihood(self.family.rule(values), carry=self.carry)
        self.near, value = InfluencePopulation.fit(self.log, logs, self.near)
        return value, self.near, logs

    def value(self, values: Floats) -> float:
        """Return the log likelihood; outside of the ranges, that of the nearest parameters."""
        ends = np.array(list(self.family.ranges.values()))
        return self.at(np.clip(values, ends[:, 0], ends[:, 1]).tolist())[0]

    def best(self, start: tuple[float, ...] | None = None, tolerance: float = 3e-3) -> tuple[float, ...]:
        """Return the parameters of largest likelihood, by the simplex method.

        It begins with the best of those tried, unless a start is given. The tolerance of each parameter is a fraction
        of the standard error that 100 people and 60 suggestions leave.
        """
        if not self.family.ranges:
            return ()
        size = 0.3 if start is None else 0.1
        start = start or max(self.family.tried, key=lambda values: self.at(values)[0])
        corners = np.tile(start, (len(start) + 1, 1))
        corners[np.arange(len(start)) + 1, np.arange(len(start))] += size * (np.abs(start) + 0.1)

        def loss(values: Floats) -> float:
            return -self.value(values)

        found = minimize(
            loss, list(start), method="Nelder-Mead", bounds=list(self.family.ranges.values()),
            options={"initial_simplex": corners, "xatol": tolerance, "fatol": 0.01},
        )  # fmt: skip
        return tuple(found.x.tolist())

    def nodes(self, best: tuple[float, ...], covariance: Floats) -> list[tuple[tuple[float, ...], float]]:
        """Return parameters and the probability of each: a quadrature of the posterior with a flat prior.

        The nodes are those of a normal distribution with this covariance, in the ranges of the parameters; their
        probabilities are corrected by the likelihood.
        """
        count = len(best)
        points, weights = np.polynomial.hermite_e.hermegauss(7 if count == 1 else 3)
        z = np.array(list(product(points, repeat=count)))
        ends = np.array(list(self.family.ranges.values()))
        factor = np.linalg.cholesky(covariance)
        values = np.clip(np.array(best) + z @ factor.T, ends[:, 0], ends[:, 1])
        inside = np.linalg.solve(factor, (values - np.array(best)).T)  # as z, at the ends of the ranges where beyond
        logs = np.array([self.value(one) for one in values]) + (inside**2).sum(axis=0) / 2
        mass = np.exp(logs - logs.max()) * np.prod(np.array(list(product(weights, repeat=count))), axis=1)
        return [(tuple(one), share) for one, share in zip(values.tolist(), (mass / mass.sum()).tolist(), strict=True)]

    def intervals(self, best: tuple[float, ...], covariance: Floats, level: float) -> list[Interval]:
        """Return the likelihood-ratio interval of each parameter.

        As one parameter moves, the others move with it along the ridge of the likelihood, which is taken to be
        straight. With one parameter the interval is exact.
        """
        at, top = np.array(best), self.value(np.array(best))
        wanted, ridges = float(chdtri(1, 1 - level)) / 2, covariance / np.diag(covariance)[:, None]
        found = []
        for j, (low, high) in enumerate(self.family.ranges.values()):

            def excess(value: float, j: int = j) -> float:
                return top - self.value(at + ridges[j] * (value - at[j])) - wanted

            ends = []
            for end in (low, high):
                inside, step = at[j], np.sign(end - at[j]) * (0.02 + 0.2 * abs(at[j]))
                outside = float(np.clip(inside + step, low, high))
                while outside != end and excess(outside) < 0:
                    inside, step = outside, 2 * step
                    outside = float(np.clip(outside + step, low, high))
                beyond = outside == inside or excess(outside) < 0
                ends.append(end if beyond else float(brentq(excess, inside, outside, xtol=1e-3, rtol=1e-3)))
            found.append((ends[0], ends[1]))
        return found

    def covariance(self, best: tuple[float, ...], noise: float = 0.1) -> Floats:
        """Return the covariance of the parameters, (P, P), from differences of the likelihood at about two deviations.

        A parameter on which the likelihood does not depend, as the differences are below `noise` nats, is taken to be
        independent of the others. So are all of them where the likelihood is not concave.
        """
        at, top, count, ranges = (
            np.array(best),
            self.value(np.array(best)),
            len(best),
            list(self.family.ranges.values()),
        )
        steps, unit = np.full(count, 0.05), np.eye(count)
        for j, (low, high) in enumerate(ranges):
            side = 1 if high - at[j] > at[j] - low else -1
            for _ in range(5):
                fall = max(top - self.value(at + side * steps[j] * unit[j]), 1e-3)
                if 0.5 < fall < 4:
                    break
                steps[j] = min(steps[j] * np.clip(np.sqrt(2 / fall), 0.2, 5), (high - low) / 4)
        middle = np.array([np.clip(a, low + d, high - d) for a, d, (low, high) in zip(at, steps, ranges, strict=True)])
        moves = steps * unit
        center = self.value(middle)
        single = np.array([[self.value(middle + side * moves[j]) for side in (1, -1)] for j in range(count)])
        curvature = np.zeros((count, count))
        for i in range(count):
            curvature[i, i] = (single[i].sum() - 2 * center) / steps[i] ** 2
            for j in range(i):
                both = self.value(middle + moves[i] + moves[j]) + self.value(middle - moves[i] - moves[j])
                mixed = (both - single[i].sum() - single[j].sum() + 2 * center) / (2 * steps[i] * steps[j])
                curvature[i, j] = curvature[j, i] = mixed
        found = np.diag((steps / 2) ** 2)
        depends = -np.diag(curvature) * steps**2 > noise
        known = np.ix_(depends, depends)
        if (np.linalg.eigvalsh(curvature[known]) < 0).all():
            found[known] = np.linalg.inv(-curvature[known])
        return found
