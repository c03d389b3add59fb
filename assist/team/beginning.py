"""The people of teams at the beginning of an episode, as the random numbers draw them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..person.pomdp import AssistPOMDP
from ..person.random_streams import Stream
from .model_group import Ints, ModelGroup
from .pool import Pool

World = Literal["people", "model"]
"""Who acts: the people of a pool as they are, or people of the robot's model of them."""


class Beginning(NamedTuple):
    """People who begin; all arrays have their shape.

    Attributes
    ----------
    model : int array
        Index of each person's policy.
    who : int array
        Row of the person in the `Minds` of their group (`Beginnings.group`). In the robot's model it is their type.
    goal : int array
        Number of the goal.
    beta, theta : float arrays
    situation : int array
        Where the person is in the task, as in `person.rows`.
    finished : bool array
    """

    model: Ints
    who: Ints
    goal: Ints
    beta: Floats
    theta: Floats
    situation: Ints
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
        self._pool, self._model, self._world = pool, pool.model, world
        self._pomdps = [policy.pomdp for policy in pool.policies]
        self._beta, self._theta = np.array([[human.beta, human.theta] for human in pool.people]).T
        each = [pool.choices(n) for n in range(len(pool.people))]
        self._finished = np.array([choices.goal[choices.initial] for choices in each])
        self._initial = np.array([policy.problem.task.initial for policy in pool.policies])
        self._goals = [pomdp.hidden.goals for pomdp in self._pomdps]
        order = np.argsort(pool.model, kind="stable")
        among = np.empty_like(order)  # the number of each person among those of their model
        among[order] = np.arange(len(order)) - np.searchsorted(pool.model[order], pool.model[order])
        self._first = among * len(pool.hidden.goals)

    def group(self, number: int) -> ModelGroup:
        """Return the people of a model, given by its number, and how they choose."""
        policy, setting = self._pool.policies[number], self._pool.setting
        if self._world == "model":
            return ModelGroup(policy)
        people = [self._pool.people[i] for i in np.flatnonzero(self._model == number).tolist()]
        return ModelGroup(policy, people, None if setting.trust in (None, "paper") else setting.trust_rule())

    def of(self, people: Ints, draw: Callable[[int], Floats]) -> Beginning:
        """Return how some people begin.

        Parameters
        ----------
        people : int array
            Their numbers in the pool.
        draw : callable
            Returns uniform numbers, in the shape of `people`, of a `Stream`. They draw people's
            goals or, in the world "model", their types and theta from the prior.
        """
        model = self._model[people]
        if self._world == "model":
            goal, who, beta, theta = from_the_prior(self._pomdps, model, draw(Stream.TYPE))
        else:
            goal = drawn_goals(self._goals, model, draw(Stream.GOAL))
            who, beta, theta = self._first[people] + goal, self._beta[people], self._theta[people]
        return Beginning(model, who, goal, beta, theta, self._initial[model], self._finished[people])


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
