"""The search for the parameters of a trust rule that make a log likeliest, their covariance and intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from ..people.decision import Floats
from .influence_population import InfluencePopulation
from .intervals import Interval, end_of, largest_fall, outwards
from .likelihood_table import LikelihoodTable
from .posterior_sample import PosteriorSample, posterior_covariance
from .rule_families import RuleFamily

DIFFERENCE = 1e-5
"""Step of a parameter by which derivatives are found; all parameters have ranges of about 1."""

EQUAL = 1e-6
"""Log-likelihoods that differ by less count as equal. Rounding errors do not decide where a search begins."""


class RuleSearch:
    """The search for the parameters of a rule; the population that fits best is found for each."""

    def __init__(
        self, log: LikelihoodTable, family: RuleFamily, carry: bool, near: InfluencePopulation | None = None
    ) -> None:  # fmt: skip
        self.log, self.family, self.carry, self.near = log, family, carry, near
        self.ends = tuple(family.ranges.values())
        self._fits: dict[tuple[float, ...], tuple[InfluencePopulation, float]] = {}

    def table(self, values: Sequence[float]) -> Floats:
        """Return the table of `LikelihoodTable.log_likelihood` with these parameters."""
        return self.log.log_likelihood(self.family.rule(values), carry=self.carry)

    def fitted(self, values: Sequence[float]) -> tuple[InfluencePopulation, float]:
        """Return the best population with these parameters, and the log likelihood; both are kept."""
        known = tuple(values)
        if known not in self._fits:
            self._fits[known] = InfluencePopulation.fit(self.log, self.table(known), self.near)
            self.near = self._fits[known][0]
        return self._fits[known]

    def value(self, values: Floats) -> float:
        """Return the log likelihood; outside of the ranges, that of the nearest parameters."""
        return self.fitted(np.clip(values, *np.array(self.ends).T).tolist())[1]

    def best(self, start: Sequence[float] | None = None) -> tuple[float, ...]:
        """Return the parameters of largest likelihood, from a start or the best of those tried."""
        if not self.family.ranges:
            return ()
        if start is None:
            found = np.array([self.fitted(values)[1] for values in self.family.tried])
            start = self.family.tried[int(np.argmax(found >= found.max() - EQUAL))]
        return tuple(self._climbed(np.array(start), self.ends)[0].tolist())

    def _climbed(self, start: Floats, ends: Sequence[Interval], flat: float = 1e-3) -> tuple[Floats, float]:
        """Return the point of largest log likelihood within ranges, and that likelihood (L-BFGS-B).

        The population is the best one at each point. So the derivative by a parameter is that with this population
        (envelope theorem), and it is found from one more table. The search ends where no derivative exceeds `flat`.
        """

        def loss(point: Floats) -> tuple[float, Floats]:
            population, value = self.fitted(point.tolist())
            slopes = np.zeros(len(point))
            for j, (low, high) in enumerate(ends):
                step = DIFFERENCE if point[j] + DIFFERENCE <= self.ends[j][1] else -DIFFERENCE
                if low < high:
                    moved = np.where(np.arange(len(point)) == j, point + step, point).tolist()
                    slopes[j] = (float(population.marginal(self.log, self.table(moved)).sum()) - value) / step
            return -value, -slopes

        found = minimize(
            loss, start, jac=True, method="L-BFGS-B", bounds=list(ends), options={"ftol": 1e-6 * flat, "gtol": flat}
        )
        return found.x, -float(found.fun)

    def sample(self, best: tuple[float, ...], covariance: Floats) -> PosteriorSample:
        """Return a sample of what the parameters may be, given their covariance at the best ones."""
        return PosteriorSample.around(self.value, np.array(best), self.ends, covariance)

    def intervals(self, best: tuple[float, ...], covariance: Floats, level: float) -> list[Interval]:
        """Return the likelihood-ratio interval of each parameter, with the others where the likelihood is largest."""
        at, found = np.array(best), []
        least = self.value(at) - largest_fall(level)
        for j, ends in enumerate(self.ends):

            def margin(value: float, j: int = j) -> float:
                # The others move along the ridge that the covariance describes, and from there to the top.
                low, high = np.array([(value, value) if i == j else other for i, other in enumerate(self.ends)]).T
                near = at + covariance[j] / covariance[j, j] * (value - best[j])
                return self._climbed(np.clip(near, low, high), list(zip(low, high, strict=True)), 0.05)[1] - least

            low, high = (end_of(margin, best[j], outwards(best[j], end), 1e-3, 1e-3)[0] for end in ends)
            found.append((low, high))
        return found

    def covariance(self, best: tuple[float, ...]) -> Floats:
        """Return the covariance of the parameters, (P, P); see `posterior_covariance`."""
        return posterior_covariance(self.value, np.array(best), self.ends)
