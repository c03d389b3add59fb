"""When people are there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..people.arguments import wholes


@dataclass(frozen=True)
class Schedule:
    """When people are there.

    Attributes
    ----------
    joins : int array, shape (K,)
        The step in which the person at each place begins.
    leaves : int array, shape (K,)
        The step in which they are gone, finished or not.
    """

    joins: NDArray[np.int64]
    leaves: NDArray[np.int64]

    @classmethod
    def of(cls, humans: int, joins: ArrayLike = 0, leaves: ArrayLike | None = None) -> Schedule:
        """Describe so many people: all from the beginning until they have finished, unless given."""
        never = np.iinfo(np.int64).max
        return cls(
            np.broadcast_to(wholes("joins", joins), (humans,)),
            np.broadcast_to(wholes("leaves", never if leaves is None else leaves), (humans,)),
        )

    def __post_init__(self) -> None:
        if (self.joins < 0).any() or (self.leaves <= self.joins).any():
            raise ValueError("presence: expected people to join at step 0 or later and to leave after that")
