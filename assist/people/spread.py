"""Means and central intervals of distributions over ascending values."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from .decision import Floats

ROUNDING = 1e-9
"""Differences up to this size count as rounding errors."""


@dataclass(frozen=True)
class Spread:
    """The mean of a distribution over ascending values, and the ends of its central interval.

    Attributes
    ----------
    mean, low, high : float
    """

    mean: float
    low: float
    high: float

    @classmethod
    def of(
        cls, values: Floats, chances: Floats, *, level: float = 0.9, limits: tuple[float, float] = (0.0, np.inf)
    ) -> Spread:
        """Return the mean and the interval of a distribution; NaN if its probabilities are.

        Each value represents a cell over which its probability is uniform, or log-uniform if the values are a
        geometric sequence. The probabilities below and above the interval are equal. If the mean of a skewed
        distribution lies outside, the interval is extended to it.

        Parameters
        ----------
        values, chances : float arrays, shape (n,)
        level : float
            The probability of the interval, from 0 to 1.
        limits : pair of float
            Smallest and largest possible value, at which cells end.
        """
        if not 0 <= level <= 1:
            raise ValueError(f"level {level:g}: expected a number from 0 to 1")
        return Cells.of(values, limits).spread(chances, level)


@dataclass(frozen=True)
class Cells:
    """The cells that ascending values represent.

    Attributes
    ----------
    values : float array, shape (n,)
    edges : tuple of float
        Ends of the cells, ascending: n + 1 numbers, on a logarithmic scale if `geometric`.
    geometric : bool
        Whether the values are a geometric sequence.
    """

    values: Floats
    edges: tuple[float, ...]
    geometric: bool

    @classmethod
    def of(cls, values: Floats, limits: tuple[float, float]) -> Cells:
        """Return the cells of values between the limits."""
        if len(values) == 1:
            return cls(values, (), geometric=False)
        geometric = len(values) > 2 and values[0] > 0 and np.ptp(np.diff(np.log(values))) < ROUNDING
        scale, back = (np.log, np.exp) if geometric else (np.positive, np.positive)
        points = scale(values)
        middles = (points[1:] + points[:-1]) / 2
        edges = np.concatenate([[2 * points[0] - middles[0]], middles, [2 * points[-1] - middles[-1]]])
        return cls(values, tuple(scale(np.clip(back(edges), *limits)).tolist()), bool(geometric))

    def spread(self, chances: Floats, level: float = 0.9) -> Spread:
        """Return the mean and the central interval of a distribution, shape (n,), as `Spread.of` does."""
        mean, each = float(self.values @ chances), chances.tolist()
        if np.isnan(mean):
            return Spread(np.nan, np.nan, np.nan)
        if not self.edges:
            return Spread(mean, mean, mean)
        below = (1 - level) / 2
        low = _quantile(self.edges, each, below)
        high = -_quantile([-edge for edge in reversed(self.edges)], each[::-1], below)
        ends = np.exp([low, high]).tolist() if self.geometric else [low, high]
        return Spread(mean, min(*ends, mean), max(*ends, mean))


def _quantile(edges: Sequence[float], chances: Sequence[float], below: float) -> float:
    """Return the largest value below which ascending cells have at most the probability `below`."""
    total = list(accumulate(chances, initial=0.0))
    cell = min(bisect_right(total, below + ROUNDING), len(chances)) - 1
    inside = min(max((below - total[cell]) / max(chances[cell], ROUNDING), 0.0), 1.0)
    return edges[cell] + inside * (edges[cell + 1] - edges[cell])
