"""The upper bound of a solution at given beliefs: the least that its points prove.

`hsvi` says how points with known bounds bound the value at another belief b, and gives up the linear program

    minimise  sum_i w_i d_i   where  sum_i w_i b_i <= b,  w >= 0

after a few pivots. Here it is solved to the end, so that the bound is convex in the belief, up to rounding. In units of
the weight that each point could carry alone, and of the entries of b, all numbers are between 0 and 1:

    minimise  c . u   where  A u + s = 1,  u >= 0,  s >= 0

The simplex method works on the table of that, condensed to the columns that are not in the basis. Whatever rounding
does to the table, the weights are checked in the end: any that keep the two conditions give a bound.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.decision import Floats
from .qmdp import ROUNDING

PIVOTS = (
    5000  # hardly ever more than a hundred are needed; a bound that stops short, should they go in circles, is valid
)
NEGLIGIBLE = 1e-14  # share of the bound that a point, or a pivot, must be able to take off
LEAST = 1e-12  # an entry of the table that is pivoted on
SLANT = 1e-11  # the right-hand sides are moved apart by this, so that no two points leave the basis at once
ABSENT = 1e-100  # share of the mass that is added to each entry of b, so that none is 0: far below rounding


# Sums may be taken in any order: what that does to rounding is covered by the margin of each bound.
@njit(fastmath={"reassoc", "contract"})
def uppers(
    value: Floats,
    x: NDArray[np.int64],
    beliefs: Floats,
    corner: Floats,
    point: Floats,
    drop: Floats,
    first: NDArray[np.int64],
    pivots: int,
) -> None:
    """Fill in the upper bounds, shape (N,), of states at unnormalised beliefs, shape (N, H).

    The points of state s, shape (H,) each, are those from `first[s]` to `first[s + 1]`, and the bound there is by
    `drop` below what the corners of s, shape (H,), give.
    """
    size = beliefs.shape[1]
    weight, used = np.empty(size), np.empty(size, np.int64)
    for n in range(len(x)):
        base, worth = 0.0, 0.0
        for h in range(size):
            base += corner[x[n], h] * beliefs[n, h]
        for j in range(weigh(weight, used, beliefs[n], base, point, drop, first[x[n]], first[x[n] + 1], pivots)):
            worth += weight[j] * drop[used[j]]
        value[n] = base + worth
        value[n] += ROUNDING * abs(value[n])


@njit(fastmath={"reassoc", "contract"})
def weigh(
    weight: Floats,
    used: NDArray[np.int64],
    belief: Floats,
    base: float,
    point: Floats,
    drop: Floats,
    begin: int,
    end: int,
    pivots: int,
) -> int:
    """Fill in the weights, shape (H,), of the points that bound the value at an unnormalised belief, shape (H,).

    They are among those from `begin` to `end`, and `base` is what the corners give. Returns how many are used.
    """
    size, mass = len(belief), belief.sum()
    table, left, inverse = np.empty((size + 1, end - begin + 1)), np.empty(size), np.empty(size)
    share, column = np.empty(end - begin), np.empty(end - begin, np.int64)
    basic, free = np.empty(size, np.int64), np.empty(end - begin, np.int64)
    for h in range(size):
        left[h] = belief[h] + ABSENT * mass
        inverse[h] = 1.0 / left[h] if left[h] > 0.0 else 0.0
    count = 0
    for i in range(begin, end):
        largest = 0.0
        for h in range(size):
            largest = max(largest, point[i, h] * inverse[h])
        if largest > 0.0 and drop[i] < NEGLIGIBLE * base * largest:
            share[count], column[count] = 1.0 / largest, i
            count += 1
    for c in range(count):
        table[size, c], free[c] = share[c] * drop[column[c]], c
    for h in range(size):
        for c in range(count):
            table[h, c] = share[c] * point[column[c], h] * inverse[h]
        table[h, count], basic[h] = 1.0 - SLANT * (h + 1) / size, count + h
    table[size, count] = 0.0
    _minimise(table, basic, free, count, -NEGLIGIBLE * abs(base), pivots)
    found = 0
    for h in range(size):
        if basic[h] < count and table[h, count] > 0.0:
            i = column[basic[h]]
            weight[found], used[found] = share[basic[h]] * table[h, count], i
            for k in range(size):
                left[k] -= weight[found] * point[i, k]
            found += 1
    scale = 1.0
    for h in range(size):
        if left[h] < 0.0:  # then the weights are that much too large
            entry = belief[h] + ABSENT * mass
            scale = min(scale, entry / (entry - left[h]))
    for j in range(found):
        weight[j] *= scale
    return found


@njit(fastmath={"reassoc", "contract"})
def _minimise(
    table: Floats, basic: NDArray[np.int64], free: NDArray[np.int64], count: int, enough: float, pivots: int
) -> None:
    """Pivot until no column can take off more than `enough`, or so many times.

    The rows are the variables `basic` and the costs, the columns the variables `free` and the right-hand sides.
    """
    rows = len(basic)
    for _ in range(pivots):
        c = 0
        for j in range(1, count):
            if table[rows, j] < table[rows, c]:
                c = j
        if count == 0 or table[rows, c] >= enough:
            return
        r = -1
        for h in range(rows):
            if table[h, c] > LEAST and (r < 0 or table[h, count] * table[r, c] < table[r, count] * table[h, c]):
                r = h
        if r < 0:
            return
        pivot = 1.0 / table[r, c]
        for j in range(count + 1):
            table[r, j] *= pivot
        table[r, c] = pivot
        for h in range(rows + 1):
            factor = table[h, c]
            if h != r and factor != 0.0:
                table[h, c] = 0.0
                for j in range(count + 1):
                    table[h, j] -= factor * table[r, j]
        basic[r], free[c] = free[c], basic[r]
