"""Keys of a task's states: hashes that do not depend on how states are numbered."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import CostToGo

BLOCK = 1 << 16
"""Number of states whose values are unpacked at a time, which limits the memory to some megabytes."""


def mix(numbers: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return a hash of each number, shape (...): every bit of it depends on all bits of the number (splitmix64)."""
    z = numbers + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(z ^ (z >> np.uint64(31)))


def keys_of(known: CostToGo, states: ArrayLike) -> NDArray[np.uint64]:
    """Return a key of each state, shape (N,): a hash of its variables' values, independent of its number.

    Parameters
    ----------
    known : CostToGo
        Cost-to-go of the task, as a table or on demand; the keys are the same.
    states : int array, shape (N,)
    """
    numbers = np.asarray(states, dtype=np.int64).reshape(-1)
    keys = np.zeros(len(numbers), dtype=np.uint64)
    for begin in range(0, len(numbers), BLOCK):
        block = slice(begin, begin + BLOCK)
        for value in known.values(numbers[block]).T:
            keys[block] = mix(keys[block] ^ value.astype(np.uint64))
    return keys
