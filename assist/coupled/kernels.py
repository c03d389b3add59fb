"""Compiled loops over the steps of single agents' problems at prices."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit()
def backwards(
    indptr: Ints, target: Ints, prob: Floats, reward: Floats, use: Floats, may: NDArray[np.bool_], price: Floats,
    tail: Floats, gamma: float, heat: float,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Solve all agents' problems backwards from values `tail` after the last price.

    With `heat` > 0 the maximum over actions is heat log sum exp(Q / heat), and choices are its derivatives.

    Returns
    -------
    values : float array, shape (W + 1, n)
    chosen : float array, shape (W, A, n)
        Probability of each action.
    """
    W, (A, n) = len(price), reward.shape
    values, chosen, q = np.empty((W + 1, n)), np.empty((W, A, n)), np.empty(A)
    values[W] = tail
    for t in range(W - 1, -1, -1):
        for i in range(n):
            best, most = -math.inf, 0
            for a in range(A):
                q[a] = -math.inf
                if may[a, i]:
                    row, total = a * n + i, 0.0
                    for j in range(indptr[row], indptr[row + 1]):
                        total += prob[j] * values[t + 1, target[j]]
                    q[a] = reward[a, i] - price[t] * use[a, i] + gamma * total
                if q[a] > best:
                    best, most = q[a], a
            if heat == 0:
                for a in range(A):
                    chosen[t, a, i] = 1.0 if a == most else 0.0
                values[t, i] = best
            else:
                total = 0.0
                for a in range(A):
                    q[a] = 1.0 if a == most else math.exp((q[a] - best) / heat)
                    total += q[a]
                for a in range(A):
                    chosen[t, a, i] = q[a] / total
                values[t, i] = best + heat * math.log(total)
    return values, chosen


@njit()
def expected_uses(
    indptr: Ints, target: Ints, prob: Floats, use: Floats, chosen: Floats, weight: Floats
) -> Floats:  # fmt: skip
    """Return the expected units used at each step, shape (W,), from the numbers of agents in each state, shape (n,)."""
    W, A, n = chosen.shape
    found, now = np.zeros(W), weight.copy()
    for t in range(W):
        then = np.zeros(n)
        for i in range(n):
            if now[i] == 0:
                continue
            for a in range(A):
                share = now[i] * chosen[t, a, i]
                if share > 0:
                    found[t] += share * use[a, i]
                    row = a * n + i
                    for j in range(indptr[row], indptr[row + 1]):
                        then[target[j]] += share * prob[j]
        now = then
    return found
