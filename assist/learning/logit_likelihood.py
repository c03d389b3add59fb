"""The likelihood of many people's choices with terms, and its derivatives.

A suggestion adds logit(theta) to the exponent of the suggested choice (equation 6), so that choices are multinomial
logit:

    P(a) proportional to exp(-beta excess(a) + sum_j w_j f_j(a) + logit(theta) [a is suggested]),

mixed with a lapse. A person's parameters are a row of coordinates (b, l, w_1 ... w_J). Here beta = small expm1(b), a
scale that is linear below `small` and logarithmic above, and l = logit(theta) at the beginning of an episode. Theta
changes by equation 7 with h* as the person's cost-to-go. Once it is clipped to 0 or 1, its earlier values do not
matter.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from planner.system.arrays import frozen
from planner.system.jit import njit

from ..people.decision import NOTHING, Floats
from .likelihood import SMALL, SURE, Method, largest_beta
from .observations import Ints, Observations

COMPILED_FOR = "estimates of terms: about ten seconds"

BETA, THETA, FIRST_TERM = 0, 1, 2
"""Indices of the coordinates of beta, theta and the first term; those of other terms follow."""

CERTAIN = 1e-9  # smallest distance of theta to 0 and 1 in the derivative of its logit

THETAS = 81
"""Nodes of theta at which searches look for a better one: 0.17 log-odds apart."""


class Steps(NamedTuple):
    """The choices of K people, of one task or of several, as compiled code reads them; N steps of up to A choices.

    `person`, shape (N,), has ascending numbers of people. `speaks`, shape (N, A, 2 + J), has the factors of the
    coordinates: minus the excess cost (0 if infinite), whether the choice is suggested, and J terms. `possible` is
    whether a choice is possible without a lapse; avoidable actions into dead ends are not. `gain` is the change of the
    person's value by the suggestion, in units of the trust update; 0 without one. `told` is whether there is any.
    """

    person: Ints
    speaks: Floats
    possible: NDArray[np.bool_]
    options: Ints
    chosen: Ints
    gain: Floats
    begins: NDArray[np.bool_]
    told: bool

    @classmethod
    def of(cls, observations: Sequence[Observations], number: Mapping[str, int], method: Method) -> Steps:
        """Return the steps of observations; `number` has the number of each person."""
        width = max(o.excess.shape[1] for o in observations)
        speaks, possible = [], []
        for o in observations:
            wide, here = ((0, 0), (0, width - o.excess.shape[1])), o.applicable & np.isfinite(o.excess)
            told = (np.arange(o.excess.shape[1]) == o.suggested[:, None]) & (o.suggested != NOTHING)[:, None]
            factors = np.stack([np.where(here, -o.excess, 0.0), told], axis=2)
            speaks.append(np.pad(np.concatenate([factors, o.features], axis=2), (*wide, (0, 0))))
            possible.append(np.pad(here, wide))
        person = np.repeat([number[o.person] for o in observations], [len(o) for o in observations])
        order = np.argsort(person, kind="stable")
        parts = (
            [person], speaks, possible, [o.applicable.sum(axis=1) for o in observations],
            [o.chosen for o in observations], [o.gain / method.utility_scale for o in observations],
            [o.begins for o in observations],
        )  # fmt: skip
        any_told = any((o.suggested != NOTHING).any() for o in observations)
        return cls._make([*(frozen(np.concatenate(part)[order]) for part in parts), any_told])

    def only(self, steps: NDArray[np.bool_]) -> Steps:
        """Return some of the steps, shape (N,), in whole episodes; people keep their numbers."""
        return Steps._make([*(frozen(array[steps]) for array in self[:-1]), self.told])

    def together(self) -> Steps:
        """Return the steps as those of one person."""
        return self._replace(person=frozen(np.zeros_like(self.person)))


@dataclass(frozen=True)
class Ranges:
    """Ranges of the coordinates, arrays of shape (2 + J,). `small` is the scale of beta.

    `told_apart` is whether choices of the log differ in what each coordinate is about.
    """

    small: float
    low: Floats
    high: Floats
    told_apart: NDArray[np.bool_]

    @classmethod
    def of(cls, steps: Steps, largest: float) -> Ranges:
        """Return ranges: beta up to `largest`, theta from 0 to 1, and weights as far as data can distinguish them."""
        small = SMALL * largest
        seen = steps.speaks[:, :, FIRST_TERM:]
        spread = np.max(seen, axis=1, where=steps.possible[:, :, None], initial=-np.inf) - np.min(
            seen, axis=1, where=steps.possible[:, :, None], initial=np.inf
        )
        usual = [float(np.median(column[column > 0])) if (column > 0).any() else 1.0 for column in spread.T]
        # The largest weight gives log-odds of 12 to a typical difference of a term between two choices.
        ends = np.array([logit(1 - SMALL), *(12.0 / size for size in usual)])
        told_apart = np.array([True, steps.told, *(spread > 0).any(axis=0)])
        return cls(small, np.array([0.0, *-ends]), np.array([np.log1p(largest / small), *ends]), told_apart)

    def thetas(self) -> Floats:
        """Return nodes of the coordinate of theta, shape (T,)."""
        return np.linspace(self.low[THETA], self.high[THETA], THETAS)

    def beta(self, coordinate: Floats) -> Floats:
        """Return beta for values of its coordinate."""
        return np.asarray(self.small * np.expm1(coordinate), dtype=np.float64)

    def theta(self, coordinate: Floats) -> Floats:
        """Return theta for a coordinate; the ends of its range are 0 and 1."""
        value = expit(coordinate)
        value = np.where(coordinate <= self.low[THETA], 0.0, np.where(coordinate >= self.high[THETA], 1.0, value))
        return np.asarray(value, dtype=np.float64)


@dataclass(frozen=True)
class Likelihood:
    """The log-likelihood of the choices of each of K people, with J terms, and its derivatives."""

    people: tuple[str, ...]
    terms: tuple[str, ...]
    steps: Steps
    ranges: Ranges
    lapse: float
    eta: float

    @classmethod
    def of(cls, observations: Sequence[Observations], method: Method) -> Likelihood:
        """Return the likelihood with the options of a method; an unknown learning rate is 0.

        Observations with the same name (in other tasks) are one person's.
        """
        if not observations:
            raise ValueError("terms need people; there are no observations")
        terms = observations[0].terms
        if any(o.terms != terms for o in observations):
            raise ValueError("expected observations with the same terms")
        people = tuple(dict.fromkeys(o.person for o in observations))
        steps = Steps.of(observations, {person: place for place, person in enumerate(people)}, method)
        ranges = Ranges.of(steps, largest_beta(observations, method))
        return cls(people, terms, steps, ranges, method.lapse, method.eta or 0.0)

    def with_terms(self, terms: Iterable[str]) -> Likelihood:
        """Return the likelihood with some of the terms only."""
        places = [j for j, term in enumerate(self.terms) if term in set(terms)]
        kept = [BETA, THETA, *(FIRST_TERM + j for j in places)]
        steps = self.steps._replace(speaks=frozen(np.ascontiguousarray(self.steps.speaks[:, :, kept])))
        of_all = self.ranges
        ranges = Ranges(of_all.small, of_all.low[kept], of_all.high[kept], of_all.told_apart[kept])
        return replace(self, terms=tuple(self.terms[j] for j in places), steps=steps, ranges=ranges)

    def together(self, steps: NDArray[np.bool_] | None = None) -> Likelihood:
        """Return the likelihood of some steps, shape (N,), or of all, as those of one person."""
        some = self.steps if steps is None else self.steps.only(steps)
        return replace(self, people=("everybody",), steps=some.together())

    def parameters(self, at: Floats) -> dict[str, float]:
        """Return what coordinates, shape (2 + J,), stand for: beta, weights, and with suggestions theta and eta."""
        found = {"beta": float(self.ranges.beta(at[BETA]))}
        found |= zip(self.terms, at[FIRST_TERM:].tolist(), strict=True)
        return found | ({"theta": float(self.ranges.theta(at[THETA])), "eta": self.eta} if self.steps.told else {})

    def log_probability(self, at: Floats) -> Floats:
        """Return the log-probability of each step's choice, shape (N,), at coordinates of shape (K, 2 + J)."""
        return self._evaluate(at, np.ones(len(at), dtype=bool))[0]

    def derivatives(self, at: Floats, who: NDArray[np.bool_] | None = None) -> tuple[Floats, Floats, Floats]:
        """Return each person's log-likelihood (K,), its gradient (K, P) and its curvature (K, P, P).

        The curvature is that of the logit alone, without lapses and the path of theta. It is positive semidefinite, as
        Newton's method and Laplace's approximation need. Who is not in `who`, shape (K,), has zeros.
        """
        chosen, gradient, curvature = self._evaluate(at, np.ones(len(at), dtype=bool) if who is None else who)
        value = np.asarray(np.bincount(self.steps.person, chosen, len(at)), dtype=np.float64)
        return value, gradient, curvature

    def by_trust(self, at: Floats, theta: Floats, rates: Floats) -> Floats:
        """Return each person's log-likelihood for each learning rate and coordinate of theta, shape (K, E, T).

        Of the coordinates `at`, all but theta are used.
        """
        bounds = np.searchsorted(self.steps.person, np.arange(len(at) + 1))
        return _by_trust(at, bounds, self.steps, self.ranges.small, self.lapse, expit(theta), rates)

    def _evaluate(self, at: Floats, who: NDArray[np.bool_]) -> tuple[Floats, Floats, Floats]:
        bounds = np.searchsorted(self.steps.person, np.arange(len(at) + 1))
        return _evaluate(at.copy(), who, bounds, self.steps, self.ranges.small, self.lapse, self.eta)


