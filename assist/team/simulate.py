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
from functools import partial
from threading import Event
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.system.limits import Deadline
from planner.system.processes import on_threads
from planner.system.progress import Wanted, adding, parts_shown, shows_progress

from ..people.arguments import Seed, whole
from .attention import AttentionSwitching
from .beginning import Beginnings
from .common_random_numbers import BLOCK
from .episodes import Episodes, with_cost
from .memory_trial import require_no_memory
from .policies import prepare
from .pool import Pool, require_pool
from .questions import Questions
from .requested import Conditions, Requested
from .run import Simulation
from .state import TeamPolicy
from .trace import Trace
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
    trace: Trace | None = None,
    progress: Wanted = None,
    **conditions: Unpack[Conditions],
) -> Episodes:
    """Simulate episodes of teams drawn from a pool.

    Parameters
    ----------
    pool : Pool
    policy : str or callable
        A team policy, or the name of one (`assist.team.policies.POLICIES`).
    humans : int, or array of names or int, shape (K,) or (N, K)
        Number of people per team, drawn from the pool without replacement. Or the person at each place, in all episodes
        or in each, by name (`Pool.names`) or by number in the pool from 0. Who is at two places is two people alike.
    episodes : int or sequence of int
        Number of episodes, or their numbers.
    seed : int or Generator
    trace : list, optional
        A dictionary is appended for every action of every person, episode by episode and step by step.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes. The stages are the solution of people's
        problems and the simulation of episodes. Episodes count as done once those simulated with them are done, too.
    **conditions
        `travel` between the places, the `world` in which people act, and others: see `Conditions`.

    Raises
    ------
    TypeError
        `pool` is no pool, but for instance a task; or there is no such condition.
    ValueError
        A parameter is out of its range.
    UserCodeError
        The policy is the user's own and fails; the message has the line of its file, and the cause is the error.
        Or it chooses an impossible action, such as going to a person who has finished. Or it is a function in a file
        (`UserPolicy`) that remembers former calls.
    LimitError
        The episodes would exceed the memory limit.
    """
    assert callable(progress)
    require_pool(pool)
    wanted = Requested.of(pool, policy, humans, episodes, seed, conditions)
    jobs, reasons = whole("jobs", conditions.get("jobs", 1), 1), conditions.get("reasons")
    policy = pool.policy(policy, wanted.travel) if isinstance(policy, str) else policy
    require_no_memory(policy, partial(_again, pool, wanted), wanted.places)
    explained = trace is not None and reasons is not None
    models = np.unique(pool.model[wanted.people(pool)]).tolist()
    beginnings = Beginnings(pool, wanted.world)
    groups = {model: beginnings.group(model) for model in models}
    if explained or hasattr(policy, "prepare"):
        needed = [pool.policies[model] for model in models]
        if explained:  # reasons compare the values of what the robot can do
            prepare(AttentionSwitching(), needed, progress=partial(progress, SOLVING), jobs=jobs)
        prepare(policy, needed, progress=partial(progress, SOLVING), jobs=jobs)
    questions = Questions.of(pool.policies, pool.setting)
    simulation = Simulation(pool, policy, wanted, beginnings, groups, questions, Event())

    def run(part: slice) -> tuple[Episodes, list[Trace]]:
        if trace is None:
            return simulation.chunk(part), []
        tracer = Tracer(pool, wanted.name, policy, wanted.numbers[part], reasons)
        return simulation.chunk(part, tracer, keeps_beliefs=reasons is not None), tracer.traces

    count, found = len(wanted.numbers), list[Episodes]()
    advance = adding(progress, f"simulating {wanted.name}" + " and explaining its suggestions" * explained, count)
    # Where a state has values for each goal, so have those to which it leads.
    together = max(1, PEOPLE_AT_A_TIME // (wanted.places * len(pool.hidden.goals) ** 2 * BLOCK)) * BLOCK
    done, size, threads = 0, 1 if explained else BLOCK, 1 if explained else jobs
    ends = Deadline.after(conditions.get("time_limit"))
    # A function of the user may solve people's problems in its first step; only the function knows.
    with nullcontext() if hasattr(policy, "prepare") else parts_shown(progress, lambda: advance(0)):
        while done < count and not (done and ends.passed):
            each = min(size, together, math.ceil((count - done) / threads))
            first = range(done, min(count, done + threads * each), each)
            for episodes_of, traces in on_threads(
                run, [slice(at, at + each) for at in first], threads, simulation.over
            ):
                found.append(episodes_of)
                for own in traces:
                    trace.extend(own)  # type: ignore[union-attr]  # there are none without it
            ended = min(count, done + threads * each)
            advance(ended - done)
            # Small chunks first, to show soon how far the work is, and to end in time. If their sizes depended on the
            # clock, so would what a user's policy draws from a generator of its own.
            done, size = ended, size if explained else (4 if conditions.get("time_limit") is None else 2) * size
    return with_cost(Episodes.joined(found), pool.setting.fleet, policy)


def _again(pool: Pool, wanted: Requested, policy: TeamPolicy, episodes: Sequence[int]) -> Episodes:
    """Simulate other episodes under the same conditions."""
    return simulate(
        pool, policy, humans=wanted.places if wanted.teams is None else wanted.teams[0], episodes=episodes, seed=0,
        travel=wanted.travel, presence=wanted.presence, world=wanted.world, goals=wanted.goals, progress=False,
    )  # fmt: skip
