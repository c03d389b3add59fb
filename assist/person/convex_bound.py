"""The upper bound of a solution at given beliefs: the optimum of the linear program of `upper_hull`.

It is convex in the belief up to rounding.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.decision import Floats
from .rounding import compiled as rounding
from .upper_hull import ABSENT, FAST, Program, new_program, solve

PIVOTS = np.int64(5000)  # limit against cycling; rarely more than a hundred are needed, and any number gives a bound


# Reassociation lets the compiler vectorise the sums. The margin of each bound covers its effect on rounding.
@njit(fastmath=FAST)
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
    for n in range(len(x)):
        base, worth = 0.0, 0.0
        for h in range(size):
            base += corner[x[n], h] * beliefs[n, h]
        begin, end = first[x[n]], first[x[n] + 1]
        program = new_program(size, end - begin)
        for j in range(weigh(beliefs[n], base, point, drop, begin, end, pivots, program)):
            worth += program.weight[j] * drop[program.used[j]]
        value[n] = base + worth
        value[n] += rounding(2 * size) * abs(value[n])


@njit(fastmath=FAST, inner=True)
def weigh(
    belief: Floats, base: float, point: Floats, drop: Floats, begin: int, end: int, pivots: int, program: Program
) -> int:
    """Compute the weights of the points that bound the value at an unnormalised belief, shape (H,).

    The points considered are `point[begin:end]`, and `base` is the value of the corners at the belief. Return the
    number of points with a weight.
    """
    size, mass, count = len(belief), belief.sum(), np.int64(0)  # for a plain 0, callees would be compiled twice
    negligible = 1e-14  # smallest improvement of a point, or of a pivot, as a share of the bound
    inverse = program.pivot
    for h in range(size):
        entry = belief[h] + ABSENT * mass
        inverse[h] = 1.0 / entry if entry > 0.0 else 0.0
    for i in range(begin, end):
        largest = 0.0
        for h in range(size):
            largest = max(largest, point[i, h] * inverse[h])
        if largest > 0.0 and drop[i] < negligible * base * largest:
            program.share[count], program.column[count] = 1.0 / largest, i
            count += 1
    return solve(belief, point, drop, count, -negligible * abs(base), pivots, program)
