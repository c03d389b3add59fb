"""Travel of robots that move at different costs or speeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from .travel import Travel


@dataclass(frozen=True)
class TravelOfEach(Travel):
    """The travel of robots that differ; the fields of `Travel` are the lowest of any robot.

    Attributes
    ----------
    robots : tuple of Travel
        The travel of each robot.
    """

    robots: tuple[Travel, ...]

    @classmethod
    def of_each(cls, robots: Sequence[Travel]) -> TravelOfEach:
        """Return the travel of robots that move the same distances, at different costs or speeds."""
        least = min(robots, key=lambda one: float(one.steps.sum()))
        if any((one.distance != least.distance).any() or (one.steps < least.steps).any() for one in robots):
            raise ValueError("robots: expected the same distances, and one robot that is nowhere slower than another")
        return cls(least.distance, least.steps, min(one.c_move for one in robots), tuple(robots))

    @property
    def each(self) -> tuple[Travel, ...]:
        """The travel of each robot."""
        return self.robots

    def of_robot(self, number: int) -> Travel:
        """Return the travel of a robot, given by its number from 0."""
        return self.robots[number]

    def costs_from(self, location: NDArray[np.int64]) -> Floats:
        """Return the cost of each robot's move to each person, shape (N, M, K); `location` has the shape (N, M)."""
        c_move = np.array([[one.c_move] for one in self.robots])
        return np.asarray(c_move * self.distance[location][..., :-1])

    def steps_from(self, location: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the steps of each robot's move to each person; shapes as in `costs_from`."""
        return np.stack([own.steps[location[:, m], :-1] for m, own in enumerate(self.robots)], axis=1)

    def costs_between(self, robot: NDArray[np.int64], origin: NDArray[np.int64], to: NDArray[np.int64]) -> Floats:
        """Return the costs of moves of robots, given by their numbers from 0, between pairs of places."""
        return np.asarray(np.array([one.c_move for one in self.robots])[robot] * self.distance[origin, to])

    def steps_between(
        self, robot: NDArray[np.int64], origin: NDArray[np.int64], to: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Return the steps of moves of robots, given by their numbers from 0, between pairs of places."""
        steps = self.steps[origin, to]
        for m, own in enumerate(self.robots):
            steps = np.where(robot == m, own.steps[origin, to], steps)
        return steps
