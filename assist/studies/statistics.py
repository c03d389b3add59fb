"""Means, ratios, shares and ranks with intervals and tests, where the unit of replication is a pool or a person.

Episodes of one pool share its people and are not independent, so that intervals over episodes would be too narrow.
Functions take one value for each pool (or participant, or group), in the same order in every array. Policies are
simulated with the same people and random numbers, so comparisons are paired. What the data do not determine is NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..learning.intervals import NONE, IntervalEstimate, wilson

FEW = 10
"""Number of pools, or of a condition's participants, below which results are called preliminary; see also `alike`."""
LEVEL, POWER = 0.95, 0.8
"""Level of intervals and tests, and the power with which a difference counts as detectable."""
EXACT = 200
"""Largest number of differences with an exact signed-rank test, which takes some milliseconds for so many."""


@dataclass(frozen=True)
class Comparison:
    """A condition compared with another one.

    Attributes
    ----------
    difference : IntervalEstimate
    p : float
        Two-sided p-value of Student's t-test of the same difference.
    hedges_g : IntervalEstimate
        The difference in standard deviations (Cohen's d) with Hedges' small-sample correction (1981).
    error, freedom : float
        The standard error of the difference, and its degrees of freedom.
    """

    difference: IntervalEstimate
    p: float = math.nan
    hedges_g: IntervalEstimate = NONE
    error: float = math.nan
    freedom: float = math.nan

    @classmethod
    def of(cls, value: float, error: float, freedom: float, hedges_g: IntervalEstimate) -> Comparison:
        """Return the comparison with this standard error, whose distribution is Student's t."""
        if not (error > 0 and freedom > 0):
            return cls(IntervalEstimate(value))
        t = value / error
        p = float(2 * scipy.special.stdtr(freedom, -abs(t)))
        return cls(IntervalEstimate.of(value, error, freedom, LEVEL), p, hedges_g, error, freedom)

    @property
    def t(self) -> float:
        """The test's statistic."""
        return self.difference.value / self.error

    @property
    def detectable(self) -> float:
        """The difference that four of five studies show, with as many values of the same variance."""
        return detectable(self.freedom, 1 / self.error)


# Means and their ratios.


def mean(values: ArrayLike, level: float = LEVEL) -> IntervalEstimate:
    """Return the mean of values, shape (n,), with Student's interval."""
    x = np.asarray(values, dtype=float)
    error = float(x.std(ddof=1)) / math.sqrt(len(x)) if len(x) > 1 else math.nan
    return IntervalEstimate.of(float(x.mean()), error, len(x) - 1, level)


def saving(with_it: ArrayLike, without: ArrayLike) -> IntervalEstimate:
    """Return the saving in percent: 100 (1 - mean(with_it) / mean(without)), of means of at least 0.

    The interval is Student's t with the standard error of the jackknife over pools (Tukey, 1958). For skewed numbers,
    such as those of people in a trap, a bootstrap of pools (BCa) was tried and covered less at 10, 20 and 50 pools.
    It ends at 100, beyond which no saving is. There is no lower limit: -100 is twice as much.
    """
    found = _of_means((with_it, without), lambda a, b: 100 * (1 - a / b))
    return replace(found, high=min(found.high, 100.0))


def change(first: tuple[ArrayLike, ArrayLike], last: tuple[ArrayLike, ArrayLike]) -> IntervalEstimate:
    """Return the first saving minus the last, in percentage points. The arrays are as in `saving`."""
    return _of_means((*first, *last), lambda a, b, c, d: 100 * (c / d - a / b))


def quotient(above: ArrayLike, below: ArrayLike) -> IntervalEstimate:
    """Return the ratio of two means of at least 0, with an interval as in `saving`, of numbers of at least 0."""
    found = _of_means((above, below), lambda a, b: a / b)
    return replace(found, low=max(found.low, 0.0))


def alike(values: ArrayLike) -> float:
    """Return how many equal values have the same sum and sum of squares (Kish, 1965): few, where few are large."""
    x = np.asarray(values, dtype=float)
    return float(x.sum() ** 2 / (x**2).sum()) if x.any() else float(len(x))


