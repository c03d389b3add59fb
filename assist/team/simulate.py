"""Simulation of episodes of a team: several people at work, and the robots of the setting, one by default.

Only the problems of people who are in a team are solved, and only if the policy needs them.

Episodes are numbered. Their random numbers are drawn in blocks, from the seed and the number of the block alone. So all
policies are simulated with the same people and the same random numbers (common random numbers). The results do not
depend on how episodes are divided among processes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from threading import Event

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.system.limits import Deadline
from planner.system.progress import Wanted, adding, parts_shown, shows_progress
from planner.system.threads import on_threads

from ..people.arguments import Seed, entropy, whole, wholes
from ..person.memory_needed import MEMORY_LIMIT_MB
from ..person.travel import Travel
from .attention import AttentionSwitching
from .common_random_numbers import BLOCK
from .episodes import Episodes
from .goal_knowledge import GoalKnowledge
from .model_group import ModelGroup, World
from .policies import prepare
from .pool import Pool, require_pool
from .questions import Questions
from .requested import number_of, people_drawn, require_possible, require_room_for_episodes, team_of
from .run import Simulation
from .schedule import Schedule
from .state import TeamPolicy
from .trace import Reasons, Trace
from .traced_run import Tracer

SOLVING = "solving people's POMDPs"
PEOPLE_AT_A_TIME = 16_384
"""Number of people who are simulated together, so that their data fit into the processor's cache."""


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
    goals: GoalKnowledge = "inferred",
    trace: Trace | None = None,
    reasons: Reasons | None = None,
    jobs: int = 1,
    memory_limit_mb: float = MEMORY_LIMIT_MB,
    time_limit: float | None = None,
    progress: Wanted = None,
) -> Episodes:
    """Simulate episodes of teams drawn from a pool.

    Parameters
    ----------
    pool : Pool
    policy : str or callable
        A team policy, or the name of one (`assist.team.policies.POLICIES`).
    humans : int, or array of names or int, shape (K,) or (N, K)
        Number of people per team, drawn from the pool without replacement. Or the person at each place, in all episodes
        or in each, by name (`Pool.names`) or by place in the pool from 0.
    episodes : int or sequence of int
        Number of episodes, or their numbers.
    seed : int or Generator
    name : str, optional
        Name of the policy in the records; by default its own name, or else "policy".
    travel : Travel, optional
        Travel between the places; by default that of the setting.
    presence : Schedule, optional
        Steps in which people are present; by default all from the beginning.
    world : "people" or "model"
        Whether the people of the pool act, or people of the robot's model: beta and theta are then drawn from the
        prior, on its grid, and people have lapses. A model's bounds hold in the second world.
    goals : "inferred", "likeliest" or "known"
        What the robot knows of people's goals, where each pursues one of several. It infers them from actions, acts on
        the most probable one alone, or knows the goal from the beginning of each episode.
    trace : list, optional
        A dictionary is appended for every action of every person, episode by episode and step by step.
    reasons : Reasons, optional
        Explains each suggestion in the trace, which takes time; `assist.live.TraceReasons` is one.
    jobs : int
        Number of threads. They call the policy concurrently; the results do not depend on their number. Reasons are
        given one after another.
    memory_limit_mb : float
        Memory of the records of all episodes, in MB.
    time_limit : float, optional
        Seconds after which no further episodes begin. Those that were simulated by then are returned, at least some.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes. The stages are the solution of people's
        problems and the simulation of episodes. Episodes count as done once those simulated with them are done, too.

    Returns
    -------
    Episodes

    Raises
    ------
    TypeError
        `pool` is no pool, but for instance a task.
    ValueError
        A parameter is out of its range.
    UserCodeError
        The policy chooses an impossible action, such as going to a person who has finished.
    LimitError
        The episodes would exceed the memory limit.
    """
    require_pool(pool)
    require_possible(pool, world, goals)
    count = number_of(episodes)
    places, given = team_of(pool, humans, count)
    require_room_for_episodes(count, places, memory_limit_mb)
    numbers = np.arange(count) if np.ndim(episodes) == 0 else wholes("episodes", episodes)
    teams = None if given is None else np.broadcast_to(given, (count, places))
    travel = travel or pool.setting.travel(places)
    presence = presence or Schedule.of(places)
    if len(travel.c_move) != len(pool.setting.robots):
        raise ValueError(f"travel of {len(travel.c_move)} robots: expected that of {len(pool.setting.robots)}")
    if len(travel) != places or len(presence.joins) != places:
        raise ValueError(f"travel for {len(travel)}, presence for {len(presence.joins)}: expected {places} people")
    called = name or (policy if isinstance(policy, str) else str(getattr(policy, "__name__", "policy")))
    policy = pool.policy(policy, travel) if isinstance(policy, str) else policy
    together = max(1, PEOPLE_AT_A_TIME // (places * BLOCK)) * BLOCK
    if pool.goals > 1:  # a state on a large task has values for each goal, and so have its successors
        together = max(1, PEOPLE_AT_A_TIME // (places * pool.goals * 8))
    explained = trace is not None and reasons is not None
    jobs, seed_number = whole("jobs", jobs, 1), entropy(seed)

    assert callable(progress)
    parted = [numbers[start : start + together] for start in range(0, count, together)]
    drawn = people_drawn(pool, seed_number, parted, places) if teams is None else teams
    models = np.unique(pool.model[drawn]).tolist()
    groups = {model: ModelGroup(pool, model, world) for model in models}
    questions: Questions | None = None
    if pool.setting.c_ask is not None:
        questions = Questions(pool.policies, pool.setting.c_ask, pool.setting.ask_error)
    if explained or hasattr(policy, "prepare"):
        needed = [pool.policies[model] for model in models]
        if explained:  # reasons compare the values of what the robot can do
            prepare(AttentionSwitching(), needed, progress=partial(progress, SOLVING), jobs=jobs)
        prepare(policy, needed, progress=partial(progress, SOLVING), jobs=jobs)
    over = Event()

    simulation = Simulation(pool, policy, called, seed_number, travel, presence, world, goals, groups, questions, over)

    def run(chunk: slice) -> tuple[Episodes, list[Trace]]:
        some, own = numbers[chunk], None if teams is None else teams[chunk]
        if trace is None:
            return simulation.chunk(some, own), []
        tracer = Tracer(pool, called, policy, some, reasons)
        return simulation.chunk(some, own, tracer, keeps_beliefs=reasons is not None), tracer.traces

    advance = adding(progress, f"simulating {called}" + " and explaining its suggestions" * explained, count)
    done, size, found = 0, 1 if explained else BLOCK, list[Episodes]()
    ends = Deadline.after(time_limit)
    # A function of the user may solve people's problems in its first step; only the function knows.
    with nullcontext() if hasattr(policy, "prepare") else parts_shown(progress, lambda: advance(0)):
        while done < count and not (done and ends.passed):
            threads = 1 if explained else jobs
            each = min(size, together, math.ceil((count - done) / threads))
            first = range(done, min(count, done + threads * each), each)
            for episodes_of, traces in on_threads(run, [slice(at, at + each) for at in first], threads, over):
                found.append(episodes_of)
                for own in traces:
                    trace.extend(own)  # type: ignore[union-attr]  # there are none without it
            ended = min(count, done + threads * each)
            advance(ended - done)
            # Small chunks first, to show soon how far the work is, and to end in time. If their sizes depended on the
            # clock, so would what a user's policy draws from a generator of its own.
            done, size = ended, size if explained else (4 if time_limit is None else 2) * size
    return _with_cost(Episodes.joined(found), pool, policy)


def _with_cost(found: Episodes, pool: Pool, policy: TeamPolicy) -> Episodes:
    """Return episodes with the cost of a suggestion, if the policy weighs it and made none."""
    costs = set(pool.setting.fleet.each("c_suggest").tolist())
    weighs_costs = getattr(policy, "weighs_costs", False) and len(costs) == 1
    if not weighs_costs or found.interventions.any() or not found.actions.any():
        return found
    return replace(found, c_suggest_too_high=costs.pop())
