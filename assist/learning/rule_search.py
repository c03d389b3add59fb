"""The search for the parameters of a trust rule that make a log likeliest, their covariance and intervals."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.optimize import minimize

from ..people.decision import Floats
from .influence_population import InfluencePopulation
from .intervals import Interval, end_of, largest_fall
from .likelihood_table import LikelihoodTable
from .posterior_sample import PosteriorSample, posterior_covariance
from .rule_families import RuleFamily


class RuleSearch:
    """The search for the parameters of a rule; the population that fits best is found for each."""

    def __init__(
        self, log: LikelihoodTable, family: RuleFamily, carry: bool, near: InfluencePopulation | None = None
    ) -> None:  # fmt: skip
        self.log, self.family, self.carry, self.near = log, family, carry, near
        self.ends = tuple(family.ranges.values())

    def at(self, values: Sequence[float]) -> tuple[float, InfluencePopulation, Floats]:
        """Return the log likelihood, the population, and the table of `LikelihoodTable.log_likelihood`."""
        logs = self.log.log_likelihood(self.family.rule(values), carry=self.carry)
        self.near, value = InfluencePopulation.fit(self.log, logs, self.near)
        return value, self.near, logs

    def value(self, values: Floats) -> float:
        """Return the log likelihood; outside of the ranges, that of the nearest parameters."""
        return self.at(np.clip(values, *np.array(self.ends).T).tolist())[0]

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

    def sample(self, best: tuple[float, ...], covariance: Floats) -> PosteriorSample:
        """Return a sample of what the parameters may be, given their covariance at the best ones."""
        return PosteriorSample.around(self.value, np.array(best), self.ends, covariance)

    def intervals(self, best: tuple[float, ...], covariance: Floats, level: float) -> list[Interval]:
        """Return the likelihood-ratio interval of each parameter, with the others where the likelihood is largest."""
        at, found = np.array(best), []
        least = self.value(at) - largest_fall(level)
        for j, ends in enumerate(self.ends):

            def margin(value: float, j: int = j) -> float:
                return self._largest(at, j, value, covariance) - least

            low, high = (end_of(margin, best[j], _outwards(best[j], end), 1e-3, 1e-3)[0] for end in ends)
            found.append((low, high))
        return found

    def _largest(self, best: Floats, j: int, value: float, covariance: Floats) -> float:
        """Return the largest log likelihood with one value given.

        The others move along the ridge that the covariance describes, which may be curved: from there, each moves to
        the top of the parabola through three points that are its conditional deviation apart.
        """
        ridge = covariance[j] / covariance[j, j]
        point = best + ridge * (value - best[j])
        low, high = np.array(self.ends).T
        found = self.value(point)
        for i in range(len(best)):
            if i == j:
                continue
            apart = math.sqrt(max(covariance[i, i] - ridge[i] * covariance[i, j], 1e-8))
            move = apart * np.eye(len(best))[i]
            plus, minus = self.value(point + move), self.value(point - move)
            if plus + minus < 2 * found:
                moved = np.clip(point + move * (plus - minus) / (4 * found - 2 * plus - 2 * minus), low, high)
                if (there := self.value(moved)) > found:
                    point, found = moved, there
        return found

    def covariance(self, best: tuple[float, ...]) -> Floats:
        """Return the covariance of the parameters, (P, P); see `posterior_covariance`."""
        return posterior_covariance(self.value, np.array(best), self.ends)


def _outwards(value: float, end: float) -> Iterator[float]:
    """Yield values from one up to an end, in steps that double."""
    step = math.copysign(0.02 + 0.2 * abs(value), end - value)
    while value != end:
        value = min(value + step, end) if step > 0 else max(value + step, end)
        yield value
        step *= 2
