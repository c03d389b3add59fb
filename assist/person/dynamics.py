"""One step of many people: their choices, their tasks and their trust.

The equations are those of `assist.people.decision`. `act_readable` applies them to arrays. `act_compiled` gives the
same bits, one person at a time. `act` is the readable one first. What the robot learns from it is in `beliefs`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.compiling import ReadableFirst
from planner.system.jit import njit

from ..people.decision import NOTHING, Floats
from ..people.influence_kernels import update_trust, weigh_by_influence
from .belief_update import in_order
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays, read_only


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
        Row of `Minds` with the person's choices; it tells their goal, too.
    theta : float array, shape (N,)
    seen : int array, shape (N,)
        Number of outcomes of suggestions that the person has seen, if the trust rule counts them.
    uniform : float array, shape (N, 2)
        Uniform numbers in [0, 1): for the choice, and for the grid point of theta.
    slot : int array, shape (N,)
        Slot of the person's choice; -1 if the robot's execution has reached the goal.
    cost : float array, shape (N,)
        Cost of the choice.
    """

    x: NDArray[np.int64]
    robot: NDArray[np.int64]
    who: NDArray[np.int64]
    theta: Floats
    seen: NDArray[np.int64]
    uniform: Floats
    slot: NDArray[np.int64]
    cost: Floats

    @classmethod
    def of_teams(
        cls, x: NDArray[np.int64], robot: NDArray[np.int64], who: NDArray[np.int64], theta: Floats,
        seen: NDArray[np.int64], uniform: Floats,
    ) -> PeopleArrays:  # fmt: skip
        """Return flat views of teams' arrays, of shape (N, K, ...) in C order, with one person after the other.

        Slots and costs begin at `NOTHING` and 0.
        """
        return cls(
            x.reshape(-1), robot.reshape(-1), who.reshape(-1), theta.reshape(-1), seen.reshape(-1),
            uniform.reshape(-1, 2), np.full(x.size, NOTHING), np.zeros(x.size),
        )  # fmt: skip


class Minds(NamedTuple):
    """The choices of people, each of whom pursues a goal, and the values that their trust depends on.

    Attributes
    ----------
    goal : int array, shape (m,)
        Number of the goal.
    p : float array, shape (m, n, A)
        Probability of each choice without a suggestion.
    value : float array, shape (m, n)
        Perceived values V(x) of equation 7.
    eta : float
        Rate of the trust update, divided by the unit of value.
    lapse : float
        Probability of a uniform choice.
    on_grid : bool
        Whether theta moves between grid points at random, as in the robot's model.
    """

    goal: NDArray[np.int64]
    p: Floats
    value: Floats
    eta: float
    lapse: float
    on_grid: bool

    @classmethod
    def of_model(cls, pomdp: AssistPOMDP) -> Minds:
        """Return the people of the robot's model of one, by their type."""
        return cls(
            read_only(pomdp.hidden.goal_of), np.ascontiguousarray(np.moveaxis(pomdp.chosen, 2, 0)), np.empty((0, 0)),
            eta=0.0, lapse=float(pomdp.model.lapse), on_grid=True,
        )  # fmt: skip


@njit(nogil=True)
def act_compiled(rows: NDArray[np.int64], people: PeopleArrays, minds: Minds, m: ProblemArrays) -> None:
    """Let the people of some rows, all of one model, act once."""
    p = np.empty(m.chosen.shape[1])
    each = 1  # number of values of theta; they are repeated for each count of outcomes
    while each < len(m.theta) and m.theta[each] > m.theta[each - 1]:
        each += 1
    for i in rows:
        x, robot, theta = people.x[i], people.robot[i], people.theta[i]
        acting, suggestion = m.afterstate[x, robot], m.suggested[x, robot]
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
                t = people.seen[i] * each + np.searchsorted(m.theta[:each], theta)
                low, up = m.low[x, robot, g, t], m.weight[x, robot, g, t]
                if slot == suggestion:
                    low, up = m.followed_low[x, robot, g, t], m.followed_weight[x, robot, g, t]
                after_it = low + (people.uniform[i, 1] < up)
                people.theta[i], people.seen[i] = m.theta[after_it], after_it // each
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


