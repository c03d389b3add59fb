"""A certified upper bound on what any team policy can reach, and with it how far a policy is from the best.

At each step the robot is with one person, or on its way to one. Relaxing that with a price lambda_t >= 0 on every
step of attention takes the team apart (`assist.team.attention_subproblem`):

    J*  <=  sum_t gamma^t lambda_t  +  sum_k V_k(lambda)

where V_k is the most that any policy gets in person k's own problem, in which attention is paid for, and coming costs
what coming from the nearest other place does. That holds for all prices. At those that are found
(`assist.certify.prices`), each V_k is bounded from above by solving the problem with beta and theta hidden
(`assist.person.solver`), so that knowing people better than one can is no source of looseness.

Where paths are asked for, what the prices leave open, that the robot may be in two places at a time as long as it is in
one on average, is narrowed by samples (`assist.certify.information_relaxation.sampled_bound`); the bound then holds
with a confidence. It is sampled from the problems at these prices, or from those without any where their bounds come to
less: a state of these needs no step, so that they are solved much further in the same time, and samples see conflicts
without prices.

The bound holds in the robot's model: people drawn from the prior, on its grid, with lapses. In that world policies are
simulated as well.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import LimitError
from planner.system.arrays import outline
from planner.system.machine import processors
from planner.system.progress import Progress, Wanted, shows_progress

from ..large_tasks.truncated_policy import TruncatedPolicy
from ..people.arguments import Seed, entropy, positive, whole
from ..people.decision import Floats
from ..person.solver import Solution, solve
from ..simulation.pool import MEMORY_LIMIT_MB, Pool
from ..team.attention_subproblem import AttentionSubproblem
from ..team.priority import Priority
from ..team.state import TeamPolicy
from ..team.travel import Travel
from .certificate import Certificate, Meeting, horizon, returns
from .information_relaxation.belief_nodes import BeliefNodes
from .information_relaxation.confidence import SampledBound
from .information_relaxation.congestion import OutOfTimeError
from .information_relaxation.sampled_bound import AFTER, InformationRelaxation
from .prices import SubproblemKind, kinds_of, search, window_of

FOR_BOUND = 0.8
"""The share of a time limit in which a bound is looked for; policies are simulated in the rest."""

FOR_PRICES = 0.4
"""The share of the time for a bound in which prices are looked for; people's problems are bounded in the rest."""

FOR_PRICES_THERE = 0.25
"""The same on parts of large tasks, where the solver has most to do; what is around these parts comes before."""

FOR_REGIONS = 0.3
"""The share of the time for a bound in which it is worked out what follows where parts of large tasks break off."""

FOR_PATHS = 0.5
"""The share of the time for a bound in which lucks are sampled, if any are to be."""

FOR_FREE = 0.3
"""The share of that in which people's problems are bounded without prices, before."""


MEETINGS = 10_000
"""Episodes of priority whose beliefs are recorded for the sample-path bound. With 1,000, people who are left alone for
long are still told apart too well, which loosens the bound."""

ALIKE = 1 / 200
"""Beliefs that differ by less than this share, in each type, count as one there."""

ROOM = 500.0
"""Megabytes for each person's problem with which they are looked for there: what is around their parts is kept, too."""

LONG = 20
"""On parts of large tasks prices are looked for on no more steps, unless they are wanted."""


