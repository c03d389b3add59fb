"""Influence under a trust rule, learned from logs of planning tasks, and which rule predicts people best.

Model. logit(theta_0) is normal over people and log(beta) is normal, independently; both are truncated at the ends of a
grid. theta_0 is the influence at a person's first suggestion. It moves by the trust rule after each suggestion, and it
is carried from one episode to the next in the order of their names. The parameters of the rule are the same for all
people. So theta is a function of theta_0, and the likelihood of a person is a table over beta and theta_0 (`TrustLog`).

Population and parameters have the largest marginal likelihood. A person's estimates are those of the posterior under
that population (empirical Bayes), averaged over the parameters of the rule.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from scipy.optimize import brentq, minimize
from scipy.special import chdtri, expit, logit
from threadpoolctl import threadpool_limits

from planner.system.jit import njit

from ..people.decision import Floats
from ..people.trust_rules import EquationSeven, TrustRule, constant, outcome, outcome_at_disagreement, plain_rule
from .fit import LogError
from .likelihood import Method
from .observations import Observations
from .population import Margin, PopulationFit
from .trust_log import TrustLog
from .trust_scores import REFERENCE, TrustComparison

STEP_SIZES = (0.1, 0.2, 0.4, 0.8)
"""Steps of logit(theta) that are tried for gain and for loss, in log-odds."""

LARGEST_STEP = 3.0
"""Largest step that is estimated, in log-odds: from theta = .18 to .82 at once."""

RATES = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Values of eta that are tried."""

TOLERANCE = 3e-3
"""Accuracy of estimated steps and rates: a fraction of the standard error that 100 people and 60 suggestions leave."""

Interval = tuple[float, float]


@dataclass(frozen=True)
class RuleFamily:
    """A shipped trust rule whose parameters are to be estimated.

    Attributes
    ----------
    make : callable
        Returns the rule with the parameters.
    ranges : mapping of str to (float, float)
        Range of each parameter, by name.
    tried : tuple of tuple of float
        Values of the parameters that are tried before the best are refined.
    """

    make: Callable[..., TrustRule]
    ranges: Mapping[str, Interval]
    tried: tuple[tuple[float, ...], ...]

    def rule(self, values: Sequence[float]) -> TrustRule:
        """Return the rule with these parameters, in the order of `ranges`."""
        return self.make(**dict(zip(self.ranges, values, strict=True)))

    @classmethod
    def of(cls, rule: TrustRule) -> RuleFamily:
        """Return the family of one rule, without parameters to estimate."""
        return cls(lambda: rule, {}, ((),))


def families(method: Method) -> dict[str, RuleFamily]:
    """Return the shipped rules by name; eta is the method's if it is known."""
    paper = partial(EquationSeven, utility_scale=method.utility_scale)
    steps, pairs = {"gain": (0.0, LARGEST_STEP), "loss": (0.0, LARGEST_STEP)}, tuple(product(STEP_SIZES, STEP_SIZES))
    return {
        REFERENCE: RuleFamily.of(constant()),
        "paper": RuleFamily(paper, {"eta": (0.0, 1.0)}, tuple((rate,) for rate in RATES))
        if method.eta is None
        else RuleFamily.of(paper(eta=method.eta)),
        "outcome": RuleFamily(outcome, steps, pairs),
        "outcome-at-disagreement": RuleFamily(
            outcome_at_disagreement, {"agreement": (-1.0, 1.0), **steps},
            tuple((agreement, *pair) for agreement in (0.0, 0.1) for pair in pairs),
        ),
    }  # fmt: skip


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

    def weights(self, log: TrustLog) -> tuple[Floats, Floats]:
        """Return the probabilities of the nodes of beta and of theta_0, shapes (B,), (T,)."""
        return (
            _normal(np.log(log.beta), self.log_beta, self.log_beta_spread)[0],
            _normal(logit(log.theta), self.logit_theta, self.logit_theta_spread)[0],
        )

    def marginal(self, log: TrustLog, logs: Floats) -> Floats:
        """Return the log probability of all that each person chose, shape (K,).

        `logs` are log likelihoods at the nodes of beta and theta_0, shape (K, B, T).
        """
        beta, theta = self.weights(log)
        top = logs.max(axis=(1, 2))
        return np.asarray(np.log(np.exp(logs - top[:, None, None]) @ theta @ beta) + top)

    @classmethod
    def fit(
        cls, log: TrustLog, logs: Floats, near: InfluencePopulation | None = None
    ) -> tuple[InfluencePopulation, float]:
        """Return the population of largest marginal likelihood, and the logarithm of that likelihood.

        Parameters
        ----------
        log : TrustLog
            Of which only the nodes are read.
        logs : float array, shape (K, B, T)
            From `TrustLog.log_likelihood`, of some people or all.
        near : InfluencePopulation, optional
            Where the search begins.
        """
        top = logs.max(axis=(1, 2))
        scaled = np.exp(logs - top[:, None, None])
        x, y = np.log(log.beta), np.asarray(logit(log.theta))
        # A distribution narrower than the distance of two nodes would lie between them.
        ranges = ((x[0], x[-1]), (x[1] - x[0], 3.0), (y[0], y[-1]), (y[1] - y[0], 4.0))

        def loss(point: Floats) -> tuple[float, Floats]:
            beta, theta = _normal(x, *point[:2]), _normal(y, *point[2:])
            found = _sums(scaled, beta, theta)
            return -float(np.log(found[:, 0]).sum()), -np.asarray((found[:, 1:] / found[:, :1]).sum(axis=0))

        start = [x[-1] - 2.0, 1.0, 1.0, 1.5] if near is None else list(vars(near).values())
        with threadpool_limits(1, user_api="blas"):  # threads wait longer than these small matrices take
            best = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=ranges)
        return cls(*best.x.tolist()), float(top.sum()) - float(best.fun)


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


