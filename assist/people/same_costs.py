"""Whether sums of costs are the same, in spite of rounding."""

from __future__ import annotations

import numpy as np

from .decision import Bools, Floats


def same_cost(a: Floats, b: Floats) -> Bools:
    """Return whether sums of costs are the same, of any shape; infinite ones are not.

    Costs with decimals are rounded, and so are their sums. Two sums that differ by at most four units in the last place
    are taken as the same. Different ones differ by at least one unit of whole-number cost (`Task.unit`), which is more
    unless a sum has more than 2^50 of these units.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(np.isfinite(a) & (np.abs(a - b) <= 4 * np.spacing(np.abs(a))))
