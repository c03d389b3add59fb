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
def act_compiled(rows: NDArray[np.int64], people: PeopleArrays, minds: Minds, m: ProblemArrays) -> None:
    """Let the people of some rows, all of one model, act once."""
    p = np.empty(m.chosen.shape[1])
    each = 1  # number of values of theta; they are repeated for each count of outcomes
    while each < len(m.theta) and m.theta[each] > m.theta[each - 1]:
        each += 1
    for i in rows:
        x, heard, theta = people.x[i], people.heard[i], people.theta[i]
        acting, suggestion = m.afterstate[x, heard], m.suggested[x, heard]
        g = minds.goal[people.who[i]]
        if m.goal[g, acting]:
            people.x[i], people.slot[i], people.cost[i] = acting, -1, 0.0
            continue
        count = m.counts[acting]
        unaided = minds.p[people.who[i], acting]
        for a in range(count):
            p[a] = unaided[a]
        if suggestion >= 0:
            weigh_by_influence(p, count, suggestion, theta)
        slot = _draw(p, count, minds.lapse, people.uniform[i, 0])
        y = m.targets[acting, slot]
        people.slot[i], people.cost[i] = slot, m.costs[acting, slot]
        if suggestion >= 0:
            if minds.on_grid:
                t = people.outcomes[i] * each + np.searchsorted(m.theta[:each], theta)
                low, up = m.low[x, heard, g, t], m.weight[x, heard, g, t]
                if slot == suggestion:
                    low, up = m.followed_low[x, heard, g, t], m.followed_weight[x, heard, g, t]
                after_it = low + (people.uniform[i, 1] < up)
                people.theta[i], people.outcomes[i] = m.theta[after_it], after_it // each
            else:
                value = minds.value[people.who[i]]
                before, expected = value[x], value[m.targets[x, suggestion]]
                gain = 0.0 if before == expected else expected - before
                people.theta[i] = update_trust(theta, minds.eta, gain)
        people.x[i] = y


@njit()
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