@njit()
def _evaluate(
    at: Floats, who: NDArray[np.bool_], bounds: Ints, steps: Steps, small: float, lapse: float, eta: float
) -> tuple[Floats, Floats, Floats]:
    """Return log-probabilities of the choices (N,), gradients (K, P) and curvatures (K, P, P).

    The steps of person k are those from `bounds[k]` to `bounds[k + 1]`.
    """
    _, speaks, possible, options, chosen, gain, begins, told = steps
    count, size = at.shape
    logs = np.zeros(len(chosen))
    gradient, curvature = np.zeros((count, size)), np.zeros((count, size, size))
    own, slope, mean, p = np.empty(size), np.empty(size), np.empty(size), np.empty(speaks.shape[1])
    for k in range(count):
        if not who[k]:
            continue
        for c in range(size):  # `own[:] = at[k]` would take half as long again to compile, as in `person.hsvi`
            own[c], slope[c] = at[k, c], 1.0
        own[BETA] = small * np.expm1(at[k, BETA])
        slope[BETA] = own[BETA] + small
        first = 1.0 / (1.0 + np.exp(-at[k, THETA]))
        theta, depends = first, True
        for i in range(bounds[k], bounds[k + 1]):
            if told:
                if begins[i]:
                    theta, depends = first, True
                own[THETA] = np.log(max(theta, SURE) / max(1.0 - theta, SURE))
                kept = min(max(theta, CERTAIN), 1.0 - CERTAIN)
                slope[THETA] = first * (1.0 - first) / (kept * (1.0 - kept)) if depends else 0.0
                if eta != 0.0 and gain[i] != 0.0:
                    theta += eta * gain[i]
                    if not 0.0 < theta < 1.0:
                        theta, depends = min(max(theta, 0.0), 1.0), False
            top = -np.inf
            for a in range(options[i]):
                p[a] = -np.inf
                if possible[i, a]:
                    p[a] = 0.0
                    for c in range(size):
                        p[a] += speaks[i, a, c] * own[c]
                    top = max(top, p[a])
            total = 0.0
            for a in range(options[i]):
                p[a] = np.exp(p[a] - top)
                total += p[a]
            mean[:] = 0.0
            for a in range(options[i]):
                p[a] /= total
                if p[a] > 0.0:
                    for c in range(size):
                        mean[c] += p[a] * speaks[i, a, c]
            picked = (1.0 - lapse) * p[chosen[i]]
            whole = picked + lapse / options[i]
            logs[i] = np.log(whole)
            share = picked / whole
            for c in range(size):
                gradient[k, c] += share * slope[c] * (speaks[i, chosen[i], c] - mean[c])
            for a in range(options[i]):
                if p[a] > 0.0:
                    for c in range(size):
                        weight = share * p[a] * slope[c] * (speaks[i, a, c] - mean[c])
                        for d in range(c + 1):
                            curvature[k, c, d] += weight * slope[d] * (speaks[i, a, d] - mean[d])
        for c in range(size):
            for d in range(c):
                curvature[k, d, c] = curvature[k, c, d]
    return logs, gradient, curvature


