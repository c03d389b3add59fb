"""A certified upper bound on the value of all team policies, and the distance of a policy from it.

In each step the robot attends to at most one person: it is at their place or on its way to them. A Lagrangian
relaxation of this constraint, with a price lambda_t for each step of attention, separates the team into the attention
subproblems of single people (`assist.team.attention_subproblem`).

Assumptions. People's choices are independent of each other, given the robot's actions. A move to a person costs at
least as much, and takes at least as long, as a move from the nearest other place.

Claim. For all prices lambda_t >= 0, the optimal value J* of the team is at most

    sum_t gamma^t lambda_t  +  sum_k V_k(lambda),

where V_k is the optimal value of person k's subproblem: attention has the price lambda_t in step t, coming costs as
much as from the nearest other place, and leaving is free.

Proof. Consider any policy of the team. Let a_k(t) be 1 in a step in which the robot attends to person k, and 0
otherwise. As sum_k a_k(t) <= 1, the return increases or stays the same if sum_t gamma^t lambda_t (1 - sum_k a_k(t)) is
added to it. The result is sum_t gamma^t lambda_t plus, for each person, a return in which attention has its price. The
robot's behaviour towards person k is a policy of their subproblem, at costs that are not higher there. This policy also
depends on the other people's states, which are independent of person k and act like additional random numbers. So the
mean of the return is at most V_k.

The prices are optimised (`assist.certify.prices`). Each V_k is bounded from above with hidden beta and theta
(`assist.person.solver`), so that the bound does not assume more knowledge of people than a robot has.

The prices only enforce that the robot is in one place on average. If sample paths are requested, an information
relaxation enforces it in every step (`assist.certify.information_relaxation.sampled_bound`). This bound holds with a
confidence level. It uses the subproblems at the prices, or those without prices if their bounds are lower. Subproblems
without prices need no step in their states, so that the solver gets further in the same time, and the sample paths
account for the conflicts.

The bound holds in the robot's model: people are drawn from the prior on its grid, with lapses. Policies are simulated
in the same model.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import LimitError
from planner.system.arrays import outline
from planner.system.machine import processors
from planner.system.progress import Progress, Wanted, shows_progress

from ..people.arguments import Seed, entropy, positive, whole
from ..people.decision import Floats
from ..person.policy import Policy
from ..person.solver import Solution, solve
from ..simulation.pool import MEMORY_LIMIT_MB, Pool
from ..team.attention_subproblem import AttentionSubproblem
from ..team.priority import Priority
from ..team.state import TeamPolicy
from ..team.travel import Travel
from .certificate import BeliefRecorder, Certificate, horizon, returns
from .information_relaxation.belief_nodes import BeliefNodes
from .information_relaxation.confidence import SampledBound
from .information_relaxation.congestion import OutOfTimeError
from .information_relaxation.options import RelaxationOptions
from .information_relaxation.sampled_bound import InformationRelaxation
from .prices import SubproblemKind, kinds_of, search, window_of


@dataclass(frozen=True)
class BoundOptions:
    """Options of `upper_bound` that trade the tightness of the bound for time and memory. It is valid for all values.

    Attributes
    ----------
    price_rounds : int
        Number of subgradient steps in the optimisation of prices. The result is the mean over the last half of them,
        which averages the noise out.
    price_episodes : int
        Number of simulated episodes of each person's problem per round. More give less noise and take longer.
    priced_steps : int
        Default limit of the number of steps with prices on truncated tasks, as the number of states grows with it.
    price_memory_mb : float
        Memory for each person's problem below which prices on truncated tasks are not optimised, in MB. Prices need the
        outer relaxation, which is kept in memory as well.
    belief_episodes : int
        Episodes of the priority policy whose beliefs are recorded for the sample-path bound. With 1,000, the beliefs
        about people without attention for long are still divided too finely, which loosens the bound.
    relaxation : RelaxationOptions
        Options of the bound from sample paths.
    """

    price_rounds: int = 40
    price_episodes: int = 2048
    priced_steps: int = 20
    price_memory_mb: float = 500.0
    belief_episodes: int = 10_000
    relaxation: RelaxationOptions = field(default_factory=RelaxationOptions)


@dataclass(frozen=True)
class TeamBound:
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
        the solver's bounds.
    upper_seen : float
        The bound with observed beta and theta, at the same prices.
    price : float array, shape (W,)
        lambda_t, in cost units; empty if the bound uses no prices.
    seconds : float
    proven : float
        The bound that holds with certainty.
    sampled : SampledBound or None
        The mean over sample paths; None if none were requested, or if there was no time for any. With fewer than
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
    sampled: SampledBound | None = None

    __repr__ = outline

    def __post_init__(self) -> None:
        self.price.flags.writeable = False

    def relaxed(self, *, episodes: int = 20_000, seed: Seed = 0) -> tuple[float, float]:
        """Simulate QMDP's policies in the relaxed problem, with one robot per person; return mean and standard error.

        Optimal policies of the relaxed problem have at least this value, and the bound is at least theirs. So the part
        of a certificate's gap below this mean is due to the relaxation and the team policy, not to the solver.
        """
        for policy in self.pool.policies:
            policy.require_enumerated("relaxed")
        episodes, seed_number = whole("episodes", episodes, 2), entropy(seed)
        gamma = self.pool.setting.gamma
        total, variance = float(self.price @ gamma ** np.arange(len(self.price))), 0.0
        kinds = kinds_of(self.pool, self.team, self.travel, len(self.price))
        for number, kind in enumerate(kinds):  # independent random numbers, so that variances add up
            value = kind.simulated(self.price, horizon(gamma), episodes, seed_number + number)[1]
            total += kind.count * float(value.mean())
            variance += kind.count**2 * float(value.var(ddof=1)) / episodes
        return total, math.sqrt(variance)

    def policy(self) -> Priority:
        """Return the priority policy at this bound's prices, one for each step, for this team from its beginning.

        It is better than priority at a single price where many people wait for the robot. Without prices it is that
        policy.

        Raises
        ------
        ValueError
            The task is truncated, and there are prices.
        """
        return Priority.of(self.pool.policies, self.travel, self.price if len(self.price) else None)

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
    team: Sequence[int] | None = None,
    *,
    travel: Travel | None = None,
    window: int | None = None,
    gap: float = 1e-3,
    time_limit: float | None = None,
    memory_limit_mb: float = MEMORY_LIMIT_MB,
    paths: int = 0,
    seed: Seed = 0,
    jobs: int | None = None,
    options: BoundOptions | None = None,
    progress: Wanted = None,
) -> TeamBound:
    """Return an upper bound on the value of all policies for a team in which all people work from the beginning.

    Parameters
    ----------
    pool : Pool
    team : sequence of int, optional
        Person at each place; by default the whole pool.
    travel : Travel, optional
        Travel between the places; by default that of the setting.
    window : int, optional
        Number of steps with prices; by default that of `prices.window_of`. On truncated tasks the default is at most
        `options.priced_steps`, and less if the memory is short.
    gap : float
        Relative gap to which each subproblem is solved.
    time_limit : float, optional
        Seconds in total. At most 40 % of the time is for prices; each subproblem then gets an equal share of the rest.
        On truncated tasks, 30 % are for the outer relaxations and 25 % for prices. With sample paths, half of the time
        is for these. Work on the first bounds is not interrupted, and the bound is valid after any time.
    memory_limit_mb : float
        Memory of all subproblems in MB, which is estimated before they are built; the solutions of those that are
        solved at a time may take as much again each.
    paths : int
        Number of sample paths that tighten the bound; with 0, the bound holds with certainty. They are useful for teams
        of up to about six people. A time limit reduces the number. If the preparation exceeds the time, no path is
        sampled.
    seed : int or Generator
    jobs : int, optional
        Number of subproblems and of sample paths that are processed at a time; by default the number of processors.
    options : BoundOptions, optional
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes.

    Raises
    ------
    LimitError
        The subproblems would exceed the memory limit.
    """
    assert callable(progress)
    start = time.perf_counter()
    limit = math.inf if time_limit is None else positive("time_limit", time_limit)
    members = _members(pool, team)
    travel = travel or pool.setting.travel(len(members))
    if len(travel) != len(members):
        raise ValueError(f"travel for {len(travel)}: expected {len(members)} people")
    run = _Computation(
        pool, members, travel, gap=gap, start=start, limit=limit, memory_limit_mb=memory_limit_mb,
        paths=whole("paths", paths, 0), workers=whole("jobs", jobs or processors(), 1), seed=entropy(seed),
        options=options or BoundOptions(), tell=progress,
    )  # fmt: skip
    together, kinds, price = run.prices(window)
    recorder = run.recorder(kinds, price, together) if run.paths and not run.needs_outer else None
    relaxed, sampled = run.relaxed(kinds, price, start + run.for_people, recorder), None
    if run.paths and len(members) > 1:
        relaxed = run.without_prices(relaxed, recorder)
        sampled = run.sampled(relaxed, together)
    upper = min(relaxed.upper, sampled.upper) if sampled and sampled.enough else relaxed.upper
    return TeamBound(
        pool, members, travel, upper, relaxed.slack, relaxed.upper_seen, relaxed.price,
        time.perf_counter() - start, relaxed.upper, sampled,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class _Computation:
    """The computation of a bound: its team, its limits, and its steps; other attributes as in `upper_bound`.

    Attributes
    ----------
    start : float
        Time at which it began, on the clock of `time.perf_counter()`.
    limit : float
        Seconds in total; infinite without a limit.
    """

    pool: Pool = field(kw_only=False)
    team: tuple[int, ...] = field(kw_only=False)
    travel: Travel = field(kw_only=False)
    gap: float
    start: float
    limit: float
    memory_limit_mb: float
    paths: int
    workers: int
    seed: int
    options: BoundOptions
    tell: Progress

    @property
    def for_people(self) -> float:
        """Seconds for people's problems; sample paths get the rest."""
        return self.limit / 2 if self.paths else self.limit

    @cached_property
    def policies(self) -> list[Policy]:
        """The policies of the team's people, each once."""
        return [self.pool.policies[model] for model in sorted(set(self.pool.model[list(self.team)].tolist()))]

    @property
    def needs_outer(self) -> bool:
        """Whether prices need the outer relaxation, as values of some states are not kept."""
        return any(math.isinf(policy.size) for policy in self.policies)

    def kinds(self, steps: int, with_outer: bool) -> list[SubproblemKind]:
        """Return the kinds of subproblems with prices on some steps."""
        return kinds_of(
            self.pool, self.team, self.travel, steps, with_outer=with_outer, memory_limit_mb=self.memory_limit_mb,
            until=self.start + 0.3 * self.for_people, tell=self.tell,
        )  # fmt: skip

    def prices(self, window: int | None) -> tuple[int, list[SubproblemKind], Floats]:
        """Optimise the prices; return the number of steps in which people are at work, the subproblems and the prices.

        `window` is the requested number of steps with prices, if any.
        """
        priced = window is not None or not self.needs_outer or self._worth_prices()
        if window is not None:
            together = whole("window", window)
        else:
            together = window_of(self.pool, self.team, self.seed) if priced or self.paths else 0
        if self.needs_outer:
            most = together if window is not None else min(together, self.options.priced_steps)
            kinds, steps = self._with_outer(most if priced and len(self.team) > 1 else 0, window is not None)
        else:
            kinds, steps = self.kinds(together, False), together
        if len(self.team) == 1 or not steps:
            return together, kinds, np.zeros(0)
        # On truncated tasks the outer relaxations have had 30 % of the time, and the solver needs more of the rest.
        for_prices = 0.3 + 0.25 if self.needs_outer else 0.4
        price = search(
            kinds, steps, rounds=self.options.price_rounds, episodes=self.options.price_episodes, seed=self.seed,
            deadline=self.start + for_prices * self.for_people, tell=self.tell,
        )  # fmt: skip
        if self.needs_outer and not len(price):
            kinds = self.kinds(0, self.paths > 0)
        return together, kinds, price

    def _worth_prices(self) -> bool:
        """Return whether prices are optimised on truncated tasks: not if states need searches or memory is short."""
        searches = any(policy.searches for policy in self.policies)
        return not searches and self.memory_limit_mb / len(self.policies) >= self.options.price_memory_mb

    def _with_outer(self, steps: int, wanted: bool) -> tuple[list[SubproblemKind], int]:
        """Return the kinds on truncated tasks, and the number of steps with prices that the memory allows.

        The number is 0 if the effect of prices at a frontier is unknown, unless prices are requested.
        """
        while steps:
            try:
                kinds = self.kinds(steps, True)
            except LimitError:
                steps //= 2
                continue
            if wanted or all(kind.between is not None or kind.visits.pomdp.frontier is None for kind in kinds):
                return kinds, steps
            break
        return self.kinds(0, self.paths > 0), 0

    def recorder(self, kinds: list[SubproblemKind], price: Floats, together: int) -> BeliefRecorder:
        """Simulate the priority policy at these prices, and return the recorder of visited beliefs.

        A robot with one person rarely leaves them alone for long, so that the solver rarely visits beliefs that arise
        then. In a team such beliefs are frequent. Where bounds are loose, the information relaxation divides them among
        known types, which tells the robot too much.
        """
        priority = Priority.of(self.policies, self.travel, price if len(price) else None)
        meeting = BeliefRecorder(priority, len(self.team), together + self.options.relaxation.free_steps)
        each = math.ceil(self.options.belief_episodes / max(kind.count for kind in kinds))
        returns(self.pool, meeting, self.team, self.travel, episodes=each, seed=self.seed)
        return meeting

    def relaxed(
        self, kinds: list[SubproblemKind], price: Floats, until: float, recorder: BeliefRecorder | None
    ) -> _Relaxed:
        """Return the relaxation at these prices, with bounds computed by a time on the clock."""

        def one(number: int, kind: SubproblemKind) -> tuple[AttentionSubproblem, Solution]:
            visits = kind.at(price)
            best = kind.best(visits)
            still = math.ceil((len(kinds) - number) / self.workers)  # rounds that remain, including this one
            share = (until - time.perf_counter()) / still
            return visits, solve(
                visits.pomdp, gap=self.gap, time_limit=None if until == math.inf else max(0.0, share),
                memory_limit_mb=self.memory_limit_mb, best=best,
                further_beliefs=None if recorder is None else _beliefs(kind, visits, recorder),
            )  # fmt: skip

        parts: list[tuple[AttentionSubproblem, Solution]] = []
        self.tell("bounding people's problems", 0, len(kinds))
        with ThreadPoolExecutor(self.workers) as threads:
            for part in threads.map(one, range(len(kinds)), kinds):
                parts.append(part)
                self.tell("bounding people's problems", len(parts), len(kinds))
        return _Relaxed(kinds, parts, price)

    def without_prices(self, relaxed: _Relaxed, recorder: BeliefRecorder | None) -> _Relaxed:
        """Return the relaxation without prices if its bound is lower, as it may be if the time was short.

        Without prices, states need no step, so that the subproblems are much smaller.
        """
        if relaxed.done or not len(relaxed.price):
            return relaxed
        kinds, begun = self.kinds(0, self.paths > 0), time.perf_counter()
        until = begun + 0.3 * (self.start + self.limit - begun)
        free = self.relaxed(kinds, relaxed.price[:0], until, recorder)
        return min(relaxed, free, key=lambda one: one.upper)

    def sampled(self, relaxed: _Relaxed, together: int) -> SampledBound | None:
        """Return the bound from sample paths; None if there was no time for any."""
        begun = time.perf_counter()

        def left(done: int) -> float:
            self.tell("drawing sample paths", done, self.paths)
            return 1.0 - (time.perf_counter() - begun) / max(1e-9, self.start + self.limit - begun)

        with suppress(OutOfTimeError):
            robot = InformationRelaxation(
                relaxed.belief_nodes(), relaxed.price, together, left, self.workers, self.options.relaxation
            )
            return robot.sampled(self.paths, self.seed)
        return None


