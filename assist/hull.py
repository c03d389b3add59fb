"""An upper bound on the value at every belief, from its values at some.

The value of one person's problem in a state is a convex and homogeneous function of the (unnormalised) belief, so
that weights w >= 0 with  sum_i w_i b_i <= b  give

    V(b) <= corner . b + sum_i w_i d_i,     d_i = v_i - corner . b_i <= 0,

where V(b_i) <= v_i is known and `corner` bounds the value at the corners of the simplex. The best weights solve a
linear program. The sawtooth of Hauskrecht ("Value-function approximations for partially observable Markov
decision processes", 2000) lets one belief at a time carry weight: that is the simplex method's first pivot. Here
some more pivots follow, which is cheap, since a basis has few beliefs and the costs of all slacks are zero, and
makes the bound much tighter between beliefs. Whatever pivots and rounding do, the weights are checked in
the end: any that keep the two conditions give a bound.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from .human import Floats
from .mdp import ROUNDING

PIVOTS = 5
CANDIDATES = 256  # the latest beliefs of a state that a bound may rest on
RELEVANT = 0.1  # beliefs that could lower the bound by less than this share of what one can are left aside
NONE = -1
TINY, HUGE = 1e-290, 1e300  # TINY * HUGE is large, so that an empty entry of both beliefs never binds
FAST = {"reassoc", "contract", "nsz", "nnan"}


class Hull(NamedTuple):
    """Beliefs with values, as linked lists, one for each state.

    Attributes
    ----------
    corner : float array, shape (n, H)
        Upper bounds where the hidden state is known, H = B * T.
    belief, inverse : float arrays, shape (capacity, H)
        Beliefs of mass 1, and one over each entry.
    drop : float array, shape (capacity,)
        The bound at each belief less what the corners give; below 0.
    state, after : int arrays, shape (capacity,)
        Whose belief it is (-1: free), and the next one of the same state (or the next free one).
    head : int array, shape (n,)
        The first belief of each state.
    space : int array, shape (2,)
        Places that have been used, and the first free one among them.
    """

    corner: Floats
    belief: Floats
    inverse: Floats
    drop: Floats
    state: NDArray[np.int32]
    after: NDArray[np.int32]
    head: NDArray[np.int32]
    space: NDArray[np.int64]


class Room(NamedTuple):
    """Room for a linear program: candidates, their possible worth, and a basis."""

    candidate: NDArray[np.int32]
    worth: Floats
    basis: NDArray[np.int32]
    row: NDArray[np.int64]
    weight: Floats
    dual: Floats
    direction: Floats
    matrix: Floats
    left: Floats
    change: Floats


def empty(corner: Floats, capacity: int) -> Hull:
    """Make a hull of the corners only."""
    states, size = corner.shape
    return Hull(
        corner, np.empty((capacity, size)), np.empty((capacity, size)), np.empty(capacity),
        np.full(capacity, NONE, dtype=np.int32), np.full(capacity, NONE, dtype=np.int32),
        np.full(states, NONE, dtype=np.int32), np.array([0, NONE]),
    )  # fmt: skip


@numba.njit(cache=True)
def room(size):
    """Make room for `upper` at beliefs of so many numbers."""
    k = PIVOTS + 1
    return Room(
        np.empty(CANDIDATES, np.int32), np.empty(CANDIDATES), np.empty(k, np.int32), np.empty(k, np.int64),
        np.empty(k), np.empty(k), np.empty(k), np.empty((k, k)), np.empty(size), np.empty(size),
    )  # fmt: skip


# Sums may be taken in any order: what that does to rounding is covered by the margin of each backup.
@numba.njit(cache=True, fastmath=FAST)
def dot(a, b):
    """Give a . b."""
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@numba.njit(cache=True, fastmath=FAST)
def _share(belief, inverse, enough):
    """Give the largest weight of a belief within another, or something below `enough` once it cannot reach that."""
    size, at, share = len(belief), 0, HUGE
    while at < size:
        end = min(at + 12, size)
        for h in range(at, end):
            share = min(share, (belief[h] + TINY) * inverse[h])
        if share < enough:
            return share
        at = end
    return share


@numba.njit(cache=True)
def upper(x, belief, hull, room):
    """Give the upper bound of a state at an unnormalised belief."""
    base = dot(hull.corner[x], belief)
    best, first, count = 0.0, NONE, 0
    i = hull.head[x]
    while i >= 0:
        worth = hull.drop[i] * _share(belief, hull.inverse[i], RELEVANT * best / hull.drop[i])
        if worth < RELEVANT * best and count < CANDIDATES:
            room.candidate[count], room.worth[count] = i, worth
            count += 1
        if worth < best:
            best, first = worth, i
        i = hull.after[i]
    if count < 2:
        return base + best
    return base + min(best, _pivot(belief, first, best, count, hull, room))


@numba.njit(cache=True)
def _pivot(belief, first, best, count, hull, room):
    """Improve on the weight of one belief by the simplex method; return what the weights found are worth.

    Basic columns are the beliefs `basis`, and all slacks but those of the entries `row`.
    """
    basis, row, weight, dual, direction, matrix = (
        room.basis, room.row, room.weight, room.dual, room.direction, room.matrix,
    )  # fmt: skip
    left, change = room.left, room.change
    k = 1
    basis[0], row[0], weight[0] = first, 0, best / hull.drop[first]
    smallest = HUGE
    for h in range(len(belief)):
        share = (belief[h] + TINY) * hull.inverse[first, h]
        if share < smallest:
            smallest, row[0] = share, h
    for _ in range(PIVOTS):
        for j in range(k):
            dual[j] = hull.drop[basis[j]]
            for r in range(k):
                matrix[j, r] = hull.belief[basis[j], row[r]]
        if not _eliminate(matrix, dual, k):
            break
        enter, slack = _price(belief, best, count, k, hull, room)
        if enter == NONE and slack == NONE:
            break
        for r in range(k):
            for j in range(k):
                matrix[r, j] = hull.belief[basis[j], row[r]]
            direction[r] = 1.0 if r == slack else 0.0
            if enter >= 0:
                direction[r] = hull.belief[enter, row[r]]
        if not _eliminate(matrix, direction, k):
            break
        step, leave = HUGE, NONE
        for j in range(k):
            if direction[j] > 1e-12 and weight[j] < step * direction[j]:
                step, leave = weight[j] / direction[j], j
        bound = NONE
        left[:] = belief
        if enter >= 0:
            change[:] = hull.belief[enter]
        else:
            change[:] = 0.0
        for j in range(k):
            _subtract(left, weight[j], hull.belief[basis[j]])
            _subtract(change, direction[j], hull.belief[basis[j]])
        for r in range(k):  # the slacks of these are not in the basis
            change[row[r]] = 0.0
        for h in range(len(belief)):
            if change[h] > 1e-12 and left[h] < step * change[h]:
                step, bound = max(left[h], 0.0) / change[h], h
        if step >= HUGE:
            break
        for j in range(k):
            weight[j] -= step * direction[j]
        if bound >= 0 and enter >= 0:
            basis[k], row[k], weight[k] = enter, bound, step
            k += 1
        elif bound >= 0:
            row[slack] = bound
        elif enter >= 0:
            basis[leave], weight[leave] = enter, step
        elif k == 1:
            break
        else:
            k -= 1
            basis[leave], weight[leave], row[slack] = basis[k], weight[k], row[k]
    worth, scale = 0.0, 1.0
    left[:] = 0.0
    for j in range(k):
        weight[j] = max(weight[j], 0.0)
        worth += weight[j] * hull.drop[basis[j]]
        _subtract(left, -weight[j], hull.belief[basis[j]])
    for h in range(len(belief)):
        if left[h] > belief[h]:
            scale = min(scale, belief[h] / left[h])
    return worth * scale


@numba.njit(cache=True, fastmath=FAST)
def _subtract(a, factor, b):
    """Take factor * b from a."""
    for i in range(len(a)):
        a[i] -= factor * b[i]


@numba.njit(cache=True)
def _price(belief, best, count, k, hull, room):
    """Give the candidate, or else the position in `row` of the slack, that promises most; `NONE` for neither."""
    enter, slack, most = NONE, NONE, 1e-3 * best
    for c in range(count):
        i = room.candidate[c]
        reduced = hull.drop[i]
        for r in range(k):
            reduced -= room.dual[r] * hull.belief[i, room.row[r]]
        gain = reduced * room.worth[c] / hull.drop[i]
        if reduced < 0.0 and gain < most:
            enter, most = i, gain
    if enter == NONE:
        for r in range(k):
            gain = -room.dual[r] * belief[room.row[r]]
            if gain < most:
                slack, most = r, gain
    return enter, slack


@numba.njit(cache=True)
def _eliminate(a, y, k):
    """Solve a z = y in place by Gaussian elimination; return whether a is regular."""
    for c in range(k):
        p = c
        for r in range(c + 1, k):
            if abs(a[r, c]) > abs(a[p, c]):
                p = r
        if abs(a[p, c]) < 1e-14:
            return False
        if p != c:
            for j in range(k):
                a[p, j], a[c, j] = a[c, j], a[p, j]
            y[p], y[c] = y[c], y[p]
        for r in range(c + 1, k):
            factor = a[r, c] / a[c, c]
            for j in range(c, k):
                a[r, j] -= factor * a[c, j]
            y[r] -= factor * y[c]
    for c in range(k - 1, -1, -1):
        for j in range(c + 1, k):
            y[c] -= a[c, j] * y[j]
        y[c] /= a[c, c]
    return True


@numba.njit(cache=True)
def add(x, belief, value, hull):
    """Add the bound at a belief of mass 1, and remove beliefs that it makes superfluous."""
    drop = value + ROUNDING * abs(value) - dot(hull.corner[x], belief)
    if drop >= 0.0:
        return
    new = hull.space[1]
    if new >= 0:
        hull.space[1] = hull.after[new]
    else:
        new = hull.space[0]
        hull.space[0] += 1
    for h in range(len(belief)):
        hull.belief[new, h] = belief[h]
        hull.inverse[new, h] = 1.0 / belief[h] if belief[h] > 1e-200 else HUGE
    hull.drop[new], hull.state[new] = drop, x
    before, i = NONE, hull.head[x]
    while i >= 0:
        following = hull.after[i]
        needed = hull.drop[i] / drop
        if _share(hull.belief[i], hull.inverse[new], needed) >= needed:
            if before >= 0:
                hull.after[before] = following
            else:
                hull.head[x] = following
            hull.after[i], hull.state[i], hull.space[1] = hull.space[1], NONE, i
        else:
            before = i
        i = following
    hull.after[new], hull.head[x] = hull.head[x], new


@numba.njit(cache=True)
def uppers(value, x, beliefs, hull):
    """Fill in the upper bounds, shape (N,), of states at beliefs, shape (N, H)."""
    space = room(beliefs.shape[1])
    for i in range(len(x)):
        v = upper(x[i], beliefs[i], hull, space)
        value[i] = v + ROUNDING * abs(v)
