"""Where the robots of a live team are: each at a person, under way to one, or at its base."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..declare.refusals import AbsentError
from ..people.decision import Floats
from ..person.settings import Setting
from ..person.travel import Travel
from ..team.assignment import placed
from ..team.state import BASE


def robot_numbers(count: int) -> str:
    """Return which numbers robots have, as messages say what they expect."""
    return f"a number from 1 to {count}" if count > 1 else "1, as there is one robot"


class RobotPlaces:
    """The places of a team's robots, and the travel between them.

    Parameters
    ----------
    setting : Setting
    people : int
        Number of people for whom there are places, if there is no matrix of distances.
    distance : array, shape (P + 1, P + 1), optional
        Distances between the places of P people and the base; by default 1 between any two.

    Attributes
    ----------
    travel : Travel
    distance : float array, shape (P + 1, P + 1), or None
        The given distances.
    at : list of int
        For each robot, the place of the person at whom it is or to whom it is under way, or BASE.
    under_way : list of bool
    """

    def __init__(self, setting: Setting, people: int, distance: ArrayLike | None) -> None:
        self._setting = setting
        self.distance: Floats | None = None if distance is None else np.array(distance, dtype=float)
        self.travel = setting.travel(max(1, people if self.distance is None else len(self.distance) - 1), self.distance)
        self.at, self.under_way = [BASE] * len(setting.robots), [False] * len(setting.robots)

    def number(self, robot: int) -> int:
        """Return the index of a robot, whose number counts from 1.

        Raises
        ------
        AbsentError
            There is no such robot.
        """
        if isinstance(robot, bool) or not isinstance(robot, int) or not 1 <= robot <= len(self.at):
            raise AbsentError("other", why=f"robot {robot!r}: expected {robot_numbers(len(self.at))}")
        return robot - 1

    def grow(self, people: int) -> None:
        """Make places for a number of people, at a distance of 1."""
        self.travel = self._setting.travel(people)

    def other_travel(self, distance: ArrayLike, people: int) -> Travel:
        """Return the travel over other distances.

        Raises
        ------
        ValueError
            The matrix is invalid, or too small for this number of people.
        """
        found = np.array(distance, dtype=float)
        travel = self._setting.travel(max(1, len(found) - 1), found)
        if len(travel) < people:
            raise ValueError(f"distance: {len(travel)} places; expected one for each of {people} people and the base")
        return travel

    def rearrange(self, distance: ArrayLike, people: int) -> None:
        """Use other distances from now on; arguments and errors as in `other_travel`. A robot under way continues."""
        self.travel = self.other_travel(distance, people)
        self.distance = np.array(distance, dtype=float)

    def cost(self, number: int, origin: int) -> Floats:
        """Return what it costs a robot to move from a place to each place, in cost units, shape (P + 1,)."""
        return self.travel.costs_of(number, origin)

    def takes_time(self, number: int, place: int) -> bool:
        """Return whether a robot that is sent to a place arrives in a later step."""
        one, origin, to = np.array([[number], [self.at[number]], [place]])
        return bool(self.travel.steps_between(one, origin, to)[0] > 0)

    def put(self, number: int, place: int, *, under_way: bool = False) -> None:
        """Record where a robot is, or to which place it is under way."""
        self.at[number], self.under_way[number] = place, under_way

    def make_room(self, sent: ArrayLike) -> None:
        """Move robots without a task away from places to which others are sent.

        Parameters
        ----------
        sent : int array, shape (M,)
            The place to which each robot is sent, or NOBODY.
        """
        self.at = placed(np.array([self.at]), np.reshape(sent, (1, -1)))[0].tolist()

    def stop_for_absent(self, present: NDArray[np.bool_]) -> None:
        """Let robots under way to people who have left be there, because their positions are unknown."""
        for number, place in enumerate(self.at):
            self.under_way[number] = self.under_way[number] and bool(present[place])