@njit()
def _by_trust(
    at: Floats, bounds: Ints, steps: Steps, small: float, lapse: float, first: Floats, rates: Floats
) -> Floats:
    """Return log-likelihoods for E rates and T values of theta at the beginning of an episode, shape (K, E, T)."""
    _, speaks, possible, options, chosen, gain, begins, _ = steps
    total = np.zeros((len(at), len(rates), len(first)))
    theta, product = np.empty((len(rates), len(first))), np.empty((len(rates), len(first)))
    p = np.empty(speaks.shape[1])
    most = max(1, int(200.0 / -np.log10(lapse / max(1, options.max()))))  # so many factors do not underflow
    for k in range(len(at)):
        beta, silent, since = small * np.expm1(at[k, BETA]), 0.0, 0
        product[:] = 1.0
        for i in range(bounds[k], bounds[k + 1]):
            if begins[i]:
                for e in range(len(rates)):
                    for t in range(len(first)):
                        theta[e, t] = first[t]
            top, heard = -np.inf, -1
            for a in range(options[i]):
                p[a] = -np.inf
                if speaks[i, a, THETA] != 0.0:
                    heard = a
                if possible[i, a]:
                    p[a] = beta * speaks[i, a, BETA]
                    for c in range(FIRST_TERM, at.shape[1]):
                        p[a] += at[k, c] * speaks[i, a, c]
                    top = max(top, p[a])
            heed = others = 0.0
            for a in range(options[i]):
                p[a] = np.exp(p[a] - top)
                if a == heard:
                    heed = p[a]
                else:
                    others += p[a]
            picked, share = (1.0 - lapse) * p[chosen[i]], lapse / options[i]
            if heard < 0:
                silent += np.log(picked / others + share)
                continue
            follows = chosen[i] == heard
            for e in range(len(rates)):
                for t in range(len(first)):
                    sure, other = max(theta[e, t], SURE), max(1.0 - theta[e, t], SURE)
                    product[e, t] *= picked * (sure if follows else other) / (sure * heed + other * others) + share
                if rates[e] != 0.0 and gain[i] != 0.0:
                    for t in range(len(first)):
                        theta[e, t] = min(max(theta[e, t] + rates[e] * gain[i], 0.0), 1.0)
            since += 1
            if since == most:
                _take_logs(total[k], product, 0.0)
                since = 0
        _take_logs(total[k], product, silent)
    return total


