"""Comparisons of conditions, between groups or within participants: differences, effect sizes and power."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize, stats

from .statistics import IntervalEstimate, mean


def difference(a: ArrayLike, b: ArrayLike, level: float = 0.95) -> IntervalEstimate:
    """Return the difference of two groups' means, with Welch's interval for unequal variances.

    Parameters
    ----------
    a, b : float arrays, shapes (n,) and (m,)
        A value for each participant. There is no interval if a group has fewer than two, or if all variances are 0.
    """
    x, y = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    value = float(x.mean() - y.mean()) if len(x) and len(y) else math.nan
    if min(len(x), len(y)) < 2 or x.var() + y.var() == 0:
        return IntervalEstimate(value, math.nan, math.nan)
    # Computed here, since scipy's test warns if all values of a group are equal, which is no fault.
    first, second = float(x.var(ddof=1)) / len(x), float(y.var(ddof=1)) / len(y)
    freedom = (first + second) ** 2 / (first**2 / (len(x) - 1) + second**2 / (len(y) - 1))
    half = float(stats.t.ppf((1 + level) / 2, freedom)) * math.sqrt(first + second)
    return IntervalEstimate(value, value - half, value + half)


def difference_within(pairs: ArrayLike, level: float = 0.95) -> IntervalEstimate:
    """Return the mean difference between two conditions for the same participants, with Student's t interval.

    Parameters
    ----------
    pairs : float array, shape (n,)
        The difference of each participant. There is no interval for fewer than two, or if the variance is 0.
    """
    x = np.asarray(pairs, dtype=float)
    found = mean(x, level=level)
    return found if x.var() > 0 else IntervalEstimate(found.value, math.nan, math.nan)


def hedges_g(a: ArrayLike, b: ArrayLike) -> float:
    """Return the standardised difference of two groups: Cohen's d with Hedges' small-sample correction (1981).

    Parameters
    ----------
    a, b : float arrays, shapes (n,) and (m,)
        A value for each participant. The result is NaN if a group has fewer than two, or if the variance is 0.
    """
    x, y = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    freedom = len(x) + len(y) - 2
    if min(len(x), len(y)) < 2:
        return math.nan
    pooled = math.sqrt(((len(x) - 1) * x.var(ddof=1) + (len(y) - 1) * y.var(ddof=1)) / freedom)
    return float(x.mean() - y.mean()) / pooled * (1 - 3 / (4 * freedom - 1)) if pooled > 0 else math.nan


def hedges_g_within(differences: ArrayLike) -> float:
    """Return the standardised mean difference of pairs (d_z), with Hedges' small-sample correction.

    Parameters
    ----------
    differences : float array, shape (n,)
        The difference of each participant. The result is NaN for fewer than three, or if the variance is 0.
    """
    x = np.asarray(differences, dtype=float)
    deviation = float(x.std(ddof=1)) if len(x) > 2 else 0.0
    return float(x.mean()) / deviation * (1 - 3 / (4 * (len(x) - 1) - 1)) if deviation > 0 else math.nan


def cronbach_alpha(scores: ArrayLike) -> float:
    """Return the internal consistency of a scale (Cronbach's alpha, 1951), at most 1.

    Parameters
    ----------
    scores : float array, shape (n, items)
        A row for each participant, with reversed items recoded. The result is NaN for fewer than two rows or items, or
        if the variance of the sums is 0.
    """
    x = np.asarray(scores, dtype=float)
    if x.ndim != 2 or min(x.shape) < 2 or x.sum(axis=1).var() == 0:
        return math.nan
    items = x.shape[1]
    return float(items / (items - 1) * (1 - x.var(axis=0, ddof=1).sum() / x.sum(axis=1).var(ddof=1)))


def detectable(n: int, m: int, power: float = 0.8, level: float = 0.95) -> float:
    """Return the smallest standardised difference of two groups that a t-test detects with this power.

    The result is NaN if a group has fewer than two participants.
    """
    return math.nan if min(n, m) < 2 else _detectable(n + m - 2, math.sqrt(n * m / (n + m)), power, level)


def detectable_within(n: int, power: float = 0.8, level: float = 0.95) -> float:
    """Return the smallest standardised difference of n pairs that a paired t-test detects with this power.

    The result is NaN for fewer than two pairs.
    """
    return math.nan if n < 2 else _detectable(n - 1, math.sqrt(n), power, level)


def _detectable(freedom: int, scale: float, power: float, level: float) -> float:
    critical = float(stats.t.ppf((1 + level) / 2, freedom))

    def missed(effect: float) -> float:
        shifted = effect * scale
        return float(stats.nct.cdf(critical, freedom, shifted)) - (1 - power)

    # Above this bound, scipy's noncentral t distribution returns NaN.
    return float(optimize.brentq(missed, 0.0, (2 * critical + 2) / scale))