def parameters_of(rule: TrustRule) -> dict[str, float]:
    """Return the numbers that a rule has, by name."""
    return {name: float(value) for name, value in vars(rule).items() if type(value) in (int, float)}


@dataclass(frozen=True)
class Influence:
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


@dataclass(frozen=True)
class InfluenceFit:
    """Influence of all people under a trust rule.

    Attributes
    ----------
    rule : str
    parameters : dict of str to float
        Those of the rule.
    intervals : dict of str to (float, float)
        Likelihood-ratio interval of each parameter that was estimated.
    population : InfluencePopulation
    log_likelihood : float
        Marginal log likelihood of all choices.
    carried : bool
        Whether theta is carried from episode to episode.
    people : tuple of Influence
    trust : TrustRule
        The rule with its parameters.
    margins : (Margin, Margin)
        Distributions of beta and of theta_0 over people, in cells around the nodes.
    """

    rule: str
    parameters: dict[str, float]
    intervals: dict[str, Interval]
    population: InfluencePopulation
    log_likelihood: float
    carried: bool
    people: tuple[Influence, ...]
    trust: TrustRule
    margins: tuple[Margin, Margin]

    def as_dict(self) -> dict[str, Any]:
        """Return estimates as plain data."""
        return {
            "rule": self.rule, "parameters": self.parameters, "intervals": self.intervals,
            "population": vars(self.population), "log_likelihood": self.log_likelihood, "carried": self.carried,
            "people": [vars(one) for one in self.people],
        }  # fmt: skip

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
            np.multiply.outer(beta.shares, theta.shares), trust=plain_rule(self.rule, self.trust),
        )  # fmt: skip


def fit_influence(
    observations: Sequence[Observations], rule: str | TrustRule, method: Method | None = None, *, carry: bool = True
) -> InfluenceFit:
    """Return each person's influence under a trust rule.

    Parameters
    ----------
    observations : sequence of Observations
        One for each person.
    rule : str or TrustRule
        The name of a shipped rule, whose parameters are estimated; or a rule, taken unchanged.
    method : Method, optional
        Level of the intervals, lapse, and what is known beforehand.
    carry : bool
        Whether theta is carried from episode to episode, in the order of their names.

    Raises
    ------
    LogError
        Nothing was ever suggested.
    ValueError
        There is no rule of that name.
    """
    method = method or Method()
    known = families(method)
    if isinstance(rule, str) and rule not in known:
        raise ValueError(f"trust '{rule}': expected one of {', '.join(known)}, or a rule")
    family = known[rule] if isinstance(rule, str) else RuleFamily.of(rule)
    log = TrustLog.of(observations, method)
    search = _Search(log, family, carry)
    values, intervals = search.best(), {}
    nodes: list[tuple[tuple[float, ...], float]] = [((), 1.0)]
    if family.ranges:
        covariance = search.covariance(values)
        intervals = dict(zip(family.ranges, search.intervals(values, covariance, method.level), strict=True))
        nodes = search.nodes(values, covariance)
    value, population, _ = search.at(values)
    # A person's belief is averaged over what the parameters of the rule may be: with the best ones alone, intervals of
    # theta after many suggestions are too short.
    joint, last = _beliefs(log, search, nodes)
    both = joint.sum(axis=0)
    beta, theta = both.sum(axis=2), both.sum(axis=1)
    after, mass = last.transpose(1, 0, 2).reshape(len(last[0]), -1), joint.sum(axis=2).transpose(1, 0, 2)
    mass = mass.reshape(len(mass), -1)
    people = [
        Influence(
            person, int(log.heard[k]), int(log.accepted[k]),
            float(log.beta @ beta[k]), _interval(np.log(log.beta), beta[k], method.level, np.exp),
            float(log.theta @ theta[k]), _interval(logit(log.theta), theta[k], method.level, _theta),
            float(after[k] @ mass[k]), _interval(after[k], mass[k], method.level, float),
        )
        for k, person in enumerate(log.people)
    ]  # fmt: skip
    weights, recorded = np.multiply.outer(*population.weights(log)), both.mean(axis=0)
    name = rule if isinstance(rule, str) else type(rule).__name__
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
        name, parameters_of(chosen), intervals, population, value, carry, tuple(people), chosen, margins
    )


