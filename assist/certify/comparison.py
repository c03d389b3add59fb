"""Policies for a team, compared with a bound on all policies."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from planner.system.progress import Progress, Wanted, shows_progress

from ..people.arguments import Seed, entropy, positive, whole
from ..team.policies import by_name
from ..team.pool import Pool, require_pool
from ..team.simulate import SOLVING
from ..team.state import TeamPolicy
from .certificate import Certificate, Simulated, simulated_until
from .team_bound import TeamBound, free_attention_bound, members_of, upper_bound

FIRST_EPISODES = 1024
"""Episodes of each policy for a first answer; they take a second for two people."""


@dataclass(frozen=True)
class Comparison:
    """A bound on the value of all policies for a team, and some policies that are simulated to be compared with it.

    Attributes
    ----------
    bound : TeamBound
    runs : dict
        The simulated returns of each policy by its name, at first none.
    episodes : int
        Number of episodes of each policy.
    deadline : float or None
        When to stop, on the clock of `time.perf_counter()`.
    """

    bound: TeamBound
    runs: dict[str, Simulated]
    episodes: int
    deadline: float | None

    @classmethod
    def of(
        cls, pool: Pool, policies: Mapping[str, TeamPolicy | str], *, episodes: int, seed: Seed,
        time_limit: float | None, progress: Progress, first: Callable[[list[Certificate]], None] | None = None,
        **options: Any,
    ) -> Comparison:  # fmt: skip
        """Compute the bound; the parameters are those of `certify`.

        `first` receives certificates with a looser bound and few episodes, before the work that takes longer. There are
        none for truncated tasks.
        """
        start, seed_number = time.perf_counter(), entropy(seed)
        episodes = whole("episodes", episodes, 2)
        limit = None if time_limit is None else 0.8 * positive("time_limit", time_limit)
        team = members_of(pool, options.get("team"))
        travel = options.get("travel") or pool.setting.travel(len(team))
        runs = {name: Simulated(pool, policy, team, travel, seed=seed_number) for name, policy in policies.items()}
        problems = [pool.policies[model].problem for model in pool.model[list(team)]]
        upper = math.inf
        if first is not None and all(problem.whole for problem in problems):
            upper = free_attention_bound(pool, team, travel, math.inf if limit is None else start + 0.2 * limit)
            _simulate(runs, min(episodes, FIRST_EPISODES), None, progress)
            first(_certificates(runs, upper, math.nan))
        if limit is not None:
            limit = max(1e-3, start + limit - time.perf_counter())
        bound = upper_bound(pool, time_limit=limit, seed=seed_number, progress=progress, **options).at_most(upper)
        return cls(bound, runs, episodes, None if time_limit is None else start + time_limit)

    def simulate(self, progress: Progress) -> None:
        """Simulate all policies, within the time that is left."""
        _simulate(self.runs, self.episodes, self.deadline, progress)

    def certificates(self) -> list[Certificate]:
        """Return the certificate of each policy of which two or more episodes were simulated."""
        return _certificates(self.runs, self.bound.upper, self.bound.slack)


def _simulate(runs: dict[str, Simulated], episodes: int, deadline: float | None, progress: Progress) -> None:
    """Simulate policies until each has so many episodes, within the time that is left."""
    for run in runs.values():
        run.prepare(partial(progress, SOLVING))
    done, total = sum(run.count for run in runs.values()), None if deadline is not None else episodes * len(runs)

    def tell(added: int) -> None:
        nonlocal done
        done += added
        progress("simulating policies", done, total)

    tell(0)
    simulated_until(list(runs.values()), episodes, deadline, tell)


def _certificates(runs: dict[str, Simulated], upper: float, slack: float) -> list[Certificate]:
    """Return the certificate of each policy of which two or more episodes were simulated."""
    return [
        Certificate.of(name, np.concatenate(run.parts), humans=len(run.team), upper=upper, slack=slack)
        for name, run in runs.items()
        if run.count > 1
    ]


@shows_progress
def certify(
    pool: Pool,
    policies: Mapping[str, TeamPolicy | str] | Iterable[TeamPolicy | str] | TeamPolicy | str,
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
    policies : mapping, or one or more policies
        Policies by their names in the certificates; by their own names unless given.
    episodes : int
        Number of episodes of each policy.
    seed : int or Generator
    time_limit : float, optional
        Seconds in total: 80 % for the bound. The policies share the rest equally.
    progress : callable or bool, optional
        As in `upper_bound`.
    **options
        As in `upper_bound`.
    """
    require_pool(pool)
    assert callable(progress)
    policies = by_name(policies)
    found = Comparison.of(
        pool, policies, episodes=episodes, seed=seed, time_limit=time_limit, progress=progress, **options
    )
    found.simulate(progress)
    return found.bound, found.certificates()
