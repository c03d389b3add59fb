"""How the rooms that deal with teams read numbers: any integer counts, and what makes no sense is named in one line."""

from __future__ import annotations

import operator

import numpy as np
from numpy.typing import ArrayLike, NDArray

Seed = int | np.random.Generator
"""A number of 0 or more, or a generator, from which one is drawn."""


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
    if array.dtype.kind not in "iu" or (array < least).any():
        raise ValueError(f"{name} {values!r}: expected whole numbers of {least} or more")
    return array.astype(np.int64)


def positive(name: str, value: float) -> float:
    """Read a number above 0, such as a limit."""
    if not value > 0:
        raise ValueError(f"{name} {value!r}: expected more than 0")
    return value


def entropy(seed: Seed) -> int:
    """Give the number from which random streams are made."""
    return int(seed.integers(2**63)) if isinstance(seed, np.random.Generator) else whole("seed", seed)
