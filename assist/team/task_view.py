"""The people's tasks as a step of a simulation sees them: the row of each person in their policy's problem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..person.policy import Policy
from ..person.rows_of_people import RowsOfPeople, by_model
from .beginning import Beginning
from .model_group import Ints, ModelGroup


class TaskView(RowsOfPeople):
    """The people's tasks in a number of episodes that are simulated together. It holds the rows of the last step.

    Parameters
    ----------
    policies : sequence of Policy
    groups : mapping of int to ModelGroup
        The group of each policy that occurs.
    people : int array, shape (N, K)
        Each person's number in the pool.
    began : Beginning
        How these people begin.

    Attributes
    ----------
    who : int array, shape (N, K)
        Row of each person in their group's `Minds`, which has their goal.
    """

    def __init__(
        self, policies: Sequence[Policy], groups: Mapping[int, ModelGroup], people: Ints, began: Beginning
    ) -> None:
        super().__init__(policies, began.model)
        self.groups, self.who = groups, np.empty_like(began.model)
        for number, flat in by_model(self.model.reshape(-1), np.arange(self.model.size), len(policies)):
            own = (one.reshape(-1)[flat] for one in (people, began.goal, began.type))
            self.who.reshape(-1)[flat] = groups[number].who(*own)
