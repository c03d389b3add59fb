"""How likely the choices of many people are where terms speak for them besides cost, with gradients; compiled.

A suggestion adds logit(theta) to the exponent of the suggested choice (eq. 6), so that a choice is a multinomial logit
all in all:

    P(a) proportional to exp(-beta excess(a) + sum_j w_j f_j(a) + logit(theta) [a is suggested]),

mixed with a lapse. People's parameters are rows of coordinates (b, l, w_1 ... w_J): beta = small expm1(b), a scale
that is linear below `small` and logarithmic above; l = logit(theta) at the beginning of an episode. Theta moves by
eq. 7 with h* for the person's cost-to-go; where it has met 0 or 1, what came before no longer matters.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from planner.system.arrays import read_only
from planner.system.jit import njit

from ..people.decision import NOTHING, Floats
from .likelihood import Method
from .maximum_likelihood import largest_beta
from .observations import Ints, Observations
from .profiles import SMALL

BETA, THETA = 0, 1
"""The coordinates that everybody has; those of terms follow."""

FIRST_TERM = 2
CERTAIN = 1e-9  # theta nearer to 0 or 1 than this is taken for this near
FAR = 12.0
"""The logarithm of the odds that the largest weight gives to what choices usually differ by."""


@dataclass(frozen=True)
class Steps:
    """The choices of K people, of one task or of several; N steps of up to A choices, J terms.

    Attributes
    ----------
    people : tuple of str
    terms : tuple of str
    person : int array, shape (N,)
        Places in `people`, ascending.
    speaks : float array, shape (N, A, 2 + J)
        What coordinates multiply: minus the excess cost (0 where that is infinite), whether it is suggested, terms.
    possible : bool array, shape (N, A)
        Which choices are made without a lapse: those that lead into no dead end needlessly.
    options : int array, shape (N,)
        How many choices there are.
    chosen : int array, shape (N,)
    gain : float array, shape (N,)
        What the suggestion changed the person's value by, in units of the trust update; 0 without one.
    begins : bool array, shape (N,)
        Where an episode begins.
    told : bool
        Whether anything was ever suggested.
    """

    people: tuple[str, ...]
    terms: tuple[str, ...]
    person: Ints
    speaks: Floats
    possible: NDArray[np.bool_]
    options: Ints
    chosen: Ints
    gain: Floats
    begins: NDArray[np.bool_]
    told: bool

    def __post_init__(self) -> None:
        read_only(self)

    def __len__(self) -> int:
        return len(self.person)

    @classmethod
    def of(cls, observations: Sequence[Observations], method: Method) -> Steps:
        """Put observations together; who occurs several times (with other tasks) is one person.

        Raises
        ------
        ValueError
            No observations, or not all with the same terms.
        """
        if not observations:
            raise ValueError("terms need people; there are no observations")
        terms = observations[0].terms
        if any(o.terms != terms for o in observations):
            raise ValueError("expected observations with the same terms")
        people = tuple(dict.fromkeys(o.person for o in observations))
        number = {person: place for place, person in enumerate(people)}
        width = max(o.excess.shape[1] for o in observations)
        blocks = []
        for o in observations:
            held, wide = o.excess.shape, ((0, 0), (0, width - o.excess.shape[1]))
            speaks = np.zeros((*held, FIRST_TERM + len(terms)))
            possible = o.applicable & np.isfinite(o.excess)
            speaks[:, :, BETA] = np.where(possible, -o.excess, 0.0)
            speaks[:, :, THETA] = (np.arange(held[1]) == o.suggested[:, None]) & (o.suggested != NOTHING)[:, None]
            speaks[:, :, FIRST_TERM:] = o.features
            blocks.append((np.pad(speaks, (*wide, (0, 0))), np.pad(possible, wide)))
        person = np.repeat([number[o.person] for o in observations], [len(o) for o in observations])
        order = np.argsort(person, kind="stable")
        return cls(
            people, terms, person[order],
            np.concatenate([block[0] for block in blocks])[order],
            np.concatenate([block[1] for block in blocks])[order],
            np.concatenate([o.applicable.sum(axis=1) for o in observations])[order],
            np.concatenate([o.chosen for o in observations])[order],
            np.concatenate([o.gain for o in observations])[order] / method.utility_scale,
            np.concatenate([o.begins for o in observations])[order],
            any((o.suggested != NOTHING).any() for o in observations),
        )  # fmt: skip

    def only(self, steps: NDArray[np.bool_]) -> Steps:
        """Give some of the steps, shape (N,); of an episode all or none. Everybody keeps their place."""
        names = ("person", "speaks", "possible", "options", "chosen", "gain", "begins")
        return replace(self, **{name: getattr(self, name)[steps] for name in names})

    def together(self) -> Steps:
        """Give the steps as if one person had taken all of them."""
        return replace(self, people=("everybody",), person=np.zeros(len(self), dtype=np.int64))


@dataclass(frozen=True)
class Ranges:
    """Where coordinates may lie.

    Attributes
    ----------
    small : float
        The scale of beta.
    low, high : float arrays, shape (2 + J,)
    """

    small: float
    low: Floats
    high: Floats

    @classmethod
    def of(cls, steps: Steps, largest: float) -> Ranges:
        """Give beta the range up to `largest`, theta that from 0 to 1, and weights what can be told apart."""
        small = SMALL * largest
        seen = steps.speaks[:, :, FIRST_TERM:]
        spread = np.max(seen, axis=1, where=steps.possible[:, :, None], initial=-np.inf) - np.min(
            seen, axis=1, where=steps.possible[:, :, None], initial=np.inf
        )
        usual = [float(np.median(column[column > 0])) if (column > 0).any() else 1.0 for column in spread.T]
        ends = np.array([logit(1 - SMALL), *(FAR / size for size in usual)])
        return cls(small, np.array([0.0, *-ends]), np.array([np.log1p(largest / small), *ends]))

    def beta(self, coordinate: Floats) -> Floats:
        """Give beta by its coordinate."""
        return np.asarray(self.small * np.expm1(coordinate), dtype=np.float64)

    def theta(self, coordinate: Floats) -> Floats:
        """Give theta by its coordinate; the ends of its range stand for 0 and 1."""
        value = expit(coordinate)
        value = np.where(coordinate <= self.low[THETA], 0.0, np.where(coordinate >= self.high[THETA], 1.0, value))
        return np.asarray(value, dtype=np.float64)


@dataclass(frozen=True)
class Likelihood:
    """The log-likelihood of each person's choices, and what it changes by.

    Attributes
    ----------
    steps : Steps
    ranges : Ranges
    lapse, eta : float
    """

    steps: Steps
    ranges: Ranges
    lapse: float
    eta: float

    @classmethod
    def of(cls, observations: Sequence[Observations], method: Method) -> Likelihood:
        """Take what a method takes for granted; a rate of the trust update that it does not know is 0."""
        steps = Steps.of(observations, method)
        ranges = Ranges.of(steps, largest_beta(observations, method))
        return cls(steps, ranges, method.lapse, method.eta or 0.0)

    def with_terms(self, terms: Iterable[str]) -> Likelihood:
        """Give the likelihood where only some of the terms speak for choices."""
        wanted = set(terms)
        places = [FIRST_TERM + j for j, term in enumerate(self.steps.terms) if term in wanted]
        kept = [BETA, THETA, *places]
        names = tuple(self.steps.terms[place - FIRST_TERM] for place in places)
        steps = replace(self.steps, terms=names, speaks=np.ascontiguousarray(self.steps.speaks[:, :, kept]))
        return replace(
            self, steps=steps, ranges=Ranges(self.ranges.small, self.ranges.low[kept], self.ranges.high[kept])
        )

    def log_probability(self, at: Floats) -> Floats:
        """Give the log-probability of each step's choice, shape (N,), with coordinates of shape (K, 2 + J)."""
        return self._evaluate(at, np.ones(len(at), dtype=bool))[0]

    def derivatives(self, at: Floats, who: NDArray[np.bool_] | None = None) -> tuple[Floats, Floats, Floats]:
        """Give for each person the log-likelihood (K,), its gradient (K, P) and its curvature (K, P, P).

        The curvature is that of the logit alone, without what lapses and trust's path add: never negative, so that it
        serves Newton's method (and, at a maximum, Laplace's approximation).

        Parameters
        ----------
        at : float array, shape (K, P)
        who : bool array, shape (K,), optional
            Of whom to give it; the others have zeros.
        """
        chosen, gradient, curvature = self._evaluate(at, np.ones(len(at), dtype=bool) if who is None else who)
        value = np.asarray(np.bincount(self.steps.person, chosen, len(at)), dtype=np.float64)
        return value, gradient, curvature

    def _evaluate(self, at: Floats, who: NDArray[np.bool_]) -> tuple[Floats, Floats, Floats]:
        s = self.steps
        bounds = np.searchsorted(s.person, np.arange(len(at) + 1))
        return _evaluate(
            np.ascontiguousarray(at), who, bounds, s.speaks, s.possible, s.options, s.chosen, s.gain, s.begins,
            self.ranges.small, self.lapse, self.eta, s.told,
        )  # fmt: skip


