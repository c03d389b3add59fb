"""The profile likelihood of one person: the maximum with none or one of beta, theta and eta fixed.

Theta is clipped to [0, 1], so that the likelihood has kinks with narrow ridges between them. The kinks can be computed.
Let S be the sum of the changes of V that an episode's suggestions promise up to some step. Theta after that step is
theta + eta S if it was never clipped. If it was last clipped to 0 or 1 after a step with the sum S', it is
eta (S - S') or 1 + eta (S - S'). So it can be clipped only on the lines theta = -eta S, theta = 1 - eta S and
eta = 1 / |S - S'|, and the likelihood is smooth between them. The grid has points between any two of these lines. A
pattern search (Hooke and Jeeves 1961) starts from the best points, for many values of beta.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from planner.system.jit import njit

from ..people.decision import NOTHING, Floats
from .likelihood import SMALL, Data, Method, alone, by_equation_seven, with_trust
from .observations import Observations

COMPILED_FOR = "estimates of people: about twelve seconds"

BETA, THETA, ETA = 0, 1, 2

POINTS = (48, 21, 17)  # numbers of grid points of beta, theta and eta, without those between lines
FIRST = np.array([0.003, 0.012])  # additional points near the ends, where the likelihood changes fast


def at_hand() -> bool:
    """Return whether the search need not be compiled first."""
    return bool(_climb.at_hand)


class Profiles:
    """Maximisation of one person's log-likelihood in the coordinates (log1p(beta / small), theta, eta).

    Attributes
    ----------
    axes : tuple of float array
        Grid points of each coordinate; a known coordinate has one.
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
        """Return the largest log-likelihood with one fixed coordinate, and its coordinates.

        Parameters
        ----------
        axis : int
        value : float
        near : float array, shape (3,)
            A further starting point.
        """
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
        """Return the largest grid values along theta or eta, and their places, both of shape (coordinates, others)."""
        ends, count = (self.low[axis], self.high[axis]), POINTS[axis] if self.free(axis) else 1
        return _on_lines(self.data, self.beta(coordinates), others, Line(axis, *ends, count, self.sums, self.gaps))


class Line(NamedTuple):
    """A line along theta or eta (`axis`) from `low` to `high`, with `points` points besides its kinks."""

    axis: int
    low: float
    high: float
    points: int
    sums: Floats
    gaps: Floats


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
def _on_lines(data: Data, betas: Floats, others: Floats, line: Line) -> tuple[Floats, Floats]:
    """Return the largest values at points along theta or eta, and their places, both of shape (betas, others).

    There is a point between any two kinks. `others` are the values of the other parameter.
    """
    n = len(data.heard)
    result, where = np.empty((len(betas), len(others))), np.empty((len(betas), len(others)))
    silent, chances = np.empty((len(betas), len(data.first))), np.empty((len(betas), 3, n))
    for b in range(len(betas)):
        alone(data, betas[b], chances[b, 0], chances[b, 1], chances[b, 2], silent[b])
    for e in range(len(others)):
        places = _places(line, others[e])
        other = np.empty(len(places))
        for i in range(len(places)):
            other[i] = others[e]
        path = by_equation_seven(data, places, other) if line.axis == THETA else by_equation_seven(data, other, places)
        for b in range(len(betas)):
            values = with_trust(data, chances[b, 0], chances[b, 1], chances[b, 2], silent[b], path)
            best = 0
            for i in range(1, len(values)):
                if values[i] > values[best]:
                    best = i
            result[b, e], where[b, e] = values[best], places[best]
    return result, where


@njit(nogil=True)
def _places(line: Line, other: float) -> Floats:
    """Return points along theta or eta: a regular grid, the kinks, and the midpoints between any two of these."""
    axis, low, high, count, sums, gaps = line
    if count == 1:
        only = np.empty(1)
        only[0] = low
        return only
    points = np.empty(count + 2 * len(sums) + len(gaps))
    n = 0
    for i in range(count):
        points[n] = low + (high - low) * i / (count - 1)
        n += 1
    for s in sums:
        for end in (0.0, 1.0):
            points[n] = end - other * s if axis == THETA else (end - other) / s
            n += 1
    for gap in gaps:
        points[n] = 1.0 / gap if axis == ETA else low
        n += 1
    for i in range(1, n):  # sorted by insertion: np.sort would take a second to compile
        point, k = points[i], i
        while k > 0 and points[k - 1] > point:
            points[k] = points[k - 1]
            k -= 1
        points[k] = point
    result = np.empty(2 * n)
    kept = 0
    for point in points:
        if low <= point <= high and (kept == 0 or point - result[kept - 1] > 1e-9):
            if kept:
                result[kept] = (result[kept - 1] + point) / 2
                kept += 1
            result[kept] = point
            kept += 1
    return result[:kept]


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
    n = len(data.heard)
    own, told, rest = np.empty(n), np.empty(n), np.empty(n)
    silent = np.empty(len(data.first))
    filled = at[0]
    alone(data, small * math.expm1(filled), own, told, rest, silent)
    best = with_trust(data, own, told, rest, silent, by_equation_seven(data, at[1:2], at[2:3]))[0]
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
                        alone(data, small * math.expm1(filled), own, told, rest, silent)
                    value = with_trust(data, own, told, rest, silent, by_equation_seven(data, at[1:2], at[2:3]))[0]
                    if value > best:
                        best = value
                        improved = True
                        break
                    for c in range(3):
                        at[c] = before[c]
        for c in range(3):
            step[c] /= 2
    return best
