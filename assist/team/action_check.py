"""Checks of the actions that a team policy returns."""

from __future__ import annotations

import numpy as np

from ..people.decision import NOTHING
from ..people.user_code import UserCodeError
from ..person.rows_of_people import by_model
from .state import BASE, NOBODY, TeamAction, TeamState


def check(team: TeamState, action: TeamAction) -> None:
    """Raise an error for an action that no policy may choose.

    Raises
    ------
    UserCodeError
        It names the fault and the step.
    """
    shape, people = team.location.shape, team.x.shape[1]

    def refused(fault: str) -> UserCodeError:
        return team.refused(f"the policy {fault}")

    wanted = f"two int arrays of shape {shape}, an entry for each robot of each team"
    if not isinstance(action, TeamAction):
        raise refused(
            f"returned {type(action).__name__}; expected a TeamAction, as team.act(person, action) gives it: {wanted}"
        )
    for array in (action.person, action.action):
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "iu" or array.shape != shape:
            found = f"an array of {array.dtype}, shape {array.shape}" if isinstance(array, np.ndarray) else array
            raise refused(f"chose {found!s:.80}; expected {wanted}")
    wrong = (action.person < NOBODY) | (action.person >= people)
    if wrong.any():
        raise refused(f"goes to person {action.person[wrong][0]} in a team of {people}")
    goes = np.nonzero(action.person != NOBODY)
    teams, to, said, robot = goes[0], action.person[goes], action.action[goes], goes[1]
    if not team.active[teams, to].all():
        raise refused("goes to a person who has finished or is not there")
    if (said[team.travel.steps_between(robot, team.location[goes], to) > 0] != 0).any():
        raise refused("speaks to a person before the robot has arrived")
    if not team.ready[goes].all():
        raise refused("sends a robot that is under way")
    if not len(to):
        return
    # Robots that are not sent make room.
    after = np.where(action.person != NOBODY, action.person, np.where(team.ready, BASE, team.location))
    crowded = np.flatnonzero((after != BASE).sum(axis=1) > 1)
    ordered = np.sort(after[crowded], axis=1)
    for row, one in zip(*np.nonzero((ordered[:, 1:] == ordered[:, :-1]) & (ordered[:, 1:] != BASE)), strict=True):
        n, person = crowded[row], ordered[row, one]
        there = after[n] == person
        # Robots may be with one person already, if somebody else has moved them.
        if (team.location[n, there] != person).any() or (action.person[n, there] != NOBODY).sum() > 1:
            raise refused("lets two robots be with one person, or on their way there")
    for model, those in by_model(team.model[teams, to], np.flatnonzero(said != 0), len(team.policies)):
        pomdp, x = team.policies[model].pomdp, team.x[teams[those], to[those]]
        if ((said[those] < 0) | (said[those] >= pomdp.robot_actions[x])).any():
            raise refused("makes a suggestion that the person's state does not have")
        if team.fleet.executes:
            unable = np.isinf(team.fleet.extra_of(robot[those], pomdp.suggested[x, said[those]] == NOTHING))
            if unable.any():
                raise refused(f"lets robot {robot[those][unable][0] + 1} execute an action, which it cannot")
