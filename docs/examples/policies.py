"""A team policy of one's own."""

import numpy as np

from assist.team import NOBODY, TeamAction, TeamState


def furthest_first(team: TeamState) -> TeamAction:
    """Of those whose last action was a mistake, help the one who is furthest from the goal."""
    robot = team.first_optimal()
    far = np.where(team.erred & (robot > 0), team.cost_to_go(), -1.0)
    person = np.where(far.max(axis=1) > 0, far.argmax(axis=1), NOBODY)
    return team.act(person, robot)


furthest_first.uses_belief = False  # type: ignore[attr-defined]  # saves the filtering
