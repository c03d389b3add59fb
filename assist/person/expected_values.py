"""Expected Q-values under beliefs, from those with observed type and theta: compiled, and for few in numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.decision import Floats
from .problem_arrays import read_only


def expected(table: Floats, robot_actions: NDArray[np.int64], x: NDArray[np.int64], belief: Floats) -> Floats:
    """Return the expected Q-value of each robot action, shape (N, R); minus infinity in padding.

    Parameters
    ----------
    table : float array, shape (n, R, H, T)
        Q-values with observed type and theta.
    robot_actions : int array, shape (n,)
        Number of robot actions in each state.
    x : int array, shape (N,)
    belief : float array, shape (N, H, T)
    """
    q, flat = np.full((len(x), table.shape[1]), -np.inf), table.reshape(*table.shape[:2], -1)
    _expected(
        q, read_only(x, np.int64), read_only(belief, float).reshape(len(x), -1), read_only(flat),
        read_only(robot_actions),
    )  # fmt: skip
    return q


def expected_of_few(table: Floats, robot_actions: NDArray[np.int64], x: NDArray[np.int64], belief: Floats) -> Floats:
    """Return what `expected` does, in numpy, for small problems."""
    found, count = np.full((len(x), table.shape[1]), -np.inf), robot_actions[x]
    rows, cells = table.reshape(*table.shape[:2], -1), belief.reshape(len(x), -1)
    for r in range(table.shape[1]):
        own = np.flatnonzero(count > r)
        terms = rows[x[own], r]
        terms *= cells if len(own) == len(x) else cells[own]  # large copies take longer than the sums
        found[own, r] = terms.sum(axis=1)
    return found


@njit(nogil=True, fastmath={"reassoc", "contract"})
def _expected(q: Floats, x: NDArray[np.int64], belief: Floats, table: Floats, actions: NDArray[np.int64]) -> None:
    """Fill `q`, shape (N, R), with the expected entries of a table of shape (n, R, H * T)."""
    for i in range(len(x)):
        b = belief[i]
        for r in range(actions[x[i]]):
            row = table[x[i], r]
            total = 0.0
            for cell in range(len(b)):
                total += b[cell] * row[cell]
            q[i, r] = total
