"""Values of a person's problem on a truncated task, and estimates of the values outside it.

The bounds at a frontier are far from the true values. A policy that used them as values would assume that people beyond
the frontier never err. So the values at the frontier are *estimated*: as the mean value of those states of the
truncated task that have the same cost-to-go. Value iteration and new means alternate a few times. The same means serve
for all states outside. The estimates are not used for any bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.system.arrays import outline, read_only
from planner.system.progress import Progress

from ..people.decision import Floats, Ints
from ..people.goals import first_of
from .backups import bellman_backup
from .frontier_bounds import never_erring
from .mdp_values import initial_upper_bounds, value_iteration
from .pomdp import AssistPOMDP
from .truncated_task import TruncatedTask


@dataclass(frozen=True)
class LeafEstimates:
    """Values of the states of a truncated task, and mean values by cost-to-go for all other states.

    Attributes
    ----------
    states : int array, shape (m,)
        States of the truncated task in ascending order, without the frontier.
    value : float array, shape (m, P, H, T)
        Values with observed type and theta, in cost units, for each of P positions of the robot. P is 1 if the robot is
        always there.
    level : float array, shape (L,)
        Distinct values of the cost-to-go, in ascending order.
    mean : float array, shape (L, P, H, T)
        Mean value of the states of each level.
    costs : float array
        Costs of the task's actions.
    gamma : float
    """

    states: Ints
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
        rows: Ints | None = None,
        *,
        like: LeafEstimates | None = None,
        tolerance: float | None = None,
        progress: Progress | None = None,
    ) -> LeafEstimates:
        """Compute the values and estimates.

        There are four rounds of value iteration and averaging, or two with `like`, since these start close to a fixed
        point. The tolerance is ten times larger in each earlier round, because early means need less precision.

        Parameters
        ----------
        problem : AssistPOMDP
            One person's problem on the truncated task, with the same frontier.
        region : TruncatedTask
            Truncated task of n states.
        rows : int array, shape (P, n)
            State of the problem for each position of the robot; by default the states of the task.
        like : LeafEstimates, optional
            Estimates of a problem with similar values, at which the iteration starts. They have as many positions, or
            one.
        tolerance : float
            Largest error of a value for given frontier values, in cost units; by default 0.3, or 1e-6 without a
            frontier, as for a whole task. A tenth of 0.3 changed returns on a task of seven million states by less than
            0.05 and took almost twice the time. Errors of probable states are much smaller: in the last sweep no value
            changes by more than (1 - gamma) times the tolerance.
        progress : callable, optional
            Receives progress reports, as in `qmdp`.
        """
        choices, costs = region.choices, first_of(region.known).task.action_costs
        rows = np.arange(len(choices))[None] if rows is None else rows
        order = region.inside
        value = initial_upper_bounds(problem)
        rounds = (4 if like is None else 2) if len(region.frontier) else 1
        tolerance = tolerance or (0.3 if len(region.frontier) else 1e-6)
        if like is not None and rounds > 1:  # without a frontier the values are bounds, and start as such
            begins = np.flatnonzero(np.isfinite(choices.h) & ~choices.goal)
            value[rows[:, begins].T] = like.at(region.states[begins], choices.h[begins])
        for round_ in range(1, rounds + 1):
            value_iteration(problem, value, tolerance=tolerance * 10.0 ** (rounds - round_), progress=progress)
            estimates = cls._of_values(region, value[rows[:, order].T], costs, problem.gamma)
            if round_ < rounds:
                value[rows[:, region.frontier].T] = estimates.beyond(choices.h[region.frontier])
        return estimates

    @classmethod
    def _of_values(cls, region: TruncatedTask, value: Floats, costs: Floats, gamma: float) -> LeafEstimates:
        """Return the estimates for values of the states inside a truncated task, shape (m, P, H, T)."""
        level, inverse = np.unique(region.choices.h[region.inside], return_inverse=True)
        mean = np.zeros((len(level), *value.shape[1:]))
        np.add.at(mean, inverse, value)
        mean /= np.bincount(inverse, minlength=len(level))[:, None, None, None]
        return cls(region.states[region.inside], value, level, mean, costs, gamma)

    def a_step_before(self, problem: AssistPOMDP, region: TruncatedTask, rows: Ints) -> LeafEstimates:
        """Return the values one step before these, by one Bellman backup; arguments as in `of`."""
        value = initial_upper_bounds(problem)
        value[rows[:, region.inside].T] = self.value
        value[rows[:, region.frontier].T] = self.beyond(region.choices.h[region.frontier])
        found = bellman_backup(problem, value)[rows[:, region.inside].T]
        return self._of_values(region, found, self.costs, self.gamma)

    def at(self, states: Ints, h: Floats) -> Floats:
        """Return the values of states, shape (N, P, H, T).

        Parameters
        ----------
        states : int array, shape (N,)
            Numbers of the states in the task.
        h : float array, shape (N,)
            Their exact cost-to-go.
        """
        index = np.minimum(np.searchsorted(self.states, states), len(self.states) - 1)
        inside = self.states[index] == states
        values = np.empty((len(states), *self.value.shape[1:]))
        values[inside] = self.value[index[inside]]
        values[~inside] = self.beyond(h[~inside])
        return values

    def beyond(self, h: Floats) -> Floats:
        """Return estimates of the value of states with a given cost-to-go, shape (N, P, H, T).

        The estimate is the mean of the nearest level that is not higher, or else of the lowest level. It is scaled by
        the ratio of the upper bounds `never_erring` of the state and of the level.
        """
        at = np.clip(np.searchsorted(self.level, h, side="right") - 1, 0, len(self.level) - 1)
        least, known = never_erring(h, self.costs, self.gamma), never_erring(self.level[at], self.costs, self.gamma)
        ratio = np.divide(least, known, out=np.ones_like(least), where=known < 0)
        return np.asarray(self.mean[at] * ratio[:, None, None, None])
