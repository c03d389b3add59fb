"""Bellman backups of all values at a time, for problems with one more step."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit
from planner.system.machine import processors

from ..people.decision import Floats
from ..person.action_values import BEST, action_values
from ..person.pomdp import AssistPOMDP
from ..person.problem_arrays import ProblemArrays, read_only
from ..person.qmdp import sweep_order


def bellman_backup(pomdp: AssistPOMDP, value: Floats) -> Floats:
    """Return the Bellman backup of values, shape (n, B, T), for a problem with one more step.

    The values of final states do not change.
    """
    arrays, order, found = ProblemArrays.of(pomdp), read_only(sweep_order(pomdp)), value.copy()
    with ThreadPoolExecutor(processors()) as pool:
        list(pool.map(lambda b: _backup(found, value, order, b, arrays), range(value.shape[1])))
    return found


@njit(nogil=True)
def _backup(found: Floats, value: Floats, order: NDArray[np.int64], b: int, m: ProblemArrays) -> None:
    """Fill `found` with the Bellman backups of `value`, for one beta."""
    thetas = len(m.theta)
    q = np.empty((m.suggested.shape[1], thetas))
    expected, mean, declined = np.empty(thetas), np.empty(thetas), np.empty(thetas)
    for x in order:
        action_values(q, expected, mean, declined, value, x, b, BEST, m)
        for t in range(thetas):
            found[x, b, t] = q[0, t]
            for r in range(1, m.robot_actions[x]):
                found[x, b, t] = max(found[x, b, t], q[r, t])
