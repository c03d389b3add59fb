"""Certificates: the simulated value of a team policy, compared with an upper bound on the value of all policies."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from planner.system.arrays import outline

from ..people.decision import Floats
from ..simulation.pool import Pool
from ..simulation.simulate import simulate
from ..team.robots import extra_costs
from ..team.state import TeamPolicy
from ..team.travel import Travel


@dataclass(frozen=True)
class Certificate:
    """The distance of a team policy from the optimum, at most.

    Attributes
    ----------
    humans : int
        Number of people in the team.
    policy : str
        Name of the policy.
    value, value_stderr : float
        Mean discounted return of the policy, in cost units, and its standard error. The largest possible costs after
        the end of an episode are included.
    upper : float
        Upper bound on the value of every policy, in cost units.
    gap_percent : float
        100 (upper - value) / abs(value).
    slack_percent : float
        Largest number of these percentage points by which a complete solution of the single people's problems could
        lower the bound.
    episodes : int
        Number of simulated episodes.
    """

    humans: int
    policy: str
    value: float
    value_stderr: float
    upper: float
    gap_percent: float
    slack_percent: float
    episodes: int

    __repr__ = outline

    @classmethod
    def of(cls, name: str, returns: Floats, *, humans: int, upper: float, slack: float) -> Certificate:
        """Return the certificate for the returns of some episodes, shape (N,), with a bound and its slack."""
        mean = float(returns.mean())
        return cls(
            humans=humans,
            policy=name,
            value=mean,
            value_stderr=float(returns.std(ddof=1) / math.sqrt(len(returns))),
            upper=upper,
            gap_percent=100 * (upper - mean) / abs(mean) if mean else 0.0,
            slack_percent=100 * slack / abs(mean) if mean else 0.0,
            episodes=len(returns),
        )


def horizon(gamma: float) -> int:
    """Return the number of steps after which episodes end.

    The remaining discounted costs are then at most a millionth of the largest cost of a step.
    """
    return math.ceil(math.log(1e-6 * (1 - gamma)) / math.log(gamma))


def returns(
    pool: Pool,
    policy: TeamPolicy | str,
    team: tuple[int, ...],
    travel: Travel,
    *,
    episodes: int,
    seed: int,
    time_limit: float | None = None,
) -> Floats:
    """Simulate a policy in the robot's model; return a lower bound on each episode's discounted return, shape (N,).

    The largest possible costs after the end of an episode are subtracted.

    Parameters
    ----------
    pool : Pool
    policy : TeamPolicy or str
    team : tuple of int
        Person at each place.
    travel : Travel
    episodes : int
        Number of episodes.
    seed : int
    time_limit : float, optional
        Seconds after which no more episodes begin; about a thousand are simulated in any case.
    """
    gamma, end = pool.setting.gamma, horizon(pool.setting.gamma)
    pool = replace(pool, setting=replace(pool.setting, max_steps=end))
    most = max(one.c_move for one in travel.each) * float(travel.distance.max())
    if (extra := extra_costs(pool.setting)) is not None:
        most += float(max(extra.suggesting.max(), extra.executing[np.isfinite(extra.executing)].max(initial=0)))
    largest_cost = max(max(1.0, p.dearest) + float(p.pomdp.robot_costs.max()) for p in pool.policies) + most
    deadline = None if time_limit is None else time.perf_counter() + time_limit
    parts: list[Floats] = []
    # The records of 65,536 episodes take about 10 MB per person. A time limit is checked after 1,024 episodes.
    portion = 65_536 if deadline is None else 1024
    for start in range(0, episodes, portion):
        if parts and deadline is not None and time.perf_counter() > deadline:
            break
        numbers = np.arange(start, min(episodes, start + portion))
        run = simulate(pool, policy, humans=list(team), episodes=numbers, seed=seed, travel=travel, world="model")
        remaining = (~run.finished).sum(axis=1) * largest_cost * gamma**end / (1 - gamma)
        parts.append(run.discounted_return - remaining)
    return np.concatenate(parts)
