"""Intervals: by standard errors, of shares, where a likelihood has fallen too far, equal tails; Holm's correction."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from statistics import NormalDist

import numpy as np
import scipy  # its modules are slow to import, and first estimates need none of them

from planner.system.files import finite

from ..people.decision import Floats

Interval = tuple[float, float]


@dataclass(frozen=True)
class IntervalEstimate:
    """An estimate with a confidence interval, whose ends are NaN where the data determine none, as that of one pool."""

    value: float
    low: float = math.nan
    high: float = math.nan

    def record(self) -> dict[str, float | None]:
        """Return the fields as plain data, with None for NaN."""
        return {"mean": finite(self.value), "low": finite(self.low), "high": finite(self.high)}

    def within(self, least: float, most: float) -> IntervalEstimate:
        """Return the estimate with its interval cut at the range of what is estimated."""
        return IntervalEstimate(self.value, *(min(max(end, least), most) for end in (self.low, self.high)))

    @classmethod
    def of(cls, value: float, error: float, freedom: float, level: float) -> IntervalEstimate:
        """Return Student's interval for a standard error.

        Without variance there is no interval: that all values seen are equal does not show that the next one is.
        """
        if not (1e-12 * max(1.0, abs(value)) < error < math.inf and freedom > 0):
            return cls(value)
        half = float(scipy.special.stdtrit(freedom, (1 + level) / 2)) * error
        return cls(value, value - half, value + half)


NONE = IntervalEstimate(math.nan)
"""An estimate that the data do not determine."""


def wilson(successes: int, n: int, level: float = 0.95) -> IntervalEstimate:
    """Return the share of successes with the interval of Wilson (1927); NaN without any members."""
    if not n:
        return NONE
    ends = scipy.stats.binomtest(successes, n).proportion_ci(level, method="wilson")
    return IntervalEstimate(successes / n, float(ends.low), float(ends.high))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return the p-values adjusted for their number (Holm, 1979), which bounds the family-wise error.

    Undefined ones (NaN) count as 1: the family is as large as it was planned.
    """
    given = np.asarray(p_values, dtype=float)
    values = np.where(np.isnan(given), 1.0, given)
    order, found = np.argsort(values, kind="stable"), np.empty(len(values))
    found[order] = np.maximum.accumulate(np.minimum(1.0, values[order] * np.arange(len(values), 0, -1)))
    return np.where(np.isnan(given), np.nan, found).tolist()


def largest_fall(level: float) -> float:
    """Return by how much the log-likelihood may be below its maximum for a value that is not rejected (Wilks 1938)."""
    return NormalDist().inv_cdf((1 + level) / 2) ** 2 / 2


def end_of(
    margin: Callable[[float], float], inside: float, outwards: Iterable[float], tolerance: float,
    relative: float = 1e-12,
) -> tuple[float, bool]:  # fmt: skip
    """Return the end of an interval, and whether it is open: nothing up to the last value is rejected.

    `margin` returns by how much a value is inside; below 0 if it is rejected. `inside` is not rejected. The values
    `outwards` are tried one after another, up to the end of the range. `tolerance` and `relative` are the largest error
    of the end, also as a share of it.
    """
    known = cache(margin)  # the root finder begins with the values at both ends
    for outside in outwards:
        if known(outside) < 0:
            if known(inside) <= 0:
                return inside, False
            return float(scipy.optimize.brentq(known, inside, outside, xtol=tolerance, rtol=relative)), False
        inside = outside
    return inside, True


def outwards(value: float, end: float) -> Iterator[float]:
    """Yield values from one up to an end, in steps that double."""
    step = math.copysign(0.02 + 0.2 * abs(value), end - value)
    while value != end:
        value = min(value + step, end) if step > 0 else max(value + step, end)
        yield value
        step *= 2


def equal_tailed(nodes: Floats, mass: Floats, level: float) -> Interval:
    """Return the equal-tailed interval of a distribution that is known at nodes, and linear between them."""
    order = np.argsort(nodes, kind="stable")
    below = np.cumsum(mass[order]) - mass[order] / 2
    low, high = np.interp(((1 - level) / 2, (1 + level) / 2), below, nodes[order]).tolist()
    return low, high
