"""Influence under a trust rule, learned from logs of planning tasks.

Model. logit(theta_0) is normal over people and log(beta) is normal, independently; both are truncated at the ends of a
grid. theta_0 is the influence at a person's first suggestion. It moves by the trust rule after each suggestion, and it
is carried from one episode to the next in the order of their names. The parameters of the rule are the same for all
people. So theta is a function of theta_0, and a person's likelihood is a table over both (`LikelihoodTable`).

Population and parameters have the largest marginal likelihood. A person's estimates are those of the posterior under
that population (empirical Bayes), averaged over the parameters of the rule.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, logit

from planner.system.results import Result

from ..people.decision import Floats
from ..people.trust_rules import TrustRule, plain_rule
from .distribution import Margin, PopulationFit
from .evidence import Evidence, is_carried
from .influence_population import InfluencePopulation, PosteriorSample, posterior_covariance
from .intervals import Interval, end_of, equal_tailed, largest_fall, outwards
from .likelihood import Method
from .likelihood_table import LikelihoodTable
from .neighbours_in_logs import rule_beside
from .observations import Observations
from .rule_families import RuleFamily, family_of, name_of, parameters_of

DIFFERENCE = 1e-5
"""Step of a parameter by which derivatives are found; all parameters have ranges of about 1."""

EQUAL = 1e-6
"""Log-likelihoods that differ by less count as equal. Rounding errors do not decide where a search begins."""


@dataclass(frozen=True, eq=False, repr=False)
class Influence(Result):
    """One person's influence under a trust rule.

    Attributes
    ----------
    person : str
    suggestions, followed : int
    beta, theta_first, theta : float
        Posterior means: expertise, influence at the first suggestion, and after the last one.
    beta_interval, theta_first_interval, theta_interval : pair of float
        Equal-tailed posterior intervals.
    """

    person: str
    suggestions: int
    followed: int
    beta: float
    beta_interval: Interval
    theta_first: float
    theta_first_interval: Interval
    theta: float
    theta_interval: Interval

    def records(self) -> list[dict[str, Any]]:
        """Return one row: estimates with the ends of their intervals."""
        row: dict[str, Any] = {}
        for name, value in vars(self).items():
            ends = (f"{name[:-8]}low", f"{name[:-8]}high") if name.endswith("interval") else ()
            row |= zip(ends, value, strict=True) if ends else {name: value}
        return [row]


@dataclass(frozen=True, eq=False, repr=False)
class InfluenceFit(Result):
    """Influence of all people under a trust rule.

    Attributes
    ----------
    rule : str
    parameters : dict of str to float
        Those of the rule.
    intervals : dict of str to (float, float)
        Likelihood-ratio interval of each parameter that was estimated.
    unidentified : tuple of str
        Parameters that the choices say nothing about: their intervals are all values that are searched.
    open_above : tuple of str
        Parameters whose intervals end only because the search does.
    population : InfluencePopulation
    log_likelihood : float
        Marginal log likelihood of all choices.
    carried : bool
        Whether theta is carried from episode to episode.
    log_likelihood_anew : float or None
        The largest one if theta begins anew in each episode; None unless it is carried, by people with several.
    people : tuple of Influence
    trust : TrustRule
        The rule with its parameters.
    margins : (Margin, Margin)
        Distributions of beta and of theta_0 over people, in cells around the nodes.
    """

    rule: str
    parameters: dict[str, float]
    intervals: dict[str, Interval]
    unidentified: tuple[str, ...]
    open_above: tuple[str, ...]
    population: InfluencePopulation
    log_likelihood: float
    carried: bool
    log_likelihood_anew: float | None
    people: tuple[Influence, ...]
    trust: TrustRule
    margins: tuple[Margin, Margin]

    def __repr__(self) -> str:
        given = {name: "" if name in self.intervals else " (given)" for name in self.parameters}
        shown = {name: "?" if name in self.unidentified else f"{value:.3g}" for name, value in self.parameters.items()}
        values = ", ".join(f"{name} {shown[name]}{given[name]}" for name in self.parameters)
        return f"<trust rule {self.rule} of {len(self.people)} people: {values or 'no parameters'}>"

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each person, as `Influence.records` does."""
        return [row for one in self.people for row in one.records()]

    def as_dict(self) -> dict[str, Any]:
        """Return estimates as plain data."""
        shown = {name: value for name, value in vars(self).items() if name not in ("trust", "margins")}
        return shown | {"population": vars(self.population), "people": [vars(one) for one in self.people]}

    def distribution(self) -> PopulationFit:
        """Return the estimated distribution of people, with the trust rule.

        Raises
        ------
        ValueError
            The rule is the user's own, which is not saved.
        """
        beta, theta = self.margins
        return PopulationFit(
            len(self.people), beta, theta, self.parameters.get("eta"), self.log_likelihood,
            np.multiply.outer(beta.shares, theta.shares), trust=plain_rule(self.trust), unidentified=self.unidentified,
        )  # fmt: skip


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


