"""Arrays of distances in small integer types, and distances from a goal over stored transitions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..states.packing import Ints

UNREACHED = np.iinfo(np.int64).max
"""Distance of states from which no goal state is reachable."""


def smallest_type(largest: int) -> type[np.unsignedinteger]:
    """Return the smallest type for distances up to `largest`; its own largest value is reserved for dead ends."""
    types: tuple[type[np.unsignedinteger], ...] = (np.uint8, np.uint16, np.uint32, np.uint64)
    return next(t for t in types if largest < np.iinfo(t).max)


def retyped(distance: NDArray[np.integer], dtype: type[np.unsignedinteger]) -> NDArray[np.unsignedinteger]:
    """Return distances in another type; the largest value of each type marks dead ends."""
    result = distance.astype(dtype)
    result[distance == np.iinfo(distance.dtype).max] = np.iinfo(dtype).max
    return result


def compact(distance: NDArray[np.integer]) -> NDArray[np.unsignedinteger]:
    """Return distances in the smallest type; the largest value of each type marks dead ends."""
    finite = distance != np.iinfo(distance.dtype).max
    return retyped(distance, smallest_type(int(distance.max(where=finite, initial=0))))


def backward(
    targets: NDArray[np.signedinteger],
    sources: Ints,
    costs: Ints,
    goal: NDArray[np.bool_],
    *,
    check: Callable[[int], None] = lambda _states: None,
) -> Ints:
    """Return the distance of every state to the goal states along the given edges (Dijkstra 1959).

    All states of one distance are settled at once.

    Parameters
    ----------
    targets, sources, costs : int arrays, shape (m,)
        Edges from `sources` to `targets`; costs of 0 or more.
    goal : bool array, shape (n,)
    check : callable, optional
        Called with n before each distance; it may raise `LimitError`.

    Returns
    -------
    int64 array, shape (n,)
        `UNREACHED` where there is no path.
    """
    by_target = np.argsort(targets, kind="stable")
    into = np.concatenate([[0], np.cumsum(np.bincount(targets, minlength=len(goal)))])
    sources, costs = sources[by_target], costs[by_target]

    distance = np.full(len(goal), UNREACHED)
    distance[goal] = 0
    waiting = {0: [np.flatnonzero(goal)]}  # states by tentative distance
    while waiting:
        check(len(goal))
        d = min(waiting)
        frontier = np.unique(np.concatenate(waiting.pop(d)))
        frontier = frontier[distance[frontier] == d]  # the others have a smaller distance, and are settled
        counts = into[frontier + 1] - into[frontier]
        starts = into[frontier] - np.concatenate([[0], np.cumsum(counts)[:-1]])
        rows = np.repeat(starts, counts) + np.arange(counts.sum())
        reached, through = sources[rows], d + costs[rows]
        better = through < distance[reached]
        reached, through = reached[better], through[better]
        np.minimum.at(distance, reached, through)
        for value in np.unique(through):
            waiting.setdefault(int(value), []).append(reached[through == value])
    return distance
