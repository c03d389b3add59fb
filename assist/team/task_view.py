"""The people's tasks as a step of a simulation sees them: the row of each person in their policy's problem."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .model_group import Ints, ModelGroup, World
from .pool import Pool
from .state import by_model


class TaskView:
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
        self.policies, self.groups, self.model, self.goal = pool.policies, groups, model, goal
        self.initial = np.array([policy.task.initial for policy in pool.policies])[model]
        self.who = mind
        if world == "people":
            self.who = np.empty_like(model)
            for number, flat in by_model(model.reshape(-1), np.arange(model.size), len(pool.policies)):
                own = people.reshape(-1)[flat], goal.reshape(-1)[flat]
                self.who.reshape(-1)[flat] = groups[number].mind(*own)
        self._growing = np.array([not policy.problem.complete for policy in pool.policies])[model].reshape(-1)

    def rows(self, places: Ints, active: Ints) -> Ints:
        """Return the row of each person, shape (N, K); of people who are not active, any row.

        Parameters
        ----------
        places : int array, shape (N, K)
        active : int array
            Active people, as indices of the flattened `places`.
        """
        if not self._growing.any():
            return places
        found = places.reshape(-1).copy()
        found[self._growing] = 0
        some = active[self._growing[active]]
        for number, flat in by_model(self.model.reshape(-1), some, len(self.policies)):
            found[flat] = self.policies[number].rows(places.reshape(-1)[flat], self)
        return found.reshape(places.shape)