def _beliefs(log: TrustLog, search: _Search, nodes: Sequence[tuple[tuple[float, ...], float]]) -> tuple[Floats, Floats]:
    """Return the probabilities of beta and theta_0 with each node of the rule's parameters, and theta at last.

    Shapes (nodes, K, B, T) and (nodes, K, T); the probabilities of a person sum to 1. `nodes` has parameters and the
    probability of each.
    """
    joint, last = [], []
    for values, mass in nodes:
        _, population, logs = search.at(values)
        found = np.multiply.outer(*population.weights(log)) * np.exp(logs - logs.max(axis=(1, 2), keepdims=True))
        joint.append(mass * found / found.sum(axis=(1, 2), keepdims=True))
        last.append(log.thetas(search.family.rule(values), carry=search.carry)[1])
    return np.array(joint), np.array(last)


def _edges(nodes: Floats) -> Floats:
    """Return the edges of cells around nodes; the first and the last cell end at their nodes."""
    return np.concatenate([nodes[:1], (nodes[1:] + nodes[:-1]) / 2, nodes[-1:]])


def _theta(log_odds: float) -> float:
    return float(expit(log_odds))


def _interval(nodes: Floats, mass: Floats, level: float, shown: Callable[[float], float]) -> Interval:
    """Return the equal-tailed interval of a distribution that is known at nodes, and linear between them."""
    order = np.argsort(nodes, kind="stable")
    below = np.cumsum(mass[order]) - mass[order] / 2
    low, high = np.interp(((1 - level) / 2, (1 + level) / 2), below, nodes[order]).tolist()
    return float(shown(low)), float(shown(high))


class _Search:
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

    def best(self, start: tuple[float, ...] | None = None) -> tuple[float, ...]:
        """Return the parameters of largest likelihood, by the simplex method.

        It begins with the best of those tried, unless a start is given.
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
            options={"initial_simplex": corners, "xatol": TOLERANCE, "fatol": 0.01},
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

    def covariance(self, best: tuple[float, ...]) -> Floats:
        """Return the covariance of the parameters, (P, P), from differences of the likelihood at about two deviations.

        Where the likelihood is not concave, parameters are taken to be independent.
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
        if (np.linalg.eigvalsh(curvature) >= 0).any():
            return np.diag((steps / 2) ** 2)
        return np.asarray(np.linalg.inv(-curvature))


def compare_trust(
    observations: Sequence[Observations],
    method: Method | None = None,
    *,
    rules: Mapping[str, RuleFamily] | None = None,
    folds: int = 8,
    carry: bool = True,
    progress: Callable[[int], None] | None = None,
) -> TrustComparison:
    """Return a comparison of trust rules by the log probability of the choices of held-out people.

    The parameters of each rule and its population are fitted to the people of the other folds.

    Parameters
    ----------
    observations, method, carry
        As for `fit_influence`.
    rules : mapping of str to RuleFamily, optional
        The rules; "constant" is among them. The shipped ones unless given.
    folds : int
        Groups of people that are left out in turn.
    progress : callable, optional
        Called with how many rules have been finished since the last call.

    Raises
    ------
    LogError
        Nothing was ever suggested, or there are fewer than two people.
    ValueError
        There are fewer than two folds, or "constant" is missing.
    """
    method = method or Method()
    if folds < 2:
        raise ValueError(f"folds {folds}: expected 2 or more")
    if len(observations) < 2:
        raise LogError("one person; a comparison needs two or more, to learn from some about others")
    rules = families(method) if rules is None else rules
    if REFERENCE not in rules:
        raise ValueError(f"rules {', '.join(rules)}: expected '{REFERENCE}' among them")
    log, found, estimates = TrustLog.of(observations, method), {}, {}
    people = len(log.people)
    fold = np.arange(people) % min(folds, people)
    for name, family in rules.items():
        every = _Search(log, family, carry)
        best = every.best()
        _, population, _ = every.at(best)
        estimates[name] = parameters_of(family.rule(best)) | vars(population)
        found[name] = np.empty(people)
        for group in range(int(fold.max()) + 1):
            inside = fold == group
            others = _Search(log.only(~inside), family, carry, population)
            values = others.best(best)
            logs = log.only(inside).log_likelihood(family.rule(values), carry=carry)
            found[name][inside] = others.at(values)[1].marginal(log, logs)
        if progress is not None:
            progress(1)
    return TrustComparison.of(found, log.counts, estimates, method.level)
