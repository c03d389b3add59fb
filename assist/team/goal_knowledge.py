"""What a robot knows of people who begin, and acts on: it infers which of several goals they pursue, or knows it."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ..people.hidden_type import Floats, HiddenType, Ints
from ..person.beliefs import Beliefs
from ..person.known_states import KnownStates
from ..person.settings import Setting
from ..person.uncertain_states import UncertainStates

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
    """Return the beliefs that policies see; other arguments as in `first_beliefs`.

    For `simulate(goals="likeliest")` it is done here, for every policy. What `Goals` says of the robot
    (`HiddenType.acted_on`) is done later, where values are averaged over goals.
    """
    if knowledge != "likeliest" or not len(beliefs.belief):
        return beliefs
    return KnownStates(beliefs.x, hidden.given_likeliest(beliefs.belief), beliefs.erred, beliefs.neighbours)


def known_at_first(row: Ints, belief: Floats | None, setting: Setting) -> Beliefs:
    """Return what robots know of people who begin.

    Parameters
    ----------
    row : int array, shape (N, K)
        Row of each person's state, which the robots know at first.
    belief : float array, shape (N, K, H, T), or None
        None if no beliefs are kept.
    setting : Setting
        It says how reliably the robots see actions, and what people see of each other.
    """
    flat = np.empty((0, 1, 1)) if belief is None else belief.reshape(-1, *belief.shape[2:])
    erred = np.zeros(row.size, dtype=bool)
    if setting.observation is None:
        return KnownStates(row.reshape(-1), flat, erred, setting.neighbourhood(row.shape[1]))
    return UncertainStates(row.reshape(-1).copy(), flat, erred, setting.observation)
