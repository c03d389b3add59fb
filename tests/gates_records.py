"""Numbers and hashes in the records of `gates`, and how closely they are compared."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numba
import numpy as np

NEAR, NEAR_ELSEWHERE = 1e-12, 1e-9
"""Largest relative difference of values on the machine of the record, and on others."""


def here() -> dict[str, str]:
    """Describe what the last bits of floats depend on."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor = next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        processor = platform.processor()
    widths = ",".join(np.show_config(mode="dicts")["SIMD Extensions"]["found"])  # processors of one name differ in them
    return {"processor": processor, "widths": widths, "numpy": np.__version__, "numba": numba.__version__}


def hashed(arrays: Iterable[tuple[str, Any]]) -> str:
    """Return a hash of named arrays, in which whole numbers of any type are alike."""
    sha = hashlib.sha256()
    for name, array in arrays:
        one = np.asarray(array)
        one = one.astype("<f8" if one.dtype.kind == "f" else "<i8")
        sha.update(f"{name} {one.dtype.str} {one.shape} ".encode() + one.tobytes())
    return sha.hexdigest()[:16]


def weights(count: int) -> np.ndarray:
    """Return weights of a sum that changes if any of its numbers does."""
    return np.cos(np.arange(count))


def near(expected: Any, found: Any, tolerance: float) -> bool:
    """Whether plain data are equal but for small relative differences of floats."""
    if isinstance(expected, dict):
        return (
            isinstance(found, dict)
            and expected.keys() == found.keys()
            and all(near(expected[name], found[name], tolerance) for name in expected)
        )
    if isinstance(expected, list):
        return (
            isinstance(found, list)
            and len(expected) == len(found)
            and all(near(one, other, tolerance) for one, other in zip(expected, found, strict=True))
        )
    if isinstance(expected, float) and isinstance(found, float):
        return expected == found or abs(expected - found) <= tolerance * max(1.0, abs(expected))
    return bool(expected == found)


def first_difference(expected: dict[str, Any], found: dict[str, Any], *, same_machine: bool) -> str | None:
    """Return the first field in which two cases differ; None if they do not."""
    tolerance = NEAR if same_machine else NEAR_ELSEWHERE
    for name in expected.keys() | found.keys():
        if name == "bits" and (not same_machine or name not in expected):  # a case may be recorded elsewhere, without
            continue
        if not near(expected.get(name), found.get(name), tolerance):
            return f"{name} was {expected.get(name)}, is {found.get(name)}"
    return None
