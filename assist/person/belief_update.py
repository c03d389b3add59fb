"""Posteriors of many people's beliefs after their choices, in numpy: the readable definition of `belief_filter`.

Sums run over the cells in the order of the compiled code, one after the other, so that both give the same bits.
Shapes are those of `belief_filter`, with one row for each person.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.system.readable import ReadableFirst

from ..people.belief import ImpossibleObservationError
from ..people.decision import Floats
from ..people.influence_kernels import LARGEST
from .belief_filter import update
from .problem_arrays import ProblemArrays

Ints = NDArray[np.int64]

IMPOSSIBLE = "an action has probability 0 under the belief; a lapse rate above 0 in the model rules this out"


def in_order(terms: Floats) -> Floats:
    """Return the sums along the last axis, added up from left to right; numpy's `sum` has another order."""
    return np.asarray(np.add.accumulate(terms, axis=-1)[..., -1])


def influence(theta: Floats, p: Floats, others: Floats) -> tuple[Floats, Floats]:
    """Return the factors of the suggested choice and of each other (equation 6), as `influence_factors` does."""
    total = theta * p + (1.0 - theta) * others
    any_left = total > 0.0
    with np.errstate(over="ignore"):
        followed = np.divide(theta, total, out=np.ones_like(total), where=any_left)
        declined = np.divide(1.0 - theta, total, out=np.ones_like(total), where=any_left)
    return followed, np.minimum(declined, LARGEST)


def posteriors(belief: Floats, x: Ints, robot: Ints, slot: Ints, m: ProblemArrays) -> tuple[Floats, Floats]:
    """Return unnormalised posteriors after one choice each, shape (N, H), and their masses, shape (N,).

    Parameters
    ----------
    belief : float array, shape (N, H)
    x, robot, slot : int arrays, shape (N,)
        States, rows of one goal; the robot actions towards the people, and the slots of their choices.
    m : ProblemArrays
    """
    betas, thetas = m.chosen.shape[2], len(m.theta)
    cells = belief.reshape(len(x), betas, thetas)
    acting, suggested = m.afterstate[x, robot], m.suggested[x, robot]
    steady, uniform = 1.0 - m.lapse, m.lapse / m.counts[acting]
    after, mass = np.empty_like(cells), np.empty(len(x))

    alone = np.flatnonzero(suggested < 0)
    likelihood = steady * m.chosen[acting[alone], slot[alone]] + uniform[alone, None]
    after[alone] = likelihood[:, :, None] * cells[alone]
    mass[alone] = in_order(in_order(after[alone]))

    rows = np.flatnonzero(suggested >= 0)
    if not len(rows):
        return after.reshape(belief.shape), mass
    x, robot, slot, suggested, uniform = x[rows], robot[rows], slot[rows], suggested[rows], uniform[rows]
    answers = (slot == suggested)[:, None]
    factors = influence(m.theta, m.chosen[x, suggested][:, :, None], m.unsuggested[x, robot][:, :, None])
    factor = np.where(answers[:, :, None], *factors)
    plain = steady * m.chosen[x, slot]
    joint = cells[rows] * (plain[:, :, None] * factor + uniform[:, None, None])
    mass[rows] = in_order(joint.reshape(len(rows), betas * thetas))
    at = np.where(answers, m.followed_low[x, robot], m.low[x, robot])
    up = np.where(answers, m.followed_weight[x, robot], m.weight[x, robot])
    parts = np.stack([joint * (1.0 - up)[:, None], joint * up[:, None]], axis=-1)
    first = np.arange(len(rows) * betas).reshape(-1, betas, 1, 1) * thetas
    places = first + np.stack([at, at + 1], axis=-1)[:, None]
    sums = np.bincount(places.ravel(), parts.ravel(), minlength=joint.size)  # which adds in the order of the places
    after[rows] = sums[: joint.size].reshape(joint.shape)
    return after.reshape(belief.shape), mass


def updated(belief: Floats, x: Ints, robot: Ints, slot: Ints, m: ProblemArrays) -> Floats:
    """Return the beliefs, shape (N, G * B, T), after one choice each; arguments as in `posteriors`.

    The rows `x` may be those of any goal. A choice of probability 0 raises an `ImpossibleObservationError`.
    """
    betas, people = m.chosen.shape[2], len(x)
    goals = belief.shape[1] // betas
    states = len(m.counts) // goals
    old, mass, after = belief.reshape(people, goals, betas * len(m.theta)), np.zeros(people), np.empty(belief.shape)
    for goal in range(goals):
        part, own = posteriors(old[:, goal], goal * states + x % states, robot, slot, m)
        after[:, goal * betas : (goal + 1) * betas] = part.reshape(people, betas, len(m.theta))
        mass += own
    if not (mass > 0.0).all():
        raise ImpossibleObservationError(IMPOSSIBLE)
    return after * (1.0 / mass)[:, None, None]


def _update_one(belief: Floats, _: Floats, x: int, robot: int, slot: int, m: ProblemArrays) -> None:
    """Do what `belief_filter.update` does to one belief, shape (G * B, T)."""
    belief[:] = updated(belief[None], np.array([x]), np.array([robot]), np.array([slot]), m)[0]


update_belief = ReadableFirst(_update_one, update, lambda *_: 150_000)
"""Replace one belief by its posterior, as `belief_filter.update` does, with the same arguments."""


def without_reached(belief: Floats, x: Ints, m: ProblemArrays) -> Floats:
    """Return beliefs, shape (N, G * B, T), conditioned on the goal not being reached in rows `x`, shape (N,).

    A belief in which every goal is reached does not change.
    """
    betas = m.chosen.shape[2]
    goals = belief.shape[1] // betas
    states = len(m.counts) // goals
    parts = belief.reshape(len(x), goals, betas * len(m.theta))
    reached = m.goal[np.arange(goals) * states + (x % states)[:, None]]
    left = in_order(np.where(reached, 0.0, in_order(parts)))
    some = left > 0.0
    kept = np.where(reached[:, :, None], 0.0, parts) / np.where(some, left, 1.0)[:, None, None]
    return np.where(some[:, None, None], kept, parts).reshape(belief.shape)
