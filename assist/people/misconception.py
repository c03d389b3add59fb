"""A person's misconceptions: a random number for each state, computed on demand.

A misconception eps(x) is a function of the person's seed and the state's key, so that no array and no generator state
is stored. The two are hashed (the finaliser of splitmix64: Steele, Lea and Flood, "Fast splittable pseudorandom number
generators", 2014), and the inverse of the normal distribution function is applied. The key of a state is a hash of its
variables' values. So a person is the same in a task of any size, whatever the order and the numbers of the states.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arguments import one_of
from .choices import Choices
from .hidden_type import Bools, Floats
from .state_keys import mix

Noise = Literal["state", "action"]


def standard_normal(seed: int, keys: ArrayLike) -> Floats:
    """Return a standard normal number for each key, a function of the seed and the key.

    Parameters
    ----------
    seed : int
        From 0 to 2**64 - 1.
    keys : uint64 array
        Keys, in an array of any shape.
    """
    from scipy.special import ndtri

    mixed = mix(np.asarray(keys, dtype=np.uint64) ^ mix(np.full(1, seed, dtype=np.uint64))[0])
    # The midpoint of one of 2**53 intervals, which is neither 0 nor 1.
    uniform = ((mixed >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53
    return np.asarray(ndtri(uniform), dtype=np.float64)


@dataclass(frozen=True)
class Misconception:
    """The error of a person's perceived cost-to-go.

    Attributes
    ----------
    sigma : float
        Standard deviation, in cost units.
    seed : int
        Seed of the person, from 0 to 2**64 - 1.
    noise : "state" or "action"
        Whether there is one error for each state, or one for each choice.
    """

    sigma: float
    seed: int
    noise: Noise = "state"

    def __post_init__(self) -> None:
        one_of("noise", self.noise, get_args(Noise))

    @classmethod
    def drawn(cls, sigma: float, rng: np.random.Generator, noise: Noise = "state") -> Misconception:
        """Return a misconception whose seed is one number of a generator."""
        return cls(sigma, int(rng.integers(2**64, dtype=np.uint64)), noise)

    def of(self, choices: Choices) -> Floats:
        """Return the perceived cost-to-go of each state, shape (n,), or after each choice, shape (n, A).

        The goal is recognised (0) and dead ends stay infinite.

        Parameters
        ----------
        choices : Choices
            A task or any part of it.
        """
        keys = choices.keys
        if self.noise == "action":
            after = choices.h[choices.targets]
            eps = standard_normal(self.seed, mix(keys)[:, None] ^ (choices.actions + 1).astype(np.uint64))
            return np.where(choices.goal[choices.targets], 0.0, after + self.sigma * eps)
        return self.of_states(choices.h, choices.goal, keys)

    def of_states(self, h: Floats, goal: Bools, keys: NDArray[np.uint64]) -> Floats:
        """Return the perceived cost-to-go of states with these keys, shape (n,), for a misconception about states."""
        return np.where(goal, 0.0, h + self.sigma * standard_normal(self.seed, keys))


def perceived_cost_to_go(choices: Choices, sigma: float, rng: np.random.Generator, noise: Noise = "state") -> Floats:
    """Return a person's perceived cost-to-go of every state, shape (n,), or after every choice, shape (n, A).

    h(x) = h*(x) + sigma * eps(x) with eps standard normal is a lasting misconception. It is drawn once per person and
    task state, whatever they did before. With `noise="action"` it is drawn once per person and choice, h(x, a) =
    h*(succ(x, a)) + sigma * eps(x, a), so that a state looks different from different predecessors. The goal is
    recognised (h = 0), and dead ends stay infinite.

    Parameters
    ----------
    choices : Choices
    sigma : float
        Standard deviation, in cost units.
    rng : numpy.random.Generator
        One number is drawn from it, whatever the size of the task: the person's seed (`Misconception`).
    noise : "state" or "action"
    """
    return Misconception.drawn(sigma, rng, noise).of(choices)