def act_readable(rows: NDArray[np.int64], people: PeopleArrays, minds: Minds, m: ProblemArrays) -> None:
    """Let the people of some rows, all of one model, act once: the definition in numpy."""
    x, robot, goal = people.x[rows], people.robot[rows], minds.goal[people.who[rows]]
    done = m.goal[goal, m.afterstate[x, robot]]
    stay = rows[done]
    people.x[stay], people.slot[stay] = m.afterstate[x[done], robot[done]], NOTHING
    people.cost[stay] = 0.0
    rows, x, robot, goal = rows[~done], x[~done], robot[~done], goal[~done]
    if not len(rows):
        return
    theta, who = people.theta[rows], people.who[rows]
    acting, suggestion = m.afterstate[x, robot], m.suggested[x, robot]
    counts, slots = m.counts[acting, None], np.arange(m.chosen.shape[1])
    p = np.where(slots < counts, minds.p[who, acting], 0.0)
    slot = drawn_slots(influenced(p, suggestion, theta), counts, minds.lapse, people.uniform[rows, 0])
    y = m.targets[acting, slot]
    people.slot[rows], people.cost[rows] = slot, m.costs[acting, slot]
    advised = np.flatnonzero(suggestion >= 0)
    _trust(advised, rows, x, robot, slot == suggestion, people, minds, m)
    people.x[rows] = y


def influenced(p: Floats, suggestion: NDArray[np.int64], theta: Floats) -> Floats:
    """Return how likely choices are after suggestions (equation 6), shape (N, A), not normalised.

    A suggestion after which no action would be possible is ignored.

    Parameters
    ----------
    p : float array, shape (N, A)
        Probability of each choice without a suggestion.
    suggestion : int array, shape (N,)
        The suggested slot; `NOTHING` for none.
    theta : float array, shape (N,)
    """
    suggested = np.arange(p.shape[1]) == suggestion[:, None]
    its = in_order(np.where(suggested, p, 0.0))
    possible = (suggestion >= 0) & (theta * its + (1.0 - theta) * in_order(np.where(suggested, 0.0, p)) > 0.0)
    weight = np.where(suggested, theta[:, None], 1.0 - theta[:, None])
    return np.where(possible[:, None], p * weight, p)


def drawn_slots(p: Floats, counts: NDArray[np.int64], lapse: float, uniform: Floats) -> NDArray[np.int64]:
    """Return the choices that uniform numbers draw, shape (N,): the first slot up to which the probability exceeds it.

    Parameters
    ----------
    p : float array, shape (N, A)
        As from `influenced`.
    counts : int array, shape (N, 1)
        Number of applicable choices.
    lapse : float
        Probability of a uniform choice.
    uniform : float array, shape (N,)
    """
    applicable = np.arange(p.shape[1]) < counts
    chance = np.where(applicable, (1.0 - lapse) * p / in_order(p)[:, None] + lapse / counts, 0.0)
    remaining = np.subtract.accumulate(np.column_stack([uniform, chance]), axis=1)[:, 1:]
    exceeded = remaining < 0.0
    last = chance.shape[1] - 1 - (chance[:, ::-1] > 0.0).argmax(axis=1)  # rounding must not select an impossible one
    return np.where(exceeded.any(axis=1), exceeded.argmax(axis=1), last)


def _trust(
    advised: NDArray[np.int64], rows: NDArray[np.int64], x: NDArray[np.int64], robot: NDArray[np.int64],
    followed: NDArray[np.bool_], people: PeopleArrays, minds: Minds, m: ProblemArrays,
) -> None:  # fmt: skip
    """Update theta of the people who got a suggestion, given by their places in `rows`."""
    rows, x, robot = rows[advised], x[advised], robot[advised]
    theta, seen = people.theta[rows], people.seen[rows]
    if minds.on_grid:
        each = int(np.argmin(np.append(np.diff(m.theta) > 0, False))) + 1  # thetas repeat for each count of outcomes
        t = seen * each + np.searchsorted(m.theta[:each], theta)
        answers = followed[advised]
        at = x, robot, minds.goal[people.who[rows]], t
        low = np.where(answers, m.followed_low[at], m.low[at])
        up = np.where(answers, m.followed_weight[at], m.weight[at])
        after = low + (people.uniform[rows, 1] < up)
        people.theta[rows], people.seen[rows] = m.theta[after], after // each
        return
    who = people.who[rows]
    before, expected = minds.value[who, x], minds.value[who, m.targets[x, m.suggested[x, robot]]]
    gain = np.subtract(expected, before, out=np.zeros(len(rows)), where=before != expected)
    if minds.eta != 0.0:
        people.theta[rows] = np.where(gain == 0.0, theta, np.clip(theta + minds.eta * gain, 0.0, 1.0))


def _work(rows: NDArray[np.int64], _people: PeopleArrays, minds: Minds, _: ProblemArrays) -> float:
    """Return the work of `act_readable`, in nanoseconds."""
    return 60_000 + len(rows) * 20 * minds.p.shape[2]


act = ReadableFirst(act_readable, act_compiled, _work)
