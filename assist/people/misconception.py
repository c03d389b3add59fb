"""What a person is mistaken about: a number for each state, drawn when it is asked for.

A misconception eps(x) is a function of a person and a state. It comes from a generator that has no memory and counts
nothing: the person's seed and the state's key are mixed to a number (the finaliser of splitmix64: Steele, Lea and
Flood, "Fast splittable pseudorandom number generators", 2014), and that is made normal by the inverse of its
distribution. So a task of any size has people without an array for each of them, and a person is the same whatever the
order in which states are met, and however they are numbered: the key of a state is made of its variables' values.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .choices import Choices, mix

Noise = Literal["state", "action"]


def standard_normal(seed: int, keys: ArrayLike) -> NDArray[np.float64]:
    """Give a standard normal number for each key, the same for the same seed and key.

    Parameters
    ----------
    seed : int
        From 0 to 2**64 - 1.
    keys : uint64 array
        Of any shape.
    """
    from scipy.special import ndtri

    mixed = mix(np.asarray(keys, dtype=np.uint64) ^ mix(np.full(1, seed, dtype=np.uint64))[0])
    # 53 bits, in the middle of their interval: never 0 nor 1.
    uniform = ((mixed >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53
    return np.asarray(ndtri(uniform), dtype=np.float64)


@dataclass(frozen=True)
class Misconception:
    """By how much somebody is wrong about what is still to come.

    Attributes
    ----------
    sigma : float
        Standard deviation, in cost units.
    seed : int
        The person's own, from 0 to 2**64 - 1.
    noise : "state" or "action"
        Whether it is about states, or about what each choice leads to.
    """

    sigma: float
    seed: int
    noise: Noise = "state"

    def __post_init__(self) -> None:
        if self.noise not in ("state", "action"):
            raise ValueError(f"noise '{self.noise}': expected 'state' or 'action'")

    @classmethod
    def drawn(cls, sigma: float, rng: np.random.Generator, noise: Noise = "state") -> Misconception:
        """Take the seed from a generator: one number, whatever the task."""
        return cls(sigma, int(rng.integers(2**64, dtype=np.uint64)), noise)

    def of(self, choices: Choices) -> NDArray[np.float64]:
        """Give what the person takes for the cost-to-go, shape (n,), or after each choice, shape (n, A).

        The goal is recognised (0) and dead ends stay infinite.

        Parameters
        ----------
        choices : Choices
            All of a task or any part of it.
        """
        keys = choices.keys
        if self.noise == "action":
            after = choices.h[choices.targets]
            eps = standard_normal(self.seed, mix(keys)[:, None] ^ (choices.actions + 1).astype(np.uint64))
            return np.where(choices.goal[choices.targets], 0.0, after + self.sigma * eps)
        return np.where(choices.goal, 0.0, choices.h + self.sigma * standard_normal(self.seed, keys))
