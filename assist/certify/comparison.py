"""Policies for a team, compared with a bound on all policies."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from planner.system.progress import Progress, Wanted, shows_progress

from ..people.arguments import Seed, entropy, positive, whole
from ..simulation.pool import Pool, require_pool
from ..simulation.simulate import SOLVING
from ..team.policies import by_name
from ..team.state import TeamPolicy
from .certificate import Certificate, Simulated, simulated_until
from .team_bound import TeamBound, upper_bound


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
        time_limit: float | None, progress: Progress, **options: Any,
    ) -> Comparison:  # fmt: skip
        """Compute the bound; the parameters are those of `certify`."""
        start, seed_number = time.perf_counter(), entropy(seed)
        episodes = whole("episodes", episodes, 2)
        limit = None if time_limit is None else 0.8 * positive("time_limit", time_limit)
        bound = upper_bound(pool, time_limit=limit, seed=seed_number, progress=progress, **options)
        runs = {
            name: Simulated(pool, policy, bound.team, bound.travel, seed=seed_number)
            for name, policy in policies.items()
        }
        return cls(bound, runs, episodes, None if time_limit is None else start + time_limit)

    def simulate(self, progress: Progress) -> None:
        """Simulate all policies, within the time that is left."""
        for run in self.runs.values():
            run.prepare(partial(progress, SOLVING))
        done, total = 0, None if self.deadline is not None else self.episodes * len(self.runs)

        def tell(added: int) -> None:
            nonlocal done
            done += added
            progress("simulating policies", done, total)

        tell(0)
        simulated_until(list(self.runs.values()), self.episodes, self.deadline, tell)

    def certificates(self) -> list[Certificate]:
        """Return the certificate of each policy of which two or more episodes were simulated."""
        bound, humans = self.bound, len(self.bound.team)
        return [
            Certificate.of(name, np.concatenate(run.parts), humans=humans, upper=bound.upper, slack=bound.slack)
            for name, run in self.runs.items()
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
