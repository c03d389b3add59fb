"""An upper confidence bound on a mean from few, skewed samples.

A sampled bound is the mean of one value per sample path. These values are skewed: few paths have high values. If none
of these is drawn, both the mean and its standard error are too low. Student's t then misses far more often than its
level states. So the bound here corrects for the skewness g of the samples (Hall, "On the removal of skewness by
transformation", Journal of the Royal Statistical Society B 54, 1992). With W = (mean - mu) / s for n samples, the cubic

    Q(W) = W + g W^2 / 3 + g^2 W^3 / 27 + g / (6 n)

is nearly normal with standard deviation 1 / sqrt(n). It has the inverse W = 3 ((1 + g (Q - g / (6 n)))^(1/3) - 1) / g.
A negative skewness would lower the bound; it counts as 0, which leaves Student's t. With fewer than `FEWEST` samples
the skewness is too uncertain, so that no bound is given. For the long tails of some teams the correction is too small.
Therefore the interval has a higher level than the stated `CONFIDENCE`. `bench/records/confidence.json` has for each
alpha how often bounds lie below the mean that they bound.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

CONFIDENCE = 0.95
"""Stated probability with which a sampled bound holds (one-sided)."""

FEWEST = 30
"""Smallest number of samples for a bound; with fewer, the skewness is too uncertain."""


@dataclass(frozen=True)
class SampledBound:
    """The mean of an upper bound over sample paths.

    Attributes
    ----------
    mean, stderr : float
        Mean of the bound and its standard error, in cost units.
    paths : int
        Number of sample paths.
    alpha : float
        Share of the congestion in the penalty (`assist.certify.information_relaxation.sampled_bound`).
    skewness : float
        Third central moment of the paths' values in units of their standard deviation; 0 if all are equal.
    """

    mean: float
    stderr: float
    paths: int
    alpha: float
    skewness: float = 0.0

    @classmethod
    def of(cls, found: Sequence[float], paths: int, alpha: float) -> SampledBound:
        """Return the mean of two or more values, with the standard error for `paths` paths of the same distribution."""
        values = np.asarray(found)
        deviation = float(values.std(ddof=1))
        third = float(((values - values.mean()) ** 3).mean())
        skewness = third / float(values.std()) ** 3 if deviation > 1e-12 * abs(float(values.mean())) else 0.0
        return cls(float(values.mean()), deviation / math.sqrt(paths), paths, alpha, skewness)

    @property
    def enough(self) -> bool:
        """Whether there are enough paths for a bound."""
        return self.paths >= FEWEST

    @property
    def upper(self) -> float:
        """Upper bound on the value of any policy, in cost units, with the confidence `CONFIDENCE`."""
        return self.mean + errors(self.paths, self.skewness) * self.stderr


def errors(paths: int, skewness: float = 0.0) -> float:
    """Return the number of standard errors between mean and bound: Student's t, corrected for a positive skewness.

    The level is 0.99. At 0.95, up to 12 % of a team's bounds lay below their mean; at 0.99 at most 6 %, and at most 5 %
    in all recorded settings but one.
    """
    student = float(stdtrit(paths - 1, 0.99))
    g, root = max(0.0, skewness), math.sqrt(paths)
    if g < 1e-6:
        return student
    corrected = root * 3 * (1 - math.cbrt(1 - g * (student / root + g / (6 * paths)))) / g
    return max(student, corrected)
