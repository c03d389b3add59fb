"""The first of the best values in each row, compiled, for many rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.decision import Floats


@njit()
def first_best_of_rows(values: Floats, near: float, found: NDArray[np.int64]) -> None:
    """Fill `found`, shape (n,), with the first number in each row of `values`, shape (n, R), as `ties.first_best`."""
    for row in range(len(values)):
        best = -np.inf
        for value in values[row]:
            best = max(best, value)
        for number, value in enumerate(values[row]):
            if value >= best - near:
                found[row] = number
                break
