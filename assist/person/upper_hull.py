"""The upper bound of a solution at given beliefs: the lowest value that its points imply.

`hsvi` states and proves how points with known bounds bound the value function at another belief b. It stops after a few
pivots of the linear program

    minimise  sum_i w_i d_i   where  sum_i w_i b_i <= b,  w >= 0.

This module solves the program to optimality, so that the bound is convex in the belief up to rounding. The weights are
scaled by the weight that each point could carry alone, and the rows by the entries of b. Then all coefficients lie
between 0 and 1:

    minimise  c . u   where  A u + s = 1,  u >= 0,  s >= 0.

The simplex method works on the condensed tableau, which holds the nonbasic columns only. The final weights are checked
against both conditions, so that rounding in the tableau cannot invalidate the bound.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.decision import Floats
from .qmdp import ROUNDING

PIVOTS = 5000  # limit against cycling; rarely more than a hundred are needed, and the bound is valid after any number


# Reassociation lets the compiler vectorise the sums. The margin of each bound covers its effect on rounding.
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

    The points of state s are `point[first[s] : first[s + 1]]`, shape (H,) each. `drop` is the bound at a point minus
    the value of the corners of s, shape (H,), there.
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

    The points considered are `point[begin:end]`, and `base` is the value of the corners at the belief. Return the
    number of points with a weight; `used` holds them.
    """
    size, mass = len(belief), belief.sum()
    absent = 1e-100  # share of the mass that is added to each entry of b, so that none is 0; far below rounding
    negligible = 1e-14  # smallest improvement of a point, or of a pivot, as a share of the bound
    slant = 1e-11  # perturbation of the right-hand sides, so that no two basic variables reach 0 at once
    table, left, inverse = np.empty((size + 1, end - begin + 1)), np.empty(size), np.empty(size)
    share, column = np.empty(end - begin), np.empty(end - begin, np.int64)
    basic, free = np.empty(size, np.int64), np.empty(end - begin, np.int64)
    for h in range(size):
        left[h] = belief[h] + absent * mass
        inverse[h] = 1.0 / left[h] if left[h] > 0.0 else 0.0
    count = 0
    for i in range(begin, end):
        largest = 0.0
        for h in range(size):
            largest = max(largest, point[i, h] * inverse[h])
        if largest > 0.0 and drop[i] < negligible * base * largest:
            share[count], column[count] = 1.0 / largest, i
            count += 1
    for c in range(count):
        table[size, c], free[c] = share[c] * drop[column[c]], c
    for h in range(size):
        for c in range(count):
            table[h, c] = share[c] * point[column[c], h] * inverse[h]
        table[h, count], basic[h] = 1.0 - slant * (h + 1) / size, count + h
    table[size, count] = 0.0
    _minimise(table, basic, free, count, -negligible * abs(base), pivots)
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
        if left[h] < 0.0:  # the weights violate this row and are scaled down
            entry = belief[h] + absent * mass
            scale = min(scale, entry / (entry - left[h]))
    for j in range(found):
        weight[j] *= scale
    return found


@njit(fastmath={"reassoc", "contract"})
def _minimise(
    table: Floats, basic: NDArray[np.int64], free: NDArray[np.int64], count: int, enough: float, pivots: int
) -> None:
    """Pivot until no column improves the objective by more than `enough`, or until the limit of pivots.

    The rows of the tableau are the basic variables and the objective. Its columns are the nonbasic variables `free` and
    the right-hand sides.
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
            # Smaller entries would amplify rounding errors.
            if table[h, c] > 1e-12 and (r < 0 or table[h, count] * table[r, c] < table[r, count] * table[h, c]):
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
