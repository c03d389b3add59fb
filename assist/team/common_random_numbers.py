"""Common random numbers: the numbers of an episode depend on the seed and the episode's number only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..person.random_streams import Stream

BLOCK = 64
"""Number of episodes whose random numbers are drawn together; a change of it changes all results for a seed."""


class CommonRandomNumbers:
    """The random numbers of some episodes, independent of the other episodes that are simulated."""

    def __init__(self, seed: int, numbers: NDArray[np.int64], places: int) -> None:
        self.blocks, self.block = np.unique(numbers // BLOCK, return_inverse=True)
        self.seed, self.within, self.places = seed, numbers % BLOCK, places
        self.drawn = np.empty((len(self.blocks), BLOCK, places))
        self._generators: dict[int, list[np.random.Generator]] = {}

    def generators(self, stream: int) -> list[np.random.Generator]:
        """Return the generator of a stream for each block, made when the first number is drawn."""
        if stream not in self._generators:
            keys = [(1, int(stream), int(block)) for block in self.blocks]
            seeds = [np.random.SeedSequence(self.seed, spawn_key=key) for key in keys]
            self._generators[stream] = [np.random.default_rng(one) for one in seeds]
        return self._generators[stream]

    def draw(self, stream: int, episodes: NDArray[np.int64]) -> Floats:
        """Return uniform numbers of a `Stream` for some episodes.

        Each call advances the generators. An episode has the same numbers whatever others are simulated if there is one
        call in each of its steps, for all episodes that have not ended, whether or not the numbers are used.
        """
        advances = np.zeros(len(self.drawn), dtype=bool)  # those of finished episodes need not
        advances[self.block[episodes]] = True
        generators = self.generators(stream)
        for block in np.flatnonzero(advances).tolist():
            generators[block].random(out=self.drawn[block])
        return self.drawn[self.block[episodes], self.within[episodes]]

    def team(self, pool: int) -> NDArray[np.int64]:
        """Return K distinct numbers of a pool for each episode, shape (N, K)."""
        order = [one.permuted(np.tile(np.arange(pool), (BLOCK, 1)), axis=1) for one in self.generators(Stream.TEAM)]
        return np.stack(order)[self.block, self.within, : self.places]
