"""Decisions between values that are almost equal: the lower number wins, so that none depends on rounding."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.system.compiling import ReadableFirst

from ..people.decision import Floats

NEAR = 1e-9
"""Cost units. Values of decisions that differ by at most as much are equal; sums in another order differ by less."""


def first_best(values: Floats) -> NDArray[np.int64]:
    """Return the first number on the last axis whose value is the largest, or within `NEAR` of it; shape (...)."""
    found: NDArray[np.int64] = _first_best(values)
    return found


def _readable_first_best(values: Floats) -> NDArray[np.int64]:
    return np.asarray((values >= values.max(axis=-1, keepdims=True) - NEAR).argmax(axis=-1))


def _compiled_first_best(values: Floats) -> NDArray[np.int64]:
    from .tie_kernels import first_best_of_rows  # slow to import

    found = np.empty(values.shape[:-1], dtype=np.int64)
    first_best_of_rows(np.ascontiguousarray(values).reshape(-1, values.shape[-1]), NEAR, found.reshape(-1))
    return found


_first_best = ReadableFirst(_readable_first_best, _compiled_first_best, work=lambda values: 20_000 + 10 * values.size)


def ranked(values: Floats) -> NDArray[np.int64]:
    """Return the numbers on the last axis by falling value, in the shape of `values`.

    Numbers whose values differ by at most `NEAR` from the next one are in ascending order.
    """
    order = np.argsort(-values, axis=-1, kind="stable")
    falling = np.take_along_axis(values, order, axis=-1)
    level = np.zeros(values.shape, dtype=np.int64)
    lower = falling[..., :-1] - NEAR > falling[..., 1:]
    np.put_along_axis(level, order[..., 1:], lower.cumsum(axis=-1), axis=-1)
    return np.argsort(level, axis=-1, kind="stable")
