"""Maximum-likelihood estimates of a person's expertise, influence and trust.

The model is that of `people.decision`, with h* as the person's cost-to-go. The parameters are beta and, if there were
suggestions, the initial theta of each episode and the learning rate eta. Intervals are those of the profile likelihood:
all values that a likelihood-ratio test does not reject, with the other parameters at their maximum (Wilks 1938).
Estimates are finite: for a person who never errs, `largest_beta` is the estimate and the end of the interval, and
`Estimate.open_above` is true.

Theta is clipped to [0, 1], so that the likelihood has kinks with narrow ridges between them. The kinks can be computed.
Let S be the sum of the changes of V that an episode's suggestions promise up to some step. Theta after that step is
theta + eta S if it was never clipped. If it was last clipped to 0 or 1 after a step with the sum S', it is
eta (S - S') or 1 + eta (S - S'). So it can be clipped only on the lines theta = -eta S, theta = 1 - eta S and
eta = 1 / |S - S'|, and the likelihood is smooth between them. The grid has points between any two of these lines. A
pattern search (Hooke and Jeeves 1961) starts from the best points, for many values of beta.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from planner.system.jit import njit

from ..people.decision import NOTHING, Floats
from .evidence import Evidence, observations_of
from .intervals import end_of, largest_fall
from .likelihood import SMALL, Data, Method, alone, by_equation_seven, largest_beta, with_trust, without_trust
from .observations import Observations
from .person_estimate import PARAMETERS, Estimate, PersonEstimate

COMPILED_FOR = "estimates of people: some seconds"

BETA, THETA, ETA = 0, 1, 2

POINTS = (48, 21, 17)  # numbers of grid points of beta, theta and eta, without those between lines
FIRST = np.array([0.003, 0.012])  # additional points near the ends, where the likelihood changes fast
TOGETHER = 2_000_000  # values of theta that are held at once


def at_hand() -> bool:
    """Return whether the search need not be compiled first."""
    return bool(_climb.at_hand)


def maximum_likelihood(
    observations: Evidence | Sequence[Observations],
    method: Method | None = None,
    *,
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> list[PersonEstimate]:
    """Return the estimates of each person.

    Parameters
    ----------
    observations : Evidence, or sequence of Observations
        A log that was replayed; or one for each person.
    method : Method, optional
    jobs : int
        Number of threads.
    progress : callable, optional
        Called with the number of people who have been finished since the last call.
    """
    method, observations = method or Method(), observations_of(observations)
    largest = largest_beta(observations, method)

    def one(person: Observations) -> PersonEstimate:
        result = _fit(person, method, largest)
        if progress is not None:
            progress(1)
        return result

    if jobs == 1:
        return [one(person) for person in observations]
    with ThreadPoolExecutor(jobs) as pool:
        return list(pool.map(one, observations))


def _fit(observations: Observations, method: Method, largest: float) -> PersonEstimate:
    """Return one person's estimates."""
    profiles = Profiles(observations, method, largest)
    best, at = _to_the_end(profiles, *profiles.maximum())
    drop = largest_fall(method.level)
    free = [axis for axis in (BETA, THETA, ETA) if profiles.free(axis)]
    found = {PARAMETERS[axis]: _estimate(profiles, axis, at, best, drop) for axis in free}
    return PersonEstimate(observations, found, best, method.eta, method)


def _to_the_end(profiles: Profiles, best: float, at: Floats) -> tuple[float, Floats]:
    """Return the maximum, moved to the end of a coordinate's range if the likelihood there is as large or larger.

    For a person without errors, the likelihood increases in beta without end, but soon by less than rounding errors.
    """
    for axis in (BETA, THETA, ETA):
        for end in (float(profiles.axes[axis][-1]), float(profiles.axes[axis][0])) if profiles.free(axis) else ():
            moved = at.copy()
            moved[axis] = end
            value, moved = profiles.largest(BETA, end, at) if axis == BETA else (profiles.at(moved), moved)
            if value >= best - 1e-6:  # values of the log-likelihood that differ by less count as equal
                best, at = max(best, value), moved
                break
    return best, at


def _estimate(profiles: Profiles, axis: int, at: Floats, best: float, drop: float) -> Estimate:
    """Return a coordinate's estimate with the interval of all values that are not rejected."""
    grid, middle = profiles.axes[axis], float(at[axis])
    coarse = profiles.coarse(axis)
    ends = []
    is_open = []

    def margin(value: float) -> float:
        return profiles.largest(axis, value, at)[0] - best + drop

    for side in (-1, 1):
        order = slice(None, None, side)
        beyond = (grid[order] - middle) * side > 0
        outwards, values = grid[order][beyond].tolist(), coarse[order][beyond]
        kept = 0  # number of these that are not rejected
        for count in range(len(outwards), 0, -1):
            short = best - drop - values[count - 1]
            # The profile likelihood is assumed to exceed the grid's values by at most 0.5.
            if short <= 0 or (short <= 0.5 and margin(outwards[count - 1]) >= 0):
                kept = count
                break
        end, open_ = end_of(margin, outwards[kept - 1] if kept else middle, outwards[kept:], 1e-4)
        ends.append(end)
        is_open.append(open_)
    value, low, high = (float(profiles.beta(np.array(x))) if axis == BETA else x for x in (middle, *ends))
    return Estimate(value, (min(low, value), max(high, value)), is_open[0], is_open[1])