@dataclass(frozen=True)
class _Relaxed:
    """The Lagrangian relaxation of a team: its subproblems at some prices, with their solutions."""

    kinds: list[SubproblemKind]
    parts: list[tuple[AttentionSubproblem, Solution]]
    price: Floats

    def _all(self, each: Callable[[Solution], float]) -> float:
        return sum(kind.count * each(solution) for kind, (_, solution) in zip(self.kinds, self.parts, strict=True))

    @property
    def paid(self) -> float:
        gamma = self.kinds[0].pool.setting.gamma
        return float(self.price @ gamma ** np.arange(len(self.price)))

    @property
    def upper(self) -> float:
        return self.paid + self._all(lambda solution: solution.upper)

    @property
    def upper_seen(self) -> float:
        return self.paid + self._all(lambda solution: solution.value_qmdp)

    @property
    def slack(self) -> float:
        return self._all(lambda solution: solution.upper - solution.lower)

    @property
    def done(self) -> bool:
        """Whether each subproblem was solved to the requested gap."""
        return all(solution.stopped == "gap" for _, solution in self.parts)

    def belief_nodes(self) -> list[BeliefNodes]:
        """Return the belief nodes of each person; people of one kind share them."""
        # The outer relaxation neglects travel time, so that it does not apply if travel takes time.
        outers = [kind.outer if not len(self.price) and not kind.visits.entry_steps else None for kind in self.kinds]
        belief_nodes = [BeliefNodes(*part, outer) for part, outer in zip(self.parts, outers, strict=True)]
        return [one for kind, one in zip(self.kinds, belief_nodes, strict=True) for _ in range(kind.count)]


