"""The policies that the paper compares with: no assistance, and reactive assistance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .assignment import assigned
from .state import NOBODY, TeamAction, TeamState


@dataclass(frozen=True)
class NoAssistance:
    """The paper's base case: the robot does nothing."""

    uses_belief = False

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Return no action for every team."""
        nobody = np.full(team.location.shape, NOBODY)
        return TeamAction(nobody, np.zeros_like(nobody))


@dataclass(frozen=True)
class Reactive:
    """Go to a person whose last action was a mistake, and suggest an optimal action.

    A mistake is an action that is not an optimal choice, that is, no optimal plan from the state begins with it. If a
    person pursues one of several goals, a mistake is no optimal choice for any that is possible, and the suggestion is
    optimal for the most probable goal. (Whether h* decreased is another question, because costs differ between actions
    and may be 0.) Robots help as many people as possible, the nearest ones: a robot stays with the present person if
    they have erred, and otherwise goes to the first of the nearest. In a dead end no action is optimal, so that nothing
    is suggested.

    Attributes
    ----------
    uses_belief : bool
        Whether people pursue one of several goals, about which the robot has a belief.
    """

    uses_belief: bool = False

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Return an action for a person who has erred, in every team that has one."""
        action = np.where(team.erred, team.first_optimal(), 0)
        far = team.travel.distance[team.location][..., :-1]
        nearness = 1.0 + float(team.travel.distance.max()) - far  # positive, so that it never pays to be idle
        return team.act(assigned(team, np.where(action[:, None] > 0, nearness, -np.inf)), action)
