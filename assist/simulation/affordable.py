"""People's choices in an enumerated task, unless their policies would exceed the memory limit."""

from __future__ import annotations

import numpy as np

from planner import Table

from ..people.arguments import require_goal
from ..people.choices import Choices
from ..people.goals import Goals
from ..people.human import Population
from ..people.memory import choices_of
from ..people.mixture import Mixture
from ..team.memory_needed import policy_bytes
from ..team.robots import best_robots
from ..team.settings import Setting
from .memory_needed import require_room, require_room_for_people


def affordable_rows(goals: Goals, setting: Setting, size: int, memory_limit_mb: float) -> Choices:
    """Return the choices of all goals; other arguments and errors as in `affordable_choices`."""
    require_room(policy_bytes(len(goals)), len(goals), _models(setting, size), memory_limit_mb, len(goals.tables))
    return goals.choices()


def affordable_choices(
    table: Table | Choices, setting: Setting, population: Population | Mixture, prior: Population | Mixture,
    size: int, memory_limit_mb: float,
) -> Choices:  # fmt: skip
    """Return the choices in an enumerated task, with the memory of people whose choices have terms.

    Parameters
    ----------
    table : Table or Choices
    setting : Setting
    population, prior : Population or Mixture
        From which people are drawn, and the robot's prior.
    size : int
        Number of people.
    memory_limit_mb : float
        Memory of all policies, and of all people, in MB.

    Raises
    ------
    LimitError
        The policies or the people would exceed the memory limit.
    ValueError
        The goal is unreachable.
    """
    models, goals = _models(setting, size), table.goal_count if isinstance(table, Choices) else 1
    # checked before the choices are built
    require_room(policy_bytes(len(table)), len(table), models, memory_limit_mb, goals)
    choices = choices_of(table, (*population.weights, *prior.weights))
    require_goal(choices.h[choices.initial])
    offered = choices.optimal if setting.suggestions == "optimal" else choices.applicable
    if goals > 1:  # what is offered for one goal is offered for all
        offered = np.logical_or.reduce(offered.reshape(goals, -1, offered.shape[1]))
    robots = 1 + int(offered.sum(axis=1).max(initial=0)) * (1 + best_robots(setting).execute)
    one = policy_bytes(len(choices), slots=choices.applicable.shape[1], robots=robots)
    require_room(one, len(choices), models, memory_limit_mb, goals)
    require_room_for_people(size, choices.h.nbytes, memory_limit_mb)
    return choices


def _models(setting: Setting, size: int) -> int:
    """Return the number of models of some people."""
    return size if setting.knowledge == "own" else 1
