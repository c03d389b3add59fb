"""Policies for one person's POMDP.

`solve` computes the values of the underlying MDP, in which beta and theta are seen, by Gauss-Seidel value
iteration in the order of h*, and returns the QMDP policy (Littman, Cassandra and Kaelbling, "Learning
policies for partially observable environments", 1995): act as if the hidden pair were seen from the
next step on. The person's own choices are a free stream of information, so little is lost by this. Its
values are an upper bound on what any policy can reach.
"""

from __future__ import annotations

from dataclasses import dataclass

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
    counts = choices.applicable.sum(axis=1)
    # Costs are positive, so that 0 is an upper bound, and remains one in every sweep; in a dead end each
    # step to come costs at least what the cheapest choice in any of them does.
    value = np.zeros((len(choices), *pomdp.grid.shape))
    dead = np.isinf(choices.h)
    if dead.any():
        value[dead] = -choices.costs[dead][choices.applicable[dead]].min() / (1 - pomdp.gamma)
    arrays = (
        counts, choices.targets, choices.costs, pomdp.suggested, pomdp.chosen, pomdp.low, pomdp.weight,
        pomdp.grid.theta, pomdp.gamma, pomdp.c_suggest, pomdp.model.lapse,
    )  # fmt: skip
    residual = np.inf
    for _ in range(max_sweeps):
        residual = _sweep(value, order, *arrays)
        if residual * pomdp.gamma / (1 - pomdp.gamma) <= tolerance:
            break
    else:
        raise RuntimeError(f"value iteration: residual {residual:g} after {max_sweeps} sweeps")
    q = np.full((len(choices), pomdp.suggested.shape[1], *pomdp.grid.shape), -np.inf)
    q[choices.goal, 0] = 0.0
    _q_values(q, value, order, *arrays)
    return Policy(pomdp, value, q)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _action_value(value, x, s, b, t, counts, targets, costs, suggested, chosen, low, weight, theta, gamma, c_suggest, lapse):  # type: ignore[no-untyped-def]
    """The return of robot action `s` in state `x` where the hidden pair is (b, t)."""
    slot = suggested[x, s]
    at, up = low[x, s, t], weight[x, s, t]
    expected = 0.0
    mean = 0.0
    followed = 0.0
    for a in range(counts[x]):
        y = targets[x, a]
        u = gamma * ((1.0 - up) * value[y, b, at] + up * value[y, b, at + 1]) - costs[x, a]
        expected += chosen[x, a, b] * u
        mean += u
        if a == slot:
            followed = u
    if slot >= 0:
        p = chosen[x, slot, b]
        total = theta[t] * p + (1.0 - theta[t]) * (1.0 - p)
        if total > 0.0:
            expected = (theta[t] * p * followed + (1.0 - theta[t]) * (expected - p * followed)) / total
    result = (1.0 - lapse) * expected + lapse * mean / counts[x]
    return result - c_suggest if slot >= 0 else result


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _sweep(value, order, counts, targets, costs, suggested, chosen, low, weight, theta, gamma, c_suggest, lapse):  # type: ignore[no-untyped-def]
    """Update every state once, in place; return the largest change."""
    residual = 0.0
    for x in order:
        for b in range(value.shape[1]):
            for t in range(value.shape[2]):
                best = -np.inf
                for s in range(suggested.shape[1]):
                    if s > 0 and suggested[x, s] < 0:
                        break
                    q = _action_value(
                        value, x, s, b, t, counts, targets, costs, suggested, chosen, low, weight, theta, gamma, c_suggest, lapse
                    )
                    best = max(best, q)
                residual = max(residual, abs(best - value[x, b, t]))
                value[x, b, t] = best
    return residual


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _q_values(q, value, order, counts, targets, costs, suggested, chosen, low, weight, theta, gamma, c_suggest, lapse):  # type: ignore[no-untyped-def]
    """Fill in the return of every robot action."""
    for x in order:
        for s in range(suggested.shape[1]):
            if s > 0 and suggested[x, s] < 0:
                break
            for b in range(value.shape[1]):
                for t in range(value.shape[2]):
                    q[x, s, b, t] = _action_value(
                        value, x, s, b, t, counts, targets, costs, suggested, chosen, low, weight, theta, gamma, c_suggest, lapse
                    )
