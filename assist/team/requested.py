"""The episodes and teams that a simulation is asked for, checked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..people.arguments import one_of, whole
from ..person.memory_needed import require_room
from .common_random_numbers import CommonRandomNumbers
from .goal_knowledge import GoalKnowledge
from .model_group import World
from .pool import Pool


def require_possible(pool: Pool, world: World, goals: GoalKnowledge) -> None:
    """Raise an error if people and robot of these kinds cannot be simulated."""
    one_of("world", world, get_args(World))
    if goals not in get_args(GoalKnowledge):
        raise ValueError(f"goals {goals!r}: expected {', '.join(map(repr, get_args(GoalKnowledge)))}")
    if goals == "likeliest" and pool.setting.observation is not None:
        raise ValueError("goals 'likeliest': expected 'inferred' or 'known' where actions are missed or confused")
    pool.setting.require_questions(pool.goals)
    if pool.setting.c_ask is not None:
        pool.setting.require_all_seen("a simulated robot that asks")


def people_drawn(pool: Pool, seed_number: int, numbers: Sequence[NDArray[np.int64]], places: int) -> NDArray[np.int64]:
    """Return the people who are in a team in any of some episodes, given in chunks."""
    size = len(pool.people)
    drawn = np.arange(size if places == size else 0)
    for chunk in numbers:
        if len(drawn) == size:
            break
        drawn = np.union1d(drawn, CommonRandomNumbers(seed_number, chunk, places).team(size))
    return drawn


def number_of(episodes: ArrayLike) -> int:
    """Return the number of requested episodes."""
    if np.ndim(episodes) == 0:
        return whole("episodes", episodes, 1)
    if np.ndim(episodes) != 1 or not np.size(episodes):
        raise ValueError(f"episodes {episodes!r}: expected how many, or the number of one or more of them")
    return np.size(episodes)


def team_of(pool: Pool, humans: ArrayLike, episodes: int) -> tuple[int, NDArray[np.int64] | None]:
    """Return the number of places of a team and, if they are given, the people at each."""
    size = len(pool.people)
    if np.ndim(humans) == 0:
        places = whole("humans", humans, 1)
        if places > size:
            raise ValueError(f"{places} people per team: expected 1 to {size}, the size of the pool")
        return places, None
    team = pool.numbers(humans)
    if team.ndim > 2 or (team.ndim == 2 and len(team) != episodes):
        raise ValueError(f"teams, shape {team.shape}: expected one row for each of {episodes} episodes")
    return team.shape[-1], team


def require_room_for_episodes(count: int, places: int, limit_mb: float) -> None:
    """Raise a `LimitError` if the records of some episodes would exceed the memory limit."""
    each = 57 * places + 40  # bytes
    expected = f"at most {int(limit_mb * 1e6 / each):,} episodes, or a higher memory limit"
    require_room(f"{count:,} episodes of {places} people take", count * each, limit_mb, expected)