@dataclass(frozen=True)
class TeamBound:
    """What no policy for a team exceeds, from the beginning of an episode on.

    Attributes
    ----------
    pool : Pool
    team : tuple of int
        Who is at each place.
    travel : Travel
    upper : float
        Mean discounted return, in cost units. Where lucks were sampled it holds with a confidence of
        `confidence.CONFIDENCE`, else in any case.
    slack : float
        By how much `upper` could be lower, at most, if each person's problem had been solved to the end: the sum of
        what is between the solver's bounds.
    upper_seen : float
        What the bound would be if beta and theta were seen, at the same prices.
    price : float array, shape (W,)
        lambda_t, in cost units; none where the team was taken apart without prices.
    seconds : float
    proven : float
        What holds in any case.
    sampled : SampledBound or None
        The sample paths' mean; None where none were asked for, or there was no time for any. Of fewer than
        `confidence.FEWEST` it is reported, and `upper` is `proven`.
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
        """Simulate QMDP's policies in the relaxed problem, with a robot for everybody; give mean and standard error.

        The best policies there get no less and the bound no more than `upper`: what of a certificate's gap is below
        this mean is not the solver's but the relaxation's and the policy's.
        """
        if self.pool.truncated:
            raise ValueError("relaxed: expected a task that is looked at whole")
        episodes, luck = whole("episodes", episodes, 2), entropy(seed)
        gamma = self.pool.setting.gamma
        total, variance = float(self.price @ gamma ** np.arange(len(self.price))), 0.0
        kinds = kinds_of(self.pool, self.team, self.travel, len(self.price))
        for number, kind in enumerate(kinds):  # of independent luck, so that variances add up
            value = kind.simulated(self.price, horizon(gamma), episodes, luck + number)[1]
            total += kind.count * float(value.mean())
            variance += kind.count**2 * float(value.var(ddof=1)) / episodes
        return total, math.sqrt(variance)

    def policy(self) -> Priority:
        """Give priority at this bound's prices, one for each step, for this team from its beginning.

        Where many wait for the robot it is ahead of priority at one price; without prices it is that.

        Raises
        ------
        ValueError
            The task is not looked at whole, and there are prices.
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
        """Simulate a policy, or the one of a name, in the model's world and compare.

        Parameters
        ----------
        pool : Pool
        time_limit : float, optional
            Begin no more episodes after so many seconds; about a thousand are simulated in any case.
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
    progress: Wanted = None,
) -> TeamBound:
    """Bound from above what any policy gets with a team in which all work from the beginning.

    Parameters
    ----------
    pool : Pool
    team : sequence of int, optional
        Who is at each place; the whole pool unless given.
    travel : Travel, optional
        The way between them; that of the setting unless given.
    window : int, optional
        Prices are looked for on so many steps. Unless given, twice what the longest task takes at best; in a large
        team, for as long as `MANY` people would still be at work without a robot, but at most `LONGEST` times that.
        On tasks that are not looked at whole on `LONG` at most, and on fewer where the memory does not allow more.
    gap : float
        Relative gap to which each person's problem is solved.
    time_limit : float, optional
        Seconds for all of it. Prices are looked for in at most `FOR_PRICES` of them; in what is left each person's
        problem gets an equal share. What is being set up or solved for the first bounds is not interrupted, and the
        bound is sound however little time there was.
    memory_limit_mb : float
        What people's problems may take, in megabytes, which is known before they are set up; and once more what each
        of those that are solved at a time may.
    paths : int
        Lucks that are sampled to make the bound tighter; with 0, none are, and the bound holds in any case. Worth while
        in teams of up to about six people. What a time limit leaves no time for is left out, but for a few; all of them
        where it takes longer to work out what people will want.
    seed : int or Generator
    jobs : int, optional
        Problems that are solved, and lucks that are looked at, at a time; as many as there are processors unless given.
    progress : callable or bool, optional
        Who is told how far it is, as in `planner.system.progress`.

    Raises
    ------
    LimitError
        People's problems would take more memory than is allowed.
    """
    assert callable(progress)
    start = time.perf_counter()
    limit = math.inf if time_limit is None else positive("time_limit", time_limit)
    members = _members(pool, team)
    travel = travel or pool.setting.travel(len(members))
    if len(travel) != len(members):
        raise ValueError(f"travel for {len(travel)}: expected {len(members)} people")
    paths = whole("paths", paths, 0)
    workers = whole("jobs", jobs or processors(), 1)
    luck = entropy(seed)
    for_people = (1 - FOR_PATHS) * limit if paths else limit

    def kinds_with(steps: int, around: bool) -> list[SubproblemKind]:
        return kinds_of(
            pool, members, travel, steps, around=around, memory_limit_mb=memory_limit_mb,
            until=start + FOR_REGIONS * for_people, tell=progress,
        )  # fmt: skip

    priced = window is not None or not pool.truncated or _worth_prices(pool, members, memory_limit_mb)
    if window is not None:
        together = whole("window", window)
    else:
        together = window_of(pool, members, luck) if priced or paths else 0
    if pool.truncated:
        most = together if window is not None else min(together, LONG)
        kinds, steps = _timed(kinds_with, most if priced and len(members) > 1 else 0, window is not None, paths > 0)
    else:
        kinds, steps = kinds_with(together, False), together
    price = np.zeros(0)
    if len(members) > 1 and steps:
        for_prices = FOR_REGIONS + FOR_PRICES_THERE if pool.truncated else FOR_PRICES
        price = search(kinds, steps, seed=luck, deadline=start + for_prices * for_people, tell=progress)
        if pool.truncated and not len(price):
            kinds = kinds_with(0, paths > 0)
    met = _met(pool, members, travel, kinds, price, together + AFTER, luck) if paths and not pool.truncated else None
    relaxed = _relax(kinds, price, gap, start + for_people, memory_limit_mb, workers, progress, met)
    sampled = None
    if paths and len(members) > 1:
        # Without prices states need no step: problems are so much smaller that this may be ahead where time was short.
        if len(price) and not relaxed.done:
            free, begun = kinds_with(0, paths > 0), time.perf_counter()
            until = begun + FOR_FREE * (start + limit - begun)
            relaxed = min(
                relaxed,
                _relax(free, price[:0], gap, until, memory_limit_mb, workers, progress, met),
                key=lambda one: one.upper,
            )

        begun = time.perf_counter()

        def left(done: int) -> float:
            progress("sampling lucks", done, paths)
            return 1.0 - (time.perf_counter() - begun) / max(1e-9, start + limit - begun)

        with suppress(OutOfTimeError):
            robot = InformationRelaxation(relaxed.lattices(), relaxed.price, together, left, workers)
            sampled = robot.sampled(paths, luck)
    upper = min(relaxed.upper, sampled.upper) if sampled and sampled.enough else relaxed.upper
    return TeamBound(
        pool, members, travel, upper, relaxed.slack, relaxed.upper_seen, relaxed.price,
        time.perf_counter() - start, relaxed.upper, sampled,
    )  # fmt: skip


def _worth_prices(pool: Pool, team: tuple[int, ...], memory_limit_mb: float) -> bool:
    """Tell whether prices are looked for on parts of a large task: not if states take searches or memory is short."""
    models = set(pool.model[list(team)].tolist())
    searches = any(
        isinstance(pool.policies[m], TruncatedPolicy) and pool.policies[m].ground.known.searches for m in models
    )
    return not searches and memory_limit_mb / len(models) >= ROOM


def _timed(
    kinds_with: Callable[[int, bool], list[SubproblemKind]], steps: int, wanted: bool, around: bool
) -> tuple[list[SubproblemKind], int]:
    """Give a team's kinds on parts of a large task, and on how many steps they have prices: as memory allows.

    None if it is not known what prices do where a part breaks off, unless they are wanted in any case.
    """
    while steps:
        try:
            kinds = kinds_with(steps, True)
        except LimitError:
            steps //= 2
            continue
        if wanted or all(kind.between is not None for kind in kinds):
            return kinds, steps
        break
    return kinds_with(0, around), 0


@dataclass(frozen=True)
class _Relaxed:
    """A team taken apart: people's problems at some prices, with their solutions."""

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
        """Whether each problem was solved as far as was asked for."""
        return all(solution.stopped == "gap" for _, solution in self.parts)

    def lattices(self) -> list[BeliefNodes]:
        """Give each person's; people of a kind share one."""
        # For a robot whose way takes time, what is around a part is of one whose way takes none.
        around = [kind.outer if not len(self.price) and not kind.visits.entry_steps else None for kind in self.kinds]
        lattices = [BeliefNodes(*part, outer) for part, outer in zip(self.parts, around, strict=True)]
        return [one for kind, one in zip(self.kinds, lattices, strict=True) for _ in range(kind.count)]


