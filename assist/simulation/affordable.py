"""People's choices in an enumerated task, unless their policies would exceed the memory limit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner import LimitError, Table

from ..people.arguments import require_goal
from ..people.choices import Choices
from ..people.goals import Goals, each_of
from ..people.human import Population
from ..people.memory import choices_of
from ..people.mixture import Mixture
from ..team.memory_needed import policy_bytes
from ..team.robots import best_robots
from ..team.settings import Setting
from .memory_needed import require_room, require_room_for_people


def affordable_choices(
    table: Table | Goals | Choices, setting: Setting, population: Population | Mixture, prior: Population | Mixture,
    size: int, memory_limit_mb: float, *, required: bool,
) -> Choices | None:  # fmt: skip
    """Return the choices in an enumerated task, with the memory of people whose choices have terms.

    The result is None if the policies for several goals would exceed the memory limit, and the task may be truncated.

    Parameters
    ----------
    table : Table, Goals or Choices
    setting : Setting
    population, prior : Population or Mixture
        From which people are drawn, and the robot's prior.
    size : int
        Number of people.
    memory_limit_mb : float
        Memory of all policies, and of all people, in MB.
    required : bool
        Whether the task must be enumerated.

    Raises
    ------
    LimitError
        The policies or the people would exceed the memory limit.
    ValueError
        The goal is unreachable.
    """
    try:
        choices = _choices(table, setting, (*population.weights, *prior.weights), size, memory_limit_mb)
    except LimitError:
        if required or not isinstance(table, Goals):
            raise
        return None
    require_room_for_people(size, choices.h.nbytes, memory_limit_mb)
    return choices


def _choices(
    table: Table | Goals | Choices, setting: Setting, terms: Sequence[str], size: int, memory_limit_mb: float
) -> Choices:
    """Return the choices in an enumerated task, unless the policies would exceed the memory limit."""
    models = size if setting.knowledge == "own" else 1
    goals = table.goal_count if isinstance(table, Choices) else len(each_of(table))
    # checked before the choices are built
    require_room(policy_bytes(len(table)), len(table), models, memory_limit_mb, goals)
    choices = table.choices() if isinstance(table, Goals) else choices_of(table, terms)
    require_goal(choices.h[choices.initial])
    offered = choices.optimal if setting.suggestions == "optimal" else choices.applicable
    if goals > 1:  # what is offered for one goal is offered for all
        offered = np.logical_or.reduce(offered.reshape(goals, -1, offered.shape[1]))
    robots = 1 + int(offered.sum(axis=1).max(initial=0)) * (1 + best_robots(setting).execute)
    one = policy_bytes(len(choices), slots=choices.applicable.shape[1], robots=robots)
    require_room(one, len(choices), models, memory_limit_mb, goals)
    return choices
