"""What people of teams at work see of each other's suggestions, and how it moves them and the robots' beliefs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..people.decision import NOTHING, Floats
from ..people.neighbourhood import Helped, seen_gain
from ..person.beliefs import Beliefs, PersonModel
from ..person.policy import Policy
from ..person.problem_arrays import Acts
from ..person.random_kinds import Kind
from .people_at_work import PeopleAtWork

Ints = NDArray[np.int64]


class Saw(NamedTuple):
    """Who has seen a neighbour helped in a step, as indices of the flattened arrays, and their theta before that."""

    who: Ints = np.zeros(0, dtype=np.int64)
    theta: Floats = np.zeros(0)


def let_see(
    them: PeopleAtWork, beliefs: Beliefs, acts: Acts, after: Ints, models: Iterable[tuple[PersonModel, Ints]],
    draw: Callable[[int], Floats],
) -> Saw:  # fmt: skip
    """Move theta of the people at work who have seen a neighbour helped, and what the robots believe of it.

    It returns who that was.

    Parameters
    ----------
    them : PeopleAtWork
        N teams of K people, after they have acted.
    beliefs : Beliefs
    acts : Acts
        What all N K people did.
    after : int array, shape (N * K,)
        The row of each person after it.
    models : iterable of pairs of PersonModel and int array
        Models, with the people at work who have each, as indices of the flattened arrays.
    draw : callable
        Returns uniform numbers, shape (N * K,), of a kind of `CommonRandomNumbers`.
    """
    shape, neighbours = them.theta.shape, beliefs.neighbours
    shown = neighbours.told(acts.heard.reshape(shape))
    # In each step, whoever is shown something: an episode's numbers do not depend on the others that are simulated.
    uniform = draw(Kind.NEIGHBOURS) if them.on_grid and len(neighbours.sees) else None
    if not shown.any():
        return Saw()
    gain, told, follows = np.zeros(len(after)), np.zeros(len(after), dtype=bool), np.zeros(len(after), dtype=bool)
    at_work, models = np.zeros(shape, dtype=bool), list(models)
    for model, flat in models:
        at_work.reshape(-1)[flat] = acts.goes_on[flat]
        own = acts.of(flat)
        suggested = model.pomdp.suggested[own.x, own.heard]
        advised = shown.reshape(-1)[flat] & (suggested != NOTHING) & (own.slot != NOTHING)
        told[flat], follows[flat] = advised, own.slot == suggested
        gain[flat[advised]] = gained(model.policy, own.x[advised], after[flat[advised]])
    those, saw = np.flatnonzero(told), [Saw()]
    if not len(those):
        return Saw()
    helped = Helped(*np.divmod(those, shape[1]), gain[those], follows[those])
    for model, flat in models:
        grid, there = model.pomdp.grid, np.zeros(shape, dtype=bool)
        there.reshape(-1)[flat] = at_work.reshape(-1)[flat]
        theta, count = them.theta.reshape(-1), them.outcomes.reshape(-1)
        who, moved = neighbours.moved(theta[:, None], helped, there)
        saw.append(Saw(who, theta[who]))
        theta[who] = moved[:, 0]
        if uniform is not None:
            low, up = grid.shares(theta[who], count[who])
            theta[who] = grid.theta[low + (uniform[who] < up)]
        beliefs.moved(*neighbours.believed.shares(grid, len(after), helped, there))
    return Saw(*(np.concatenate(parts) for parts in zip(*saw, strict=True)))


def gained(policy: Policy, before: Ints, after: Ints) -> Floats:
    """Return what came of steps from some rows to others, both of shape (m,), in cost units, as neighbours see it."""
    # Rows to which a choice has just led may have no choices yet.
    before, after = (policy.rows(policy.places(x)) for x in (before, after))
    return seen_gain(policy.pomdp.model, before, after)
