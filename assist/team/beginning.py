"""The people of teams at the beginning of an episode, as the random numbers draw them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..person.pomdp import AssistPOMDP
from ..person.random_kinds import Kind
from .model_group import World
from .pool import Pool

Ints = NDArray[np.int64]


class Beginning(NamedTuple):
    """People who begin; all arrays have their shape.

    Attributes
    ----------
    model : int array
        Index of each person's policy.
    type, goal : int arrays
        Number of the type in the robot's model, 0 for people of the pool; and of the goal.
    beta, theta : float arrays
    place : int array
        Where the person is, as in `person.rows`.
    finished : bool array
    """

    model: Ints
    type: Ints
    goal: Ints
    beta: Floats
    theta: Floats
    place: Ints
    finished: NDArray[np.bool_]


class Beginnings:
    """How the people of a pool begin.

    Parameters
    ----------
    pool : Pool
    world : World
        As in `simulate`.
    """

    def __init__(self, pool: Pool, world: World) -> None:
        self._model, self._world, self._pomdps = pool.model, world, [policy.pomdp for policy in pool.policies]
        self._beta, self._theta = np.array([[human.beta, human.theta] for human in pool.people]).T
        each = [pool.choices(n) for n in range(len(pool.people))]
        self._finished = np.array([choices.goal[choices.initial] for choices in each])
        self._initial = np.array([policy.problem.task.initial for policy in pool.policies])
        self._goals = [pomdp.hidden.goals for pomdp in self._pomdps]

    def of(self, people: Ints, draw: Callable[[int], Floats]) -> Beginning:
        """Return how some people begin.

        Parameters
        ----------
        people : int array
            Their numbers in the pool.
        draw : callable
            Returns uniform numbers, in the shape of `people`, of a kind of `CommonRandomNumbers`. They draw people's
            goals or, in the world "model", their types and theta from the prior.
        """
        model = self._model[people]
        if self._world == "model":
            goal, type_, beta, theta = from_the_prior(self._pomdps, model, draw(Kind.TYPE))
        else:
            goal = drawn_goals(self._goals, model, draw(Kind.GOAL))
            type_, beta, theta = np.zeros_like(model), self._beta[people], self._theta[people]
        return Beginning(model, type_, goal, beta, theta, self._initial[model], self._finished[people])


def from_the_prior(pomdps: Sequence[AssistPOMDP], model: Ints, drawn: Floats) -> tuple[Ints, Ints, Floats, Floats]:
    """Draw people in the robot's model, from the prior of their model.

    Parameters
    ----------
    pomdps : sequence of AssistPOMDP
        Problem of each model.
    model : int array
        Model of each person.
    drawn : float array, of the same shape
        Uniform numbers.

    Returns
    -------
    goal, type, beta, theta : arrays of the same shape
        Number of the goal, number of the type, and the expertise and theta.
    """
    goal, type_ = np.zeros((2, *model.shape), dtype=np.int64)
    beta, theta = np.zeros((2, *model.shape))
    for number, pomdp in enumerate(pomdps):
        at, prior = model == number, pomdp.prior.ravel()
        cell = np.searchsorted(np.cumsum(prior), drawn[at], side="right")
        h, t = np.divmod(np.minimum(cell, np.flatnonzero(prior)[-1]), len(pomdp.grid.theta))
        goal[at], type_[at] = pomdp.hidden.goal_of[h], h
        beta[at], theta[at] = pomdp.hidden.expertise[h], pomdp.grid.theta[t]
    return goal, type_, beta, theta


def drawn_goals(priors: list[Mapping[str, float]], model: Ints, uniform: Floats) -> Ints:
    """Return the number of each person's goal, drawn from their model's prior by uniform numbers."""
    below = np.cumsum([list(prior.values()) for prior in priors], axis=1)[model]
    # rounding must not select a goal of probability 0
    last = np.array([np.flatnonzero(list(prior.values()))[-1] for prior in priors])[model]
    return np.minimum((uniform[..., None] >= below).sum(axis=-1), last)
