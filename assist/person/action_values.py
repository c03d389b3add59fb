"""Expected returns of the robot's actions in one state, where the type and theta are observed: compiled code.

The function is written so that it compiles fast. Loops over theta stand in the place of whole-array forms (a[:] = b),
which would add numba's code for broadcasting and for its error messages. Fields of the problem that are read often are
names of their own, because each look-up is compiled again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner.system.jit import njit

from ..people.decision import Floats
from .problem_arrays import ProblemArrays

BEST = np.int64(-1)  # in the place of a robot action: the best one; numba would compile again for a literal


class Work(NamedTuple):
    """The Q-values of one state, shape (R, T), and arrays of shape (T,) that their computation needs."""

    q: Floats
    expected: Floats
    mean: Floats
    declined: Floats


@njit(inner=True)
def new_work(actions: int, thetas: int) -> Work:
    """Return empty arrays for a number of robot actions and of thetas."""
    return Work(np.empty((actions, thetas)), np.empty(thetas), np.empty(thetas), np.empty(thetas))


# One function, since value iteration took 1.5 to 2 times as long with its inner loops in a function of their own.
@njit(error_model="numpy", inner=True)
def action_values(work: Work, value: Floats, x: int, h: int, only: int, m: ProblemArrays) -> None:
    """Fill `work.q` with the Q-values of all robot actions (or of `only` one) in state x for one type.

    The trust update is the same for all choices, or for all but the suggested one if the trust rule
    uses the answer. So the returns are interpolated in the sums without a suggestion, and not for each choice:
    `expected`, the expected return, and `mean`, that of a uniform choice (a lapse). If the suggested choice is almost
    certain, the sum over the other choices is recomputed, because a difference would lose precision.
    """
    q, expected, mean, declined = work
    computed, g = -1, m.goal_of[h]
    targets, costs, chosen, counts, robot_costs = m.targets, m.costs, m.chosen, m.counts, m.robot_costs
    thetas, gamma, lapse = len(m.theta), m.gamma, m.lapse
    for r in range(m.robot_actions[x]):
        if only >= 0 and r != only:
            continue
        slot, acting = m.suggested[x, r], m.afterstate[x, r]
        if m.goal[g, acting]:
            for t in range(thetas):
                q[r, t] = -robot_costs[x, r]
            continue
        count = counts[acting]
        if acting != computed:
            computed = acting
            for t in range(thetas):
                expected[t], mean[t] = 0.0, 0.0
            for a in range(count):
                z, c, p = np.uint64(targets[acting, a]), costs[acting, a], chosen[acting, a, h]
                for t in range(thetas):
                    u = gamma * value[z, h, t] - c
                    expected[t] += p * u
                    mean[t] += u
            if count > 0:
                for t in range(thetas):
                    mean[t] /= count
        if slot < 0:
            for t in range(thetas):
                e, lapsed = expected[t], mean[t]
                if m.moves[x, r]:
                    at, up = m.low[x, r, g, t], m.weight[x, r, g, t]
                    e, lapsed = (1.0 - up) * expected[at], (1.0 - up) * mean[at]
                    e, lapsed = e + up * expected[at + 1], lapsed + up * mean[at + 1]
                q[r, t] = (1.0 - lapse) * e + lapse * lapsed - robot_costs[x, r]
            continue
        y, c, p, rest = targets[acting, slot], costs[acting, slot], chosen[acting, slot, h], m.unsuggested[x, r, h]
        small = p > 0.9  # whether the difference would lose precision
        if not small:
            for t in range(thetas):
                declined[t] = expected[t] - p * (gamma * value[y, h, t] - c)
                small |= abs(declined[t]) < 0.1 * abs(expected[t])
        if small:
            for t in range(thetas):
                declined[t] = 0.0
            for a in range(count):
                if a != slot:
                    for t in range(thetas):
                        u = gamma * value[targets[acting, a], h, t] - costs[acting, a]
                        declined[t] += chosen[acting, a, h] * u
        for t in range(thetas):
            at, up, theta = m.low[x, r, g, t], m.weight[x, r, g, t], m.theta[t]
            as_followed = gamma * ((1.0 - up) * value[y, h, at] + up * value[y, h, at + 1]) - c
            expect_declined = (1.0 - up) * declined[at] + up * declined[at + 1]
            lapsed = (1.0 - up) * mean[at] + up * mean[at + 1]
            if m.uses_answer:  # the suggested slot has a trust update of its own
                others = lapsed - as_followed / count
                if abs(others) < 0.1 * abs(lapsed):  # the difference would lose precision
                    others = 0.0
                    for a in range(count):
                        if a != slot:
                            z = np.uint64(targets[acting, a])
                            v = (1.0 - up) * value[z, h, at] + up * value[z, h, at + 1]
                            others += (gamma * v - costs[acting, a]) / count
                at, up = m.followed_low[x, r, g, t], m.followed_weight[x, r, g, t]
                as_followed = gamma * ((1.0 - up) * value[y, h, at] + up * value[y, h, at + 1]) - c
                lapsed = others + as_followed / count
            followed = p * as_followed
            total = theta * p + (1.0 - theta) * rest
            e = (
                (theta * followed + (1.0 - theta) * expect_declined) / total
                if total > 0.0
                else followed + expect_declined
            )
            q[r, t] = (1.0 - lapse) * e + lapse * lapsed - robot_costs[x, r]
