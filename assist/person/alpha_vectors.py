"""Policies represented by alpha vectors, as point-based solvers return them.

An alpha vector belongs to a state x and to a plan that begins with one robot action. It holds the plan's return for
each type and theta. The value of state x at belief b is at least the largest alpha . b over the vectors of x
(Smallwood and Sondik, "The optimal control of partially observable Markov processes over a finite horizon", 1973).
Every observed state has its own set of vectors (Ong, Png, Hsu and Lee, "POMDPs for robotic tasks with mixed
observability", 2009).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import outline
from planner.system.jit import njit

from ..people.decision import Floats
from ..people.type_kernels import leave_out_reached
from .belief_filter import child, new_parts, split
from .policy import Policy
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays, read_only


@dataclass(frozen=True)
class VectorPolicy(Policy):
    """The policy of a set of alpha vectors for one person's problem.

    Attributes
    ----------
    pomdp : AssistPOMDP
    vectors : float array, shape (m, H, T)
        Alpha vectors, sorted by state. They hold values in cost units, that is, minus costs.
    action : int array, shape (m,)
        First robot action of each vector's plan.
    first : int array, shape (n + 1,)
        The vectors of state x are `vectors[first[x] : first[x + 1]]`. A state in which all
        goals are reached needs none: its value is 0.

    Raises
    ------
    ValueError
        The shapes do not match, or a state in which a goal is not reached has no vector.
    """

    pomdp: AssistPOMDP
    vectors: Floats
    action: NDArray[np.int64]
    first: NDArray[np.int64]

    __repr__ = outline

    def __post_init__(self) -> None:
        states, count, hidden = len(self.pomdp.robot_actions), len(self.action), self.pomdp.prior.shape
        if self.vectors.shape != (count, *hidden) or self.first.shape != (states + 1,):
            raise ValueError(
                f"vectors {self.vectors.shape}, action {self.action.shape}, first {self.first.shape}: expected "
                f"({count}, {hidden[0]}, {hidden[1]}), ({count},) and ({states + 1},)"
            )
        if self.first[0] != 0 or self.first[-1] != count or (np.diff(self.first) < 0).any():
            raise ValueError(f"first: expected ascending offsets from 0 to {count}")
        without = (np.diff(self.first) == 0) & ~self.pomdp.model.choices.goal
        if without.any():
            raise ValueError(f"state {int(without.argmax())}: expected one alpha vector or more")
        state = np.repeat(np.arange(states), np.diff(self.first))
        if ((self.action < 0) | (self.action >= self.pomdp.robot_actions[state])).any():
            raise ValueError("action: expected robot actions that the vectors' states have")
        for array in (self.vectors, self.action, self.first):
            array.flags.writeable = False

    def __getstate__(self) -> dict[str, object]:
        """Return the state for pickling: the fields without cached properties."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def _arrays(self) -> ProblemArrays:
        return ProblemArrays.of(self.pomdp)

    def q_values(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the Q-values of all robot actions, shape (N, R): one exact Bellman backup of the vectors' values.

        Parameters
        ----------
        x : int array, shape (N,)
        belief : float array, shape (N, H, T)
            The beliefs need not be normalised; the values scale with their mass.
        """
        q = np.full((len(x), self.pomdp.suggested.shape[1]), -np.inf)
        of_state = read_only(self.vectors), read_only(self.first)
        _look_ahead(q, read_only(x, np.int64), read_only(belief, float), *of_state, self._arrays)
        if self.pomdp.frontier is not None:
            broken_off = self.pomdp.ends[x] & ~self.pomdp.model.choices.goal[x]
            q[broken_off, 0] = self.value(x[broken_off], belief[broken_off])
        return q

    def value(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the largest alpha . b for each person, shape (N,); arguments as in `q_values`."""
        return self._best(x, belief)[0]

    def choose(self, x: NDArray[np.int64], belief: Floats) -> NDArray[np.int64]:
        """Return the robot action of each person's best vector, shape (N,); 0 where the task has ended."""
        best = self._best(x, belief)[1]
        return np.where(best >= 0, self.action[best], 0) if len(self.action) else np.zeros(len(x), dtype=np.int64)

    def _best(self, x: NDArray[np.int64], belief: Floats) -> tuple[Floats, NDArray[np.int64]]:
        value, best = np.zeros(len(x)), np.full(len(x), -1, dtype=np.int64)
        of_state = read_only(self.vectors), read_only(self.first)
        _maximise(value, best, read_only(x, np.int64), read_only(belief, float), *of_state)
        return value, best


# Reassociation lets the compiler vectorise the sums. These values are not part of a certified bound.
@njit(fastmath={"reassoc", "contract"}, inner=True)
def _dot(alpha: Floats, belief: Floats) -> float:
    total = 0.0
    for i in range(len(alpha)):
        total += alpha[i] * belief[i]
    return total


@njit(inner=True)
def _best_vector(y: int, belief: Floats, vectors: Floats, first: NDArray[np.int64]) -> tuple[float, int]:
    """Return the largest alpha . b in state y, and its vector; `belief` and `vectors` are flat, (..., H * T)."""
    if first[y] == first[y + 1]:
        return 0.0, -1
    value, best = -np.inf, -1
    for i in range(first[y], first[y + 1]):
        product = _dot(vectors[i], belief)
        if product > value:
            value, best = product, i
    return value, best


@njit()
def _maximise(
    value: Floats,
    best: NDArray[np.int64],
    x: NDArray[np.int64],
    belief: Floats,
    vectors: Floats,
    first: NDArray[np.int64],
) -> None:
    """Fill in each person's value and best vector, both of shape (N,)."""
    cells = belief.shape[1] * belief.shape[2]
    beliefs, alphas = belief.reshape((len(x), cells)), vectors.reshape((len(vectors), cells))
    for i in range(len(x)):
        value[i], best[i] = _best_vector(x[i], beliefs[i], alphas, first)


@njit()
def _look_ahead(
    q: Floats, x: NDArray[np.int64], belief: Floats, vectors: Floats, first: NDArray[np.int64], m: ProblemArrays
) -> None:
    """Fill `q`, shape (N, R), with the Q-values of all robot actions; padding is left unchanged."""
    cells = belief.shape[1] * belief.shape[2]
    beliefs, alphas = belief.reshape((len(x), cells)), vectors.reshape((len(vectors), cells))
    parts, after, going_on = new_parts(cells, m.uses_answer), np.empty(cells), np.empty(cells)
    for i in range(len(x)):
        s = x[i]
        if m.ends[s]:
            q[i, 0] = 0.0
            continue
        mass = beliefs[i].sum()
        for h in range(cells):
            going_on[h] = beliefs[i, h]
        leave_out_reached(going_on, mass, s, m.goal, m.goal_of)
        for r in range(m.robot_actions[s]):
            q[i, r] = -m.robot_costs[s, r] * mass
            acting, slot = split(parts, going_on, s, r, m)
            if m.ends[acting]:
                continue
            for a in range(m.counts[acting]):
                chance = child(after, acting, a, slot, parts, m)
                q[i, r] += m.gamma * _best_vector(m.targets[acting, a], after, alphas, first)[0]
                q[i, r] -= m.costs[acting, a] * chance
