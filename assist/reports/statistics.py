"""Means, savings and effects with intervals, where the unit that is repeated is a pool of people.

Episodes of one pool share its people, so that they are not independent, and an interval over episodes would be too
narrow. Every function here takes one number for each pool (or one row), which belongs to the same pool in every
array: policies have met the same people with the same luck, and what is compared is paired.

The bootstrap is ours and not `scipy.stats.bootstrap`, with which it agrees up to chance (a test compares them): where
all pools are alike, or nothing can be saved in some resample (0 / 0), scipy's interval is not a number; and the figures
of studies that have been published with ours stay what they are, to the byte.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special, stats

from planner.system.files import finite

Floats = NDArray[np.float64]

RESAMPLES = 10_000
FEW_POOLS = 10
"""Of fewer, resampling knows too little: its 95 % intervals then cover 52 % (2 pools), 71 % (3) or 82 % (5)."""


@dataclass(frozen=True)
class IntervalEstimate:
    """A number with an interval.

    Attributes
    ----------
    value : float
    low, high : float
        Ends of the interval; not a number where there are fewer than two pools.
    """

    value: float
    low: float
    high: float

    def record(self) -> dict[str, float | None]:
        """Give the fields as plain data, None for what is not a number."""
        return {
            "mean": finite(self.value),
            "low": finite(self.low),
            "high": finite(self.high),
        }


def mean(values: ArrayLike, level: float = 0.95) -> IntervalEstimate:
    """Give the mean of pools with Student's t interval.

    Parameters
    ----------
    values : float array, shape (n,)
        One number for each pool.
    """
    x = np.asarray(values, dtype=float)
    if len(x) < 2:
        return IntervalEstimate(float(x.mean()), math.nan, math.nan)
    half = float(stats.t.ppf((1 + level) / 2, len(x) - 1)) * float(x.std(ddof=1)) / math.sqrt(len(x))
    return IntervalEstimate(float(x.mean()), float(x.mean()) - half, float(x.mean()) + half)


def saving(with_it: ArrayLike, without: ArrayLike, rng: np.random.Generator, level: float = 0.95) -> IntervalEstimate:
    """Give how much less is needed with something than without it, in percent: 100 (1 - mean / mean).

    The interval is the bias-corrected and accelerated bootstrap over pools (Efron, "Better bootstrap confidence
    intervals", 1987), because a ratio of means is skewed, and so are the means of people who are caught in a trap. Of
    fewer than `FEW_POOLS` it is Student's t with the jackknife's standard error (Tukey, 1958), which is as wide as
    so little deserves.

    Parameters
    ----------
    with_it, without : float arrays, shape (n,)
        One number for each pool; the same pool at the same place.
    """
    pairs = np.stack([np.asarray(with_it, dtype=float), np.asarray(without, dtype=float)], axis=1)

    def percent(means: Floats) -> Floats:
        return 100 * (1 - means[..., 0] / means[..., 1])

    return _bootstrap(pairs, percent, rng, level)


def change(
    first: tuple[ArrayLike, ArrayLike], last: tuple[ArrayLike, ArrayLike], rng: np.random.Generator, level: float = 0.95
) -> IntervalEstimate:
    """Give how much larger the first of two savings is than the last, in percentage points; arrays as in `saving`."""
    columns = np.stack([np.asarray(values, dtype=float) for values in (*first, *last)], axis=1)

    def points(means: Floats) -> Floats:
        return 100 * (means[..., 2] / means[..., 3] - means[..., 0] / means[..., 1])

    return _bootstrap(columns, points, rng, level)


def ratio(above: ArrayLike, below: ArrayLike, rng: np.random.Generator, level: float = 0.95) -> IntervalEstimate:
    """Give the ratio of two means, with an interval as in `saving`."""
    pairs = np.stack([np.asarray(above, dtype=float), np.asarray(below, dtype=float)], axis=1)

    def quotient(means: Floats) -> Floats:
        return means[..., 0] / means[..., 1]

    return _bootstrap(pairs, quotient, rng, level)


def effect(difference: ArrayLike) -> float:
    """Give Cohen's d of paired values: their mean difference in units of its standard deviation over pools.

    Parameters
    ----------
    difference : float array, shape (n,)
        One for each pool; at least two, otherwise the result is not a number.
    """
    x = np.asarray(difference, dtype=float)
    spread = float(x.std(ddof=1)) if len(x) > 1 else 0.0
    return float(x.mean()) / spread if spread > 0 else math.nan


def _bootstrap(columns: Floats, statistic, rng: np.random.Generator, level: float) -> IntervalEstimate:  # type: ignore[no-untyped-def]
    """Give a function of the columns' means, shape (..., m) to (...), with its bootstrap interval over rows."""
    n = len(columns)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = float(statistic(columns.mean(axis=0)))
        if n < 2 or not math.isfinite(value):
            return IntervalEstimate(value, math.nan, math.nan)
        left_out = np.asarray(statistic((columns.sum(axis=0) - columns) / (n - 1)))
        if n < FEW_POOLS:
            return _jackknife(value, left_out, level)
        weights = rng.multinomial(n, np.full(n, 1 / n), size=RESAMPLES) / n
        drawn = np.asarray(statistic(weights @ columns))
    drawn, left_out = drawn[np.isfinite(drawn)], left_out[np.isfinite(left_out)]
    off = left_out.mean() - left_out
    spread = float((off**2).sum())
    if not len(drawn) or spread < 1e-24 * max(1.0, value**2):  # all pools are alike
        return IntervalEstimate(value, value, value)
    acceleration = float((off**3).sum()) / (6 * spread**1.5)
    below = (np.sum(drawn < value) + np.sum(drawn == value) / 2) / len(drawn)
    bias = float(special.ndtri(np.clip(below, 1 / len(drawn), 1 - 1 / len(drawn))))
    tails = bias + special.ndtri(np.array([(1 - level) / 2, (1 + level) / 2]))
    low, high = np.quantile(drawn, special.ndtr(bias + tails / (1 - acceleration * tails)))
    return IntervalEstimate(value, float(low), float(high))


def _jackknife(value: float, left_out: Floats, level: float) -> IntervalEstimate:
    """Give Student's t interval with the standard error of what is found when each of the n pools is left out."""
    n = len(left_out)
    error = math.sqrt((n - 1) / n * float(((left_out - left_out.mean()) ** 2).sum()))
    half = float(stats.t.ppf((1 + level) / 2, n - 1)) * error
    return (
        IntervalEstimate(value, value - half, value + half)
        if math.isfinite(half)
        else IntervalEstimate(value, math.nan, math.nan)
    )