def _of_means(columns: Sequence[ArrayLike], function: Callable[..., Any]) -> IntervalEstimate:
    """Return a function of the columns' means, with its jackknife interval over rows."""
    x = [np.asarray(column, dtype=float) for column in columns]
    n = len(x[0])
    with np.errstate(divide="ignore", invalid="ignore"):
        value = float(function(*(column.mean() for column in x)))
        if n < 2 or not math.isfinite(value):
            return IntervalEstimate(value)
        left_out = function(*((column.sum() - column) / (n - 1) for column in x))
        spread = float(((left_out - left_out.mean()) ** 2).sum())
    return IntervalEstimate.of(value, math.sqrt((n - 1) / n * spread), n - 1, LEVEL)


def effect(difference: ArrayLike) -> float:
    """Return Cohen's d of paired differences, shape (n,): their mean divided by their standard deviation."""
    x = np.asarray(difference, dtype=float)
    spread = float(x.std(ddof=1)) if len(x) > 1 else 0.0
    return float(x.mean()) / spread if spread > 0 else math.nan


# Two groups.


def between_groups(a: ArrayLike, b: ArrayLike) -> Comparison:
    """Compare the means of two groups with Welch's t-test for unequal variances.

    Parameters
    ----------
    a, b : float arrays, shapes (n,) and (m,)
        A value for each participant. There is no interval if a group has fewer than two, or if all variances are 0.
    """
    x, y = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    value = float(x.mean() - y.mean()) if len(x) and len(y) else math.nan
    if min(len(x), len(y)) < 2 or x.var() + y.var() == 0:
        return Comparison(IntervalEstimate(value))
    own, other = x.var(ddof=1) / len(x), y.var(ddof=1) / len(y)
    freedom = float((own + other) ** 2 / (own**2 / (len(x) - 1) + other**2 / (len(y) - 1)))
    together = len(x) + len(y) - 2
    pooled = math.sqrt(((len(x) - 1) * x.var(ddof=1) + (len(y) - 1) * y.var(ddof=1)) / together)
    effect = standardised(value / pooled, together, math.sqrt(len(x) * len(y) / (len(x) + len(y))))
    return Comparison.of(value, math.sqrt(own + other), freedom, effect)


def standardised(d: float, freedom: float, scale: float) -> IntervalEstimate:
    """Return Hedges' g of a standardised difference, with the interval by the noncentral t distribution.

    Parameters
    ----------
    d : float
        The difference in standard deviations (Cohen's d).
    freedom : float
        Degrees of freedom of the standard deviation; without two, the result is NaN.
    scale : float
        As in `detectable`: the test's statistic for a standardised difference of 1.
    """
    if freedom <= 1 or not math.isfinite(d):
        return NONE
    ends = (scipy.special.nctdtrinc(freedom, p, d * scale) / scale for p in ((1 + LEVEL) / 2, (1 - LEVEL) / 2))
    return IntervalEstimate(*(float(one) * small(freedom) for one in (d, *ends)))


def small(freedom: float) -> float:
    """Return Hedges' factor for small samples."""
    return 1 - 3 / (4 * freedom - 1)


def newcombe(successes: int, n: int, other: int, m: int) -> IntervalEstimate:
    """Return the difference of two shares, with the interval of Newcombe (1998) from Wilson's intervals.

    Parameters
    ----------
    successes, n : int
        Successes among the n members of the first group.
    other, m : int
        Successes among the m members of the second group.
    """
    if not n or not m:
        return IntervalEstimate(math.nan)
    a, b = wilson(successes, n, LEVEL), wilson(other, m, LEVEL)
    apart = a.value - b.value
    return IntervalEstimate(
        apart,
        apart - math.hypot(a.value - a.low, b.high - b.value),
        apart + math.hypot(a.high - a.value, b.value - b.low),
    )


def fisher_p(successes: int, n: int, other: int, m: int) -> float:
    """Return the p-value of Fisher's exact test of `successes` out of n and `other` out of m."""
    table = np.array([[successes, n - successes], [other, m - other]])
    return float(scipy.stats.fisher_exact(table)[1]) if n and m else math.nan


