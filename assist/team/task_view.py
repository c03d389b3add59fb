"""The people's tasks as a step of a simulation sees them: the row of each person in their policy's problem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..person.policy import Policy
from .model_group import Ints, ModelGroup, World
from .pool import Pool
from .state import by_model


class RowsOfPeople:
    """The rows of people in the problems of their policies; it holds those that it was asked for last.

    Parameters
    ----------
    policies : sequence of Policy
    model : int array, shape (N, K)
        Index of each person's policy.
    """

    def __init__(self, policies: Sequence[Policy], model: Ints) -> None:
        self.policies, self.model = policies, model
        self._grows = np.array([not policy.problem.complete for policy in policies])

    def rows(self, places: Ints, active: Ints) -> Ints:
        """Return the row of each person, shape (N, K); of people who are not active, any row.

        Parameters
        ----------
        places : int array, shape (N, K)
        active : int array
            Active people, as indices of the flattened `places`.
        """
        if not self._grows.any():
            return places
        found, grows = places.reshape(-1).copy(), self._grows[self.model].reshape(-1)
        found[grows] = 0
        for number, flat in by_model(self.model.reshape(-1), active[grows[active]], len(self.policies)):
            found[flat] = self.policies[number].rows(places.reshape(-1)[flat], self)
        return found.reshape(places.shape)


class TaskView(RowsOfPeople):
    """The people's tasks in a number of episodes that are simulated together. It holds the rows of the last step.

    Parameters
    ----------
    pool : Pool
    groups : mapping of int to ModelGroup
        The group of each policy that occurs.
    world : World
    model, people, mind, goal : int arrays, shape (N, K)
        Each person's model, their number in the pool, the number of their type in the robot's model, and that of their
        goal.

    Attributes
    ----------
    initial : int array, shape (N, K)
        Place of each person at the beginning.
    who : int array, shape (N, K)
        Row of each person in their group's `Minds`, which has their goal.
    """

    def __init__(
        self, pool: Pool, groups: Mapping[int, ModelGroup], world: World, model: Ints, people: Ints, mind: Ints,
        goal: Ints,
    ) -> None:  # fmt: skip
        super().__init__(pool.policies, model)
        self.groups, self.goal = groups, goal
        self.initial = np.array([policy.task.initial for policy in pool.policies])[model]
        self.who = mind
        if world == "people":
            self.who = np.empty_like(model)
            for number, flat in by_model(model.reshape(-1), np.arange(model.size), len(pool.policies)):
                own = people.reshape(-1)[flat], goal.reshape(-1)[flat]
                self.who.reshape(-1)[flat] = groups[number].mind(*own)
