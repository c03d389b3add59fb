"""What a person's problem is worth on a region of their task, and about what it is worth everywhere else.

Where a `TruncatedTask` breaks off, bounds are far from what really follows: a policy that took them for values would
think that people who leave it never err again. So here the values at the frontier are *estimated*, by the mean of the
region's values at states of the same cost-to-go, and worked out together with these: sweeps of value iteration, then
new means, a few times. The same means stand for all states outside. No bound rests on them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import outline, read_only
from planner.system.progress import Progress

from ..people.decision import Floats
from ..person.pomdp import AssistPOMDP
from ..person.qmdp import highest, improve
from .truncated_task import TruncatedTask, never_erring

TOLERANCE = 0.3
"""Largest error of a region's values given those at its frontier, in cost units.

With a tenth of it policies on a task of seven million states got the same within 0.05, and took nearly twice as long to
work out. Where it matters errors are far smaller: in the last sweep no value changes by more than 1 - gamma times this.
"""

DIGITS = 1e-3
"""The same where the region is the whole task, so that no value is estimated."""

ROUNDS = 4
"""Times that the means are taken."""

AGAIN = 2
"""Times that they are taken where values begin from somebody else's."""


@dataclass(frozen=True)
class LeafEstimates:
    """Values of a region's states, and of all others by their cost-to-go.

    Attributes
    ----------
    states : int array, shape (m,)
        Of the region, ascending; those on its frontier are not among them.
    value : float array, shape (m, P, B, T)
        Where beta and theta are seen, for each of P positions of the robot (one, if it is always there).
    level : float array, shape (L,)
        Costs-to-go, ascending.
    mean : float array, shape (L, P, B, T)
        The mean value of the region's states of each.
    costs : float array
        Of the task's actions.
    gamma : float
    """

    states: NDArray[np.int64]
    value: Floats
    level: Floats
    mean: Floats
    costs: Floats
    gamma: float

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    @classmethod
    def of(
        cls,
        problem: AssistPOMDP,
        region: TruncatedTask,
        rows: NDArray[np.int64] | None = None,
        *,
        like: LeafEstimates | None = None,
        tolerance: float | None = None,
        progress: Progress | None = None,
    ) -> LeafEstimates:
        """Work them out.

        Parameters
        ----------
        problem : AssistPOMDP
            One person's, on the region, which breaks off where the region does.
        region : TruncatedTask
            Of n states.
        rows : int array, shape (P, n)
            The problem's state for each position of the robot; those of the region unless given.
        like : LeafEstimates, optional
            Of a problem with similar values, from which these begin; with as many positions, or one.
        tolerance : float
            Largest error of a value given those at the frontier; `TOLERANCE` unless given, `DIGITS` where there is no
            frontier.
        progress : callable, optional
            Told how far it is, as `qmdp` says.
        """
        choices, costs = region.choices, np.array(region.known.task.costs, dtype=np.float64)
        rows = np.arange(len(choices))[None] if rows is None else rows
        inside = np.ones(len(choices), dtype=bool)
        inside[region.frontier] = False
        order = np.flatnonzero(inside)[np.argsort(region.states[inside])]
        level, place = np.unique(choices.h[order], return_inverse=True)
        value = highest(problem)
        rounds = (ROUNDS if like is None else AGAIN) if len(region.frontier) else 1
        tolerance = tolerance or (TOLERANCE if len(region.frontier) else DIGITS)
        if like is not None and rounds > 1:  # where nothing breaks off values are bounds, and begin as such
            begins = np.flatnonzero(np.isfinite(choices.h) & ~choices.goal)
            value[rows[:, begins].T] = like.at(region.states[begins], choices.h[begins])
        for round_ in range(1, rounds + 1):
            # Early means need no digits.
            improve(problem, value, tolerance=tolerance * 10.0 ** (rounds - round_), progress=progress)
            found = value[rows[:, order].T]
            mean = np.zeros((len(level), *found.shape[1:]))
            np.add.at(mean, place, found)
            mean /= np.bincount(place, minlength=len(level))[:, None, None, None]
            estimates = cls(region.states[order], found, level, mean, costs, problem.gamma)
            if round_ < rounds:
                value[rows[:, region.frontier].T] = estimates.beyond(choices.h[region.frontier])
        return estimates

    def at(self, states: NDArray[np.int64], h: Floats) -> Floats:
        """Give the values of states, shape (N, P, B, T).

        Parameters
        ----------
        states : int array, shape (N,)
            As the task numbers them.
        h : float array, shape (N,)
            Their exact cost-to-go.
        """
        place = np.minimum(np.searchsorted(self.states, states), len(self.states) - 1)
        inside = self.states[place] == states
        values = np.empty((len(states), *self.value.shape[1:]))
        values[inside] = self.value[place[inside]]
        values[~inside] = self.beyond(h[~inside])
        return values

    def beyond(self, h: Floats) -> Floats:
        """Estimate the value of states by their cost-to-go, shape (N, P, B, T).

        That of the nearest level below, or of the lowest, times by how much more must be paid at least.
        """
        at = np.clip(np.searchsorted(self.level, h, side="right") - 1, 0, len(self.level) - 1)
        least, known = never_erring(h, self.costs, self.gamma), never_erring(self.level[at], self.costs, self.gamma)
        ratio = np.divide(least, known, out=np.ones_like(least), where=known < 0)
        return np.asarray(self.mean[at] * ratio[:, None, None, None])
