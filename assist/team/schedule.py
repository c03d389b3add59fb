"""The steps in which people are present."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..people.arguments import wholes


@dataclass(frozen=True)
class Schedule:
    """The steps in which people are present.

    Attributes
    ----------
    joins : int array, shape (K,)
        First step of the person at each place.
    leaves : int array, shape (K,)
        Step before which the person leaves, whether or not they have finished.

    Raises
    ------
    ValueError
        A person joins before step 0, or leaves before they join.
    """

    joins: NDArray[np.int64]
    leaves: NDArray[np.int64]

    @classmethod
    def of(cls, humans: int, joins: ArrayLike = 0, leaves: ArrayLike | None = None) -> Schedule:
        """Return a schedule for `humans` people; by default all are present from the beginning until they finish."""
        never = np.iinfo(np.int64).max
        return cls(
            np.broadcast_to(wholes("joins", joins), (humans,)),
            np.broadcast_to(wholes("leaves", never if leaves is None else leaves), (humans,)),
        )

    def __post_init__(self) -> None:
        if (self.joins < 0).any() or (self.leaves <= self.joins).any():
            raise ValueError("presence: expected people to join at step 0 or later and to leave after that")
