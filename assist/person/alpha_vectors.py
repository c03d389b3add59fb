"""Policies made of alpha vectors: what point-based solvers return.

An alpha vector gives, for each hidden pair (beta, theta), the return of a plan that begins in one state x with one
robot action. In state x with belief b a person's problem is worth at least the largest alpha . b over the vectors
of x (Smallwood and Sondik, "The optimal control of partially observable Markov processes over a finite horizon",
1973; one set of vectors per observed state: Ong, Png, Hsu and Lee, "POMDPs for robotic tasks with mixed
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
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays, read_only


@dataclass(frozen=True)
class VectorPolicy:
    """The policy of a set of alpha vectors for one person's problem.

    Attributes
    ----------
    pomdp : AssistPOMDP
    vectors : float array, shape (m, B, T)
        Alpha vectors, sorted by state, in cost units (values, that is, minus costs).
    robot : int array, shape (m,)
        The robot action with which each vector's plan begins.
    first : int array, shape (n + 1,)
        The vectors of state x are `vectors[first[x] : first[x + 1]]`. A goal needs none: its value is 0.
    """

    pomdp: AssistPOMDP
    vectors: Floats
    robot: NDArray[np.int64]
    first: NDArray[np.int64]

    __repr__ = outline

    def __post_init__(self) -> None:
        states, count = len(self.pomdp.model.choices), len(self.robot)
        if self.vectors.shape != (count, *self.pomdp.grid.shape) or self.first.shape != (states + 1,):
            raise ValueError(
                f"vectors {self.vectors.shape}, robot {self.robot.shape}, first {self.first.shape}: expected "
                f"({count}, {self.pomdp.grid.shape[0]}, {self.pomdp.grid.shape[1]}), ({count},) and ({states + 1},)"
            )
        if self.first[0] != 0 or self.first[-1] != count or (np.diff(self.first) < 0).any():
            raise ValueError(f"first: expected ascending offsets from 0 to {count}")
        without = (np.diff(self.first) == 0) & ~self.pomdp.model.choices.goal
        if without.any():
            raise ValueError(f"state {int(without.argmax())}: expected one alpha vector or more")
        state = np.repeat(np.arange(states), np.diff(self.first))
        if ((self.robot < 0) | (self.robot >= self.pomdp.robot_actions[state])).any():
            raise ValueError("robot: expected actions that the vectors' states have")
        for array in (self.vectors, self.robot, self.first):
            array.flags.writeable = False

    def __getstate__(self) -> dict[str, object]:
        """Give what another process is sent: not what it can work out again."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def _arrays(self) -> ProblemArrays:
        return ProblemArrays.of(self.pomdp)

    def q_values(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give the value of each robot action, shape (N, R): one exact step, then the vectors.

        Parameters
        ----------
        x : int array, shape (N,)
        belief : float array, shape (N, B, T)
            Need not be normalised; values scale with it.
        """
        q = np.full((len(x), self.pomdp.suggested.shape[1]), -np.inf)
        of_state = read_only(self.vectors), read_only(self.first)
        _look_ahead(q, read_only(x, np.int64), read_only(belief, float), *of_state, self._arrays)
        if self.pomdp.frontier is not None:
            broken_off = self.pomdp.final[x] & ~self.pomdp.model.choices.goal[x]
            q[broken_off, 0] = self.value(x[broken_off], belief[broken_off])
        return q

    def value(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give the largest alpha . b of each person, shape (N,); arguments as in `q_values`."""
        return self._best(x, belief)[0]

    def choose(self, x: NDArray[np.int64], belief: Floats) -> NDArray[np.int64]:
        """Give the robot action of each person's best vector, shape (N,); nothing where the task has ended."""
        best = self._best(x, belief)[1]
        return np.where(best >= 0, self.robot[best], 0) if len(self.robot) else np.zeros(len(x), dtype=np.int64)

    def _best(self, x: NDArray[np.int64], belief: Floats) -> tuple[Floats, NDArray[np.int64]]:
        value, best = np.zeros(len(x)), np.full(len(x), -1, dtype=np.int64)
        of_state = read_only(self.vectors), read_only(self.first)
        _maximise(value, best, read_only(x, np.int64), read_only(belief, float), *of_state)
        return value, best


# Sums may be taken in another order, so that a processor's vector units do them; nothing here is a proof.
@njit(fastmath={"reassoc", "contract"})
def _dot(alpha: Floats, belief: Floats) -> float:
    total = 0.0
    for i in range(len(alpha)):
        total += alpha[i] * belief[i]
    return total


@njit()
def _most(y: int, belief: Floats, vectors: Floats, first: NDArray[np.int64]) -> tuple[float, int]:
    """Give the largest alpha . b in state y, and which vector has it; `belief` and `vectors` are flat, (..., B * T)."""
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
    """Fill in each person's value and vector, both of shape (N,)."""
    cells = belief.shape[1] * belief.shape[2]
    beliefs, alphas = belief.reshape((len(x), cells)), vectors.reshape((len(vectors), cells))
    for i in range(len(x)):
        value[i], best[i] = _most(x[i], beliefs[i], alphas, first)


@njit()
def _look_ahead(
    q: Floats, x: NDArray[np.int64], belief: Floats, vectors: Floats, first: NDArray[np.int64], m: ProblemArrays
) -> None:
    """Fill `q`, shape (N, R), with the value of every robot action; padding keeps what it holds.

    What a suggestion does is alike for all slots but the suggested one: their chances share the factor
    (1 - theta) / total, and theta moves in the same way. So the belief is weighed and moved three times per robot
    action, whatever the number of slots: by that factor (`other`), by theta / total (`same`), and by 1 (`lapsed`).
    """
    betas, thetas = belief.shape[1], belief.shape[2]
    cells = betas * thetas
    alphas = vectors.reshape((len(vectors), cells))
    other, same, lapsed = np.empty((betas, thetas)), np.empty((betas, thetas)), np.empty((betas, thetas))
    after = np.empty((betas, thetas))
    for i in range(len(x)):
        s = x[i]
        if m.final[s]:
            q[i, 0] = 0.0
            continue
        mass = belief[i].sum()
        for r in range(m.robot_actions[s]):
            q[i, r] = -m.robot_costs[s, r] * mass
            place, slot = m.afterstate[s, r], m.suggested[s, r]
            if m.goal[place]:
                continue
            other[:], same[:], lapsed[:] = 0.0, 0.0, 0.0
            for b in range(betas):
                p = m.chosen[place, max(slot, 0), b]
                for t in range(thetas):
                    theta, weight = m.theta[t], belief[i, b, t]
                    others, suggested = weight, weight
                    if slot >= 0:
                        total = theta * p + (1.0 - theta) * m.unsuggested[s, r, b]
                        if total > 0.0:
                            others, suggested = weight * (1.0 - theta) / total, weight * theta / total
                    at, up = m.low[s, r, t], m.weight[s, r, t]
                    other[b, at] += others * (1.0 - up)
                    other[b, at + 1] += others * up
                    same[b, at] += suggested * (1.0 - up)
                    same[b, at + 1] += suggested * up
                    lapsed[b, at] += weight * (1.0 - up)
                    lapsed[b, at + 1] += weight * up
            uniform = m.lapse / m.counts[place]
            for a in range(m.counts[place]):
                chance = 0.0
                for b in range(betas):
                    p = (1.0 - m.lapse) * m.chosen[place, a, b]
                    for t in range(thetas):
                        heard = same[b, t] if a == slot else other[b, t]
                        after[b, t] = p * heard + uniform * lapsed[b, t]
                        chance += after[b, t]
                q[i, r] += m.gamma * _most(m.targets[place, a], after.reshape(cells), alphas, first)[0]
                q[i, r] -= m.costs[place, a] * chance
