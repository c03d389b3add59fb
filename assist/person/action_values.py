"""Expected returns of the robot's actions in one state, where the type and theta are observed: compiled code."""

from __future__ import annotations

import numpy as np

from planner.system.jit import njit

from ..people.decision import Floats
from .problem_arrays import ProblemArrays

BEST = np.int64(-1)  # in the place of a robot action: the best one; numba would compile again for a literal


@njit()
def _without_suggestion(expected: Floats, mean: Floats, value: Floats, x: int, h: int, m: ProblemArrays) -> None:
    """Fill in the expected return without a suggestion, and that of a uniform choice (a lapse), both of shape (T,)."""
    expected[:] = 0.0
    mean[:] = 0.0
    for a in range(m.counts[x]):
        y, c, p = np.uint64(m.targets[x, a]), m.costs[x, a], m.chosen[x, a, h]
        for t in range(len(m.theta)):
            u = m.gamma * value[y, h, t] - c
            expected[t] += p * u
            mean[t] += u
    share = 1.0 / max(1, m.counts[x])
    for t in range(len(m.theta)):
        mean[t] *= share


# One function, since value iteration took 1.5 to 2 times as long with its inner loops in a function of their own.
@njit()
def action_values(
    q: Floats,
    expected: Floats,
    mean: Floats,
    declined: Floats,
    value: Floats,
    x: int,
    h: int,
    only: int,
    m: ProblemArrays,
) -> None:
    """Fill `q`, shape (R, T), with the Q-values of all robot actions (or of `only` one) in state x for one type.

    The trust update after a suggestion is the same for all choices, or for all but the suggested one if the trust rule
    uses the answer. So the returns are interpolated in the sums that `_without_suggestion` fills in, and not for each
    choice. If the suggested choice is almost certain, the sum over the other choices is recomputed, because a
    difference would lose precision. `expected`, `mean` and `declined`, shape (T,), are work arrays.
    """
    computed, g = -1, m.goal_of[h]
    for r in range(m.robot_actions[x]):
        if only >= 0 and r != only:
            continue
        slot, acting = m.suggested[x, r], m.afterstate[x, r]
        if m.goal[g, acting]:
            q[r] = -m.robot_costs[x, r]
            continue
        if acting != computed:
            _without_suggestion(expected, mean, value, acting, h, m)
            computed = acting
        if slot >= 0:
            y, c, p, rest = (
                m.targets[acting, slot],
                m.costs[acting, slot],
                m.chosen[acting, slot, h],
                m.unsuggested[x, r, h],
            )
            small = p > 0.9  # whether the difference would lose precision
            if not small:
                for t in range(len(m.theta)):
                    declined[t] = expected[t] - p * (m.gamma * value[y, h, t] - c)
                    small |= abs(declined[t]) < 0.1 * abs(expected[t])
            if small:
                declined[:] = 0.0
                for a in range(m.counts[acting]):
                    if a != slot:
                        for t in range(len(m.theta)):
                            u = m.gamma * value[m.targets[acting, a], h, t] - m.costs[acting, a]
                            declined[t] += m.chosen[acting, a, h] * u
            for t in range(len(m.theta)):
                at, up, theta = m.low[x, r, g, t], m.weight[x, r, g, t], m.theta[t]
                followed = p * (m.gamma * ((1.0 - up) * value[y, h, at] + up * value[y, h, at + 1]) - c)
                expect_declined = (1.0 - up) * declined[at] + up * declined[at + 1]
                lapsed = (1.0 - up) * mean[at] + up * mean[at + 1]
                if m.uses_answer:  # the suggested slot has a trust update of its own
                    as_declined = m.gamma * ((1.0 - up) * value[y, h, at] + up * value[y, h, at + 1]) - c
                    others = lapsed - as_declined / m.counts[acting]
                    if abs(others) < 0.1 * abs(lapsed):  # the difference would lose precision
                        others = 0.0
                        for a in range(m.counts[acting]):
                            if a != slot:
                                z = m.targets[acting, a]
                                v = (1.0 - up) * value[z, h, at] + up * value[z, h, at + 1]
                                others += (m.gamma * v - m.costs[acting, a]) / m.counts[acting]
                    at, up = m.followed_low[x, r, g, t], m.followed_weight[x, r, g, t]
                    as_followed = m.gamma * ((1.0 - up) * value[y, h, at] + up * value[y, h, at + 1]) - c
                    followed, lapsed = p * as_followed, others + as_followed / m.counts[acting]
                total = theta * p + (1.0 - theta) * rest
                e = (
                    (theta * followed + (1.0 - theta) * expect_declined) / total
                    if total > 0.0
                    else followed + expect_declined
                )
                q[r, t] = (1.0 - m.lapse) * e + m.lapse * lapsed - m.robot_costs[x, r]
        else:
            for t in range(len(m.theta)):
                q[r, t] = (1.0 - m.lapse) * expected[t] + m.lapse * mean[t] - m.robot_costs[x, r]
