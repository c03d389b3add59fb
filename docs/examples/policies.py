"""A team policy of one's own."""

import numpy as np

from assist.team import TeamAction, TeamState, assigned


def furthest_first(team: TeamState) -> TeamAction:
    """Of those whose last action was a mistake, help the one who is furthest from the goal."""
    action = team.first_optimal()
    far = np.where(team.erred & (action > 0), team.cost_to_go(), -1.0)
    return team.act(assigned(team, far[:, None]), action)
