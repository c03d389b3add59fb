"""Expertise, influence and trust of a person, from what they did.

Maximum likelihood under the model of `people.decision`, with h* for the person's cost-to-go: beta, and where there were
suggestions the theta that each episode began with and the rate eta of the trust update. Intervals are those of the
profile likelihood: all values that a likelihood-ratio test at the level does not reject, the other parameters at
their best (Wilks 1938). Nothing ends at infinity: who never errs gets `largest_beta` as an estimate and as the end
of an interval, and `Estimate.open_above` says so.

A likelihood is evaluated on a coarse grid of all parameters first, which finds its modes, and refined by a pattern
search: theta is cut off at 0 and 1, so that the likelihood has kinks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtri

from planner.compiled import njit

from ..people.decision import NOTHING, Floats, choice, influence, lapse
from .likelihood import Data, Method, alone, at_point, on_grid, thetas, with_trust
from .observations import Observations

BETA, THETA, ETA = 0, 1, 2


@dataclass(frozen=True)
class Estimate:
    """A parameter's maximum-likelihood value, and its interval.

    Attributes
    ----------
    value : float
    interval : (float, float)
        All values that are not rejected lie in it. It may end where the parameter's range does.
    open_below, open_above : bool
        Whether it does: what is recorded does not bound the parameter on that side.
    """

    value: float
    interval: tuple[float, float]
    open_below: bool
    open_above: bool

    @property
    def identified(self) -> bool:
        """Whether the interval is less than the parameter's whole range."""
        return not (self.open_below and self.open_above)


@dataclass(frozen=True)
class Fit:
    """What was learned about a person.

    Attributes
    ----------
    observations : Observations
    beta : Estimate
        Per cost unit.
    theta, eta : Estimate or None
        Influence at the beginning of an episode, and rate of the trust update; None without suggestions, eta also
        where it was given.
    log_likelihood : float
        At the estimates, lapses included.
    known_eta : float or None
        The rate that was given.
    method : Method
        How it was learned.
    weights : mapping of str to Estimate
        Of the terms that speak for choices besides cost; empty where none were asked for.
    """

    observations: Observations
    beta: Estimate
    theta: Estimate | None
    eta: Estimate | None
    log_likelihood: float
    known_eta: float | None
    method: Method
    weights: Mapping[str, Estimate] = field(default_factory=dict)

    def probabilities(self) -> Floats:
        """Give the probability of each choice at the estimates, shape (N, A), lapses included."""
        o = self.observations
        bias = o.features @ np.array([weight.value for weight in self.weights.values()]) if self.weights else None
        if o.own is not None:
            p = o.own.at(self.beta.value)
        else:
            p = choice(o.excess, o.applicable, np.full(len(o), self.beta.value), bias)
        return lapse(influence(p, o.suggested, self.thetas()), o.applicable, self.method.lapse)

    def thetas(self) -> Floats:
        """Give theta before each step at the estimates, shape (N,); 0.5 throughout without suggestions."""
        if self.theta is None:
            return np.full(len(self.observations), 0.5)
        eta = self.eta.value if self.eta is not None else self.known_eta
        gain = self.observations.gain / self.method.utility_scale
        return thetas(gain, self.observations.begins, self.theta.value, 0.0 if eta is None else eta)


def largest_beta(observations: Sequence[Observations], method: Method) -> float:
    """Give the end of the range of beta: `Method.largest_beta`, or what it stands for where that is None."""
    if method.largest_beta is not None:
        return method.largest_beta
    sizes = [o.excess[(o.excess > 0) & np.isfinite(o.excess)] for o in observations]
    return 10.0 / min((float(size.min()) for size in sizes if len(size)), default=1.0)


