"""Policies for one person's POMDP.

`solve` computes the values of the underlying MDP, in which beta and theta are seen, by Gauss-Seidel value
iteration in the order of h*, and returns the QMDP policy (Littman, Cassandra and Kaelbling, "Learning
policies for partially observable environments", 1995): act as if the hidden pair were seen from the
next step on. The person's own choices are a free stream of information, so little is lost by this. Its
values are an upper bound on what any policy can reach.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from .human import Floats
from .pomdp import AssistPOMDP


@dataclass(frozen=True)
class Policy:
    """The QMDP policy of one person's POMDP.

    Attributes
    ----------
    pomdp : AssistPOMDP
    value_mdp : float array, shape (n, B, T)
        Expected discounted return where beta and theta are seen.
    q_mdp : float array, shape (n, 1 + S, B, T)
        The same for each robot action in the first step; minus infinity in padding.
    """

    pomdp: AssistPOMDP
    value_mdp: Floats
    q_mdp: Floats

    def __post_init__(self) -> None:
        self.value_mdp.flags.writeable = False
        self.q_mdp.flags.writeable = False

    def q_values(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give the expected return of each robot action, shape (N, 1 + S).

        Parameters
        ----------
        x : int array, shape (N,)
        belief : float array, shape (N, B, T)
        """
        q = self.q_mdp[x]
        # Padding is infinite, and 0 * infinity undefined: it is summed as 0 and put back.
        used = np.isfinite(q[:, :, 0, 0])
        return np.where(used, np.einsum("nsbt,nbt->ns", np.where(used[:, :, None, None], q, 0.0), belief), -np.inf)

    def value(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give the QMDP value, shape (N,): an upper bound on the return of any policy."""
        return np.einsum("nbt,nbt->n", self.value_mdp[x], belief)

    def choose(self, x: NDArray[np.int64], belief: Floats) -> NDArray[np.int64]:
        """Give the best robot action for each person, shape (N,); 0 is nothing, also on ties."""
        return self.q_values(x, belief).argmax(axis=1)


def solve(pomdp: AssistPOMDP, *, tolerance: float = 1e-6, max_sweeps: int = 100_000) -> Policy:
    """Compute the QMDP policy.

    Parameters
    ----------
    pomdp : AssistPOMDP
    tolerance : float
        Largest error of any value, in cost units.
    max_sweeps : int
        Sweeps over all states at the most.

    Raises
    ------
    RuntimeError
        The values had not converged after `max_sweeps`.
    """
    choices = pomdp.model.choices
    states = np.flatnonzero(~choices.goal)
    order = states[np.argsort(choices.h[states], kind="stable")]
    # Costs are positive, so that 0 is an upper bound, and remains one in every sweep; in a dead end each
    # step to come costs at least what the cheapest choice in any of them does.
    value = np.zeros((len(choices), *pomdp.grid.shape))
    dead = np.isinf(choices.h)
    if dead.any():
        value[dead] = -choices.costs[dead][choices.applicable[dead]].min() / (1 - pomdp.gamma)
    arrays = _Arrays.of(pomdp)
    residual = np.inf
    for _ in range(max_sweeps):
        residual = _sweep(value, order, arrays)
        if residual * pomdp.gamma / (1 - pomdp.gamma) <= tolerance:
            break
    else:
        raise RuntimeError(f"value iteration: residual {residual:g} after {max_sweeps} sweeps")
    betas, thetas = pomdp.grid.shape
    q = np.full((len(choices), betas, pomdp.suggested.shape[1], thetas), -np.inf)
    q[choices.goal, :, 0] = 0.0
    _q_values(q, value, order, arrays)
    q = np.ascontiguousarray(q.transpose(0, 2, 1, 3))
    return Policy(pomdp, value, q)


class _Arrays(NamedTuple):
    """A problem in the form that compiled code reads; shapes as in `AssistPOMDP` and `Choices`."""

    counts: NDArray[np.int64]
    targets: NDArray[np.int64]
    costs: Floats
    suggested: NDArray[np.int64]
    chosen: Floats
    low: NDArray[np.int64]
    weight: Floats
    theta: Floats
    gamma: float
    c_suggest: float
    lapse: float

    @classmethod
    def of(cls, pomdp: AssistPOMDP) -> _Arrays:
        choices = pomdp.model.choices
        return cls(
            choices.applicable.sum(axis=1), choices.targets, choices.costs, pomdp.suggested, pomdp.chosen, pomdp.low,
            pomdp.weight, pomdp.grid.theta, pomdp.gamma, pomdp.c_suggest, pomdp.model.lapse,
        )  # fmt: skip


@numba.njit(cache=True)
def _row(q: Floats, expected: Floats, mean: Floats, value: Floats, x: int, b: int, m: _Arrays) -> None:
    """Fill `q`, shape (1 + S, T), with the return of every robot action in state x for one beta.

    `expected` and `mean`, shape (T,), are room for the person's mean return without a suggestion, and
    for that of a uniform choice. A suggestion moves theta alike whatever the person does, so that its
    returns are interpolated in these sums, not action by action.
    """
    expected[:] = 0.0
    mean[:] = 0.0
    for a in range(m.counts[x]):
        y, c, p = m.targets[x, a], m.costs[x, a], m.chosen[x, a, b]
        for t in range(len(m.theta)):
            u = m.gamma * value[y, b, t] - c
            expected[t] += p * u
            mean[t] += u / m.counts[x]
    for t in range(len(m.theta)):
        q[0, t] = (1.0 - m.lapse) * expected[t] + m.lapse * mean[t]
    for s in range(1, m.suggested.shape[1]):
        slot = m.suggested[x, s]
        if slot < 0:
            q[s:] = -np.inf
            break
        y, c, p = m.targets[x, slot], m.costs[x, slot], m.chosen[x, slot, b]
        for t in range(len(m.theta)):
            at, up, theta = m.low[x, s, t], m.weight[x, s, t], m.theta[t]
            e = (1.0 - up) * expected[at] + up * expected[at + 1]
            followed = p * (m.gamma * ((1.0 - up) * value[y, b, at] + up * value[y, b, at + 1]) - c)
            total = theta * p + (1.0 - theta) * (1.0 - p)
            if total > 0.0:
                e = (theta * followed + (1.0 - theta) * (e - followed)) / total
            lapsed = (1.0 - up) * mean[at] + up * mean[at + 1]
            q[s, t] = (1.0 - m.lapse) * e + m.lapse * lapsed - m.c_suggest


@numba.njit(cache=True)
def _sweep(value: Floats, order: NDArray[np.int64], m: _Arrays) -> float:
    """Update every state once, in place; return the largest change."""
    q = np.empty((m.suggested.shape[1], len(m.theta)))
    expected, mean = np.empty(len(m.theta)), np.empty(len(m.theta))
    residual = 0.0
    for x in order:
        for b in range(value.shape[1]):
            _row(q, expected, mean, value, x, b, m)
            for t in range(len(m.theta)):
                best = q[:, t].max()
                residual = max(residual, abs(best - value[x, b, t]))
                value[x, b, t] = best
    return residual


@numba.njit(cache=True)
def _q_values(q: Floats, value: Floats, order: NDArray[np.int64], m: _Arrays) -> None:
    """Fill `q`, shape (n, B, 1 + S, T), with the return of every robot action."""
    expected, mean = np.empty(len(m.theta)), np.empty(len(m.theta))
    for x in order:
        for b in range(value.shape[1]):
            _row(q[x, b], expected, mean, value, x, b, m)
