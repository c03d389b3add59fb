"""Arrays of distances in small integer types, and numbers of actions over stored transitions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..system.arrays import Ints

UNREACHED = np.iinfo(np.int64).max
"""Distance of states from which no goal state is reachable."""

EXACT = 1 << 53
"""Distances must stay below this, since they are handed on as floats, which are exact up to it."""


def smallest_type(largest: int) -> type[np.unsignedinteger]:
    """Return the smallest type for distances up to `largest`; its own largest value is reserved for dead ends."""
    types: tuple[type[np.unsignedinteger], ...] = (np.uint8, np.uint16, np.uint32, np.uint64)
    return next(t for t in types if largest < np.iinfo(t).max)


def is_dead_end(distance: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Return whether each distance marks a dead end, as the largest value of its type does."""
    return np.asarray(distance == np.iinfo(distance.dtype).max)


def retyped(distance: NDArray[np.integer], dtype: type[np.unsignedinteger]) -> NDArray[np.unsignedinteger]:
    """Return distances in another type; the largest value of each type marks dead ends."""
    result = distance.astype(dtype)
    result[is_dead_end(distance)] = np.iinfo(dtype).max
    return result


def compact(distance: NDArray[np.integer]) -> NDArray[np.unsignedinteger]:
    """Return distances in the smallest type; the largest value of each type marks dead ends."""
    return retyped(distance, smallest_type(int(distance.max(where=~is_dead_end(distance), initial=0))))


def as_floats(distance: NDArray[np.unsignedinteger]) -> NDArray[np.float64]:
    """Return distances as floats: infinite at dead ends."""
    return np.where(is_dead_end(distance), np.inf, distance)


def plan_lengths(targets: NDArray[np.signedinteger], sources: Ints, goal: NDArray[np.bool_]) -> Ints:
    """Return the least number of edges from every state to a goal state; `UNREACHED` where there is no path.

    The edges lead from `sources` to `targets`, shape (m,); `goal` has shape (states,).
    """
    from scipy.sparse import csr_array  # slow to import
    from scipy.sparse.csgraph import dijkstra

    into = csr_array((np.ones(len(targets)), (targets, sources)), shape=(len(goal), len(goal)))
    lengths = dijkstra(into, indices=np.flatnonzero(goal), unweighted=True, min_only=True)
    reached, found = np.isfinite(lengths), np.full(len(goal), UNREACHED)
    found[reached] = lengths[reached]
    return found
