"""Belief over a person's hidden type, which is their goal and expertise beta, and their influence theta.

Beta and theta take the values of a small `Grid`. A belief is an array of probabilities of shape (..., H, T), with an
axis of types (`hidden_type`), which never change, and one of theta. Theta moves by a known map. Its
result is divided between the two neighbouring grid points, so that its mean is exact (`shares`). Rounding to the
nearest point would freeze trust whenever a step is shorter than half a cell.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from planner.system.arrays import frozen

from .decision import Floats, Ints
from .hidden_type import HiddenType
from .ranges import Population
from .spread import Cells, Spread


class ImpossibleObservationError(ValueError):
    """The observation has probability zero under the belief."""


@dataclass(frozen=True)
class Grid:
    """The values of beta and theta that a belief distinguishes.

    Attributes
    ----------
    beta : float array, shape (B,)
    theta : float array, shape (T,)
        Ascending, from 0 to 1. If the trust rule counts outcomes, such values are repeated for each count.
    """

    beta: Floats
    theta: Floats

    def __post_init__(self) -> None:
        for name in ("beta", "theta"):
            object.__setattr__(self, name, frozen(np.asarray(getattr(self, name), dtype=float)))
        if self.beta.ndim != 1 or len(self.beta) < 1 or not ((np.diff(self.beta) > 0).all() and self.beta[0] >= 0):
            raise ValueError("beta: expected one or more ascending values from 0 upwards")
        if self.beta[-1] == np.inf:
            raise ValueError("beta: expected finite values")
        one = self.values
        if self.theta.ndim != 1 or len(one) < 2 or not (np.diff(one) > 0).all():
            raise ValueError("theta: expected two or more ascending values")
        if not np.array_equal(self.theta, np.tile(one, len(self.theta) // len(one))):
            raise ValueError("theta: expected the same ascending values for each count")
        if self.theta[0] != 0 or self.theta[-1] != 1:
            raise ValueError("theta: expected a grid from 0 to 1, because trust can move that far")

    @classmethod
    def regular(cls, population: Population, betas: int = 6, thetas: int = 10) -> Grid:
        """Return a grid with the midpoints of equal cells of the population's range of beta, and [0, 1] for theta."""
        low, high = population.beta
        edges = np.linspace(low, high, betas + 1)
        middles = (edges[1:] + edges[:-1]) / 2
        return cls(np.unique(middles), np.linspace(0.0, 1.0, thetas))

    def with_counts(self, counts: int) -> Grid:
        """Return the grid with its values of theta for each number of outcomes from 0 to `counts`."""
        return Grid(self.beta, np.tile(self.values, counts + 1))

    @property
    def values(self) -> Floats:
        """The ascending values of theta, without repetition."""
        falls = np.flatnonzero(np.diff(self.theta) < 0)
        return self.theta[: falls[0] + 1] if len(falls) else self.theta

    @property
    def count(self) -> Ints:
        """The number of outcomes that each grid point of theta belongs to, shape (T,)."""
        return np.arange(len(self.theta)) // len(self.values)

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of values of beta and of theta."""
        return len(self.beta), len(self.theta)

    def spreads(self, belief: Floats, hidden: HiddenType) -> tuple[Spread, Spread]:
        """Return the means and intervals of beta and theta under a belief, shape (H, T), over some types."""
        each = belief.sum(axis=0).reshape(-1, len(self.values)).sum(axis=0)  # over the counts of outcomes
        beta, theta = self._cells
        return beta.spread(hidden.marginal(belief, "beta")), theta.spread(each)

    @cached_property
    def _cells(self) -> tuple[Cells, Cells]:
        """The cells of beta and theta."""
        return Cells.of(self.beta, (0.0, np.inf)), Cells.of(self.values, (0.0, 1.0))

    def shares(self, theta: ArrayLike, count: ArrayLike = 0) -> tuple[Ints, Floats]:
        """Divide values of theta, with a number of outcomes each, between neighbouring grid points.

        Returns
        -------
        low : int array
            The grid point at or below each value; `low + 1` is the one above.
        weight : float array
            The share of `low + 1`; `low` has the rest.
        """
        theta = np.asarray(theta, dtype=float)
        values = self.values
        low = np.clip(np.searchsorted(values, theta, side="right") - 1, 0, len(values) - 2)
        weight = (theta - values[low]) / (values[low + 1] - values[low])
        low = low + np.asarray(count) * len(values)
        return low.astype(np.int64), np.clip(weight, 0.0, 1.0)

    def prior(self, population: Population) -> Floats:
        """Return the belief, shape (B, T), in a person drawn from a population.

        For a mixture, it is the mixture of the parts' beliefs. Beta is uniform over the grid's values in the
        population's range, or on the nearest one if there is none. The uniform density of theta is divided between
        grid points as single values are, so that its mean is exact. No outcome has been seen yet.
        """
        if population.parts:
            parts = zip(population.shares, population.parts, strict=True)
            return np.sum([share * self.prior(part) for share, part in parts], axis=0) / sum(population.shares)
        low, high = population.beta
        inside = (self.beta >= low) & (self.beta <= high)
        if not inside.any():
            inside = np.arange(len(self.beta)) == np.abs(self.beta - (low + high) / 2).argmin()
        beta = inside / inside.sum()
        (low, high), values = population.theta, self.values
        knots = np.unique(np.clip(values, low, high))
        theta = np.zeros(len(self.theta))
        if high > low:  # between knots the shares are linear, so that the midpoint represents the interval
            nodes, mass = (knots[1:] + knots[:-1]) / 2, np.diff(knots) / (high - low)
        else:
            nodes, mass = np.array([low]), np.array([1.0])
        at, weight = self.shares(nodes)
        np.add.at(theta, at, mass * (1 - weight))
        np.add.at(theta, at + 1, mass * weight)
        return beta[:, None] * theta[None, :]


def update(belief: Floats, likelihood: Floats, low: Ints, weight: Floats) -> Floats:
    """Return beliefs after an observation: Bayes' rule, followed by the trust update of theta.

    b'(h, theta') proportional to sum over theta of b(h, theta) P(a | x, r, h, theta) T(theta' | theta)

    Parameters
    ----------
    belief : float array, shape (N, H, T)
    likelihood : float array, shape (N, H, T)
        Probability of the observation.
    low, weight : int and float arrays, shape (N, T) or (N, H, T)
        New theta of each grid point, as `Grid.shares` returns it.

    Returns
    -------
    float array, shape (N, H, T)

    Raises
    ------
    ImpossibleObservationError
        The observation has probability zero.
    """
    joint = belief * likelihood
    evidence = joint.sum(axis=(1, 2))
    if not (evidence > 0).all():
        row = int(np.flatnonzero(~(evidence > 0))[0])
        raise ImpossibleObservationError(
            f"row {row}: the observation has probability {evidence[row]:g} under the belief {belief[row].tolist()}; "
            "a lapse rate above 0 in the model rules this out"
        )
    joint /= evidence[:, None, None]
    return moved(joint, low, weight)


def moved(belief: Floats, low: Ints, weight: Floats) -> Floats:
    """Return beliefs, shape (N, H, T), after theta of each grid point has moved; other arguments as in `update`."""
    found = np.zeros_like(belief)
    low = np.broadcast_to(low if low.ndim == 3 else low[:, None], belief.shape)
    weight = np.broadcast_to(weight if weight.ndim == 3 else weight[:, None], belief.shape)
    rows, columns = np.ogrid[: belief.shape[0], : belief.shape[1]]
    for t in range(belief.shape[2]):
        found[rows, columns, low[:, :, t]] += belief[:, :, t] * (1 - weight[:, :, t])
        found[rows, columns, low[:, :, t] + 1] += belief[:, :, t] * weight[:, :, t]
    return found
