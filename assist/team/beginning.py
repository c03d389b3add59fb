"""The people of teams at the beginning of an episode, as the random numbers draw them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..people.hidden_type import drawn_goals
from .common_random_numbers import from_the_prior
from .model_group import World
from .pool import Pool

Ints = NDArray[np.int64]


class Beginning(NamedTuple):
    """People who begin; all arrays have their shape.

    Attributes
    ----------
    model : int array
        Index of each person's policy.
    mind, goal : int arrays
        Number of the type in the robot's model, 0 for people of the pool; and of the goal.
    beta, theta : float arrays
    place : int array
        Where the person is, as in `person.rows`.
    finished : bool array
    """

    model: Ints
    mind: Ints
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
        self._initial = np.array([policy.task.initial for policy in pool.policies])
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
            goal, mind, beta, theta = from_the_prior(self._pomdps, model, draw(0))
        else:
            goal = drawn_goals(self._goals, model, draw(4)) if len(self._goals[0]) > 1 else np.zeros_like(model)
            mind, beta, theta = np.zeros_like(model), self._beta[people], self._theta[people]
        return Beginning(model, mind, goal, beta, theta, self._initial[model], self._finished[people])
