"""Certificates: the simulated value of a team policy, compared with an upper bound on the value of all policies."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.system.results import Result

from ..people.decision import Floats
from ..person.travel import Travel
from ..team.policies import prepare
from ..team.pool import Pool
from ..team.simulate import simulate
from ..team.state import TeamPolicy


@dataclass(frozen=True, repr=False)
class Certificate(Result):
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
        100 (upper - value) / abs(value). It is negative where the mean is above the bound by chance.
    slack_percent : float
        Largest number of these percentage points by which a complete solution of the single people's problems could
        lower the bound: not by more than the gap, as no bound is below the policy's value.
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

    def __repr__(self) -> str:
        value = f"{self.value:.3f} ± {self.value_stderr:.3f}"
        gap = f"gap at most {self.gap} (upper bound {self.upper:.3f})"
        drawn = f"{self.episodes:,} episodes with people drawn from the robot's prior"
        return f"<{self.policy}: value {value} over {drawn}, {gap}>"

    @property
    def within_error(self) -> bool:
        """Whether the mean is above the bound, but not by more than three of its standard errors."""
        return 0 < self.value - self.upper <= 3 * self.value_stderr + 1e-9 * abs(self.value)

    @property
    def above(self) -> bool:
        """Whether the mean is above the bound by more than its error, so that more episodes are needed."""
        return self.value > self.upper and not self.within_error

    @property
    def gap(self) -> str:
        """The largest distance to the best policy in percent of the value, as tables show it."""
        if self.above:
            return "the mean is above the bound"
        return "0 %, within the error" if self.within_error else f"{self.gap_percent:.2f} %"

    @classmethod
    def of(cls, name: str, returns: Floats, *, humans: int, upper: float, slack: float) -> Certificate:
        """Return the certificate for the returns of some episodes, shape (N,), with a bound and its slack."""
        mean = float(returns.mean())
        gap = 100 * (upper - mean) / abs(mean) if mean else 0.0
        return cls(
            humans=humans,
            policy=name,
            value=mean,
            value_stderr=float(returns.std(ddof=1) / math.sqrt(len(returns))),
            upper=upper,
            gap_percent=gap,
            slack_percent=min(100 * slack / abs(mean), max(gap, 0.0)) if mean else 0.0,
            episodes=len(returns),
        )


LONGEST = 10_000
"""Largest number of steps of an episode, which takes some seconds.

People in a dead end act until it ends, and the time is looked at after a portion of episodes. For gamma above 0.998,
the rest of those who have not finished weighs more than a millionth.
"""


def horizon(gamma: float) -> int:
    """Return the number of steps after which episodes end.

    The remaining discounted costs are then at most a millionth of the largest cost of a step.
    """
    return math.ceil(math.log(1e-6 * (1 - gamma)) / math.log(gamma))


class Simulated:
    """The returns of a policy that is simulated in the robot's model, in portions of episodes.

    They are lower bounds: the largest possible costs after the end of an episode are subtracted.

    Attributes
    ----------
    team : tuple of int
        Person at each place.
    parts : list of float arrays
        The returns of each portion, in cost units.
    count : int
        Number of episodes that were simulated.
    seconds : float
        Time that they took, without the first portion, which also computes what policies share.
    """

    def __init__(
        self, pool: Pool, policy: TeamPolicy | str, team: tuple[int, ...], travel: Travel, *, seed: int
    ) -> None:
        gamma = pool.setting.gamma
        self._end = min(horizon(gamma), LONGEST)
        self._pool = replace(pool, setting=replace(pool.setting, max_steps=self._end))
        self._policy = self._pool.policy(policy, travel) if isinstance(policy, str) else policy
        self.team, self._travel, self._seed = team, travel, seed
        extra = pool.setting.fleet.extra
        most = float(travel.c_move.max()) * float(travel.distance.max()) + float(extra[np.isfinite(extra)].max())
        most += pool.setting.c_ask or 0.0
        dearest = max(max(1.0, p.problem.dearest) + float(p.pomdp.robot_costs.max()) for p in pool.policies) + most
        self._rest = dearest * gamma**self._end / (1 - gamma)
        self.parts: list[Floats] = []
        self.count, self.seconds = 0, 0.0

    def prepare(self, progress: Callable[[int, int], None]) -> None:
        """Compute now what the policy needs about the team's people; `progress` is called as by `policies.prepare`."""
        models = np.unique(self._pool.model[list(self.team)]).tolist()
        prepare(self._policy, [self._pool.policies[model] for model in models], progress=progress)

    def more(self, episodes: int) -> None:
        """Simulate so many further episodes."""
        begun = time.perf_counter()
        run = simulate(
            self._pool, self._policy, humans=list(self.team), episodes=np.arange(self.count, self.count + episodes),
            seed=self._seed, travel=self._travel, world="model",
        )  # fmt: skip
        self.seconds += time.perf_counter() - begun if self.parts else 0.0
        self.parts.append(run.discounted_return - (~run.finished).sum(axis=1) * self._rest)
        self.count += episodes


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

    The largest possible costs after the end of an episode are subtracted. `team` has the person at each place; other
    parameters are as in `TeamBound.certify`.
    """
    run = Simulated(pool, policy, team, travel, seed=seed)
    simulated_until([run], episodes, None if time_limit is None else time.perf_counter() + time_limit)
    return np.concatenate(run.parts)


def simulated_until(
    runs: Sequence[Simulated], episodes: int, deadline: float | None, tell: Callable[[int], None] = lambda _: None
) -> None:
    """Simulate policies until each has so many episodes, or until a time on the clock of `time.perf_counter()`.

    They share the time equally: the next episodes are those of the policy that has had the least of it. A policy that
    needs less leaves the rest to the others. Each gets about a thousand episodes in any case. `tell` is called with the
    number of episodes that were added.
    """
    # The records of 65,536 episodes take about 10 MB per person. A time limit is checked after 1,024 episodes.
    portion = 65_536 if deadline is None else 1024
    while True:
        late = deadline is not None and time.perf_counter() > deadline
        open_ones = [run for run in runs if run.count < episodes and not (late and run.parts)]
        if not open_ones:
            return
        run = min(open_ones, key=lambda one: (bool(one.parts), one.seconds))
        added = min(portion, episodes - run.count)
        run.more(added)
        tell(added)
