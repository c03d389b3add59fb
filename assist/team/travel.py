"""Travel between the people's places: distances, travel times and costs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from planner.system.arrays import frozen

from ..people.arguments import MOST, whole, within
from ..people.decision import Floats


@dataclass(frozen=True)
class Travel:
    """Travel between the places of K people and the base, which comes last.

    Attributes
    ----------
    distance : float array, shape (K + 1, K + 1)
    steps : int array, shape (K + 1, K + 1)
        Travel time between two places in steps. With 0 the robot makes its suggestion in the step of its departure.
    c_move : float
        Cost of moving by a distance of 1, in cost units; it is paid at the departure.

    Raises
    ------
    ValueError
        A number is out of its range, or the matrices are not square with a diagonal of 0.
    """

    distance: Floats
    steps: NDArray[np.int64]
    c_move: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "c_move", within("c_move", self.c_move, 0, MOST))
        if self.distance.ndim != 2 or self.distance.shape[0] != self.distance.shape[1] or len(self.distance) < 2:
            raise ValueError(
                f"distance, shape {self.distance.shape}: expected a square, one row for each place and base"
            )
        # No temporary array of the matrix's size is created, which for 10,000 people would take a second.
        least, most = self.distance.min(), self.distance.max()
        if not (least >= 0 and most <= MOST) or self.distance.diagonal().any():
            raise ValueError(f"distance: expected 0 from each place to itself, and from 0 to {MOST:g} to the others")
        if self.steps.shape != self.distance.shape or self.steps.min() < 0 or self.steps.diagonal().any():
            raise ValueError("steps: expected one number of 0 or more for each distance, and 0 to stay")
        object.__setattr__(self, "distance", frozen(self.distance))
        object.__setattr__(self, "steps", frozen(self.steps))

    @classmethod
    def of(
        cls, places: int, *, c_move: float = 0.5, travel_time: float = 0.0, distance: ArrayLike | None = None
    ) -> Travel:
        """Return the travel between `places` people and the base.

        Parameters
        ----------
        places : int
            Number of people, K; at most 1,000,000.
        c_move : float
            Cost of moving by a distance of 1, in cost units.
        travel_time : float
            Steps for a distance of 1; fractions are rounded up to whole steps.
        distance : array, shape (K + 1, K + 1), optional
            Distances; by default 1 between any two places.
        """
        places = whole("places", places, 1)
        if places > 1_000_000:
            raise ValueError(f"places {places:,}: expected at most 1,000,000")
        travel_time = within("travel_time", travel_time, 0, MOST)
        if distance is None:
            row = np.ones(2 * places + 1)
            row[places] = 0.0
            return cls(_windows(row), _windows(_whole_steps(row * travel_time)), c_move)
        try:
            matrix = np.array(distance, dtype=float)
        except (TypeError, ValueError):
            raise ValueError("distance: expected a list of lists of numbers, all of the same length") from None
        if matrix.shape != (places + 1, places + 1):
            raise ValueError(
                f"distance, shape {matrix.shape}: expected ({places + 1}, {places + 1}), {places} people and the base"
            )
        return cls(matrix, _whole_steps(matrix * travel_time), c_move)

    def __len__(self) -> int:
        return len(self.distance) - 1

    @property
    def each(self) -> tuple[Travel, ...]:
        """The travel of each robot if robots differ (`TravelOfEach`), otherwise of all of them."""
        return (self,)

    def of_robot(self, _number: int) -> Travel:
        """Return the travel of a robot, given by its number from 0."""
        return self

    def costs_from(self, location: NDArray[np.int64]) -> Floats:
        """Return the cost of moving from each place to each person, shape (N, K).

        With several robots, `location` has the shape (N, M), and the costs (N, M, K).
        """
        return np.asarray(self.c_move * self.distance[location][..., :-1])

    def steps_from(self, location: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the steps of moving from each place to each person; shapes as in `costs_from`."""
        return self.steps[location][..., :-1]

    def costs_between(self, _robot: NDArray[np.int64], origin: NDArray[np.int64], to: NDArray[np.int64]) -> Floats:
        """Return the costs of moves of robots, given by their numbers from 0, between pairs of places."""
        return np.asarray(self.c_move * self.distance[origin, to])

    def steps_between(
        self, _robot: NDArray[np.int64], origin: NDArray[np.int64], to: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Return the steps of moves of robots, given by their numbers from 0, between pairs of places."""
        return self.steps[origin, to]

    @cached_property
    def equally_far(self) -> bool:
        """Whether all places, the base included, are equally far from each other for all robots, also in time."""
        return _off_the_diagonal_equal(self.distance) and all(_off_the_diagonal_equal(one.steps) for one in self.each)

    @property
    def entry(self) -> Floats:
        """The smallest cost of coming to each person from any other place, shape (K,)."""
        return self.c_move * np.array([np.delete(column, k).min() for k, column in enumerate(self.distance.T[:-1])])

    @property
    def entry_steps(self) -> NDArray[np.int64]:
        """The smallest number of steps for coming to each person from any other place, shape (K,)."""
        return np.array([np.delete(column, k).min() for k, column in enumerate(self.steps.T[:-1])], dtype=np.int64)


def _off_the_diagonal_equal(matrix: NDArray[Any]) -> bool:
    return all(
        bool((row[:k] == matrix[0, 1]).all() and (row[k + 1 :] == matrix[0, 1]).all()) for k, row in enumerate(matrix)
    )


def _whole_steps(steps: Floats) -> NDArray[np.int64]:
    longest = 1_000_000_000  # steps; far beyond the length of any episode
    if steps.max() >= longest:
        raise ValueError(f"travel_time: the longest way takes {steps.max():g} steps; expected less than {longest:,}")
    # For example, 3 * 0.1 is slightly larger than 0.3 in floating-point arithmetic; that must not add a step.
    return np.ceil(steps - 1e-9).clip(0).astype(np.int64)


def _windows(row: NDArray[Any]) -> NDArray[Any]:
    """Return a square matrix whose rows are shifts of one vector, as a view without memory of its own.

    For 10,000 people the matrix would take 800 MB.
    """
    return np.asarray(sliding_window_view(row, len(row) // 2 + 1)[::-1])
