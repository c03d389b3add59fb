"""Types of arrays, read-only arrays in frozen dataclasses, and their representation in one line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T", bound=np.generic)

Ints = NDArray[np.int64]
Words = NDArray[np.uint64]
"""Packed states have these: 64-bit words, several variables in one."""


def read_only(record: Any) -> None:
    """Make all arrays in the fields of a dataclass read-only."""
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, np.ndarray):
            value.flags.writeable = False


def frozen(array: NDArray[T]) -> NDArray[T]:
    """Return the array itself if it is read-only, else a read-only copy. The caller's array is not changed."""
    if not array.flags.writeable:
        return array
    copy = array.copy()
    copy.flags.writeable = False
    return copy


def padded(lists: Sequence[Sequence[int]], filler: int) -> NDArray[np.int64]:
    """Return lists as the rows of an array, shape (n, most), padded with `filler`."""
    rows = np.full((len(lists), max(map(len, lists), default=0)), filler, dtype=np.int64)
    for row, entries in zip(rows, lists, strict=True):
        row[: len(entries)] = entries
    return rows


def outline(record: Any) -> str:
    """Return the one-line representation of a dataclass or named tuple.

    Arrays are shown by type and shape. Long strings and containers are shown by their length.
    """
    names = getattr(record, "_fields", None) or [field.name for field in fields(record) if field.repr]
    return f"{type(record).__name__}({', '.join(f'{name}={_short(getattr(record, name))}' for name in names)})"


def _short(value: Any) -> str:
    """Return one value as `outline` shows it."""
    shown = 80  # number of characters from which a value is abbreviated in a representation, to keep it on one line
    if isinstance(value, np.ndarray):
        return f"<{value.dtype} {value.shape}>"
    if isinstance(value, str):
        return repr(value) if len(value) < shown else f"<{len(value):,} characters>"
    if isinstance(value, tuple | list | set | frozenset | Mapping) and len(value) > 3:
        return f"<{len(value):,} items>"
    if isinstance(value, tuple | list) and not hasattr(value, "_fields"):
        inner = ", ".join(map(_short, value))
        text = f"[{inner}]" if isinstance(value, list) else f"({inner}{',' * (len(value) == 1)})"
    elif isinstance(value, set | frozenset) and value:  # in one order, whatever the seed of hashes
        text = f"{type(value).__name__}({{{', '.join(sorted(map(_short, value)))}}})"
    else:
        text = repr(value)
    return text if len(text) < shown else f"<{type(value).__name__}>"
