"""The tasks of teams: where the people of each model are in their problem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..person.policy import Policy
from ..person.rows_of_people import RowsOfPeople
from .model_group import Ints, ModelGroup


class TeamTasks(RowsOfPeople):
    """The tasks of teams: the row of each person in the problem of their policy, and how people choose there.

    Parameters
    ----------
    policies : sequence of Policy
    groups : mapping of int to ModelGroup
        The people of each policy that occurs, by its index.
    model, who : int arrays, shape (N, K)
        Index of each person's policy, and their row in the `Minds` of its group.
    """

    def __init__(self, policies: Sequence[Policy], groups: Mapping[int, ModelGroup], model: Ints, who: Ints) -> None:
        super().__init__(policies, model)
        self.groups, self.who = groups, who