@njit()
def _evaluate(
    at: Floats, who: NDArray[np.bool_], bounds: Ints, speaks: Floats, possible: NDArray[np.bool_], options: Ints,
    chosen: Ints, gain: Floats, begins: NDArray[np.bool_], small: float, lapse: float, eta: float, told: bool,
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Give log-probabilities of the choices (N,), gradients (K, P) and curvatures (K, P, P)."""
    count, size = at.shape
    logs = np.zeros(len(chosen))
    gradient, curvature = np.zeros((count, size)), np.zeros((count, size, size))
    own, slope, mean, p = np.empty(size), np.empty(size), np.empty(size), np.empty(speaks.shape[1])
    for k in range(count):
        if not who[k]:
            continue
        own[:], slope[:] = at[k], 1.0
        own[BETA] = small * np.expm1(at[k, BETA])
        slope[BETA] = own[BETA] + small
        first = 1.0 / (1.0 + np.exp(-at[k, THETA]))
        theta, depends = first, True
        for i in range(bounds[k], bounds[k + 1]):
            if told:
                if begins[i]:
                    theta, depends = first, True
                kept = min(max(theta, CERTAIN), 1.0 - CERTAIN)
                own[THETA] = np.log(kept / (1.0 - kept))
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


@dataclass(frozen=True)
class Prior:
    """What is known of everybody's coordinates beforehand: independent and normal.

    Attributes
    ----------
    mean, precision : float arrays, shape (P,)
        A precision of 0 says nothing.
    """

    mean: Floats
    precision: Floats

    @classmethod
    def none(cls, size: int) -> Prior:
        """Say nothing."""
        return cls(np.zeros(size), np.zeros(size))


ROUNDS = 100
LONGEST = 2.0  # step of a coordinate
ENOUGH = 1e-7  # what a step has to promise the log-likelihood


def maximise(
    likelihood: Likelihood, start: Floats, fixed: NDArray[np.bool_], prior: Prior | None = None, rounds: int = ROUNDS
) -> tuple[Floats, Floats, Floats]:
    """Find everybody's best coordinates by Newton's method, all people at once.

    Parameters
    ----------
    likelihood : Likelihood
    start : float array, shape (K, P)
    fixed : bool array, shape (K, P)
        Which coordinates stay as they are.
    prior : Prior, optional
    rounds : int
        The most steps.

    Returns
    -------
    at : float array, shape (K, P)
    value : float array, shape (K,)
        The log-likelihood there, the prior's density included up to a constant.
    curvature : float array, shape (K, P, P)
        Of the same.
    """
    low, high = likelihood.ranges.low, likelihood.ranges.high
    prior = prior or Prior.none(start.shape[1])
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
        for _ in range(2):  # the second time without those that would leave their range
            slope = np.where(stuck, 0.0, gradient)
            bend = np.where(stuck[:, :, None] | stuck[:, None], 0.0, curvature) + (1e-9 + stuck[:, :, None]) * unit
            step = np.linalg.solve(bend, slope[:, :, None])[:, :, 0]
            stuck = stuck | ((at <= low) & (step < 0)) | ((at >= high) & (step > 0))
        step *= np.minimum(1.0, LONGEST / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
        tried = np.clip(at + length[:, None] * step, low, high)
        promised = (slope * step).sum(axis=1)
        going = promised * length > ENOUGH
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
