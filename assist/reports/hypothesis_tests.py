"""Tests of ranks and of shares: two-sided p-values and effect sizes, and Holm's adjustment.

Every function returns NaN where the data do not determine a result, for instance if all values are equal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from .statistics import IntervalEstimate

EXACT = 200
"""Largest number of differences with an exact signed-rank test, which takes some milliseconds for so many."""


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
    """
    x, y = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    if not len(x) or not len(y):
        return RankTest(math.nan, math.nan)
    ranks = stats.rankdata(np.concatenate([x, y]))
    if np.ptp(ranks) == 0:
        return RankTest(math.nan, 0.0)
    found = stats.mannwhitneyu(ranks[: len(x)], ranks[len(x) :])
    return RankTest(float(found.pvalue), float(2 * found.statistic / (len(x) * len(y)) - 1))


def signed_rank(differences: ArrayLike) -> RankTest:
    """Compare two conditions of the same participants by Wilcoxon's signed-rank test.

    The p-value is exact, also with ties, up to `EXACT` differences. Beyond it is a normal approximation, with
    corrections for continuity and ties.

    Parameters
    ----------
    differences : float array, shape (n,)
        The difference of each participant. Differences of 0 are left out.
    """
    x = np.asarray(differences, dtype=float)
    x = x[x != 0]
    if not len(x):
        return RankTest(math.nan, 0.0 if len(np.asarray(differences)) else math.nan)
    ranks = stats.rankdata(np.abs(x))
    approximate = len(x) > EXACT
    p = stats.wilcoxon(x, correction=True, method="approx").pvalue if approximate else _exact_p(ranks, x > 0)
    return RankTest(float(p), float((ranks * np.sign(x)).sum() / ranks.sum()))


def _exact_p(ranks: NDArray[np.float64], positive: NDArray[np.bool_]) -> float:
    """Return the probability of a sum of positive ranks at least as far from its mean, over all signs of the ranks."""
    doubled = np.rint(2 * ranks).astype(int)  # whole numbers, also for the mean ranks of ties
    total = int(doubled.sum())
    chance = np.zeros(total + 1)
    chance[0] = 1.0
    for rank in doubled:
        chance[rank:] += chance[:-rank].copy()
        chance /= 2
    seen = int(doubled[positive].sum())
    return min(1.0, 2 * float(chance[: min(seen, total - seen) + 1].sum()))


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
    return RankTest(float(stats.binomtest(larger, n).pvalue), (larger - smaller) / n)


def fisher_p(successes: int, n: int, other: int, m: int) -> float:
    """Return the p-value of Fisher's exact test of `successes` out of n and `other` out of m."""
    if not n or not m:
        return math.nan
    table = np.array([[successes, n - successes], [other, m - other]])
    return float(stats.fisher_exact(table).pvalue)


def newcombe(successes: int, n: int, other: int, m: int, level: float = 0.95) -> IntervalEstimate:
    """Return the difference of two shares, with the interval of Newcombe (1998) from Wilson's intervals.

    Parameters
    ----------
    successes, n : int
        Successes among the n members of the first group.
    other, m : int
        Successes among the m members of the second group.
    level : float
    """
    if not n or not m:
        return IntervalEstimate(math.nan, math.nan, math.nan)
    (p, low, high), (q, under, over) = _wilson(successes, n, level), _wilson(other, m, level)
    return IntervalEstimate(p - q, p - q - math.hypot(p - low, over - q), p - q + math.hypot(high - p, q - under))


def _wilson(successes: int, n: int, level: float) -> tuple[float, float, float]:
    z, p = float(stats.norm.ppf((1 + level) / 2)), successes / n
    middle, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return p, (middle - half) / (1 + z * z / n), (middle + half) / (1 + z * z / n)
