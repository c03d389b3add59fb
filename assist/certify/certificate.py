"""How far a team policy is from the best, at most: its simulated value beside what no policy exceeds."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import outline

from ..people.decision import Floats
from ..simulation.pool import Pool
from ..simulation.simulate import simulate
from ..team.attention_subproblem import AWAY, HERE
from ..team.state import TeamAction, TeamPolicy, TeamState
from ..team.travel import Travel

BEYOND = 1e-6
"""Episodes are cut off where what may come after is worth less than this share of the first step's largest cost."""

PORTION = 1024
"""Episodes between two looks at the clock."""

AT_ONCE = 65_536
"""Episodes that are simulated together where there is no clock: their records take some 10 MB a person."""


@dataclass(frozen=True)
class Certificate:
    """How far a team policy is from the best, at most.

    Attributes
    ----------
    humans : int
    policy : str
    value, value_stderr : float
        Its mean discounted return, what episodes cut off could still cost included, and the standard error.
    upper : float
        What no policy's exceeds.
    gap_percent : float
        100 (upper - value) / abs(value).
    slack_percent : float
        By how many of these percentage points the bound could be lower, at most, if the solver of single people's
        problems had gone on to the end.
    episodes : int
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
        """Compare the returns of some episodes, shape (N,), with a bound, in which so much is left to the solver."""
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
    """Give the step beyond which episodes are cut off."""
    return math.ceil(math.log(BEYOND * (1 - gamma)) / math.log(gamma))


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
    """Simulate a policy in the model's world; give each episode's discounted return, or less, shape (N,).

    Parameters
    ----------
    time_limit : float, optional
        Begin no more episodes after so many seconds; about a thousand are simulated in any case.
    """
    gamma, end = pool.setting.gamma, horizon(pool.setting.gamma)
    pool = replace(pool, setting=replace(pool.setting, max_steps=end))
    dearest = max(
        float(p.pomdp.model.choices.costs.max() + p.pomdp.robot_costs.max()) for p in pool.policies
    ) + travel.c_move * float(travel.distance.max())
    deadline = None if time_limit is None else time.perf_counter() + time_limit
    parts: list[Floats] = []
    for start in range(0, episodes, portion := AT_ONCE if deadline is None else PORTION):
        if parts and deadline is not None and time.perf_counter() > deadline:
            break
        numbers = np.arange(start, min(episodes, start + portion))
        run = simulate(
            pool, policy, humans=list(team), episodes=numbers, seed=seed, travel=travel, world="model", explain=False
        )
        left = (~run.finished).sum(axis=1) * dearest * gamma**end / (1 - gamma)
        parts.append(run.discounted_return - left)
    return np.concatenate(parts)


class Meeting:
    """A team policy that does as another one does and notes down with what the robot was met, in each place.

    Attributes
    ----------
    met : list of lists of (int, int array, int array, float array)
        For each place: a step, then of each team in which somebody is at work there their task's state, the robot's
        position (`team.attention_subproblem`) and its belief, shape (n, B, T).
    """

    uses_belief = True

    def __init__(self, policy: TeamPolicy, places: int, steps: int) -> None:
        self.policy, self.steps = policy, steps
        self.met: list[list[tuple[int, NDArray[np.int64], NDArray[np.int64], Floats]]] = [[] for _ in range(places)]

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Note down what is known of the teams, and choose."""
        if team.step < self.steps:
            assert team.belief is not None
            for k, met in enumerate(self.met):
                at = np.flatnonzero(team.active[:, k])
                here = np.where(team.location[at] == k, HERE, AWAY)
                met.append((team.step, team.x[at, k], here, team.belief[at, k]))
        return self.policy(team)