@njit(inner=True)
def _take_logs(total: Floats, product: Floats, more: float) -> None:
    """Add the logarithms of products and a number to totals, and begin the products anew."""
    for e in range(total.shape[0]):
        for t in range(total.shape[1]):
            total[e, t] += np.log(product[e, t]) + more
            product[e, t] = 1.0


class Prior(NamedTuple):
    """Independent normal priors of the coordinates, each array of shape (P,). A precision of 0 is a flat prior."""

    mean: Floats
    precision: Floats


def maximise(
    likelihood: Likelihood, start: Floats, fixed: NDArray[np.bool_], prior: Prior | None = None, rounds: int = 100
) -> tuple[Floats, Floats, Floats]:
    """Return the coordinates of largest likelihood of all people, by Newton's method, with values and curvatures.

    Coordinates have shape (K, P), as have `start` and `fixed`. Values, (K,), are log-likelihoods plus the prior's
    log-density up to a constant; curvatures, (K, P, P), are of the same function. Trust that reaches 0 or 1 makes
    several maxima. So the search begins again where another node of theta is better.
    """
    prior = prior or Prior(*np.zeros((2, start.shape[1])))
    at, value, curvature = _climbed(likelihood, start, fixed, prior, rounds)
    if not likelihood.steps.told or likelihood.eta == 0.0 or fixed[:, THETA].all():
        return at, value, curvature
    nodes, rate = likelihood.ranges.thetas(), np.array([likelihood.eta])
    falls = prior.precision[THETA] * (nodes - prior.mean[THETA]) ** 2 / 2
    for _ in range(3):
        off = np.delete(prior.precision * (at - prior.mean) ** 2, THETA, axis=1).sum(axis=1) / 2
        values = likelihood.by_trust(at, nodes, rate)[:, 0] - falls - off[:, None]
        jumps = (values.max(axis=1) > value + 1e-6) & ~fixed[:, THETA]
        if not jumps.any():
            break
        begin = at.copy()
        begin[jumps, THETA] = nodes[values[jumps].argmax(axis=1)]
        new = _climbed(likelihood, begin, fixed | ~jumps[:, None], prior, rounds)
        at, value = np.where(jumps[:, None], new[0], at), np.where(jumps, new[1], value)
        curvature = np.where(jumps[:, None, None], new[2], curvature)
    return at, value, curvature


