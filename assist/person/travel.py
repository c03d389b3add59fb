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
from ..people.decision import Floats, Ints
from .robots import LONGEST


@dataclass(frozen=True, eq=False)
class Travel:
    """Travel of M robots between the places of K people and the base, which comes last.

    Attributes
    ----------
    distance : float array, shape (K + 1, K + 1)
    c_move : float array, shape (M,)
        Cost of moving by a distance of 1, in cost units; it is paid at the departure.
    travel_time : float array, shape (M,)
        Steps for a distance of 1; fractions are rounded up to whole steps. With 0 a robot makes its suggestion in the
        step of its departure.

    Raises
    ------
    ValueError
        A number is out of its range, or the matrix is not square with a diagonal of 0.
    """

    distance: Floats
    c_move: Floats
    travel_time: Floats

    def __post_init__(self) -> None:
        for name in ("c_move", "travel_time"):
            values = [within(name, one, 0, MOST) for one in np.atleast_1d(getattr(self, name)).tolist()]
            object.__setattr__(self, name, frozen(np.array(values)))
        if self.distance.ndim != 2 or self.distance.shape[0] != self.distance.shape[1] or len(self.distance) < 2:
            raise ValueError(
                f"distance, shape {self.distance.shape}: expected a square, one row for each place and base"
            )
        # No temporary array of the matrix's size is created, which for 10,000 people would take a second.
        least, most = self.distance.min(), self.distance.max()
        if not (least >= 0 and most <= MOST) or self.distance.diagonal().any():
            raise ValueError(f"distance: expected 0 from each place to itself, and from 0 to {MOST:g} to the others")
        longest = float(most * self.travel_time.max())
        if longest > LONGEST:
            raise ValueError(f"travel_time: the longest way takes {longest:g} steps; expected at most {LONGEST:,.0f}")
        object.__setattr__(self, "distance", frozen(self.distance))

    @classmethod
    def of(
        cls, places: int, *, c_move: ArrayLike = 0.5, travel_time: ArrayLike = 0.0, distance: ArrayLike | None = None
    ) -> Travel:
        """Return the travel between `places` people and the base.

        Parameters
        ----------
        places : int
            Number of people, K; at most 1,000,000.
        c_move : float, or float array of shape (M,)
            Cost of moving by a distance of 1, in cost units: of each robot, or of the only one.
        travel_time : float, or float array of shape (M,)
            Steps for a distance of 1; fractions are rounded up to whole steps.
        distance : array, shape (K + 1, K + 1), optional
            Distances; by default 1 between any two places.
        """
        places = whole("places", places, 1)
        if places > 1_000_000:
            raise ValueError(f"places {places:,}: expected at most 1,000,000")
        each = np.broadcast_arrays(np.atleast_1d(c_move), np.atleast_1d(travel_time))
        if distance is None:
            row = np.ones(2 * places + 1)
            row[places] = 0.0
            return cls(_windows(row), *each)
        try:
            matrix = np.array(distance, dtype=float)
        except (TypeError, ValueError):
            raise ValueError("distance: expected a list of lists of numbers, all of the same length") from None
        if matrix.shape != (places + 1, places + 1):
            raise ValueError(
                f"distance, shape {matrix.shape}: expected ({places + 1}, {places + 1}), {places} people and the base"
            )
        return cls(matrix, *each)

    def __len__(self) -> int:
        return len(self.distance) - 1

    def costs_from(self, location: Ints) -> Floats:
        """Return the cost of each robot's move to each person, shape (N, M, K); `location` has the shape (N, M)."""
        return np.asarray(self.c_move[:, None] * self.distance[location][..., :-1])

    def steps_from(self, location: Ints) -> Ints:
        """Return the steps of each robot's move to each person; shapes as in `costs_from`."""
        if self.at_once:
            return np.zeros((*location.shape, len(self)), dtype=np.int64)
        return _whole_steps(self.distance[location][..., :-1] * self.travel_time[:, None])

    def costs_between(self, robot: Ints, origin: Ints, to: Ints) -> Floats:
        """Return the costs of moves of robots, given by their numbers from 0, between pairs of places."""
        return np.asarray(self.c_move[robot] * self.distance[origin, to])

    def costs_of(self, robot: int, origin: int) -> Floats:
        """Return the costs of one robot's moves from a place to each place and the base, shape (K + 1,)."""
        return self.costs_between(np.array(robot), np.array(origin), np.arange(len(self.distance)))

    def steps_between(self, robot: Ints, origin: Ints, to: Ints) -> Ints:
        """Return the steps of moves of robots, given by their numbers from 0, between pairs of places."""
        if self.at_once:
            return np.zeros(np.broadcast_shapes(np.shape(robot), np.shape(origin), np.shape(to)), dtype=np.int64)
        return _whole_steps(self.distance[origin, to] * self.travel_time[robot])

    @cached_property
    def at_once(self) -> bool:
        """Whether no way takes time, so that nothing needs to be computed."""
        return not self.travel_time.any()

    @cached_property
    def equally_far(self) -> bool:
        """Whether all places, the base included, are equally far from each other."""
        return all(
            bool((row[:k] == self.distance[0, 1]).all() and (row[k + 1 :] == self.distance[0, 1]).all())
            for k, row in enumerate(self.distance)
        )

    @cached_property
    def alike(self) -> bool:
        """Whether all robots move at the same cost and speed."""
        return bool((self.c_move == self.c_move[0]).all() and (self.travel_time == self.travel_time[0]).all())

    @property
    def entry(self) -> Floats:
        """The smallest cost of coming to each person from any other place by any robot, shape (K,)."""
        return self.c_move.min() * self._nearest

    @property
    def entry_steps(self) -> Ints:
        """The smallest number of steps for coming to each person from any other place by any robot, shape (K,)."""
        return _whole_steps(self._nearest * self.travel_time.min())

    @property
    def _nearest(self) -> Floats:
        return np.array([np.delete(column, k).min() for k, column in enumerate(self.distance.T[:-1])])

    @property
    def mean_way(self) -> tuple[float, float]:
        """The mean cost of coming to a person, and its mean number of steps, over all ways and robots."""
        way = self.distance[:, :-1][~np.eye(len(self.distance), dtype=bool)[:, :-1]]
        # Relative to the first robot, so that robots that are alike have its cost to the last bit.
        c_move = self.c_move[0] + (self.c_move - self.c_move[0]).mean()
        steps = np.mean([_whole_steps(way * one).mean() for one in self.travel_time])
        return float(c_move) * float(way.mean()), float(steps)

    @property
    def longest_way(self) -> int:
        """The number of steps from a place to the farthest one by the slowest robot."""
        return int(_whole_steps(self.distance.max() * self.travel_time.max()))


def _whole_steps(steps: Floats) -> Ints:
    # For example, 3 * 0.1 is slightly larger than 0.3 in floating-point arithmetic; that must not add a step.
    return np.ceil(steps - 1e-9).clip(0).astype(np.int64)


def _windows(row: NDArray[Any]) -> NDArray[Any]:
    """Return a square matrix whose rows are shifts of one vector, as a view without memory of its own.

    For 10,000 people the matrix would take 800 MB.
    """
    return np.asarray(sliding_window_view(row, len(row) // 2 + 1)[::-1])
