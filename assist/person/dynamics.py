"""One step of many people, compiled: their choices, their tasks, their trust, and the robot's belief.

The equations are those of `assist.people.decision` and `assist.people.belief`, applied to one person at a time instead
of whole arrays. So unnecessary work is skipped: without a suggestion trust does not change, and a choice is informative
about beta only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.decision import NOTHING, Floats
from ..people.influence_kernels import update_trust, weigh_by_influence
from .belief_filter import update
from .problem_arrays import ProblemArrays
from .reached_goals import exclude_reached


# numba accepts and caches compiled code for named tuples of arrays, but not for dataclasses.
class PeopleArrays(NamedTuple):
    """The state of N people; every array has one entry per person and is changed in place.

    Attributes
    ----------
    x : int array, shape (N,)
        Task state.
    robot : int array, shape (N,)
        Robot action towards the person; 0 is nothing.
    who : int array, shape (N,)
        Row of `Minds` with the person's choices.
    theta : float array, shape (N,)
    seen : int array, shape (N,)
        Number of outcomes of suggestions that the person has seen, if the trust rule counts them.
    uniform : float array, shape (N, 2)
        Uniform numbers in [0, 1): for the choice, and for the grid point of theta.
    belief : float array, shape (N, B, T)
        The robot's beliefs; without rows if the policy uses none.
    slot : int array, shape (N,)
        Slot of the person's choice; -1 if the robot's execution has reached the goal.
    cost : float array, shape (N,)
        Cost of the choice.
    erred : bool array, shape (N,)
        Whether the choice was not optimal: no optimal plan begins with it.
    """

    x: NDArray[np.int64]
    robot: NDArray[np.int64]
    who: NDArray[np.int64]
    theta: Floats
    seen: NDArray[np.int64]
    uniform: Floats
    belief: Floats
    slot: NDArray[np.int64]
    cost: Floats
    erred: NDArray[np.bool_]

    @classmethod
    def of_teams(
        cls, x: NDArray[np.int64], robot: NDArray[np.int64], who: NDArray[np.int64], theta: Floats,
        seen: NDArray[np.int64], uniform: Floats, belief: Floats | None, erred: NDArray[np.bool_],
    ) -> PeopleArrays:  # fmt: skip
        """Return flat views of teams' arrays, of shape (N, K, ...) in C order, with one person after the other.

        Slots and costs begin at `NOTHING` and 0.
        """
        return cls(
            x.reshape(-1), robot.reshape(-1), who.reshape(-1), theta.reshape(-1), seen.reshape(-1),
            uniform.reshape(-1, 2),
            np.empty((0, 1, 1)) if belief is None else belief.reshape(-1, *belief.shape[2:]),
            np.full(x.size, NOTHING), np.zeros(x.size), erred.reshape(-1),
        )  # fmt: skip


class Minds(NamedTuple):
    """The choices of people, and the values that their trust depends on.

    Attributes
    ----------
    p : float array, shape (m, n, A)
        Probability of each choice without a suggestion.
    value : float array, shape (m, n)
        Perceived values V(x) of equation 7.
    optimal : bool array, shape (n, A)
        Whether each choice is optimal.
    eta : float
        Rate of the trust update, divided by the unit of value.
    lapse : float
        Probability of a uniform choice.
    on_grid : bool
        Whether theta moves between grid points at random, as in the robot's model.
    """

    p: Floats
    value: Floats
    optimal: NDArray[np.bool_]
    eta: float
    lapse: float
    on_grid: bool


@njit(nogil=True)
def act(rows: NDArray[np.int64], people: PeopleArrays, minds: Minds, m: ProblemArrays) -> None:
    """Let the people of some rows, all of one model, act once."""
    p = np.empty(m.chosen.shape[1])
    after = np.empty(people.belief.shape[1:])
    has_beliefs = len(people.belief) > 0
    each = 1  # number of values of theta; they are repeated for each count of outcomes
    while each < len(m.theta) and m.theta[each] > m.theta[each - 1]:
        each += 1
    for i in rows:
        x, robot, theta = people.x[i], people.robot[i], people.theta[i]
        acting, suggestion = m.afterstate[x, robot], m.suggested[x, robot]
        if m.goal[acting]:
            people.x[i], people.slot[i], people.cost[i], people.erred[i] = acting, -1, 0.0, False
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
        people.erred[i] = not minds.optimal[acting, slot]
        if suggestion >= 0:
            if minds.on_grid:
                t = people.seen[i] * each + np.searchsorted(m.theta[:each], theta)
                low, up = m.low[x, robot, t], m.weight[x, robot, t]
                if slot == suggestion:
                    low, up = m.followed_low[x, robot, t], m.followed_weight[x, robot, t]
                after_it = low + (people.uniform[i, 1] < up)
                people.theta[i], people.seen[i] = m.theta[after_it], after_it // each
            else:
                value = minds.value[people.who[i]]
                before, expected = value[x], value[m.targets[x, suggestion]]
                gain = 0.0 if before == expected else expected - before
                people.theta[i] = update_trust(theta, minds.eta, gain)
        if has_beliefs:
            update(people.belief[i], after, x, robot, slot, m)
            if len(after) > m.chosen.shape[2] and not m.goal[y]:
                exclude_reached(people.belief[i], y, m)
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
