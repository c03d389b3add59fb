"""What the actions of robots that differ cost more than in people's problems."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..people.decision import NOTHING, Floats
from ..person.ties import first_best
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


def scores_of_each(team: TeamState, q: Floats, reference: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return each robot's action towards each person, and its score, as `AttentionSwitching.scores` does.

    Parameters
    ----------
    team : TeamState
        N teams of K people and M robots that differ.
    q : float array, shape (N, K, R)
        Q-values of the robot actions in people's problems.
    reference : float array, shape (N, K)

    Returns
    -------
    robot, score : int and float arrays, shape (N, M, K)
    """
    each = q[:, None] - extra_costs_of(team, q.shape[2])
    robot = first_best(each)
    useful = team.active[:, None] & (robot > 0)
    score = np.subtract(
        np.take_along_axis(each, robot[..., None], axis=3)[..., 0],
        reference[:, None],
        out=np.full(robot.shape, -np.inf),
        where=useful,
    )
    return robot, score - team.to()
