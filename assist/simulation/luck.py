"""The luck of simulated episodes: each has its own random numbers, whatever others are simulated beside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats

BLOCK = 64
"""Episodes whose random numbers are drawn together."""


class Luck:
    """The random numbers of some episodes, whatever others are simulated beside them."""

    def __init__(self, seed: int, numbers: NDArray[np.int64], places: int) -> None:
        blocks, self.block = np.unique(numbers // BLOCK, return_inverse=True)
        self.row, self.places = numbers % BLOCK, places
        self.streams = [
            [np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1, kind, int(b)))) for b in blocks]
            for kind in range(4)
        ]
        self.drawn = np.empty((len(blocks), BLOCK, places))

    def draw(self, kind: int, rows: NDArray[np.int64]) -> Floats:
        """Give uniform numbers for some episodes: 0 who they are in the model, 1 choices, 2 moves of theta."""
        for block in np.unique(self.block[rows]):  # the streams of those that have ended are not missed
            self.streams[kind][block].random(out=self.drawn[block])
        return self.drawn[self.block[rows], self.row[rows]]

    def team(self, pool: int) -> NDArray[np.int64]:
        """Draw K different numbers of a pool, shape (N, K)."""
        order = [stream.permuted(np.tile(np.arange(pool), (BLOCK, 1)), axis=1) for stream in self.streams[3]]
        return np.stack(order)[self.block, self.row, : self.places]
