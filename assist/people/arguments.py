"""How numbers are read that callers give: any integer or real counts, and what makes no sense is named in one line."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

Seed = int | np.random.Generator
"""A number of 0 or more, or a generator, from which one is drawn."""

MOST = 1e15
"""Costs, rates and sizes are at most this: sums of larger ones are no longer exact, and products overflow."""


def whole(name: str, value: object, least: int = 0) -> int:
    """Read a whole number; a truth value is none."""
    try:
        number = None if isinstance(value, bool | np.bool_) else operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        number = None
    if number is None or number < least:
        raise ValueError(f"{name} {value!r}: expected a whole number of {least} or more")
    return number


def wholes(name: str, values: ArrayLike, least: int = 0) -> NDArray[np.int64]:
    """Read whole numbers, as many as there are."""
    array = np.asarray(values)
    if array.dtype.kind not in "iu" or (array < least).any() or (array > np.iinfo(np.int64).max).any():
        raise ValueError(f"{name} {values!r}: expected whole numbers of {least} or more")
    return array.astype(np.int64)


def number(name: str, value: object) -> float:
    """Read a number; a truth value is none, and nor is an array. What no float holds is infinite."""
    real = None if isinstance(value, bool | np.bool_) else value
    try:
        read = float(real) if isinstance(real, Real) else None
    except OverflowError:
        read = math.inf
    if read is None:
        raise ValueError(f"{name} {value!r}: expected a number")
    return read


def span(name: str, value: object) -> tuple[float, float]:
    """Read two numbers, from one to the other."""
    pair = list(value) if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str) else []
    if len(pair) != 2:
        raise ValueError(f"{name} {value!r}: expected two numbers, low and high")
    low, high = pair
    return number(name, low), number(name, high)


def positive(name: str, value: object) -> float:
    """Read a number above 0, such as a limit."""
    limit = number(name, value)
    if not limit > 0:
        raise ValueError(f"{name} {value!r}: expected more than 0")
    return limit


def entropy(seed: Seed) -> int:
    """Return the number from which random streams are made."""
    return int(seed.integers(2**63)) if isinstance(seed, np.random.Generator) else whole("seed", seed)