def _beliefs(
    kind: SubproblemKind, visits: AttentionSubproblem, recorder: BeliefRecorder
) -> tuple[NDArray[np.int64], Floats]:
    """Return the states and visited beliefs of the people of one subproblem, the latest steps first.

    Beliefs that differ by less than 1/200 in each entry count as equal.
    """
    found = [one for place in kind.places for one in recorder.visited[place] if len(one[1])]
    states = np.concatenate([visits.layout.number(step, here, x) for step, x, here, _ in found])
    steps = np.concatenate([np.full(len(x), step) for step, x, _, _ in found])
    beliefs = np.concatenate([belief for *_, belief in found])
    rounded = np.column_stack([states, np.rint(beliefs.reshape(len(states), -1) / (1 / 200))])
    first = np.unique(rounded.astype(np.int32), axis=0, return_index=True)[1]
    first = first[(states[first] >= 0) & ~visits.pomdp.final[states[first]]]
    first = first[np.argsort(-steps[first], kind="stable")]
    return states[first], beliefs[first]


def _members(pool: Pool, team: Sequence[int] | None) -> tuple[int, ...]:
    """Return the checked numbers of the people at each place."""
    people = len(pool.people)
    members = tuple(range(people)) if team is None else tuple(whole("person", person) for person in team)
    if not members or max(members) >= people:
        raise ValueError(f"team {members}: expected one or more numbers of the pool, from 0 to {people - 1}")
    return members


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
