"""Means and central intervals of distributions over ascending values."""

from __future__ import annotations

from dataclasses import dataclass

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
        if np.isnan(chances).any():
            return cls(np.nan, np.nan, np.nan)
        mean = float(values @ chances)
        if len(values) == 1:
            return cls(mean, mean, mean)
        geometric = len(values) > 2 and values[0] > 0 and np.ptp(np.diff(np.log(values))) < ROUNDING
        scale, back = (np.log, np.exp) if geometric else (np.positive, np.positive)
        points = scale(values)
        middles = (points[1:] + points[:-1]) / 2
        edges = np.concatenate([[2 * points[0] - middles[0]], middles, [2 * points[-1] - middles[-1]]])
        edges = scale(np.clip(back(edges), *limits))
        low = _quantile(edges, chances, (1 - level) / 2)
        high = -_quantile(-edges[::-1], chances[::-1], (1 - level) / 2)
        ends = (*back(np.array([low, high])).tolist(), mean)
        return cls(mean, min(ends), max(ends))


def _quantile(edges: Floats, chances: Floats, below: float) -> float:
    """Return the largest value below which ascending cells have at most the probability `below`."""
    total = np.concatenate([[0.0], chances.cumsum()])
    cell = min(int(np.searchsorted(total, below + ROUNDING, side="right")), len(chances)) - 1
    inside = np.clip((below - total[cell]) / max(chances[cell], ROUNDING), 0, 1)
    return float(edges[cell] + inside * (edges[cell + 1] - edges[cell]))