def fit_influence(
    observations: Evidence | Sequence[Observations], rule: str | TrustRule | RuleFamily, method: Method | None = None,
    *, carry: bool | None = None,
) -> InfluenceFit:  # fmt: skip
    """Return each person's influence under a trust rule.

    It has no limit of time, as an unfinished search has no estimates; `fit_population` and `compare_rules` have one.

    Parameters
    ----------
    observations : Evidence, or sequence of Observations
        A log that was replayed; or one for each person.
    rule : str, TrustRule or RuleFamily
        The name of a shipped rule, whose parameters are estimated; or a rule, or FILE.py:RULE, taken unchanged; or a
        family of rules.
    method : Method, optional
        Level of the intervals, lapse, and what is known beforehand. With neighbours, theta also moves by the rule of
        this name, whose parameters are estimated, too; or by one of the user's own, taken unchanged.
    carry : bool, optional
        Whether theta is carried from episode to episode, in the order of their names. Unless given, it is, but for the
        log of a simulation, in which theta begins anew in each episode.

    Raises
    ------
    InputFileError
        Nothing was ever suggested.
    UserCodeError
        A rule of the user's own fails, or returns what is impossible.
    ValueError
        There is no rule of that name; or theta is to be carried, but each episode has one of several goals.
    """
    method, carry = method or Method(), is_carried(observations, carry)
    family = rule_beside(family_of(rule, method), method)
    log = LikelihoodTable.of_advised(observations, method, carry=carry)
    search = RuleSearch(log, family, carry)
    values, intervals, unidentified, open_above = search.best(), {}, list[str](), list[str]()
    # A person's belief is averaged over what the parameters of the rule may be: with the best ones alone, intervals of
    # theta after many suggestions are too short.
    points, shares = np.zeros((1, 0)), np.ones(1)
    if family.ranges:
        covariance = search.covariance(values)
        ends = dict(zip(family.ranges, search.intervals(values, covariance, method.level), strict=True))
        intervals = {
            name: (family.parameter(name, end[0]), family.parameter(name, end[1])) for name, end in ends.items()
        }
        unidentified = [name for name, whole in family.ranges.items() if np.allclose(ends[name], whole)]
        open_above = [name for name, whole in family.ranges.items() if np.isclose(ends[name][1], whole[1])]
        sample = search.sample(values, covariance)
        points, shares = sample.points, sample.shares
    population, value = search.fitted(values)
    anew = None
    if carry and (log.anew.sum(axis=1) > 1).any():
        other = RuleSearch(log, family, False, population)
        anew = other.fitted(other.best())[1]
    joint, last = _beliefs(log, search, points, shares)
    both = joint.sum(axis=0)
    beta, theta = both.sum(axis=2), both.sum(axis=1)
    after, mass = last.transpose(1, 0, 2).reshape(len(last[0]), -1), joint.sum(axis=2).transpose(1, 0, 2)
    mass = mass.reshape(len(mass), -1)
    people = [
        Influence(
            person, int(log.told[k]), int(log.accepted[k]),
            float(log.beta @ beta[k]), _shown(equal_tailed(np.log(log.beta), beta[k], method.level), np.exp),
            float(log.theta @ theta[k]), _shown(equal_tailed(logit(log.theta), theta[k], method.level), expit),
            float(after[k] @ mass[k]), equal_tailed(after[k], mass[k], method.level),
        )
        for k, person in enumerate(log.people)
    ]  # fmt: skip
    weights, recorded = np.multiply.outer(*population.weights(log)), both.mean(axis=0)
    margins = (
        Margin.of(
            "log-normal", (population.log_beta, population.log_beta_spread), np.exp(_edges(np.log(log.beta))),
            weights.sum(axis=1), recorded.sum(axis=1),
        ),
        Margin.of(
            "logit-normal", (population.logit_theta, population.logit_theta_spread),
            np.asarray(expit(_edges(logit(log.theta)))), weights.sum(axis=0), recorded.sum(axis=0),
        ),
    )  # fmt: skip
    chosen = family.rule(values)
    return InfluenceFit(
        name_of(rule) + family.beside, parameters_of(chosen), intervals, tuple(unidentified), tuple(open_above),
        population, value, carry, anew, tuple(people), chosen, margins,
    )  # fmt: skip


def _beliefs(log: LikelihoodTable, search: RuleSearch, points: Floats, shares: Floats) -> tuple[Floats, Floats]:
    """Return the probabilities of beta and theta_0 with each point of the rule's parameters, and theta at last.

    Shapes (points, K, B, T) and (points, K, T); the probabilities of a person sum to 1. `points`, shape (points, P),
    are of `RuleSearch.sample`, and `shares` their probabilities with the best population of each.
    """
    joint, last = [], []
    with np.errstate(divide="ignore"):  # a point far out has a share of 0
        logs = np.log(shares)
    for at, point in enumerate(points.tolist()):
        population, best = search.fitted(point)
        found, average = population.posteriors(log, search.table(point))
        logs[at] += average - best
        joint.append(found)
        last.append(log.thetas(search.family.rule(point), carry=search.carry)[1])
    mass = np.exp(logs - logs.max())
    return np.array(joint) * (mass / mass.sum())[:, None, None, None], np.array(last)


def _edges(nodes: Floats) -> Floats:
    """Return the edges of cells around nodes; the first and the last cell end at their nodes."""
    return np.concatenate([nodes[:1], (nodes[1:] + nodes[:-1]) / 2, nodes[-1:]])


def _shown(interval: Interval, shown: Callable[[float], float]) -> Interval:
    return float(shown(interval[0])), float(shown(interval[1]))
