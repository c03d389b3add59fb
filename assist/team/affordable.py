"""People's choices in an enumerated task, unless their policies would exceed the memory limit."""

from __future__ import annotations

from collections.abc import Sequence

from planner import LimitError, Table

from ..people.arguments import require_goal
from ..people.choices import Choices
from ..people.goals import Goals, each_of, first_of
from ..people.memory import choices_of
from ..person.memory_needed import ONE_FOR_ALL, policy_bytes, require_room
from ..person.settings import Setting


def affordable_choices(
    table: Table | Goals | Choices, setting: Setting, terms: Sequence[str], size: int, memory_limit_mb: float
) -> Choices | None:
    """Return the choices in an enumerated task, with the memory of people whose choices have terms.

    The result is None if the policies would exceed the memory limit, and the task can be truncated: to as many states
    as it allows (`states_within`).

    Parameters
    ----------
    table : Table, Goals or Choices
    setting : Setting
    terms : sequence of str
        Terms of people's choices, and of the robot's prior.
    size : int
        Number of people.
    memory_limit_mb : float
        Memory of all policies, and of all people, in MB.

    Raises
    ------
    LimitError
        The people would exceed the memory limit, or policies on choices that are given as such.
    ValueError
        The goal is unreachable.
    """
    try:
        choices = _choices(table, setting, terms, size, memory_limit_mb)
    except LimitError:
        if isinstance(table, Choices):
            raise
        return None
    require_room_for_people(size, choices.h.nbytes, memory_limit_mb)
    return choices


def _choices(
    table: Table | Goals | Choices, setting: Setting, terms: Sequence[str], size: int, memory_limit_mb: float
) -> Choices:
    """Return the choices in an enumerated task, unless the policies would exceed the memory limit."""
    models = size if setting.knowledge == "own" else 1
    goals = len(table.goals if isinstance(table, Choices) else each_of(table))
    # checked before the choices are built
    states = len(table) if isinstance(table, Choices) else len(first_of(table))
    _require_room_for_policies(goals * policy_bytes(states), states, models, memory_limit_mb, goals)
    choices = choices_of(table, terms)
    require_goal(choices.h[choices.initial])
    offered = choices.optimal if setting.suggestions == "optimal" else choices.applicable
    actions = 1 + int(offered.sum(axis=1).max(initial=0)) * (1 + setting.fleet.executes)
    one = policy_bytes(len(choices), slots=choices.applicable.shape[1], actions=actions)
    _require_room_for_policies(goals * one, len(choices), models, memory_limit_mb, goals)
    return choices


def _require_room_for_policies(one: int, states: int, models: int, limit_mb: float, goals: int) -> None:
    """Raise a `LimitError` if the policies of `one` bytes each exceed the memory limit."""
    who, less = ("one person", "") if models == 1 else (f"{models:,} people", ONE_FOR_ALL)
    size = f"{states:,} states" + (f" and {goals} goals" if goals > 1 else "")
    what = f"policies for {who} on a task of {size} take"
    # a sorted copy of one policy's values exists temporarily
    require_room(what, (models + 1) * one, limit_mb, f"{less}a higher memory limit")


def require_room_for_people(size: int, one: int, limit_mb: float) -> None:
    """Raise a `LimitError` if people with `one` bytes of perceived cost-to-go each would exceed the memory limit."""
    needed = size * (2000 + one)  # a person and their policy take about 2,000 bytes
    require_room(f"{size:,} people take", needed, limit_mb, "a smaller pool, or a higher memory limit")
