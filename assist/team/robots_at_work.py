"""The robots of teams at work: where they are, and when they arrive."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..person.fleet import Fleet
from ..person.travel import Travel
from .assignment import placed
from .state import BASE, NOBODY, TeamAction

Ints = NDArray[np.int64]


class Sent(NamedTuple):
    """The robots that were sent in a step, each an entry of all arrays.

    Attributes
    ----------
    team, robot : int arrays
        The team, and the number of the robot in it.
    person, action : int arrays
        To whom the robot goes, and its robot action there.
    cost : float array
        Cost of the way, in cost units.
    changes_place : bool array
        Whether the robot changes its place.
    """

    team: Ints
    robot: Ints
    person: Ints
    action: Ints
    cost: Floats
    changes_place: NDArray[np.bool_]


class RobotsAtWork:
    """The M robots of each of N teams.

    A robot that makes room for another one is at its base in the same step, at no cost, however far that is.

    Parameters
    ----------
    fleet : Fleet
    travel : Travel
    teams : int

    Attributes
    ----------
    location : int array, shape (N, M)
        The person at whose place each robot is, or `BASE`; of a robot that is under way, the person to whom it goes.
    busy_until : int array, shape (N, M)
        The step of its arrival.
    """

    def __init__(self, fleet: Fleet, travel: Travel, teams: int) -> None:
        self.fleet, self.travel = fleet, travel
        self.location = np.full((teams, len(fleet)), BASE, dtype=np.int64)
        self.busy_until = np.zeros((teams, len(fleet)), dtype=np.int64)

    def ready(self, clock: Ints) -> NDArray[np.bool_]:
        """Return which robots are not under way, shape (N, M), at a step of each team, shape (N,)."""
        return self.busy_until <= clock[:, None]

    def left(self, clock: Ints) -> Ints:
        """Return the number of steps until each robot arrives, shape (N, M); 0 for one that is there."""
        return (self.busy_until - clock[:, None]).clip(0)

    def begin(self, teams: Ints) -> None:
        """Put the robots of some teams to their bases, at the beginning of an episode."""
        self.location[teams], self.busy_until[teams] = BASE, 0

    def send(self, action: TeamAction, teams: Ints, clock: Ints) -> Sent:
        """Send the robots of some teams, and return those that were sent; the others stay, or make room.

        Parameters
        ----------
        action : TeamAction
            The actions of these teams.
        teams : int array
        clock : int array, shape (N,)
            The present step of each of all teams.
        """
        rows, robot = np.nonzero(action.person != NOBODY)
        team, person = teams[rows], action.person[rows, robot]
        origin = self.location[team, robot]
        if len(rows):
            self.busy_until[team, robot] = clock[team] + self.travel.steps_between(robot, origin, person)
            self.location[teams] = placed(self.location[teams], action.person)
        cost = self.travel.costs_between(robot, origin, person)
        return Sent(team, robot, person, action.action[rows, robot], cost, origin != person)
