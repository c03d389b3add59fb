"""A confidence bound on a mean from few, skewed samples.

A sampled bound is the mean of one value for each sample path. These values are skewed: few paths have high values, and
where none of these was drawn, both the mean and its standard error are too low. Student's t then misses far more often
than it states. So the bound here corrects for the skewness g of the samples (Hall, "On the removal of skewness by
transformation", Journal of the Royal Statistical Society B 54, 1992). With W = (mean - mu) / s for n samples, the
cubic

    Q(W) = W + g W^2 / 3 + g^2 W^3 / 27 + g / (6 n)

is nearly normal with standard deviation 1 / sqrt(n), and has the inverse W = 3 ((1 + g (Q - g / (6 n)))^(1/3) - 1) / g.
A skewness below 0 would lower the bound; it counts as 0, which leaves Student's t. Of fewer than `FEWEST` samples the
skewness is not known well enough, so that no bound is taken from them. For tails as long as those of some teams the
correction is too small, so that the interval is taken at a higher `LEVEL` than the `CONFIDENCE` that is stated.
`bench/confidence.py` measures at each alpha how often bounds lie below the mean that they bound.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

CONFIDENCE = 0.95
"""Probability with which a sampled bound holds (one-sided)."""

LEVEL = 0.99
"""Level of the interval. At 0.95 up to 12 % of the bounds of a team lay below their mean, at 0.99 at most 6 %
(5 % in all settings on record but one)."""

FEWEST = 30
"""Samples from which a bound is taken at least."""


@dataclass(frozen=True)
class SampledBound:
    """The mean of a bound over sample paths.

    Attributes
    ----------
    mean, stderr : float
        Of the bound, in cost units.
    paths : int
        Number of sample paths.
    alpha : float
        Share of the conflicts in the penalty (`assist.certify.information_relaxation.sampled_bound`).
    skewness : float
        Third central moment of the paths' values in units of their standard deviation; 0 where all are equal.
    """

    mean: float
    stderr: float
    paths: int
    alpha: float
    skewness: float = 0.0

    @classmethod
    def of(cls, found: Sequence[float], paths: int, alpha: float) -> SampledBound:
        """Return the mean of two or more values, with the standard error that it has over so many paths like these."""
        values = np.asarray(found)
        spread = float(values.std(ddof=1))
        third = float(((values - values.mean()) ** 3).mean())
        skewness = third / float(values.std()) ** 3 if spread > 1e-12 * abs(float(values.mean())) else 0.0
        return cls(float(values.mean()), spread / math.sqrt(paths), paths, alpha, skewness)

    @property
    def enough(self) -> bool:
        """Whether there are enough paths for a bound."""
        return self.paths >= FEWEST

    @property
    def upper(self) -> float:
        """Upper bound on any policy's value, in cost units, with a confidence of `CONFIDENCE`."""
        return self.mean + errors(self.paths, self.skewness) * self.stderr


def errors(paths: int, skewness: float = 0.0) -> float:
    """Return how many standard errors the bound is above the mean: Student's t, corrected for a positive skewness."""
    student = float(stdtrit(paths - 1, LEVEL))
    g, root = max(0.0, skewness), math.sqrt(paths)
    if g < 1e-6:
        return student
    corrected = root * 3 * (1 - math.cbrt(1 - g * (student / root + g / (6 * paths)))) / g
    return max(student, corrected)
