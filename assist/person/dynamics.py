"""One step of many people: their choices, their tasks and their trust.

The robot acts first, then everyone (equation 3): people choose in the state after an execution.

Equations (6) and (7) are written here once more, for arrays of people; tests compare them with
`assist.people.decision`. Equation (5) is in `Minds.p`. `act_compiled` (`dynamics_kernel`) gives the same bits as
`act_readable`; `act` calls the readable one until that has taken a second or so (`planner.system.jit`). Theta of
people of the robot's model moves here on the grid, under any rule. For people of a pool, rules other than (7) move it
in `team.trust_of_people`. What the robot learns is in `beliefs`.
"""

from __future__ import annotations

import numpy as np

from planner.system.jit import ReadableFirst

from ..people.decision import NOTHING, Bools, Floats, Ints
from .belief_update import in_order
from .dynamics_kernel import act_compiled
from .people_arrays import Minds, PeopleArrays
from .problem_arrays import ProblemArrays


def act_readable(people: Ints, them: PeopleArrays, minds: Minds, m: ProblemArrays) -> None:
    """Let some people, all of one model, act once: the definition in numpy."""
    x, heard, goal = them.x[people], them.heard[people], minds.goal[them.who[people]]
    done = m.goal[goal, m.afterstate[x, heard]]
    stay = people[done]
    them.x[stay], them.slot[stay] = m.afterstate[x[done], heard[done]], NOTHING
    them.cost[stay] = 0.0
    people, x, heard, goal = people[~done], x[~done], heard[~done], goal[~done]
    if not len(people):
        return
    theta, who = them.theta[people], them.who[people]
    acting, suggestion = m.afterstate[x, heard], m.suggested[x, heard]
    counts, slots = m.counts[acting, None], np.arange(m.chosen.shape[1])
    p = np.where(slots < counts, minds.p[who, acting], 0.0)
    slot = drawn_slots(influenced(p, suggestion, theta), counts, minds.lapse, them.uniform[people, 0])
    y = m.targets[acting, slot]
    them.slot[people], them.cost[people] = slot, m.costs[acting, slot]
    moving = np.flatnonzero(m.moves[x, heard] if minds.on_grid else suggestion >= 0)
    _trust(moving, people, x, heard, slot == suggestion, them, minds, m)
    them.x[people] = y


def influenced(p: Floats, suggestion: Ints, theta: Floats) -> Floats:
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


def drawn_slots(p: Floats, counts: Ints, lapse: float, uniform: Floats) -> Ints:
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
    moving: Ints, people: Ints, x: Ints, heard: Ints,
    followed: Bools, them: PeopleArrays, minds: Minds, m: ProblemArrays,
) -> None:  # fmt: skip
    """Update theta of those people for whom it may move, given by their places in `people`."""
    people, x, heard = people[moving], x[moving], heard[moving]
    theta, outcomes = them.theta[people], them.outcomes[people]
    if minds.on_grid:
        each = int(np.argmin(np.append(np.diff(m.theta) > 0, False))) + 1  # thetas repeat for each count of outcomes
        t = outcomes * each + np.searchsorted(m.theta[:each], theta)
        answers = followed[moving]
        at = x, heard, minds.goal[them.who[people]], t
        low = np.where(answers, m.followed_low[at], m.low[at])
        up = np.where(answers, m.followed_weight[at], m.weight[at])
        after = low + (them.uniform[people, 1] < up)
        them.theta[people], them.outcomes[people] = m.theta[after], after // each
        return
    who = them.who[people]
    before, expected = minds.value[who, x], minds.value[who, m.targets[x, m.suggested[x, heard]]]
    gain = np.subtract(expected, before, out=np.zeros(len(people)), where=before != expected)
    if minds.eta != 0.0:
        them.theta[people] = np.where(gain == 0.0, theta, np.clip(theta + minds.eta * gain, 0.0, 1.0))


def _work(people: Ints, _them: PeopleArrays, minds: Minds, _: ProblemArrays) -> float:
    """Return the work of `act_readable`, in nanoseconds."""
    return 60_000 + len(people) * 60 * minds.p.shape[2]


act = ReadableFirst(act_readable, act_compiled, _work)