def _met(
    pool: Pool, team: tuple[int, ...], travel: Travel, kinds: list[SubproblemKind], price: Floats, steps: int, seed: int
) -> Meeting:
    """Simulate priority at these prices for so many steps.

    A robot with one person only hardly ever leaves them alone for long, so that the solver looks there last; in a team
    it does, and where bounds are poor a belief is divided among types that are told apart, which tells it too much.
    """
    policies = [pool.policies[model] for model in sorted(set(pool.model[list(team)].tolist()))]
    meeting = Meeting(Priority.of(policies, travel, price if len(price) else None), len(team), steps)
    episodes = math.ceil(MEETINGS / max(kind.count for kind in kinds))
    returns(pool, meeting, team, travel, episodes=episodes, seed=seed)
    return meeting


def _beliefs(kind: SubproblemKind, visits: AttentionSubproblem, met: Meeting) -> tuple[NDArray[np.int64], Floats]:
    """Give the states of a problem and the beliefs with which people of a kind are met, the latest first."""
    found = [one for place in kind.places for one in met.met[place] if len(one[1])]
    states = np.concatenate([visits.layout.number(step, here, x) for step, x, here, _ in found])
    steps = np.concatenate([np.full(len(x), step) for step, x, _, _ in found])
    beliefs = np.concatenate([belief for *_, belief in found])
    alike = np.column_stack([states, np.rint(beliefs.reshape(len(states), -1) / ALIKE)])
    first = np.unique(alike.astype(np.int32), axis=0, return_index=True)[1]
    first = first[(states[first] >= 0) & ~visits.pomdp.final[states[first]]]
    first = first[np.argsort(-steps[first], kind="stable")]
    return states[first], beliefs[first]