def detectable(freedom: float, scale: float) -> float:
    """Return the smallest difference that a t-test detects with a power of `POWER`.

    Parameters
    ----------
    freedom : float
        Degrees of freedom; without any, the result is NaN.
    scale : float
        The test's statistic for a difference of 1, which is 1 / its standard error. For differences of groups of n and
        m in standard deviations, it is sqrt(n m / (n + m)).
    """
    if not (freedom >= 1 and math.isfinite(scale)):
        return math.nan
    critical = float(scipy.special.stdtrit(freedom, (1 + LEVEL) / 2))

    def missed(size: float) -> float:
        return float(scipy.stats.nct.cdf(critical, freedom, size * scale)) - (1 - POWER)

    # Above this bound, scipy's noncentral t distribution returns NaN.
    return float(scipy.optimize.brentq(missed, 0.0, (2 * critical + 2) / scale))


# Ranks.


@dataclass(frozen=True)
class RankTest:
    """A comparison by ranks.

    Attributes
    ----------
    p : float
        Two-sided p-value.
    effect : float
        Rank-biserial correlation, from -1 to 1: positive if the first condition has the larger values.
    """

    p: float
    effect: float


def mann_whitney(a: ArrayLike, b: ArrayLike) -> RankTest:
    """Compare two groups by the Mann-Whitney test. Infinite values share the highest rank, that of the worst results.

    Parameters
    ----------
    a, b : float arrays, shapes (n,) and (m,)

    Raises
    ------
    ValueError
        A value is NaN.
    """
    x, y = _known(a), _known(b)
    if not len(x) or not len(y):
        return RankTest(math.nan, math.nan)
    ranks = scipy.stats.rankdata(np.concatenate([x, y]))
    if np.ptp(ranks) == 0:
        return RankTest(math.nan, 0.0)
    found = scipy.stats.mannwhitneyu(ranks[: len(x)], ranks[len(x) :])
    return RankTest(float(found.pvalue), float(2 * found.statistic / (len(x) * len(y)) - 1))


def signed_rank(differences: ArrayLike) -> RankTest:
    """Compare two conditions of the same participants by Wilcoxon's signed-rank test.

    The p-value is exact, also with ties, for which scipy has no exact one, up to `EXACT` differences. Beyond it is a
    normal approximation, with corrections for continuity and ties.

    Parameters
    ----------
    differences : float array, shape (n,)
        The difference of each participant. Differences of 0 are left out. Those that differ by less
        than 1e-12 of the largest are equal.

    Raises
    ------
    ValueError
        A difference is NaN.
    """
    every = _known(differences)
    largest = float(np.abs(every[np.isfinite(every)]).max(initial=0.0)) or 1.0
    every = np.round(every / largest, 12)  # 7/3 - 2 and 10/3 - 3 are equal but for rounding
    x = every[every != 0]
    if not len(x):
        return RankTest(math.nan, 0.0 if len(every) else math.nan)
    ranks = scipy.stats.rankdata(np.abs(x))
    if len(x) > EXACT:
        p = float(scipy.stats.wilcoxon(x, correction=True, method="approx").pvalue)
    else:  # the chance of each sum of positive ranks over all signs; doubled, mean ranks are whole numbers
        doubled = np.rint(2 * ranks).astype(int)
        chance = np.zeros(doubled.sum() + 1)
        chance[0] = 1.0
        for rank in doubled:
            chance[rank:] += chance[:-rank].copy()
            chance /= 2
        seen = doubled[x > 0].sum()
        p = min(1.0, 2 * float(chance[: min(seen, doubled.sum() - seen) + 1].sum()))
    return RankTest(p, float((ranks * np.sign(x)).sum() / ranks.sum()))


def _known(values: ArrayLike) -> Any:
    x = np.asarray(values, dtype=float)
    if np.isnan(x).any():
        raise ValueError("NaN among values to be ranked: expected a number for each participant who is compared")
    return x


def sign_test(larger: int, smaller: int) -> RankTest:
    """Compare two conditions of the same participants by the exact sign test, which for yes or no is McNemar's test.

    Parameters
    ----------
    larger, smaller : int
        Numbers of participants with the larger and the smaller value in the first condition.
    """
    n = larger + smaller
    if not n:
        return RankTest(math.nan, 0.0)
    return RankTest(float(scipy.stats.binomtest(larger, n).pvalue), (larger - smaller) / n)


# Scales.


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
