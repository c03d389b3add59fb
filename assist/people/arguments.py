"""Checks of callers' numbers: any integer or real type is accepted, and an invalid value is one clear error."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import ArrayLike
from pydantic_core import PydanticCustomError

from planner.system.errors import expected

from ..declare.declared import MOST as MOST
from ..declare.declared import real_number, whole_number
from .hidden_type import Ints

Seed = int | np.random.Generator
"""An integer of 0 or more, or a generator from which one is drawn."""


def whole(name: str, value: object, least: int = 0) -> int:
    """Return a value as an int; truth values are refused."""
    with suppress(PydanticCustomError):
        if (number := whole_number(value)) >= least:
            return number
    raise ValueError(f"{name} {value!r}: expected a whole number of {least} or more")


def wholes(name: str, values: ArrayLike) -> Ints:
    """Return values of 0 or more as an int array."""
    array = np.asarray(values)
    if array.dtype.kind not in "iu" or (array < 0).any() or (array > np.iinfo(np.int64).max).any():
        raise ValueError(f"{name} {values!r}: expected whole numbers of 0 or more")
    return array.astype(np.int64)


def number(name: str, value: object) -> float:
    """Return a value as a float; truth values and arrays are refused. A number too large for a float is infinite."""
    try:
        return real_number(value)
    except PydanticCustomError:
        raise ValueError(f"{name} {value!r}: expected a number") from None


def within(name: str, value: object, low: float, high: float) -> float:
    """Return a value as a float between two limits, which it may equal."""
    found = number(name, value)
    if not low <= found <= high:
        raise ValueError(f"{name} {found:g}: expected a number from {low:g} to {high:g}")
    return found


def fraction(name: str, value: object) -> float:
    """Return a value as a float from 0 to 1."""
    found = None if isinstance(value, str) else number(name, value)
    if found is None or not 0 <= found <= 1:
        raise ValueError(f"{name} {value!r}: expected a fraction from 0 to 1, such as 0.05 for 5 %")
    return found


def one_of(name: str, value: object, choices: Sequence[str]) -> None:
    """Check that a value is one of some words."""
    if value not in choices:
        raise ValueError(f"{name} {value!r}: expected {' or '.join(map(repr, choices))}")


def require_options(given: Mapping[str, object], known: Iterable[str]) -> None:
    """Check that all options of a call exist.

    Raises
    ------
    TypeError
        There is another one.
    """
    for name in given.keys() - set(known):
        raise TypeError(f"{name}: there is no such option; {expected(name, known)}")


def positive(name: str, value: object) -> float:
    """Return a value as a float above 0, such as a limit."""
    limit = number(name, value)
    if not limit > 0:
        raise ValueError(f"{name} {value!r}: expected more than 0")
    return limit


def entropy(seed: Seed) -> int:
    """Return a seed as an integer; a generator provides one by drawing a number."""
    return int(seed.integers(2**63)) if isinstance(seed, np.random.Generator) else whole("seed", seed)


def require_goal(cost: float) -> None:
    """Check that the cost-to-go of the initial state is finite.

    Raises
    ------
    ValueError
        The goal cannot be reached.
    """
    if not np.isfinite(cost):
        raise ValueError("the goal cannot be reached from the initial state, so there is nobody to assist")


def check_costs(gamma: float, **costs: float) -> None:
    """Raise a `ValueError` unless 0 < gamma < 1 and every cost is finite and at least 0."""
    if not 0 < gamma < 1:
        raise ValueError(f"gamma {gamma:g}: expected 0 < gamma < 1")
    for name, cost in costs.items():
        if not 0 <= cost < np.inf:
            raise ValueError(f"{name} {cost:g}: expected 0 or more")
