"""A certified upper bound on the value of all team policies, and the distance of a policy from it.

In each step a robot attends to at most one person: it is at their place or on its way to them. M robots attend to at
most M people. A Lagrangian relaxation of this constraint, with a price lambda_t for each step of attention, separates
the team into the attention subproblems of single people (`assist.person.attention_subproblem`).

Assumptions. What is hidden about people is independent, and so are their choices, given the robot's actions. Robot
actions cost 0 or more. A move to a person costs at least as much, and takes at least as long, as a move from the
nearest other place.

Claim. For all prices lambda_t >= 0, the optimal value J* of the team is at most

    M sum_t gamma^t lambda_t  +  sum_k V_k(lambda),

where V_k is the optimal value of person k's subproblem: attention has the price lambda_t in step t, coming costs as
much as from the nearest other place, and leaving is free. Waiting with the person costs what it costs the robot, but
nothing if there are several robots and their ways take time.

Proof. Consider any policy of the team. Let a_k(t) be 1 in a step in which any robot attends to person k, and 0
otherwise. As sum_k a_k(t) <= M, the return increases or stays the same if sum_t gamma^t lambda_t (M - sum_k a_k(t)) is
added to it. The result is M sum_t gamma^t lambda_t plus, for each person, a return in which attention has its price.
The robots' behaviour towards person k is a policy of their subproblem, at costs that are not higher there: the robot in
it comes when the first of them sets out, and leaves with the last. Where coming takes no time, it comes with its first
action: to be there before would cost as much or more, as costs and prices are 0 or more, and would change nothing.
Where coming takes time, it may be with the person in a step in which the robots of the team are all on their way there,
since another one left. It then waits for free, and the person chooses as if nobody were there. This policy also depends
on what the robots see of the other people. Given the robots' actions, that is independent of what is hidden about
person k and of their choices. So a robot that is alone with person k can draw it, step by step: it acts like additional
random numbers. The mean of the return is at most V_k.

The prices are optimised (`assist.certify.prices`). Each V_k is bounded from above with hidden beta and theta
(`assist.person.solver`), so that the bound does not assume more knowledge of people than a robot has.

The prices only enforce on average that M robots attend to M people. If sample paths are requested, an information
relaxation enforces it in every step (`assist.certify.information_relaxation.sampled_bound`). This bound holds with a
confidence level. It uses the subproblems at the prices, or those without prices if their bounds are lower. Subproblems
without prices need no step in their states, so that the solver gets further in the same time, and the sample paths
account for the conflicts.

Why the bound also holds for people with unknown goals, for robots that differ, and for people who see each other helped
stands at `person.each_goal`, `person.fleet` and `certify.envelope`. Prices of actions lower that of robots that differ
(`certify.action_prices`).

The bound holds in the robot's model: people are drawn from the prior on its grid, with lapses. Policies are simulated
in the same model.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Unpack

from planner.system.progress import Wanted, shows_progress
from planner.system.results import Result

from ..people.arguments import Seed, entropy, whole
from ..people.decision import Floats
from ..person.travel import Travel
from ..team.pool import Pool, require_pool
from ..team.priority import Priority
from ..team.state import TeamPolicy
from . import sample_paths
from .certificate import Certificate, returns
from .computation import Computation, InterruptedBound, summed
from .envelope import require_envelope
from .information_relaxation.confidence import SampledBound
from .options import Effort
from .prices import groups_of
from .truncated_prices import truncated_prices


@dataclass(frozen=True, eq=False, repr=False)
class TeamBound(Result):
    """An upper bound on the value of every policy for a team, from the beginning of an episode.

    Attributes
    ----------
    pool : Pool
    team : tuple of int
        Person at each place.
    travel : Travel
    upper : float
        Upper bound on the mean discounted return, in cost units. With sample paths it holds with the confidence
        `confidence.CONFIDENCE`, otherwise with certainty.
    slack : float
        Largest amount by which a complete solution of the subproblems could lower `upper`: the sum of the gaps between
        the solver's bounds. It is infinite with neighbours, where nothing is known of that.
    upper_seen : float
        The bound with observed beta and theta, at the same prices.
    price : float array, shape (W,)
        lambda_t, in cost units; empty if attention is free in the bound, which is then looser for several people.
    seconds : float
    proven : float
        The bound that holds with certainty.
    on_actions : float array, shape (2, W)
        Additional prices of a suggestion and of an execution at these steps; 0 unless the robots differ.
    sampled : SampledBound or None
        The mean over sample paths; None if none were requested, or if there was too little time. With fewer than
        `confidence.FEWEST` paths it is only reported, and `upper` is `proven`.
    """

    pool: Pool
    team: tuple[int, ...]
    travel: Travel
    upper: float
    slack: float
    upper_seen: float
    price: Floats
    seconds: float
    proven: float
    on_actions: Floats
    sampled: SampledBound | None = None

    def __repr__(self) -> str:
        how = "prices of attention" if len(self.price) else "free attention"
        upper = f"upper bound {self.upper:.3f} on the value of every policy"
        people = "people" if len(self.team) > 1 else "person"
        return f"<{upper} for {len(self.team)} {people} drawn from the robot's prior, with {how}>"

    def records(self) -> list[dict[str, Any]]:
        """Return one row: the number of people, the bound in cost units, its slack, and the seconds."""
        return [{"humans": len(self.team), "upper": self.upper, "slack": self.slack, "seconds": self.seconds}]

    def __post_init__(self) -> None:
        self.price.flags.writeable = False

    def at_most(self, upper: float) -> TeamBound:
        """Return the smaller of this bound and another proven one; a search that ends early may not have reached it."""
        lower = max(0.0, self.upper - upper)
        return replace(
            self, upper=min(self.upper, upper), proven=min(self.proven, upper), slack=max(0.0, self.slack - lower)
        )

    def policy(self) -> Priority:
        """Return the priority policy at this bound's prices, one for each step, for this team from its beginning.

        It is better than priority at a single price where many people wait for the robot. Without prices it is that
        policy, at a price of 0 if everybody has a robot.
        """
        without = None if self.pool.setting.fleet.scarce_for(len(self.team)) else 0.0
        return Priority.of(self.pool.policies, self.travel, self.price if len(self.price) else without)

    def certify(
        self,
        policy: TeamPolicy | str,
        name: str | None = None,
        *,
        episodes: int = 20_000,
        seed: Seed = 0,
        time_limit: float | None = None,
    ) -> Certificate:
        """Simulate a policy in the robot's model and compare it with the bound.

        Parameters
        ----------
        policy : TeamPolicy or str
            A policy, or the name of one.
        name : str, optional
            Name in the certificate.
        episodes : int
            Number of episodes.
        seed : int or Generator
        time_limit : float, optional
            Seconds after which no more episodes begin; about a thousand are simulated in any case.
        """
        called = name or (policy if isinstance(policy, str) else str(getattr(policy, "__name__", "policy")))
        value = returns(
            self.pool, policy, self.team, self.travel, episodes=whole("episodes", episodes, 2),
            seed=entropy(seed), time_limit=time_limit,
        )  # fmt: skip
        return Certificate.of(called, value, humans=len(self.team), upper=self.upper, slack=self.slack)


@shows_progress
def upper_bound(
    pool: Pool,
    team: Sequence[int] | Sequence[str] | None = None,
    *,
    travel: Travel | None = None,
    seed: Seed = 0,
    progress: Wanted = None,
    **effort: Unpack[Effort],
) -> TeamBound:
    """Return an upper bound on the value of all policies for a team in which all people work from the beginning.

    Values are of work without a step limit. `simulate` ends episodes after the setting's `max_steps`, and later steps
    cost nothing, so that its means may be higher. `TeamBound.certify` compares a policy with the bound.

    Parameters
    ----------
    pool : Pool
    team : sequence of int or str, optional
        Person at each place, by number in the pool or by name; by default the whole pool.
    travel : Travel, optional
        Travel between the places; by default that of the setting.
    seed : int or Generator
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes.
    **effort
        How tight the bound is to be, and what it may take: see `Effort`.

    Raises
    ------
    ValueError
        A parameter is out of its range; or sample paths are requested for people whose goal is unknown.
    LimitError
        The subproblems would exceed the memory limit.
    """
    require_pool(pool)
    assert callable(progress)
    run = Computation.of(pool, members_of(pool, team), travel, entropy(seed), progress, effort)
    members, paths, window = run.team, run.paths, effort.get("window")
    if paths:
        pool.choices(members[0]).require_one_goal("the bound from sample paths")
    require_envelope(pool, members, paths)
    together, groups, price = truncated_prices(run, window) if run.needs_outer else run.prices(window)
    visited = sample_paths.visited(run, groups, price, together) if run.paths and not run.needs_outer else None
    relaxed, sampled = run.relaxed(groups, price, run.start + run.for_people, visited), None
    try:
        if run.paths and pool.setting.fleet.scarce_for(len(members)):
            relaxed = sample_paths.without_prices(run, relaxed, visited)
            sampled = sample_paths.sampled(run, relaxed, together)
    except KeyboardInterrupt as error:
        raise InterruptedBound(relaxed.upper, len(members), len(members), error) from error
    upper = min(relaxed.upper, sampled.upper) if sampled and sampled.enough else relaxed.upper
    return TeamBound(
        pool, members, run.travel, upper, relaxed.slack, relaxed.upper_seen, relaxed.price[0],
        time.perf_counter() - run.start, relaxed.upper, relaxed.price[1:], sampled,
    )  # fmt: skip


def free_attention_bound(pool: Pool, team: tuple[int, ...], travel: Travel, until: float = math.inf) -> float:
    """Return a first upper bound: attention is free, and what is hidden about people is observed.

    It needs no search, so that it is there in a second on a task of some hundred states. With neighbours it is less
    tight if the time until `until`, on the clock of `time.perf_counter()`, is short.
    """
    groups = groups_of(pool, team, travel, 0, until=until)
    return summed(0.0, [(group.count, group.with_free_attention()) for group in groups])


def members_of(pool: Pool, team: Sequence[int] | Sequence[str] | None) -> tuple[int, ...]:
    """Return the checked numbers of the people at each place."""
    members = pool.numbers(range(len(pool.people)) if team is None else team)
    return tuple(members.tolist())
