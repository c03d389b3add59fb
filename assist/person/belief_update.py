"""Posteriors of many people's beliefs after their choices, in numpy: the readable definition of `belief_filter`.

An update has three parts. The belief is multiplied by the likelihood of the choice under the theta before it. Then
theta moves, as the trust rule says for this robot action and this answer: each cell is divided between two. Goals that
are reached in the new state are left out last, for somebody who has reached their goal acts no more.

Sums run over the cells in the order of the compiled code, one after the other, so that both give the same bits.
Shapes are those of `belief_filter`, with one row for each person.
"""

from __future__ import annotations

import numpy as np

from ..people.belief import ImpossibleObservationError
from ..people.decision import NOTHING, Bools, Floats, Ints
from ..people.influence_kernels import LARGEST
from .problem_arrays import Acts, ProblemArrays

IMPOSSIBLE = "an action has probability 0 under the belief; a lapse rate above 0 in the model rules this out"


def update_readable(
    people: Ints, acts: Acts, belief: Floats, erred: Bools, optimal: Bools, possible: Floats, m: ProblemArrays
) -> None:
    """Update the beliefs in people of one model who have acted: the definition of `Beliefs.update`.

    Parameters
    ----------
    people : int array, shape (m,)
        Their numbers.
    acts : Acts
        What they did: one entry for each of these, in their order.
    belief, erred : float and bool arrays, shapes (P, H, T) and (P,)
        The beliefs, which change, and whether the last action was a mistake; without rows for no beliefs.
    optimal, possible
        As in `PersonModel`.
    m : ProblemArrays
    """
    erred[people] = False
    acted = np.flatnonzero(acts.slot != NOTHING)
    people, (x, heard, slot, goes_on) = people[acted], acts.of(acted)
    if not len(people):
        return
    acting = m.afterstate[x, heard]
    known = belief[people] if len(belief) else possible[None]
    erred[people] = mistaken(optimal[acting, slot], known, acting, m)
    if not len(belief):
        return
    after, y = updated(known, x, heard, slot, m), m.targets[acting, slot]
    on = np.flatnonzero(goes_on & m.goal[:, y].any(axis=0))
    after[on] = without_reached(after[on], y[on], m)
    belief[people] = after


def in_order(terms: Floats) -> Floats:
    """Return the sums along the last axis, added up from left to right; numpy's `sum` has another order."""
    return np.asarray(np.add.accumulate(terms, axis=-1)[..., -1])


def factors_of(theta: Floats, p: Floats, others: Floats) -> tuple[Floats, Floats]:
    """Return the factors of the suggested choice and of each other (equation 6), as `influence_factors` does."""
    total = theta * p + (1.0 - theta) * others
    any_left = total > 0.0
    with np.errstate(over="ignore"):
        followed = np.divide(theta, total, out=np.ones_like(total), where=any_left)
        declined = np.divide(1.0 - theta, total, out=np.ones_like(total), where=any_left)
    return followed, np.minimum(declined, LARGEST)


def posteriors(belief: Floats, x: Ints, action: Ints, slot: Ints, m: ProblemArrays) -> tuple[Floats, Floats]:
    """Return unnormalised posteriors after one choice each, shape (N, H, T), and their masses, shape (N,).

    They are the belief times the likelihood under the theta before, with theta then moved by `low` and `weight`
    where it may move.

    Parameters
    ----------
    belief : float array, shape (N, H, T)
    x, action, slot : int arrays, shape (N,)
        States, the robot actions towards the people, and the slots of their choices.
    m : ProblemArrays
    """
    cells, (types, thetas) = belief, belief.shape[1:]
    acting, suggested = m.afterstate[x, action], m.suggested[x, action]
    steady, uniform = 1.0 - m.lapse, m.lapse / m.counts[acting]
    after, mass = np.empty_like(cells), np.empty(len(x))

    moves = m.moves[x, action]
    alone = np.flatnonzero(~moves)
    likelihood = steady * m.chosen[acting[alone], slot[alone]] + uniform[alone, None]
    after[alone] = likelihood[:, :, None] * cells[alone]
    mass[alone] = in_order(in_order(after[alone]))

    rows = np.flatnonzero(moves)
    if not len(rows):
        return after, mass
    x, action, slot, acting = x[rows], action[rows], slot[rows], acting[rows]
    suggested, uniform = suggested[rows], uniform[rows]
    answers, silent = (slot == suggested)[:, None], (suggested < 0)[:, None, None]
    # After a suggestion people act in x itself: there `afterstate` is x.
    factors = factors_of(m.theta, m.chosen[x, suggested][:, :, None], m.unsuggested[x, action][:, :, None])
    factor = np.where(silent, 1.0, np.where(answers[:, :, None], *factors))
    plain = steady * m.chosen[acting, slot]
    joint = cells[rows] * (plain[:, :, None] * factor + uniform[:, None, None])
    mass[rows] = in_order(joint.reshape(len(rows), types * thetas))
    followed = answers[:, :, None]
    at = np.where(followed, m.followed_low[x, action], m.low[x, action])[:, m.goal_of]
    up = np.where(followed, m.followed_weight[x, action], m.weight[x, action])[:, m.goal_of]
    parts = np.stack([joint * (1.0 - up), joint * up], axis=-1)
    first = np.arange(len(rows) * types).reshape(-1, types, 1, 1) * thetas
    cells = first + np.stack([at, at + 1], axis=-1)
    sums = np.bincount(cells.ravel(), parts.ravel(), minlength=joint.size)  # which adds in the order of the cells
    after[rows] = sums[: joint.size].reshape(joint.shape)
    return after, mass


def updated(belief: Floats, x: Ints, action: Ints, slot: Ints, m: ProblemArrays) -> Floats:
    """Return the beliefs, shape (N, H, T), after one choice each; arguments as in `posteriors`.

    A choice of probability 0 raises an `ImpossibleObservationError`.
    """
    after, mass = posteriors(belief, x, action, slot, m)
    if not (mass > 0.0).all():
        raise ImpossibleObservationError(IMPOSSIBLE)
    return after * (1.0 / mass)[:, None, None]


def without_reached(belief: Floats, x: Ints, m: ProblemArrays) -> Floats:
    """Return beliefs, shape (N, H, T), conditioned on the goal not being reached in states `x`, shape (N,).

    A belief in which every goal is reached does not change.
    """
    reached = _reached(x, m)
    left = in_order(np.where(reached, 0.0, in_order(belief)))
    some = reached.any(axis=1) & (left > 0.0)
    kept = np.where(reached[:, :, None], 0.0, belief) / np.where(some, left, 1.0)[:, None, None]
    return np.where(some[:, None, None], kept, belief)


def mistaken(optimal: Bools, belief: Floats, x: Ints, m: ProblemArrays) -> Bools:
    """Return which actions are optimal for no goal that is possible, shape (N,): probable, and not reached in `x`.

    Parameters
    ----------
    optimal : bool array, shape (N, G)
        Whether the action is optimal for each goal.
    belief : float array, shape (N, H, T)
    x : int array, shape (N,)
    m : ProblemArrays
    """
    possible = (belief > 0.0).any(axis=2) & ~_reached(x, m)
    return np.asarray(~(optimal[:, m.goal_of] & possible).any(axis=1))


def _reached(x: Ints, m: ProblemArrays) -> Bools:
    """Return whether the goal of each type is reached in states, shape (N, H)."""
    return m.goal[:, x].T[:, m.goal_of]