def _relax(
    kinds: list[SubproblemKind], price: Floats, gap: float, until: float, memory_limit_mb: float, workers: int,
    tell: Progress,
    met: Meeting | None = None,
) -> _Relaxed:  # fmt: skip
    """Bound people's problems at these prices, by some time on `time.perf_counter()`'s clock."""

    def one(number: int, kind: SubproblemKind) -> tuple[AttentionSubproblem, Solution]:
        visits = kind.at(price)
        best = kind.best(visits)
        still = math.ceil((len(kinds) - number) / workers)  # rounds of problems to come, with this one's
        share = (until - time.perf_counter()) / still
        return visits, solve(
            visits.pomdp, gap=gap, time_limit=None if until == math.inf else max(0.0, share),
            memory_limit_mb=memory_limit_mb, best=best,
            met=None if met is None else _beliefs(kind, visits, met),
        )  # fmt: skip

    parts: list[tuple[AttentionSubproblem, Solution]] = []
    tell("bounding people's problems", 0, len(kinds))
    with ThreadPoolExecutor(workers) as threads:
        for part in threads.map(one, range(len(kinds)), kinds):
            parts.append(part)
            tell("bounding people's problems", len(parts), len(kinds))
    return _Relaxed(kinds, parts, price)


def _members(pool: Pool, team: Sequence[int] | None) -> tuple[int, ...]:
    """Read who is at each place."""
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
    """Bound what any policy gets with a team, and compare some with it.

    Parameters
    ----------
    pool : Pool
    policies : mapping
        Each by the name that it gets in its certificate.
    episodes : int
        Of each policy.
    seed : int or Generator
    time_limit : float, optional
        Seconds for all of it: `FOR_BOUND` of them for the bound, and an equal share of what is left for each policy.
    progress : callable or bool, optional
        As in `upper_bound`.
    **options
        As in `upper_bound`.
    """
    assert callable(progress)
    start, luck = time.perf_counter(), entropy(seed)
    episodes = whole("episodes", episodes, 2)
    limit = None if time_limit is None else FOR_BOUND * positive("time_limit", time_limit)
    bound = upper_bound(pool, time_limit=limit, seed=luck, progress=progress, **options)
    found: list[Certificate] = []
    for name, policy in policies.items():
        progress("simulating policies", len(found), len(policies))
        left = None
        if time_limit is not None:
            left = max(0.0, start + time_limit - time.perf_counter()) / (len(policies) - len(found))
        found.append(bound.certify(policy, name, episodes=episodes, seed=luck, time_limit=left))
    return bound, found
