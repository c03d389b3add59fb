"""The upper bound of a state at a belief: the lowest value that beliefs with known bounds imply.

Let V be the value function of a state on unnormalised beliefs, `corner` an upper bound on V at the unit vectors, and
b_i beliefs with known bounds V(b_i) <= v_i. V is the supremum of the values of policies, each of which is linear in the
belief: so V is convex, and positively homogeneous.

Claim. For all weights w >= 0 with  sum_i w_i b_i <= b,

    V(b) <= corner . b + sum_i w_i d_i,     where d_i = v_i - corner . b_i.

Proof. V is subadditive, since it is convex and positively homogeneous. With r = b - sum_i w_i b_i >= 0 follows
V(b) <= sum_i w_i V(b_i) + V(r). The first term is at most sum_i w_i v_i. By the same argument V(r) <= corner . r. The
sum of both bounds is the right-hand side.

Only points with d_i < 0 improve the bound. The best weights solve a linear program. The sawtooth bound of Hauskrecht
("Value-function approximations for partially observable Markov decision processes", 2000) gives weight to one belief
only, which is the first pivot of the simplex method. The search for bounds (`hsvi`) does a few pivots more, which are
cheap and make the bound much tighter between the stored beliefs. `convex_bound` solves the program to optimality.

The weights are scaled by the weight that each point could carry alone, and the rows by the entries of b. Then all
coefficients lie between 0 and 1:

    minimise  c . u   where  A u + s = 1,  u >= 0,  s >= 0.

The simplex method works on the condensed tableau, which holds the nonbasic columns only. The final weights are checked
against both conditions of the claim, with `ABSENT` of the mass added to b. So every number of pivots, and any rounding
in them, gives a valid bound.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.decision import Floats

ABSENT = 1e-100  # share of the mass that is added to each entry of b, so that none is 0; far below rounding
FAST = {"reassoc", "contract"}


class Program(NamedTuple):
    """Work arrays of the linear program for up to m points; beliefs have H entries.

    Attributes
    ----------
    column : int array, shape (m,)
        The points.
    share : float array, shape (m,)
        The largest weight of each alone.
    table : float array, shape (m + 1, H + 1)
        The tableau by columns: those of the variables `nonbasic`, then the right-hand sides. The last row is the
        objective.
    nonbasic, basic : int arrays, shapes (m,) and (H,)
        Nonbasic and basic variables: a position in `column`, or m + h for the slack variable of entry h.
    pivot : float array, shape (H + 1,)
        Column of the entering variable.
    weight : float array, shape (H,)
        Weights of the points that have one; `used` holds them.
    used : int array, shape (H,)
    """

    column: NDArray[np.int64]
    share: Floats
    table: Floats
    nonbasic: NDArray[np.int64]
    basic: NDArray[np.int64]
    pivot: Floats
    weight: Floats
    used: NDArray[np.int64]


@njit()
def new_program(size: int, most: int = 256) -> Program:
    """Return the work arrays for beliefs with `size` entries and at most `most` points.

    The search considers at most the default number of points of a state, the most recent ones.
    """
    return Program(
        np.empty(most, np.int64), np.empty(most), np.empty((most + 1, size + 1)), np.empty(most, np.int64),
        np.empty(size, np.int64), np.empty(size + 1), np.empty(size), np.empty(size, np.int64),
    )  # fmt: skip


@njit(fastmath=FAST, inner=True)
def solve(belief: Floats, point: Floats, drop: Floats, count: int, enough: float, pivots: int, program: Program) -> int:
    """Compute the weights of the first `count` points of `program.column`; return the number of those with a weight.

    It ends if no column improves the objective by more than `enough`, or after `pivots` pivots.
    """
    column, share, table, nonbasic, basic, inverse, weight, used = program
    size, mass = len(belief), belief.sum()
    slant = 1e-11  # perturbation of the right-hand sides, so that no two basic variables reach 0 at once
    for h in range(size):
        entry = belief[h] + ABSENT * mass
        inverse[h] = 1.0 / entry if entry > 0.0 else 0.0
        table[count, h], basic[h] = 1.0 - slant * (h + 1) / size, count + h
    table[count, size] = 0.0
    for c in range(count):
        i = column[c]
        for h in range(size):
            table[c, h] = share[c] * point[i, h] * inverse[h]
        table[c, size], nonbasic[c] = share[c] * drop[i], c
    _minimise(table, basic, nonbasic, count, enough, pivots, program.pivot)
    found = 0
    left = program.pivot
    for h in range(size):
        left[h] = belief[h] + ABSENT * mass
    for h in range(size):
        if basic[h] < count and table[count, h] > 0.0:
            i = column[basic[h]]
            weight[found], used[found] = share[basic[h]] * table[count, h], i
            for k in range(size):
                left[k] -= weight[found] * point[i, k]
            found += 1
    scale = 1.0
    for h in range(size):
        if left[h] < 0.0:  # the weights violate this row and are scaled down
            entry = belief[h] + ABSENT * mass
            scale = min(scale, entry / (entry - left[h]))
    for j in range(found):
        weight[j] *= scale
    return found


@njit(fastmath=FAST, inner=True)
def _minimise(
    table: Floats, basic: NDArray[np.int64], nonbasic: NDArray[np.int64], count: int, enough: float, pivots: int,
    entering: Floats,
) -> None:  # fmt: skip
    """Pivot until no column improves the objective by more than `enough`, or until the limit of pivots."""
    rows = len(basic)
    for _ in range(pivots):
        c = 0
        for j in range(1, count):
            if table[j, rows] < table[c, rows]:
                c = j
        if count == 0 or table[c, rows] >= enough:
            return
        r = -1
        for h in range(rows):
            # Smaller entries would amplify rounding errors.
            if table[c, h] > 1e-12 and (r < 0 or table[count, h] * table[c, r] < table[count, r] * table[c, h]):
                r = h
        if r < 0:
            return
        inverse = 1.0 / table[c, r]
        for h in range(rows + 1):
            entering[h] = table[c, h]
        entering[r] = 0.0
        for j in range(count + 1):
            factor = table[j, r] * inverse
            if j != c and factor != 0.0:
                for h in range(rows + 1):
                    table[j, h] -= factor * entering[h]
                table[j, r] = factor
        for h in range(rows + 1):
            table[c, h] = -inverse * entering[h]
        table[c, r] = inverse
        basic[r], nonbasic[c] = nonbasic[c], basic[r]