class Profiles:
    """Maximisation of one person's log-likelihood in the coordinates (log1p(beta / small), theta, eta).

    `axes` has the grid points of each; a known coordinate has one.
    """

    def __init__(self, observations: Observations, method: Method, largest: float) -> None:
        self.data = Data.of(observations, method)
        self.small = SMALL * largest
        self.sums, self.gaps = _sums(self.data)
        told = bool((observations.suggested != NOTHING).any())
        eta = np.array([method.eta or 0.0])
        if told and method.eta is None:
            turns = np.unique([*np.linspace(0.0, 1.0, POINTS[ETA]), *1 / self.gaps[self.gaps > 1]])
            eta = np.sort([*turns, *(turns[1:] + turns[:-1]) / 2, *FIRST])
        theta = np.sort([*np.linspace(0.0, 1.0, POINTS[THETA]), *FIRST, *1 - FIRST]) if told else np.array([0.5])
        self.axes = (np.linspace(0.0, math.log1p(1 / SMALL), POINTS[BETA]), theta, eta)
        self.step = np.array([1 / (n - 1) for n in POINTS]) * [axis[-1] - axis[0] for axis in self.axes]
        self.low, self.high = (np.array([axis[end] for axis in self.axes]) for end in (0, -1))
        self.of_rates = [self._places(THETA, rate) for rate in eta.tolist()]
        self.over_theta = self._lines(self.axes[BETA], THETA, eta)

    def free(self, axis: int) -> bool:
        """Return whether a coordinate is to be estimated."""
        return len(self.axes[axis]) > 1

    def beta(self, coordinate: Floats) -> Floats:
        """Return beta for values of its coordinate, which is log1p(beta / small)."""
        return np.asarray(self.small * np.expm1(coordinate))

    def at(self, point: Floats) -> float:
        """Return the log-likelihood at a point, given by its three coordinates."""
        return self._climbed([point.copy()], self.step, 0)[0]

    def coarse(self, axis: int) -> Floats:
        """Return, for each grid point of one coordinate, the largest log-likelihood on the grid of the others."""
        if axis == THETA:
            return self._lines(self.axes[BETA][1::2], ETA, self.axes[THETA])[0].max(axis=0)
        return self.over_theta[0].max(axis=1 if axis == BETA else 0)

    def maximum(self) -> tuple[float, Floats]:
        """Return the largest log-likelihood, and its coordinates."""
        values, theta = self.over_theta
        cells = _peaks(values, 6)
        cells += [(b, int(values[b].argmax())) for b in range(0, len(values), 3)]
        starts = [np.array([self.axes[BETA][b], theta[b, e], self.axes[ETA][e]]) for b, e in cells]
        return self._climbed(starts, self.step, 18)

    def largest(self, axis: int, value: float, near: Floats) -> tuple[float, Floats]:
        """Return the largest log-likelihood with one coordinate fixed, and all three; `near` is one more start."""
        fixed = np.array([value])
        if axis == BETA:
            values, places = (found[0] for found in self._lines(fixed, THETA, self.axes[ETA]))
            best = [e for (e,) in _peaks(values, 4)]
            starts = [np.array([value, places[e], self.axes[ETA][e]]) for e in best]
        else:
            line = ETA if axis == THETA else THETA
            betas = self.axes[BETA][1::2]
            values, places = (found[:, 0] for found in self._lines(betas, line, fixed))
            # Searches also start at every sixth line, unless its log-likelihood is too far below the largest.
            spread = [b for b in range(0, len(values), 6) if values[b] > values.max() - 3.0]
            best = [b for (b,) in _peaks(values, 2)] + spread
            starts = [np.insert([betas[b], places[b]], axis, value) for b in best]
        starts.append(near.copy())
        starts[-1][axis] = value
        step = self.step.copy()
        step[axis] = 0.0
        return self._climbed(starts, step, 12)

    def _climbed(self, starts: list[Floats], step: Floats, halvings: int) -> tuple[float, Floats]:
        """Return the largest value that a search from one of several points reaches, and its coordinates."""
        best, at = -np.inf, starts[0]
        ridges = self.sums[:5]  # along the lines of the smallest sums, a search also moves
        for start in starts:
            value = _climb(self.data, start, step.copy(), halvings, self.low, self.high, self.small, ridges)
            if value > best:
                best, at = value, start
        return best, at

    def _lines(self, coordinates: Floats, axis: int, others: Floats) -> tuple[Floats, Floats]:
        """Return the largest values at points along theta or eta, and their places, shape (coordinates, others).

        There is a point between any two kinks. `others` are the values of the other parameter.
        """
        chances, silent = without_trust(self.data, self.beta(coordinates))
        along = self.of_rates if others is self.axes[ETA] else [self._places(axis, other) for other in others.tolist()]
        shape = len(coordinates), len(others)
        found, where = np.empty(shape), np.empty(shape)
        most = max(1, TOGETHER // max(1, len(self.data.heard)) // max(map(len, along)))
        for begin in range(0, len(others), most):
            some = along[begin : begin + most]
            sizes = np.array([len(places) for places in some])
            places, other = np.concatenate(some), np.repeat(others[begin : begin + most], sizes)
            path = by_equation_seven(self.data, *((places, other) if axis == THETA else (other, places)))
            values, starts = with_trust(self.data, chances, silent, path), sizes.cumsum() - sizes
            best = np.maximum.reduceat(values, starts, axis=1)
            first = np.where(values == best.repeat(sizes, axis=1), np.arange(len(places)), len(places))
            found[:, begin : begin + most] = best
            where[:, begin : begin + most] = places[np.minimum.reduceat(first, starts, axis=1)]
        return found, where

    def _places(self, axis: int, other: float) -> Floats:
        """Return points along theta or eta: a regular grid, the kinks, and the midpoints between any two of these."""
        low, high, ends = self.low[axis], self.high[axis], np.array([[0.0], [1.0]])
        if not self.free(axis):
            return np.array([low])
        kinks = ends - other * self.sums if axis == THETA else (ends - other) / self.sums
        points = np.sort(
            [*np.linspace(low, high, POINTS[axis]), *kinks.ravel(), *(1 / self.gaps if axis == ETA else ())]
        )
        points = points[(points >= low) & (points <= high)]
        points = points[np.diff(points, prepend=-1.0) > 1e-9]
        return np.sort(np.append(points, (points[1:] + points[:-1]) / 2))


def _sums(data: Data) -> tuple[Floats, Floats]:
    """Return the sums of promised changes of V up to each step of an episode, and the differences between two sums."""
    sums, gaps = [np.zeros(0)], [np.zeros(0)]
    for gain in np.split(data.gain[data.heard], np.flatnonzero(data.anew)):
        finite = gain[: np.flatnonzero(np.append(~np.isfinite(gain), True))[0]]  # after an infinite change, theta is 0
        own = _smallest(finite.cumsum())
        sums.append(own)
        own = np.append(own, 0.0)
        gaps.append(np.abs(own[:, None] - own).ravel())
    return _smallest(np.concatenate(sums)), _smallest(np.concatenate(gaps))


def _smallest(values: Floats) -> Floats:
    """Return the 24 smallest sums by absolute value; the lines of larger ones are close together."""
    found = np.unique(values.round(9))
    found = found[found != 0]
    return found[np.argsort(np.abs(found), kind="stable")[:24]]


def _peaks(values: Floats, count: int) -> list[tuple[int, ...]]:
    """Return the cells with the largest values among those without a better neighbour, best first."""
    padded = np.pad(values, 1, constant_values=-np.inf)
    inner = (slice(1, -1),) * values.ndim
    peak = np.ones(values.shape, dtype=bool)
    for axis in range(values.ndim):
        for shift in (-1, 1):
            peak &= values >= np.roll(padded, shift, axis)[inner]
    cells = np.argwhere(peak)
    order = np.argsort(-values[peak], kind="stable")[:count]
    return [tuple(cell) for cell in cells[order].tolist()]


@njit(nogil=True)
def _climb(
    data: Data, at: Floats, step: Floats, halvings: int, low: Floats, high: Floats, small: float, sums: Floats
) -> float:
    """Improve a point in place by a pattern search; return its log-likelihood.

    It moves along single coordinates, and along the lines theta = -eta S and theta = 1 - eta S.

    It is compiled so that people can be fitted in parallel threads. Of scipy's optimisers, Nelder-Mead finds the same
    maxima in twice the time; Powell and L-BFGS-B end up to 0.5 below them (at kinks) for six and seven of 20 people on
    `kitting/paper`.
    """
    chances, silent = np.empty((1, 3, len(data.heard))), np.empty((1, len(data.first)))
    filled = at[0]
    alone(data, small * math.expm1(filled), chances[0], silent[0])
    best = with_trust(data, chances, silent, by_equation_seven(data, at[1:2], at[2:3]))[0, 0]
    before = np.empty(3)
    for _ in range(halvings):
        improved = True
        rounds = 0
        while improved and rounds < 50:
            improved = False
            rounds += 1
            for direction in range(3 + len(sums)):
                axis = min(direction, 2)
                if step[axis] == 0.0 or (direction > 2 and step[1] == 0.0):
                    continue
                for sign in (-1.0, 1.0):
                    for c in range(3):
                        before[c] = at[c]
                    at[axis] += sign * step[axis]
                    if direction > 2:
                        at[1] -= sign * step[2] * sums[direction - 3]
                    for c in range(3):
                        at[c] = min(max(at[c], low[c]), high[c])
                    if at[0] != filled:
                        filled = at[0]
                        alone(data, small * math.expm1(filled), chances[0], silent[0])
                    value = with_trust(data, chances, silent, by_equation_seven(data, at[1:2], at[2:3]))[0, 0]
                    if value > best:
                        best = value
                        improved = True
                        break
                    for c in range(3):
                        at[c] = before[c]
        for c in range(3):
            step[c] /= 2
    return best
