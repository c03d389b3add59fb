"""One step of many people, compiled: they choose, their tasks and trust move on, and so does the belief in them.

The same equations as in `assist.people.decision` and `assist.people.belief`, one person at a time instead of one array
at a time, so that nothing is computed that is not needed: without a suggestion trust stays as it is, and what a person
does tells of beta only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.decision import NOTHING, Floats
from ..people.influence_kernels import heed, moved
from ..person.belief_filter import update
from ..person.problem_arrays import ProblemArrays


# Named tuples, however long: they are the only records of arrays that compiled code takes and that are kept compiled.
class PeopleArrays(NamedTuple):
    """Many people in whatever state their task is; one entry for each in every array, changed in place.

    Attributes
    ----------
    x : int array, shape (N,)
    robot : int array, shape (N,)
        What the robot does to each: a robot action, 0 is nothing.
    who : int array, shape (N,)
        The row of `Minds` that holds how they choose.
    theta : float array, shape (N,)
    luck : float array, shape (N, 2)
        Uniform in [0, 1): the first decides what they choose, the second to which point of a grid theta moves.
    belief : float array, shape (N, B, T)
        Of no rows where nobody keeps one.
    slot : int array, shape (N,)
        What they did; -1 where the robot's execution reached the goal and nothing was left to do.
    cost : float array, shape (N,)
        What they spent.
    erred : bool array, shape (N,)
        Whether their action was not an optimal choice: no cheapest way to the goal begins with it.
    """

    x: NDArray[np.int64]
    robot: NDArray[np.int64]
    who: NDArray[np.int64]
    theta: Floats
    luck: Floats
    belief: Floats
    slot: NDArray[np.int64]
    cost: Floats
    erred: NDArray[np.bool_]

    @classmethod
    def of_teams(
        cls, x: NDArray[np.int64], robot: NDArray[np.int64], who: NDArray[np.int64], theta: Floats, luck: Floats,
        belief: Floats | None, erred: NDArray[np.bool_],
    ) -> PeopleArrays:  # fmt: skip
        """Give teams' people one after the other; arrays of shape (N, K, ...) in C order, of which these are views.

        Who has done nothing yet has spent nothing.
        """
        return cls(
            x.reshape(-1), robot.reshape(-1), who.reshape(-1), theta.reshape(-1), luck.reshape(-1, 2),
            np.empty((0, 1, 1)) if belief is None else belief.reshape(-1, *belief.shape[2:]),
            np.full(x.size, NOTHING), np.zeros(x.size), erred.reshape(-1),
        )  # fmt: skip


class Minds(NamedTuple):
    """How people choose, and what their trust looks at.

    Attributes
    ----------
    p : float array, shape (m, n, A)
        The chance of each choice where nothing is suggested.
    value : float array, shape (m, n)
        Perceived values.
    optimal : bool array, shape (n, A)
        Which choices a cheapest way to the goal begins with.
    eta : float
        Rate of the trust update, divided by the unit of value.
    lapse : float
        Weight of a uniform choice.
    on_grid : bool
        Theta moves between points of the grid, by chance, as the robot's model has it.
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
    after = np.empty((m.chosen.shape[2], len(m.theta)))
    believed = len(people.belief) > 0
    for i in rows:
        x, robot, theta = people.x[i], people.robot[i], people.theta[i]
        place, suggestion = m.afterstate[x, robot], m.suggested[x, robot]
        if m.goal[place]:
            people.x[i], people.slot[i], people.cost[i], people.erred[i] = place, -1, 0.0, False
            continue
        count = m.counts[place]
        alone = minds.p[people.who[i], place]
        for a in range(count):
            p[a] = alone[a]
        if suggestion >= 0:
            heed(p, count, suggestion, theta)
        slot = _draw(p, count, minds.lapse, people.luck[i, 0])
        y = m.targets[place, slot]
        people.slot[i], people.cost[i] = slot, m.costs[place, slot]
        people.erred[i] = not minds.optimal[place, slot]
        if suggestion >= 0:
            if minds.on_grid:
                t = np.searchsorted(m.theta, theta)
                people.theta[i] = m.theta[m.low[x, robot, t] + (people.luck[i, 1] < m.weight[x, robot, t])]
            else:
                value = minds.value[people.who[i]]
                before, expected = value[x], value[m.targets[x, suggestion]]
                gain = 0.0 if before == expected else expected - before
                people.theta[i] = moved(theta, minds.eta, gain)
        if believed:
            update(people.belief[i], after, x, robot, slot, m)
        people.x[i] = y


@njit()
def _draw(p: Floats, count: int, lapse: float, luck: float) -> int:
    """Give the first slot whose cumulated probability exceeds `luck`."""
    total = 0.0
    for a in range(count):
        total += p[a]
    left = luck
    last = 0
    for a in range(count):
        chance = (1.0 - lapse) * p[a] / total + lapse / count
        if chance > 0.0:  # rounding must not end in an action that is never chosen
            last = a
            left -= chance
            if left < 0.0:
                break
    return last