def _climbed(
    likelihood: Likelihood, start: Floats, fixed: NDArray[np.bool_], prior: Prior, rounds: int
) -> tuple[Floats, Floats, Floats]:
    """Return the local maximum that Newton's method reaches from a start, as `maximise` does."""
    low, high = likelihood.ranges.low, likelihood.ranges.high
    unit = np.eye(start.shape[1])

    def value_at(at: Floats, who: NDArray[np.bool_] | None = None) -> tuple[Floats, Floats, Floats]:
        value, gradient, curvature = likelihood.derivatives(at, who)
        off = at - prior.mean
        return (
            value - (prior.precision * off**2).sum(axis=1) / 2,
            gradient - prior.precision * off,
            curvature + prior.precision * unit,
        )

    at = np.clip(start, low, high)
    value, gradient, curvature = value_at(at)
    length = np.ones(len(at))
    for _ in range(rounds):
        stuck = fixed | ((at <= low) & (gradient < 0)) | ((at >= high) & (gradient > 0))
        for _ in range(2):  # the second time without coordinates that would leave their range
            slope = np.where(stuck, 0.0, gradient)
            bend = np.where(stuck[:, :, None] | stuck[:, None], 0.0, curvature) + (1e-9 + stuck[:, :, None]) * unit
            step = np.linalg.solve(bend, slope[:, :, None])[:, :, 0]
            stuck = stuck | ((at <= low) & (step < 0)) | ((at >= high) & (step > 0))
        # No coordinate moves by more than 2 in a step, since the quadratic model is local.
        step *= np.minimum(1.0, 2.0 / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
        tried = np.clip(at + length[:, None] * step, low, high)
        promised = (slope * step).sum(axis=1)
        going = promised * length > 1e-7  # smaller gains of log-likelihood are not worth a step
        if not going.any():
            break
        new = value_at(tried, going)
        better = going & (new[0] >= value)
        at = np.where(better[:, None], tried, at)
        value = np.where(better, new[0], value)
        gradient = np.where(better[:, None], new[1], gradient)
        curvature = np.where(better[:, None, None], new[2], curvature)
        length = np.where(better, np.minimum(1.0, 2 * length), length / 4)
    return at, value, curvature