def maximum_likelihood(
    observations: Sequence[Observations],
    method: Method | None = None,
    *,
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> list[Fit]:
    """Estimate the parameters of each person.

    Parameters
    ----------
    observations : sequence of Observations
        One for each person.
    method : Method, optional
    jobs : int
        Threads.
    progress : callable, optional
        Called with how many people have been finished since the last call.
    """
    method = method or Method()
    largest = largest_beta(observations, method)

    def one(person: Observations) -> Fit:
        result = _Search(person, method, largest).fit()
        if progress is not None:
            progress(1)
        return result

    if jobs == 1:
        return [one(person) for person in observations]
    with ThreadPoolExecutor(jobs) as pool:
        return list(pool.map(one, observations))


SMALL = 1e-3  # beta is searched on a scale that is linear below this share of its range, and logarithmic above
POINTS = (48, 31, 17)  # of the coarse grid over beta, theta, eta
RIDGES = 5


class _Search:
    """One person's likelihood, on coordinates (log1p(beta / small), theta, eta)."""

    def __init__(self, observations: Observations, method: Method, largest: float) -> None:
        self.observations, self.method = observations, method
        self.data = Data.of(observations, method)
        self.small = SMALL * largest
        told = bool((observations.suggested != NOTHING).any())
        spans = [
            np.linspace(0.0, math.log1p(largest / self.small), POINTS[BETA]),
            np.linspace(0.0, 1.0, POINTS[THETA]) if told else np.array([0.5]),
            np.linspace(0.0, 1.0, POINTS[ETA]) if told and method.eta is None else np.array([method.eta or 0.0]),
        ]
        self.axes = spans
        self.low, self.high = (np.array([axis[end] for axis in spans]) for end in (0, -1))
        self.step = np.array([axis[1] - axis[0] if len(axis) > 1 else 0.0 for axis in spans])
        self.values = on_grid(self.data, self.small * np.expm1(spans[BETA]), spans[THETA], spans[ETA])
        sizes = np.abs(self.data.gain[np.isfinite(self.data.gain) & (self.data.gain != 0)])
        self.unit = float(sizes.min()) if len(sizes) else 1.0
        self.drop = float(chdtri(1, 1 - method.level)) / 2

    def fit(self) -> Fit:
        best, at = -np.inf, np.zeros(3)
        for cell in self._starts(self.values, 6):
            found, where = self._refine(cell, -1)
            if found > best:
                best, at = found, where
        at = self._to_the_end(best, at)
        free = [axis for axis in (BETA, THETA, ETA) if self.step[axis] > 0]
        estimates = {axis: self._estimate(axis, at, best) for axis in free}
        return Fit(
            self.observations, estimates[BETA], estimates.get(THETA), estimates.get(ETA), best,
            self.method.eta, self.method,
        )  # fmt: skip

    def _starts(self, values: Floats, count: int) -> list[Floats]:
        """Give the best cells of the grid (of a slice of it) that have no better neighbour, best first."""
        padded = np.pad(values, 1, constant_values=-np.inf)
        peak = np.ones(values.shape, dtype=bool)
        for axis in range(3):
            for shift in (-1, 1):
                peak &= values >= np.roll(padded, shift, axis)[1:-1, 1:-1, 1:-1]
        cells = np.argwhere(peak)
        order = np.argsort(-values[peak], kind="stable")[:count]
        return [np.array([self.axes[k][cell[k]] for k in range(3)]) for cell in cells[order]]

    def _refine(self, start: Floats, fixed: int) -> tuple[float, Floats]:
        """Improve a point, but for one coordinate (none if -1)."""
        step = self.step.copy()
        if fixed >= 0:
            step[fixed] = 0.0
        at = start.copy()
        best = _climb(self.data, at, step, self.low, self.high, self.small, self.unit)
        return best, at

    def _to_the_end(self, best: float, at: Floats) -> Floats:
        """Take the end of a coordinate's range for a maximum that the end does not fall short of.

        Where nobody errs, the likelihood rises for ever but soon by less than numbers can tell.
        """
        for axis in range(3):
            for end in (self.high[axis], self.low[axis]):
                moved = at.copy()
                moved[axis] = end
                if self.step[axis] > 0 and at_point(self.data, moved, self.small) >= best - 1e-6:
                    at = moved
                    break
        return at

    def _profile(self, axis: int, value: float, near: Floats) -> float:
        """Give the likelihood with one coordinate fixed and the others at their best."""
        place = int(np.clip(np.searchsorted(self.axes[axis], value), 1, len(self.axes[axis]) - 1))
        starts = [near]
        for index in (place - 1, place):
            section = np.take(self.values, [index], axis=axis)
            cell = np.unravel_index(int(section.argmax()), section.shape)
            starts.append(np.array([self.axes[k][index if k == axis else cell[k]] for k in range(3)]))
        best = -np.inf
        for start in starts:
            begin = start.copy()
            begin[axis] = value
            best = max(best, self._refine(begin, axis)[0])
        return best

    def _estimate(self, axis: int, at: Floats, best: float) -> Estimate:
        rest = tuple(k for k in range(3) if k != axis)
        coarse = self.values.max(axis=rest)
        grid = self.axes[axis]
        ends = []
        is_open = []
        for side in (-1, 1):
            outside = np.flatnonzero((grid - at[axis]) * side > 0)
            outside = outside[np.argsort(grid[outside] * side)]
            inside = at[axis]  # the outermost value that is known not to be rejected
            kept = np.flatnonzero(coarse[outside] >= best - self.drop)
            if len(kept):
                inside = float(grid[outside[kept[-1]]])
                outside = outside[kept[-1] + 1 :]

            def margin(value: float) -> float:
                return self._profile(axis, value, at) - best + self.drop

            end, opened = inside, True
            for index in outside:
                value = float(grid[index])
                if margin(value) < 0:
                    end = brentq(margin, inside, value, xtol=1e-4) if margin(inside) > 0 else inside
                    opened = False
                    break
                inside = end = value
            ends.append(end)
            is_open.append(opened)
        value, low, high = (self._value(axis, float(x)) for x in (at[axis], *ends))
        return Estimate(value, (min(low, value), max(high, value)), is_open[0], is_open[1])

    def _value(self, axis: int, coordinate: float) -> float:
        return self.small * math.expm1(coordinate) if axis == BETA else coordinate


@njit(nogil=True)
def _climb(data: Data, at: Floats, step: Floats, low: Floats, high: Floats, small: float, unit: float) -> float:
    """Improve a point in place by a pattern search (Hooke and Jeeves 1961); return its log-likelihood.

    Besides single coordinates it moves along theta + k unit eta = constant: where trust just reaches 0 or 1 after k
    suggestions that change V by `unit`, the likelihood has a ridge.

    Compiled, since people are fitted in parallel, which an optimiser in Python would keep from happening: scipy's
    Nelder-Mead finds the same maxima in twice the time; Powell and L-BFGS-B end up to 0.5 below them (at the kinks) for
    six and seven of 20 people on `kitting/paper`.
    """
    n = len(data.chosen)
    own, told, rest = np.empty(n), np.empty(n), np.empty(n)
    filled = at[0]
    alone(data, small * math.expm1(filled), own, told, rest)
    best = with_trust(data, own, told, rest, at[1], at[2])
    before = at.copy()
    for _ in range(18):  # until steps are a 260,000th of the grid's
        improved = True
        rounds = 0
        while improved and rounds < 50:
            improved = False
            rounds += 1
            for direction in range(3 + 2 * RIDGES):
                axis = min(direction, 2)
                if step[axis] == 0.0 or (direction > 2 and step[1] == 0.0):
                    continue
                k = (direction - 1) // 2 * (1.0 if direction % 2 else -1.0)
                for sign in (-1.0, 1.0):
                    for c in range(3):
                        before[c] = at[c]
                    at[axis] += sign * step[axis]
                    if direction > 2:
                        at[1] -= sign * step[2] * k * unit
                    for c in range(3):
                        at[c] = min(max(at[c], low[c]), high[c])
                    if at[0] != filled:
                        filled = at[0]
                        alone(data, small * math.expm1(filled), own, told, rest)
                    value = with_trust(data, own, told, rest, at[1], at[2])
                    if value > best:
                        best = value
                        improved = True
                        break
                    for c in range(3):
                        at[c] = before[c]
        for c in range(3):
            step[c] /= 2
    return best
