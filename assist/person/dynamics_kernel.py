"""One step of many people, compiled: `dynamics.act_readable`, one person at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.decision import Floats
from ..people.influence_kernels import update_trust, weigh_by_influence
from .people_arrays import Minds, PeopleArrays
from .problem_arrays import ProblemArrays


@njit(nogil=True)
def act_compiled(people: NDArray[np.int64], them: PeopleArrays, minds: Minds, m: ProblemArrays) -> None:
    """Let some people, all of one model, act once."""
    p = np.empty(m.chosen.shape[1])
    each = 1  # number of values of theta; they are repeated for each count of outcomes
    while each < len(m.theta) and m.theta[each] > m.theta[each - 1]:
        each += 1
    for i in people:
        x, heard, theta = them.x[i], them.heard[i], them.theta[i]
        acting, suggestion = m.afterstate[x, heard], m.suggested[x, heard]
        g = minds.goal[them.who[i]]
        if m.goal[g, acting]:
            them.x[i], them.slot[i], them.cost[i] = acting, -1, 0.0
            continue
        count = m.counts[acting]
        unaided = minds.p[them.who[i], acting]
        for a in range(count):
            p[a] = unaided[a]
        if suggestion >= 0:
            weigh_by_influence(p, count, suggestion, theta)
        slot = _draw(p, count, minds.lapse, them.uniform[i, 0])
        y = m.targets[acting, slot]
        them.slot[i], them.cost[i] = slot, m.costs[acting, slot]
        if minds.on_grid:
            if m.moves[x, heard]:
                t = them.outcomes[i] * each + np.searchsorted(m.theta[:each], theta)
                low, up = m.low[x, heard, g, t], m.weight[x, heard, g, t]
                if slot == suggestion:
                    low, up = m.followed_low[x, heard, g, t], m.followed_weight[x, heard, g, t]
                after_it = low + (them.uniform[i, 1] < up)
                them.theta[i], them.outcomes[i] = m.theta[after_it], after_it // each
        elif suggestion >= 0:
            value = minds.value[them.who[i]]
            before, expected = value[x], value[m.targets[x, suggestion]]
            gain = 0.0 if before == expected else expected - before
            them.theta[i] = update_trust(theta, minds.eta, gain)
        them.x[i] = y


@njit(inner=True)
def _draw(p: Floats, count: int, lapse: float, uniform: float) -> int:
    """Return the first slot whose cumulative probability exceeds a uniform number."""
    total = 0.0
    for a in range(count):
        total += p[a]
    remaining = uniform
    last = 0
    for a in range(count):
        chance = (1.0 - lapse) * p[a] / total + lapse / count
        if chance > 0.0:  # rounding must not select a choice of probability 0
            last = a
            remaining -= chance
            if remaining < 0.0:
                break
    return last
