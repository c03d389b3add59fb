"""The people of teams at work, as they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from .schedule import Schedule

Ints = NDArray[np.int64]


class Draws(Protocol):
    """The random numbers of the episodes of teams."""

    def draw(self, stream: int, teams: Ints) -> Floats:
        """Return uniform numbers of a stream for some teams, shape (m, K); `Stream` names them."""
        ...


@dataclass(eq=False, kw_only=True)
class PeopleAtWork:
    """N teams of K people as they are, which robots see in part; the arrays change in place.

    Attributes
    ----------
    number : int array, shape (N, K)
        Which person of a pool each of them is.
    draws : Draws
    on_grid : bool
        Whether they are people of the robot's model, whose theta moves between grid points at random.
    situation, row : int arrays, shape (N, K)
        Where each person is in the task, and the row of this situation in the present step (`person.rows`).
    goal : int array, shape (N, K)
        Number of the goal that each person pursues.
    theta : float array, shape (N, K)
    outcomes : int array, shape (N, K)
        Number of outcomes of suggestions that the person has seen.
    finished : bool array, shape (N, K)
    presence : Schedule
        The steps in which the person at each place is present.
    """

    number: Ints
    draws: Draws
    on_grid: bool
    situation: Ints
    row: Ints
    goal: Ints
    theta: Floats
    outcomes: Ints
    finished: NDArray[np.bool_]
    presence: Schedule
