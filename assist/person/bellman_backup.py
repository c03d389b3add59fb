"""The Bellman backup of a person's problem with an observed type and theta, in numpy.

It is the readable definition of `action_values`, for types of one goal (`policy_iteration.of_goal`). Sums run over
arrays, so that results differ from compiled ones by rounding. Small problems use it, since compiling takes seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from .problem_arrays import ProblemArrays

Ints = NDArray[np.int64]


MOST_ENTRIES = 0
"""Values times choices of a problem up to which it is small: none so far. Of 600,000, solving takes half a second in
numpy, and compiling seven. Before this is raised, what is recorded of bounds and live teams has to be recorded anew.
"""


def is_small(value: Floats, slots: int) -> bool:
    """Return whether a problem with values of shape (n, H, T) is small: this depends on its size alone."""
    return value.size * slots <= MOST_ENTRIES


@dataclass(frozen=True)
class _Sums:
    """Sums over the choices in some states, one state for each entry of `x`, shape (P,), but without one choice each.

    `left_out`, shape (P,), is the slot of the choice that is left out, -1 for none.
    """

    x: Ints
    left_out: Ints
    m: ProblemArrays

    @cached_property
    def _rows(self) -> tuple[Ints, Ints, Ints]:
        """Place in `x` of each summand, its state and its slot, in order."""
        slots = np.arange(self.m.targets.shape[1])
        place, slot = np.nonzero((slots < self.m.counts[self.x, None]) & (slots != self.left_out[:, None]))
        return place, self.x[place], slot

    def of(self, value: Floats) -> tuple[Floats, Floats]:
        """Return the expected returns, shape (P, H, T), of these choices, and those of uniform choices."""
        m, (place, x, slot) = self.m, self._rows
        returns = m.gamma * value[m.targets[x, slot]] - m.costs[x, slot, None, None]
        expected, mean = np.zeros((2, len(self.x), *value.shape[1:]))
        if len(place):
            begin = np.flatnonzero(np.diff(place, prepend=-1))
            expected[place[begin]] = np.add.reduceat(m.chosen[x, slot][:, :, None] * returns, begin)
            mean[place[begin]] = np.add.reduceat(returns, begin)
        return expected, mean / np.maximum(m.counts[self.x], 1)[:, None, None]


def _between(table: Floats, low: Ints, up: Floats) -> Floats:
    """Return a table, shape (P, H, T), between its entries of thetas `low` and `low + 1`, shape (P, T)."""
    low, up = low[:, None], up[:, None]
    return (1.0 - up) * np.take_along_axis(table, low, 2) + up * np.take_along_axis(table, low + 1, 2)


@dataclass(frozen=True)
class BellmanBackup:
    """The Q-values of robot actions in some states: `x` and `robot`, shape (P,), are pairs of a state and an action."""

    x: Ints
    robot: Ints
    m: ProblemArrays

    @classmethod
    def of(cls, states: Ints, robot: Ints, m: ProblemArrays) -> BellmanBackup:
        """Return the backup of all robot actions in some states, or of the only one where `robot` names one.

        `states` has the shape (k,), and `robot` (n,); it is negative for all actions.
        """
        actions, only = np.arange(m.suggested.shape[1]), robot[states, None]
        place, r = np.nonzero((actions < m.robot_actions[states, None]) & ((only < 0) | (actions == only)))
        return cls(states[place], r, m)

    @cached_property
    def _silent(self) -> tuple[Ints, Ints, _Sums]:
        """Pairs without a suggestion: their places, and the place of each among the states in which people act."""
        places = np.flatnonzero((self.m.suggested[self.x, self.robot] < 0) & ~self._ends)
        states, which = np.unique(self.m.afterstate[self.x[places], self.robot[places]], return_inverse=True)
        return places, which, _Sums(states, np.full(len(states), -1), self.m)

    @cached_property
    def _ends(self) -> NDArray[np.bool_]:
        """Whether the robot's execution reaches the goal."""
        return self.m.goal[0, self.m.afterstate[self.x, self.robot]]

    @cached_property
    def _advised(self) -> tuple[Ints, _Sums]:
        """Pairs with a suggestion: their places, and the sums over the other choices."""
        places = np.flatnonzero((self.m.suggested[self.x, self.robot] >= 0) & ~self._ends)
        x, robot = self.x[places], self.robot[places]
        return places, _Sums(self.m.afterstate[x, robot], self.m.suggested[x, robot], self.m)

    def q_values(self, value: Floats) -> Floats:
        """Return the Q-value of each pair, shape (P, H, T), from values of all states, shape (n, H, T)."""
        m, q = self.m, np.zeros((len(self.x), *value.shape[1:]))
        places, which, sums = self._silent
        expected, mean = sums.of(value)
        q[places] = ((1.0 - m.lapse) * expected + m.lapse * mean)[which]
        places, others = self._advised
        if len(places):
            q[places] = self._after_suggestion(value, others, self.x[places], self.robot[places])
        return q - m.robot_costs[self.x, self.robot][:, None, None]

    def _after_suggestion(self, value: Floats, others: _Sums, x: Ints, robot: Ints) -> Floats:
        """Return the Q-values of suggestions, without their costs."""
        m, slot = self.m, others.left_out
        y, cost, count = m.targets[others.x, slot], m.costs[others.x, slot], m.counts[others.x]
        p, rest = m.chosen[others.x, slot][:, :, None], m.unsuggested[x, robot][:, :, None]
        low, up = m.low[x, robot, 0], m.weight[x, robot, 0]
        declined, uniform = (_between(sums, low, up) for sums in others.of(value))
        followed = m.gamma * _between(value[y], m.followed_low[x, robot, 0], m.followed_weight[x, robot, 0])
        followed -= cost[:, None, None]
        lapsed = uniform + followed / count[:, None, None]
        total = m.theta * p + (1.0 - m.theta) * rest
        both = m.theta * p * followed + (1.0 - m.theta) * declined
        influenced = np.divide(both, total, out=p * followed + declined, where=total > 0.0)
        return (1.0 - m.lapse) * influenced + m.lapse * lapsed

    def best(self, q: Floats) -> Floats:
        """Return the largest Q-value of each state, shape (k, H, T), in the order of the states."""
        return np.maximum.reduceat(q, np.flatnonzero(np.diff(self.x, prepend=-1)))
