"""What a robot knows of the goals of people who pursue one of several: it infers them, or knows them."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ..people.hidden_type import Floats, HiddenType, Ints
from ..person.beliefs import Beliefs, Seen

GoalKnowledge = Literal["inferred", "likeliest", "known"]


def first_beliefs(prior: Floats, hidden: HiddenType, goal: Ints, knowledge: GoalKnowledge) -> Floats:
    """Return the robot's first beliefs, shape (N, K, H, T): given the goals, if it knows them.

    Parameters
    ----------
    prior : float array, shape (N, K, H, T)
    hidden : HiddenType
        The types of the people; all have as many goals.
    goal : int array, shape (N, K)
        Number of each person's goal.
    knowledge : GoalKnowledge
        As in `simulate`.
    """
    if knowledge != "known":
        return prior
    given = hidden.given_goal(prior, np.arange(len(hidden.goals)) == goal[:, :, None])
    share = given.sum(axis=(2, 3), keepdims=True) / prior.sum(axis=(2, 3), keepdims=True)
    return np.asarray(given / share)


def acted_on(beliefs: Beliefs, hidden: HiddenType, knowledge: GoalKnowledge) -> Beliefs:
    """Return the beliefs on which the robot acts; other arguments as in `first_beliefs`."""
    if knowledge != "likeliest" or not len(beliefs.belief):
        return beliefs
    return Seen(beliefs.x, hidden.given_likeliest(beliefs.belief), beliefs.erred)
