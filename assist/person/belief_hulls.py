"""Upper bounds on one person's problem: for each state, beliefs with known bounds (compiled code).

From these `upper_hull` derives the bound at any other belief. The search uses a few pivots of its linear program, so
that the bound is not exactly convex.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.decision import Floats
from .rounding import compiled as rounding
from .upper_hull import solve

NONE = -1
"""The number of no belief and of no vector, at the end of a list."""

# TINY * HUGE is large, so that an entry that is 0 in both beliefs never limits a weight.
TINY, HUGE = 1e-290, 1e300
FAST = {"reassoc", "contract", "nsz", "nnan"}


class UpperHull(NamedTuple):
    """Beliefs with upper bounds, as one linked list per state.

    Attributes
    ----------
    corner : float array, shape (n, cells)
        Upper bounds for a known type and theta, a cell: there are H * T of them.
    belief, inverse : float arrays, shape (capacity, cells)
        Beliefs of mass 1, and the reciprocal of each entry.
    drop : float array, shape (capacity,)
        d_i in `upper_hull`, below 0: the bound at each belief minus corner . belief.
    state, after : int arrays, shape (capacity,)
        State of each belief (-1: unused entry), and the next belief of the same state (or the next unused entry).
    head : int array, shape (n,)
        First belief of each state.
    space : int array, shape (2,)
        Number of entries that have ever been used, and the first unused one among them.
    """

    corner: Floats
    belief: Floats
    inverse: Floats
    drop: Floats
    state: NDArray[np.int32]
    after: NDArray[np.int32]
    head: NDArray[np.int32]
    space: NDArray[np.int64]


def empty_hull(corner: Floats, capacity: int) -> UpperHull:
    """Return a hull that contains the corners only."""
    states, size = corner.shape
    return UpperHull(
        corner=corner,
        belief=np.empty((capacity, size)),
        inverse=np.empty((capacity, size)),
        drop=np.empty(capacity),
        state=np.full(capacity, NONE, dtype=np.int32),
        after=np.full(capacity, NONE, dtype=np.int32),
        head=np.full(states, NONE, dtype=np.int32),
        space=np.array([0, NONE]),
    )


# Reassociation lets the compiler vectorise the sums. The margin of each backup covers its effect on rounding.
@njit(fastmath=FAST, inner=True)
def dot(a, b):
    """Return a . b."""
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@njit(fastmath=FAST, inner=True)
def _largest_weight(belief, inverse, enough):
    """Return the largest w with w * stored <= belief, where `inverse` holds 1 / stored.

    The result is some number below `enough` as soon as the weight is known to be smaller than that.
    """
    size, at, share = len(belief), 0, HUGE
    while at < size:
        end = min(at + 12, size)
        for h in range(at, end):
            share = min(share, (belief[h] + TINY) * inverse[h])
        if share < enough:
            return share
        at = end
    return share


@njit()
def upper(x, belief, hull, room):
    """Return the upper bound of a state at an unnormalised belief.

    A belief is a candidate for further pivots if its own weight could lower the bound by at least half as much as the
    best belief does. Smaller contributions cost more time than they improve the bound.
    """
    drop, inverse, after = hull.drop, hull.inverse, hull.after
    base = dot(hull.corner[x], belief)
    best, count = 0.0, 0
    i = hull.head[x]
    while i >= 0:
        share = _largest_weight(belief, inverse[i], 0.5 * best / drop[i])
        worth = drop[i] * share
        if worth < 0.5 * best and count < len(room.share):
            room.column[count], room.share[count] = i, share
            count += 1
        best = min(best, worth)
        i = after[i]
    if count < 2:
        return base + best
    worth = 0.0
    # More pivots would tighten the bound, but the search does more backups with cheap bounds.
    for j in range(solve(belief, hull.belief, drop, count, 1e-3 * best, np.int64(5), room)):
        worth += room.weight[j] * drop[room.used[j]]
    return base + min(best, worth)


@njit()
def add_point(x, belief, value, hull):
    """Add a bound at a belief of mass 1 to the hull, and remove the beliefs that it makes redundant.

    A stored belief is redundant if the new one alone gives at least as low a bound there.
    """
    after, head, space, drops, inverse, state = hull.after, hull.head, hull.space, hull.drop, hull.inverse, hull.state
    drop = value + rounding(len(belief)) * abs(value) - dot(hull.corner[x], belief)
    if drop >= 0.0:
        return
    new = space[1]
    if new >= 0:
        space[1] = after[new]
    else:
        new = space[0]
        space[0] += 1
    for h in range(len(belief)):
        hull.belief[new, h] = belief[h]
        inverse[new, h] = 1.0 / belief[h] if belief[h] > 1e-200 else HUGE
    drops[new], state[new] = drop, x
    before, i = NONE, head[x]
    while i >= 0:
        following = after[i]
        needed = drops[i] / drop
        if _largest_weight(hull.belief[i], inverse[new], needed) >= needed:
            if before >= 0:
                after[before] = following
            else:
                head[x] = following
            after[i], state[i], space[1] = space[1], NONE, i
        else:
            before = i
        i = following
    after[new], head[x] = head[x], new
