"""Policies for a team, compared with a bound on all policies."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from planner.system.progress import Wanted, shows_progress

from ..people.arguments import Seed, entropy, positive, whole
from ..simulation.pool import Pool
from ..team.state import TeamPolicy
from .certificate import Certificate
from .team_bound import TeamBound, upper_bound


@shows_progress
def certify(
    pool: Pool,
    policies: Mapping[str, TeamPolicy | str],
    *,
    episodes: int = 20_000,
    seed: Seed = 0,
    time_limit: float | None = None,
    progress: Wanted = None,
    **options: Any,
) -> tuple[TeamBound, list[Certificate]]:
    """Bound the value of all policies for a team, and compare some policies with the bound.

    Parameters
    ----------
    pool : Pool
    policies : mapping
        Policies by their names in the certificates.
    episodes : int
        Number of episodes of each policy.
    seed : int or Generator
    time_limit : float, optional
        Seconds in total: 80 % for the bound, and equal shares of the rest for the policies.
    progress : callable or bool, optional
        As in `upper_bound`.
    **options
        As in `upper_bound`.
    """
    assert callable(progress)
    start, seed_number = time.perf_counter(), entropy(seed)
    episodes = whole("episodes", episodes, 2)
    limit = None if time_limit is None else 0.8 * positive("time_limit", time_limit)
    bound = upper_bound(pool, time_limit=limit, seed=seed_number, progress=progress, **options)
    found: list[Certificate] = []
    for name, policy in policies.items():
        progress("simulating policies", len(found), len(policies))
        left = None
        if time_limit is not None:
            left = max(0.0, start + time_limit - time.perf_counter()) / (len(policies) - len(found))
        found.append(bound.certify(policy, name, episodes=episodes, seed=seed_number, time_limit=left))
    return bound, found
