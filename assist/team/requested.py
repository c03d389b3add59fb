"""What a simulation is asked for, checked: the episodes and teams, and the conditions under which they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypedDict, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..people.arguments import Seed, entropy, one_of, require_options, whole, wholes
from ..person.memory_needed import MEMORY_LIMIT_MB, require_room
from ..person.travel import Travel
from .beginning import World
from .common_random_numbers import CommonRandomNumbers
from .goal_knowledge import GoalKnowledge
from .pool import Pool
from .schedule import Schedule
from .state import TeamPolicy
from .trace import Reasons

EPISODES_AT_A_TIME = 8192
"""Number of episodes whose teams are drawn together."""


class Conditions(TypedDict, total=False):
    """The conditions of a simulation, and what it may take. Each entry has a default.

    Attributes
    ----------
    name : str or None
        Name of the policy in the records; by default its own name, or else "policy".
    travel : Travel or None
        Travel between the places; by default that of the setting.
    presence : Schedule or None
        Steps in which people are present; by default all from the beginning.
    world : "people" or "model"
        Whether the people of the pool act, as by default, or people of the robot's model: beta and theta are then drawn
        from the prior, on its grid, and people have lapses. A model's bounds hold in the second world.
    reasons : Reasons or None
        Explains each suggestion in the trace, which takes time; `assist.live.TraceReasons` is one.
    goals : "inferred", "likeliest" or "known"
        What the robot knows of people's goals, where each pursues one of several. It infers them from actions, as by
        default, acts on the most probable one alone, or knows the goal from the beginning of each episode.
    jobs : int
        Number of threads, 1 by default. They call the policy concurrently; the results do not depend on their number.
        Reasons are given one after another.
    memory_limit_mb : float
        Memory of the records of all episodes, in MB.
    time_limit : float or None
        Seconds after which no further episodes begin; none by default. Those that were simulated by then are returned,
        at least some.
    """

    name: str | None
    travel: Travel | None
    presence: Schedule | None
    world: World
    goals: GoalKnowledge
    reasons: Reasons | None
    jobs: int
    memory_limit_mb: float
    time_limit: float | None


@dataclass(frozen=True, eq=False)
class Requested:
    """The episodes that a simulation is asked for, checked; other attributes as in `Conditions`.

    Attributes
    ----------
    numbers : int array, shape (N,)
        Numbers of the episodes.
    places : int
        Number of people in a team, K.
    teams : int array, shape (N, K), or None
        The person at each place; None if they are drawn.
    seed : int
    """

    numbers: NDArray[np.int64]
    places: int
    teams: NDArray[np.int64] | None
    seed: int
    name: str
    travel: Travel
    presence: Schedule
    world: World
    goals: GoalKnowledge

    @classmethod
    def of(
        cls, pool: Pool, policy: TeamPolicy | str, humans: int | ArrayLike, episodes: ArrayLike, seed: Seed,
        conditions: Conditions,
    ) -> Requested:  # fmt: skip
        """Return what is asked for.

        Raises
        ------
        ValueError, TypeError
            A parameter is out of its range, or there is no such condition.
        LimitError
            The episodes would exceed the memory limit.
        """
        require_options(conditions, Conditions.__annotations__)
        world, goals = conditions.get("world", "people"), conditions.get("goals", "inferred")
        require_possible(pool, world, goals)
        count = number_of(episodes)
        places, teams = team_of(pool, humans, count)
        require_room_for_episodes(count, places, conditions.get("memory_limit_mb", MEMORY_LIMIT_MB))
        numbers = np.arange(count) if np.ndim(episodes) == 0 else wholes("episodes", episodes)
        teams = None if teams is None else np.broadcast_to(teams, (count, places))
        travel = conditions.get("travel") or pool.setting.travel(places)
        presence = conditions.get("presence") or Schedule.of(places)
        if len(travel.c_move) != len(pool.setting.robots):
            raise ValueError(f"travel of {len(travel.c_move)} robots: expected that of {len(pool.setting.robots)}")
        if len(travel) != places or len(presence.joins) != places:
            raise ValueError(f"travel for {len(travel)}, presence for {len(presence.joins)}: expected {places} people")
        own = policy if isinstance(policy, str) else str(getattr(policy, "__name__", "policy"))
        name = conditions.get("name") or own
        return cls(numbers, places, teams, entropy(seed), name, travel, presence, world, goals)

    def people(self, pool: Pool) -> NDArray[np.int64]:
        """Return the people of the pool who are in a team."""
        if self.teams is not None:
            return np.unique(self.teams)
        size = len(pool.people)
        found = np.arange(size if self.places == size else 0)
        for at in range(0, len(self.numbers), EPISODES_AT_A_TIME):
            if len(found) == size:
                break
            some = self.numbers[at : at + EPISODES_AT_A_TIME]
            found = np.union1d(found, CommonRandomNumbers(self.seed, some, self.places).team(size))
        return found


def require_possible(pool: Pool, world: World, goals: GoalKnowledge) -> None:
    """Raise an error if such people and robots cannot be simulated."""
    one_of("world", world, get_args(World))
    if goals not in get_args(GoalKnowledge):
        raise ValueError(f"goals {goals!r}: expected {', '.join(map(repr, get_args(GoalKnowledge)))}")
    if goals == "likeliest" and pool.setting.observation is not None:
        raise ValueError("goals 'likeliest': expected 'inferred' or 'known' where actions are missed or confused")
    pool.setting.require_questions(possible=pool.hidden.distinguishes_goals)
    if pool.setting.c_ask is not None:
        pool.setting.require_all_seen("a simulated robot that asks")


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
