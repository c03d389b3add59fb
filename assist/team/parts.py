"""The forms of what an engine is given: people's problems, groups of people who choose alike, and random numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..person.beliefs import PersonModel
from ..person.people_arrays import PeopleArrays
from ..person.policy import Policy
from ..person.problem_arrays import ProblemArrays

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


class Group(Protocol):
    """The people of one model, and how they choose."""

    @property
    def model(self) -> PersonModel:
        """The robot's model of them."""
        ...

    @property
    def arrays(self) -> ProblemArrays:
        """Their problem."""
        ...

    def act(self, rows: Ints, people: PeopleArrays) -> None:
        """Let some people of the group act once."""
        ...

    def ended(self, rows: Ints, people: PeopleArrays) -> Bools:
        """Return whether the episode has ended for some people of the group."""
        ...


class Tasks(Protocol):
    """The people's problems.

    Attributes
    ----------
    policies : sequence of Policy
    groups : mapping of int to Group
        By the index of the policy.
    model : int array, shape (N, K)
        Index of each person's policy.
    who : int array, shape (N, K)
        Row of each person in the `Minds` of their group.
    """

    @property
    def policies(self) -> Sequence[Policy]: ...  # noqa: D102
    @property
    def groups(self) -> Mapping[int, Group]: ...  # noqa: D102
    @property
    def model(self) -> Ints: ...  # noqa: D102
    @property
    def who(self) -> Ints: ...  # noqa: D102

    def rows(self, places: Ints, active: Ints) -> Ints:
        """Return the row of each person in their policy's problem, shape (N, K).

        Parameters
        ----------
        places : int array, shape (N, K)
            Where people are, as in `person.rows`.
        active : int array
            The people at work, as indices of the flattened array.
        """
        ...


class Draws(Protocol):
    """The random numbers of the episodes of teams."""

    def draw(self, kind: int, rows: Ints) -> Floats:
        """Return uniform numbers of a kind for some teams, shape (m, K); `CommonRandomNumbers.draw` has the kinds."""
        ...
