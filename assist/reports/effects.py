"""What a comparison of conditions shows, between groups or within participants: differences, effect sizes, power."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize, stats

from .statistics import IntervalEstimate, mean

POWER = 0.8


def difference(a: ArrayLike, b: ArrayLike, level: float = 0.95) -> IntervalEstimate:
    """Give how much larger the mean of one group is than another's, with Welch's interval, for unequal variances.

    Parameters
    ----------
    a, b : float arrays, shapes (n,) and (m,)
        A number for each participant. Of fewer than two in a group there is no interval, nor where nobody differs.
    """
    x, y = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    value = float(x.mean() - y.mean()) if len(x) and len(y) else math.nan
    if min(len(x), len(y)) < 2 or x.var() + y.var() == 0:
        return IntervalEstimate(value, math.nan, math.nan)
    # By hand: scipy's test warns where everybody in one group is alike, which here is no fault.
    first, second = float(x.var(ddof=1)) / len(x), float(y.var(ddof=1)) / len(y)
    freedom = (first + second) ** 2 / (first**2 / (len(x) - 1) + second**2 / (len(y) - 1))
    half = float(stats.t.ppf((1 + level) / 2, freedom)) * math.sqrt(first + second)
    return IntervalEstimate(value, value - half, value + half)


def difference_within(pairs: ArrayLike, level: float = 0.95) -> IntervalEstimate:
    """Give how much larger a number is in one condition than in another for the same participants (Student's t).

    Parameters
    ----------
    pairs : float array, shape (n,)
        The difference of each participant. Of fewer than two there is no interval, nor where nobody differs.
    """
    x = np.asarray(pairs, dtype=float)
    found = mean(x, level=level)
    return found if x.var() > 0 else IntervalEstimate(found.value, math.nan, math.nan)


def hedges_g(a: ArrayLike, b: ArrayLike) -> float:
    """Give the standardised difference of two groups: Cohen's d with Hedges' correction for few participants (1981).

    Parameters
    ----------
    a, b : float arrays, shapes (n,) and (m,)
        Not a number for fewer than two in a group, and where nobody differs.
    """
    x, y = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    freedom = len(x) + len(y) - 2
    if min(len(x), len(y)) < 2:
        return math.nan
    pooled = math.sqrt(((len(x) - 1) * x.var(ddof=1) + (len(y) - 1) * y.var(ddof=1)) / freedom)
    return float(x.mean() - y.mean()) / pooled * (1 - 3 / (4 * freedom - 1)) if pooled > 0 else math.nan


def hedges_g_within(differences: ArrayLike) -> float:
    """Give the mean difference of pairs by their standard deviation (d_z), with Hedges' correction for few pairs.

    Parameters
    ----------
    differences : float array, shape (n,)
        One for each participant. Not a number for fewer than three, and where nobody differs.
    """
    x = np.asarray(differences, dtype=float)
    deviation = float(x.std(ddof=1)) if len(x) > 2 else 0.0
    return float(x.mean()) / deviation * (1 - 3 / (4 * (len(x) - 1) - 1)) if deviation > 0 else math.nan


def cronbach_alpha(scores: ArrayLike) -> float:
    """Give how well the items of a scale go together (Cronbach, 1951): 1 if they say the same.

    Parameters
    ----------
    scores : float array, shape (n, items)
        A row for each participant, reversed items turned round. Not a number for fewer than two of either, and where
        nobody differs.
    """
    x = np.asarray(scores, dtype=float)
    if x.ndim != 2 or min(x.shape) < 2 or x.sum(axis=1).var() == 0:
        return math.nan
    items = x.shape[1]
    return float(items / (items - 1) * (1 - x.var(axis=0, ddof=1).sum() / x.sum(axis=1).var(ddof=1)))


def detectable(n: int, m: int, power: float = POWER, level: float = 0.95) -> float:
    """Give the smallest standardised difference that two groups of these sizes would show so often (t-test).

    Not a number for fewer than two in a group.
    """
    return math.nan if min(n, m) < 2 else _detectable(n + m - 2, math.sqrt(n * m / (n + m)), power, level)


def detectable_within(n: int, power: float = POWER, level: float = 0.95) -> float:
    """Give the smallest standardised difference that so many pairs would show so often (t-test of their differences).

    Not a number for fewer than two.
    """
    return math.nan if n < 2 else _detectable(n - 1, math.sqrt(n), power, level)


def _detectable(freedom: int, scale: float, power: float, level: float) -> float:
    critical = float(stats.t.ppf((1 + level) / 2, freedom))

    def missed(effect: float) -> float:
        shifted = effect * scale
        return float(stats.nct.cdf(critical, freedom, shifted)) - (1 - power)

    # Far beyond what is sought scipy's distribution is not a number.
    return float(optimize.brentq(missed, 0.0, (2 * critical + 2) / scale))
