"""Episodes of a team: several people at work, one robot.

Only the problems of people who are in a team are solved, and only if the policy needs that.

Episodes are numbered, and their random numbers are drawn for a block of them at a time from the seed and the block's
number alone: policies meet the same people with the same luck (common random numbers), and results do not depend on
how episodes are divided among processes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache, partial
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import LimitError
from planner.system.progress import Wanted, adding, shows_progress

from ..people.arguments import Seed, entropy, positive, whole, wholes
from ..person.suggestion_threshold import LARGEST, search_threshold
from ..team.attention import NoAssistance
from ..team.policies import prepare
from ..team.state import TeamAction, TeamPolicy, TeamState
from ..team.travel import Travel
from .common_random_numbers import BLOCK, CommonRandomNumbers
from .episodes import Episodes, Trace
from .pool import MEMORY_LIMIT_MB, Pool
from .run import Run
from .schedule import Schedule
from .task_view import ModelGroup, TaskView, WholeTaskView, World
from .truncated_view import TruncatedTaskView

SOLVING = "solving people's POMDPs"

TOGETHER = 16_384
"""People who are simulated at a time: what is known of them should stay in the processor's cache."""


@shows_progress
def simulate(
    pool: Pool,
    policy: TeamPolicy | str,
    *,
    humans: int | ArrayLike,
    episodes: Sequence[int] | NDArray[np.int64] | int,
    seed: Seed,
    name: str | None = None,
    travel: Travel | None = None,
    presence: Schedule | None = None,
    world: World = "people",
    trace: Trace | None = None,
    jobs: int = 1,
    memory_limit_mb: float = MEMORY_LIMIT_MB,
    explain: bool = True,
    progress: Wanted = None,
) -> Episodes:
    """Simulate episodes of teams drawn from a pool.

    Parameters
    ----------
    pool : Pool
    policy : str or callable
        A team policy, or the name of one (`assist.team.policies.POLICIES`).
    humans : int, or int array, shape (K,) or (N, K)
        People per team, drawn from the pool without replacement; or who is in the team, at which place, in every
        episode or in each.
    episodes : int or sequence of int
        How many episodes, or their numbers.
    seed : int or Generator
    name : str, optional
        What the policy is called in the records; its own name, or else "policy", unless given.
    travel : Travel, optional
        The way between the places; that of the setting unless given.
    presence : Schedule, optional
        When people are there; all from the beginning unless given.
    world : "people" or "model"
        Whether the pool's people act, or others as the robot's models have them: beta and theta drawn from
        the prior, on its grid, with lapses. In the second world a model's bounds hold.
    trace : list, optional
        Every action of every person is appended to it, one dictionary each.
    jobs : int
        Threads that simulate at a time. The policy is then called by several; results do not depend on it.
    memory_limit_mb : float
        What the records of all episodes may take, in megabytes.
    explain : bool
        Whether to find out, where a policy that weighs costs makes no suggestion, from which cost of suggestions on it
        does (`Episodes.suggestion_threshold`). That takes a few times as long as the simulation, or some seconds.
    progress : callable or bool, optional
        Who is told how far it is, as in `planner.system.progress`: people's problems are solved, then episodes are
        simulated.

    Raises
    ------
    TypeError
        Without a pool, as with a task alone.
    ValueError
        What cannot be.
    PolicyError
        The policy chooses what cannot be, such as a person who has finished.
    LimitError
        More episodes than fit the memory.
    """
    if not isinstance(pool, Pool):
        raise TypeError(f"pool: expected people at a task, a Pool, not what is a {type(pool).__name__}")
    if world not in get_args(World):
        raise ValueError(f"world {world!r}: expected {' or '.join(map(repr, get_args(World)))}")
    count = _count(episodes)
    places, given = _team(humans, len(pool.people), count)
    needed = count * (57 * places + 40) / 1e6
    if needed > positive("memory_limit_mb", memory_limit_mb):
        raise LimitError(
            f"{count:,} episodes of {places} people take {needed:,.0f} MB of memory, and {memory_limit_mb:,.0f} MB are "
            f"allowed; expected at most {int(memory_limit_mb / needed * count):,} episodes, or a higher memory limit"
        )
    numbers = np.arange(count) if np.ndim(episodes) == 0 else wholes("episodes", episodes)
    teams = None if given is None else np.broadcast_to(given, (count, places))
    travel = travel or pool.setting.travel(places)
    presence = presence or Schedule.of(places)
    if len(travel) != places or len(presence.joins) != places:
        raise ValueError(f"travel for {len(travel)}, presence for {len(presence.joins)}: expected {places} people")
    called = name or (policy if isinstance(policy, str) else str(getattr(policy, "__name__", "policy")))
    policy = pool.policy(policy, travel) if isinstance(policy, str) else policy
    together = max(1, TOGETHER // (places * BLOCK)) * BLOCK
    jobs = 1 if trace is not None else whole("jobs", jobs, 1)  # a trace is in order
    luck = entropy(seed)
    if pool.truncated:
        jobs = 1  # what has been met grows under one hand
        ground: Callable[..., TaskView] = partial(TruncatedTaskView, pool, world, {})
    else:
        ground = partial(WholeTaskView, pool, cache(lambda number: ModelGroup.of_model(pool, number, world)), world)

    assert callable(progress)
    chunks = [slice(start, start + together) for start in range(0, count, together)]
    if hasattr(policy, "prepare"):
        drawn = _drawn(pool, luck, [numbers[chunk] for chunk in chunks], places) if teams is None else teams
        models = np.unique(pool.model[drawn]).tolist()
        prepare(policy, [pool.policies[model] for model in models], progress=partial(progress, SOLVING))
    advance = adding(progress, f"simulating {called}", count)

    def run(chunk: slice) -> Episodes:
        return Run(
            pool, policy, teams=None if teams is None else teams[chunk], numbers=numbers[chunk], seed=luck, name=called,
            travel=travel, presence=presence, world=world, trace=trace, progress=advance, ground=ground,
        ).run()  # fmt: skip

    with ThreadPoolExecutor(jobs) as workers:
        found = Episodes.joined(list(map(run, chunks) if jobs == 1 else workers.map(run, chunks)))
    remade = getattr(policy, "with_policies", None)  # of policies that weigh costs
    if not explain or remade is None or found.interventions.any() or not found.actions.any():
        return found
    few = _few(pool, found)

    def suggests(c_suggest: float) -> bool:
        progress(f"trying c_suggest {c_suggest:g}", 0, None)
        other = pool.priced(c_suggest)
        once = _UntilFirstSuggestion(remade(other.policies, travel))
        simulate(
            other, once, humans=found.people[:few], episodes=numbers[:few], seed=luck, travel=travel,
            presence=presence, world=world, explain=False,
        )  # fmt: skip
        return once.suggested

    return replace(found, suggestion_threshold=search_threshold(pool.setting.c_suggest, suggests if few else None))


class _UntilFirstSuggestion:
    """A policy that makes no more suggestions after its first one: whether there is one is then known."""

    def __init__(self, policy: TeamPolicy) -> None:
        self._policy, self.suggested = policy, False

    def __call__(self, team: TeamState, /) -> TeamAction:
        action = NoAssistance()(team) if self.suggested else self._policy(team)
        self.suggested = self.suggested or bool(action.robot.any())
        return action


def _few(pool: Pool, episodes: Episodes) -> int:
    """Return how many of the first episodes have people whose problems have at most `LARGEST` states in all."""
    count = min(len(episodes), BLOCK)
    if pool.truncated:
        return 0
    while (
        count
        and sum(
            len(pool.policies[model].pomdp.robot_actions)
            for model in np.unique(pool.model[episodes.people[:count]]).tolist()
        )
        > LARGEST
    ):
        count //= 2
    return count


def _drawn(pool: Pool, luck: int, numbers: Sequence[NDArray[np.int64]], places: int) -> NDArray[np.int64]:
    """Give who is in a team in any of some episodes, in chunks."""
    size = len(pool.people)
    drawn = np.arange(size if places == size else 0)
    for chunk in numbers:
        if len(drawn) == size:
            break
        drawn = np.union1d(drawn, CommonRandomNumbers(luck, chunk, places).team(size))
    return drawn


def _count(episodes: ArrayLike) -> int:
    """Give how many episodes are asked for."""
    if np.ndim(episodes) == 0:
        return whole("episodes", episodes, 1)
    if np.ndim(episodes) != 1 or not np.size(episodes):
        raise ValueError(f"episodes {episodes!r}: expected how many, or the number of one or more of them")
    return np.size(episodes)


def _team(humans: ArrayLike, size: int, episodes: int) -> tuple[int, NDArray[np.int64] | None]:
    """Give how many places a team has and, where that is given, who is at each."""
    if np.ndim(humans) == 0:
        places = whole("humans", humans, 1)
        if places > size:
            raise ValueError(f"{places} people per team: expected 1 to {size}, the size of the pool")
        return places, None
    team = np.asarray(humans)
    if team.dtype.kind not in "iu" or not team.size or team.min() < 0 or team.max() >= size:
        raise ValueError(f"team {team.tolist()}: expected numbers of the pool, from 0 to {size - 1}")
    if team.ndim > 2 or (team.ndim == 2 and len(team) != episodes):
        raise ValueError(f"teams, shape {team.shape}: expected one row for each of {episodes} episodes")
    return team.shape[-1], team.astype(np.int64)
