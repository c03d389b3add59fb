"""What the actions of robots that differ cost more than in people's problems."""

from __future__ import annotations

import numpy as np

from ..people.decision import NOTHING, Floats
from .state import TeamState


def extra_costs_of(team: TeamState, actions: int) -> Floats:
    """Return the extra cost of each robot's action on each person, shape (N, M, K, R), where robots differ.

    It is 0 for no action, and infinite for an action that the robot cannot execute. `actions` is the number R.
    """
    assert team.extra is not None
    executes = np.zeros((team.x.size, actions), dtype=bool)
    if np.isfinite(team.extra.executing).any():
        for group, rows in team.groups():
            suggested = team.policies[group].pomdp.suggested[team.x.ravel()[rows], :actions]
            executes[rows, : suggested.shape[1]] = suggested == NOTHING
    each = np.arange(team.robots)[:, None, None]
    costs = team.extra.of(each, executes.reshape(len(team.x), 1, *team.x.shape[1:], actions))
    costs[..., 0] = 0.0
    return costs
