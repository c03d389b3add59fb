"""Intervals: where the likelihood has fallen too far, and equal tails of a distribution that is known at nodes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from statistics import NormalDist

import numpy as np

from ..people.decision import Floats

Interval = tuple[float, float]


def largest_fall(level: float) -> float:
    """Return by how much the log-likelihood may be below its maximum for a value that is not rejected (Wilks 1938)."""
    return NormalDist().inv_cdf((1 + level) / 2) ** 2 / 2


def end_of(
    margin: Callable[[float], float],
    inside: float,
    outwards: Iterable[float],
    tolerance: float,
    relative: float = 1e-12,
) -> tuple[float, bool]:  # fmt: skip
    """Return the end of an interval, and whether it is open: nothing up to the last value is rejected.

    Parameters
    ----------
    margin : callable
        By how much a value is inside; below 0 if it is rejected.
    inside : float
        A value that is not rejected.
    outwards : iterable of float
        Values that are tried, one after another, up to the end of the range.
    tolerance, relative : float
        Largest error of the end: of a value, and as a share of it.
    """
    from scipy.optimize import brentq  # slow to import, and first estimates do not need it

    for outside in outwards:
        if margin(outside) < 0:
            found = brentq(margin, inside, outside, xtol=tolerance, rtol=relative) if margin(inside) > 0 else inside
            return float(found), False
        inside = outside
    return inside, True


def equal_tailed(nodes: Floats, mass: Floats, level: float) -> Interval:
    """Return the equal-tailed interval of a distribution that is known at nodes, and linear between them."""
    order = np.argsort(nodes, kind="stable")
    below = np.cumsum(mass[order]) - mass[order] / 2
    low, high = np.interp(((1 - level) / 2, (1 + level) / 2), below, nodes[order]).tolist()
    return low, high
