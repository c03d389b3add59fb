"""Comparisons of conditions, between groups or within participants: differences, p-values, effect sizes and power."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, stats

from .statistics import IntervalEstimate

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Comparison:
    """A condition compared with another one.

    Attributes
    ----------
    difference : IntervalEstimate
        Its ends are NaN if the data do not determine them.
    p : float
        Two-sided p-value of Student's t-test of the same difference; NaN without an interval.
    hedges_g : float
        The difference in standard deviations (Cohen's d) with Hedges' small-sample correction (1981), or NaN.
    """

    difference: IntervalEstimate
    p: float = math.nan
    hedges_g: float = math.nan

    @classmethod
    def of(cls, value: float, error: float, freedom: float, hedges_g: float, level: float) -> Comparison:
        """Return the comparison with this standard error, whose distribution is Student's t."""
        if not (error > 0 and freedom > 0):
            return cls(IntervalEstimate(value, math.nan, math.nan))
        half = float(stats.t.ppf((1 + level) / 2, freedom)) * error
        p = float(2 * stats.t.sf(abs(value) / error, freedom))
        return cls(IntervalEstimate(value, value - half, value + half), p, hedges_g)


def between_groups(a: ArrayLike, b: ArrayLike, level: float = 0.95) -> Comparison:
    """Compare the means of two groups with Welch's t-test for unequal variances.

    Parameters
    ----------
    a, b : float arrays, shapes (n,) and (m,)
        A value for each participant. There is no interval if a group has fewer than two, or if all variances are 0.
    """
    x, y = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    value = float(x.mean() - y.mean()) if len(x) and len(y) else math.nan
    if min(len(x), len(y)) < 2 or x.var() + y.var() == 0:
        return Comparison(IntervalEstimate(value, math.nan, math.nan))
    # Computed here, since scipy's test warns if all values of a group are equal, which is no fault.
    first, second = float(x.var(ddof=1)) / len(x), float(y.var(ddof=1)) / len(y)
    freedom = (first + second) ** 2 / (first**2 / (len(x) - 1) + second**2 / (len(y) - 1))
    together = len(x) + len(y) - 2
    pooled = math.sqrt(((len(x) - 1) * x.var(ddof=1) + (len(y) - 1) * y.var(ddof=1)) / together)
    return Comparison.of(value, math.sqrt(first + second), freedom, value / pooled * _small(together), level)


def within_participants(differences: ArrayLike, periods: ArrayLike, level: float = 0.95) -> Comparison:
    """Compare two conditions of the same participants, adjusted for the periods in which they had them.

    Least squares explain each participant's difference by the conditions and the periods. So learning from one period
    to the next is no part of the difference, also if orders are not balanced, and does not widen its interval. Other
    conditions do not matter, so that variances of conditions may differ.

    Parameters
    ----------
    differences : float array, shape (n,)
        For each participant, the value in the condition minus that in the other one.
    periods : int array, shape (n, 2)
        The period of the condition and of the other one. If all participants had the same order, the effects of
        condition and period are the same, and there is no interval.
    """
    y = np.asarray(differences, dtype=float)
    design, inverse, determined = _of_periods(periods)
    found = inverse @ design.T @ y
    freedom, left = len(y) - int(np.linalg.matrix_rank(design)), float(((y - design @ found) ** 2).sum())
    if not determined or freedom < 1 or left <= 1e-20 * float((y**2).sum()):
        return Comparison(IntervalEstimate(float(found[0] if determined else y.mean()), math.nan, math.nan))
    deviation = math.sqrt(left / freedom)
    effect = float(found[0]) / deviation * _small(freedom) if freedom > 1 else math.nan
    return Comparison.of(float(found[0]), deviation * math.sqrt(inverse[0, 0]), freedom, effect, level)


def _of_periods(periods: ArrayLike) -> tuple[Floats, Floats, bool]:
    """Return the design matrix of a comparison, its inverse information, and whether the difference is determined."""
    when = np.asarray(periods, dtype=np.int64).reshape(-1, 2)
    later = np.unique(when)[1:]
    design = np.column_stack([np.ones(len(when)), *[(when == period) @ [1.0, -1.0] for period in later]])
    inverse = np.linalg.pinv(design.T @ design)
    return design, inverse, math.isclose(float(inverse[0] @ (design.T @ design)[:, 0]), 1.0, abs_tol=1e-9)


def _small(freedom: int) -> float:
    """Return Hedges' factor for small samples."""
    return 1 - 3 / (4 * freedom - 1)


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


def detectable_within(periods: ArrayLike, power: float = 0.8, level: float = 0.95) -> float:
    """Return the smallest standardised difference that `within_participants` detects with this power.

    Parameters
    ----------
    periods : int array, shape (n, 2)
        As in `within_participants`. The effects of periods take degrees of freedom from the test. The result is NaN
        where there is no test.
    power, level : float
    """
    design, inverse, determined = _of_periods(periods)
    freedom = len(design) - int(np.linalg.matrix_rank(design))
    return _detectable(freedom, 1 / math.sqrt(inverse[0, 0]), power, level) if determined and freedom > 0 else math.nan


def _detectable(freedom: int, scale: float, power: float, level: float) -> float:
    critical = float(stats.t.ppf((1 + level) / 2, freedom))

    def missed(effect: float) -> float:
        shifted = effect * scale
        return float(stats.nct.cdf(critical, freedom, shifted)) - (1 - power)

    # Above this bound, scipy's noncentral t distribution returns NaN.
    return float(optimize.brentq(missed, 0.0, (2 * critical + 2) / scale))
