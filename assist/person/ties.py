"""Decisions between values that are almost equal: the lower number wins, so that none depends on rounding."""

from __future__ import annotations

import numpy as np

from ..people.decision import Floats, Ints

NEAR = 1e-9
"""Cost units. Values of decisions that differ by at most as much are equal; sums in another order differ by less."""

ROWS, COLUMNS = 256, 16
"""Numbers from which, and up to which, numpy is faster by columns than by rows."""


def first_best(values: Floats) -> Ints:
    """Return the first number on the last axis whose value is the largest, or within `NEAR` of it; shape (...)."""
    if values.shape[-1] > COLUMNS or values.size <= ROWS * values.shape[-1]:
        return np.asarray((values >= values.max(axis=-1, keepdims=True) - NEAR).argmax(axis=-1))
    columns = np.ascontiguousarray(np.moveaxis(values, -1, 0))  # one after the other, which is faster than by rows
    enough, found = columns.max(axis=0) - NEAR, np.full(values.shape[:-1], len(columns) - 1)
    for number in reversed(range(len(columns) - 1)):
        found[columns[number] >= enough] = number
    return found


def ranked(values: Floats) -> Ints:
    """Return the numbers on the last axis by falling value, in the shape of `values`.

    Numbers whose values differ by at most `NEAR` from the next one are in ascending order.
    """
    order = np.argsort(-values, axis=-1, kind="stable")
    falling = np.take_along_axis(values, order, axis=-1)
    level = np.zeros(values.shape, dtype=np.int64)
    lower = falling[..., :-1] - NEAR > falling[..., 1:]
    np.put_along_axis(level, order[..., 1:], lower.cumsum(axis=-1), axis=-1)
    return np.argsort(level, axis=-1, kind="stable")
