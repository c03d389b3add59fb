"""What people of teams at work see of each other's suggestions, and how it moves them and the robots' beliefs."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from ..people.decision import NOTHING, Bools, Floats
from ..people.neighbourhood import Helped, seen_gain
from ..person.beliefs import Beliefs, PersonModel
from ..person.policy import Policy
from ..person.problem_arrays import Acts
from ..person.random_streams import Stream
from .people_at_work import PeopleAtWork

Ints = NDArray[np.int64]


def let_see(
    them: PeopleAtWork, beliefs: Beliefs, acts: Acts, after: Ints, models: Iterable[tuple[PersonModel, Ints]],
    draw: Callable[[int], Floats],
) -> None:  # fmt: skip
    """Move theta of the people at work who have seen a neighbour helped, and what the robots believe of it.

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
        Models, with the people at work who have each, as indices of the flattened arrays; all have one grid.
    draw : callable
        Returns uniform numbers, shape (N * K,), of a `Stream`.
    """
    shape, neighbours = them.theta.shape, beliefs.neighbours
    if not len(neighbours.sees):
        return
    # In each step, whoever is shown something: an episode's numbers do not depend on the others that are simulated.
    uniform = draw(Stream.NEIGHBOURS) if them.on_grid else None
    shown = neighbours.told(acts.heard.reshape(shape))
    if not shown.any():
        return
    heard, gain = np.where(shown.reshape(-1), acts.heard, 0), np.zeros(len(after))
    answered, follows, there = np.zeros((3, len(after)), dtype=bool)
    for model, flat in models:
        own, grid = acts.of(flat), model.pomdp.grid
        answered[flat], follows[flat], gain[flat] = answers(model.policy, own.x, heard[flat], own.slot, after[flat])
        there[flat] = own.goes_on
    those = np.flatnonzero(answered)
    helped = Helped(*np.divmod(those, shape[1]), gain[those], follows[those])
    theta, there = them.theta.reshape(-1), there.reshape(shape)
    onlookers, moved = neighbours.moved(theta[:, None], helped, there)
    theta[onlookers] = moved[:, 0]
    if uniform is not None:
        low, up = grid.shares(theta[onlookers], them.outcomes.reshape(-1)[onlookers])
        theta[onlookers] = grid.theta[low + (uniform[onlookers] < up)]
    neighbours.believed.believe(beliefs.belief, grid, helped, there)


def answers(policy: Policy, x: Ints, heard: Ints, slot: Ints, after: Ints) -> tuple[Bools, Bools, Floats]:
    """Return who answered a suggestion, whether they followed it, and what came of it, each of shape (m,).

    Parameters
    ----------
    policy : Policy
    x, heard, slot, after : int arrays, shape (m,)
        Rows of people, the robot actions that they heard, what they chose, and the rows after it.
    """
    suggested, gain = policy.pomdp.suggested[x, heard], np.zeros(len(x))
    told = (suggested != NOTHING) & (slot != NOTHING)
    gain[told] = gained(policy, x[told], after[told])
    return told, told & (slot == suggested), gain


def gained(policy: Policy, before: Ints, after: Ints) -> Floats:
    """Return what came of steps from some rows to others, both of shape (m,), in cost units, as neighbours see it."""
    # Rows to which a choice has just led may have no choices yet.
    before, after = (policy.rows(policy.situations(x)) for x in (before, after))
    return seen_gain(policy.pomdp.model, before, after)
