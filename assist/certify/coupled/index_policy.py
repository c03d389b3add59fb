"""Policies that divide the resource among agents by an index: a gain per unit of the resource.

At each step the pairs of agent and action with a positive gain are taken in descending order of gain per unit, one for
each agent, as long as the resource suffices. The other agents take the best action that uses nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.system.arrays import outline, read_only

from .agents import Agents, Floats, Ints


@dataclass(frozen=True, eq=False)
class IndexPolicy:
    """A policy that takes actions in descending order of gain per unit of the resource.

    Attributes
    ----------
    agents : Agents
    resources : float
        Units of the resource at each step.
    gain : float array, shape (W, A, K * S)
        Gain of each action over the best one that uses nothing, at each step; the last holds from then on.
    rest : int array, shape (W, K * S)
        The best action that uses nothing.
    """

    agents: Agents
    resources: float
    gain: Floats
    rest: Ints

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    def __call__(self, step: int, states: Ints, /) -> Ints:
        """Return the actions of all agents, shape (runs, N)."""
        S = self.agents.shape[2]
        column = states + self.agents.kind * S
        at = min(step, len(self.gain) - 1)
        action = self.rest[at][column]
        gain = self.gain[at]
        use = self.agents.flat[1]
        units = np.unique(use[1:])
        if len(gain) == 2 and len(units) == 1 and units[0] > 0 and not use[0].any():
            return _most(gain[1][column], action, int(self.resources / units[0] + 1e-9))
        return _greedy(gain[:, column], use[:, column], action, self.agents.room(self.resources))


def _most(gain: Floats, action: Ints, count: int) -> Ints:
    """Return action 1 for the `count` agents with the largest positive gains, and `action` for the others."""
    N = gain.shape[1]
    if count <= 0:
        return action
    if count < N:
        # Ties go to the first agent: argpartition alone would leave them open.
        order = np.argsort(-gain, axis=1, kind="stable")[:, :count]
        chosen = np.zeros(gain.shape, dtype=bool)
        np.put_along_axis(chosen, order, True, axis=1)
        chosen &= gain > 0
    else:
        chosen = gain > 0
    return np.where(chosen, 1, action)


def _greedy(gain: Floats, use: Floats, action: Ints, resources: float) -> Ints:
    """Return actions in descending order of gain per unit, one for each agent, as long as the resource suffices."""
    A, runs, N = gain.shape
    with np.errstate(divide="ignore", invalid="ignore"):
        score = np.where((gain > 0) & (use > 0), gain / use, -np.inf).transpose(1, 2, 0).reshape(runs, -1)
    order = np.argsort(-score, axis=1, kind="stable")
    left, unserved, found = np.full(runs, resources), np.ones((runs, N), dtype=bool), action.copy()
    rows = np.arange(runs)
    for pair in order.T:
        k, a = pair // A, pair % A
        units = use[a, rows, k]
        takes = (score[rows, pair] > -np.inf) & unserved[rows, k] & (units <= left)
        if not (score[rows, pair] > -np.inf).any():
            break
        found[rows[takes], k[takes]] = a[takes]
        left[takes] -= units[takes]
        unserved[rows[takes], k[takes]] = False
    return found
