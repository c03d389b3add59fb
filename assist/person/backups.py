"""Bellman backups of all values at a time, for problems with one more step."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit
from planner.system.limits import processors

from ..people.decision import Floats
from .action_values import BEST, action_values, new_work
from .mdp_values import sweep_order
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays, read_only


def bellman_backup(pomdp: AssistPOMDP, value: Floats) -> Floats:
    """Return the Bellman backup of values, shape (n, H, T), for a problem with one more step.

    The values of final states do not change.
    """
    arrays, found = ProblemArrays.of(pomdp), value.copy()
    orders = [read_only(sweep_order(pomdp, goal)) for goal in range(len(pomdp.final))]
    with ThreadPoolExecutor(processors()) as pool:
        types = enumerate(arrays.goal_of.tolist())
        list(pool.map(lambda one: _backup(found, value, orders[one[1]], one[0], arrays), types))
    return found


@njit(nogil=True)
def _backup(found: Floats, value: Floats, order: NDArray[np.int64], h: int, m: ProblemArrays) -> None:
    """Fill `found` with the Bellman backups of `value`, for one type."""
    thetas = len(m.theta)
    work = new_work(m.suggested.shape[1], thetas)
    for x in order:
        action_values(work, value, x, h, BEST, m)
        for t in range(thetas):
            found[x, h, t] = work.q[0, t]
            for r in range(1, m.robot_actions[x]):
                found[x, h, t] = max(found[x, h, t], work.q[r, t])
