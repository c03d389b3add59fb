"""The computation of a bound on all team policies: prices, people's problems and sample paths, within given limits.

`assist.certify.team_bound` states and proves the bound. A `Computation` holds a team and the limits of time and memory.
A `Relaxation` holds the solutions of the people's subproblems at some prices.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner import LimitError
from planner.system.progress import Progress

from ..people.arguments import whole
from ..people.decision import Floats
from ..person.policy import Policy
from ..person.solver import Solution, solve
from ..simulation.pool import Pool
from ..team.attention_subproblem import AttentionSubproblem
from ..team.priority import Priority
from ..team.travel import Travel
from .certificate import BeliefRecorder, returns
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
class Relaxation:
    """The Lagrangian relaxation of a team: its subproblems at some prices, with their solutions."""

    kinds: list[SubproblemKind]
    parts: list[tuple[AttentionSubproblem, Solution]]
    price: Floats

    def _all(self, each: Callable[[Solution], float]) -> float:
        return sum(kind.count * each(solution) for kind, (_, solution) in zip(self.kinds, self.parts, strict=True))

    @property
    def paid(self) -> float:
        """The discounted sum of the prices that all robots pay, in cost units."""
        gamma = self.kinds[0].pool.setting.gamma
        return self.kinds[0].pool.setting.robots * float(self.price @ gamma ** np.arange(len(self.price)))

    @property
    def upper(self) -> float:
        """The upper bound on the value of every team policy."""
        return self.paid + self._all(lambda solution: solution.upper)

    @property
    def upper_seen(self) -> float:
        """The same bound with observed beta and theta."""
        return self.paid + self._all(lambda solution: solution.value_qmdp)

    @property
    def slack(self) -> float:
        """The sum of the gaps between the solver's bounds."""
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


@dataclass(frozen=True, kw_only=True)
class Computation:
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
        """Seconds for solving the problems of single people. With sample paths, half of the limit is left for them."""
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
        if len(self.team) <= self.pool.setting.robots or not steps:  # robots never have to choose
            return together, kinds, np.zeros(0)
        # On truncated tasks the outer relaxations have had 30 % of the time, and the solver needs more of the rest.
        for_prices = 0.3 + 0.25 if self.needs_outer else 0.4
        price = search(
            kinds, steps, rounds=self.options.price_rounds, episodes=self.options.price_episodes, seed=self.seed,
            deadline=self.start + for_prices * self.for_people, tell=self.tell, robots=self.pool.setting.robots,
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
    ) -> Relaxation:
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
        return Relaxation(kinds, parts, price)

    def without_prices(self, relaxed: Relaxation, recorder: BeliefRecorder | None) -> Relaxation:
        """Return the relaxation without prices if its bound is lower, as it may be if the time was short.

        Without prices, states need no step, so that the subproblems are much smaller.
        """
        if relaxed.done or not len(relaxed.price):
            return relaxed
        kinds, begun = self.kinds(0, self.paths > 0), time.perf_counter()
        until = begun + 0.3 * (self.start + self.limit - begun)
        free = self.relaxed(kinds, relaxed.price[:0], until, recorder)
        return min(relaxed, free, key=lambda one: one.upper)

    def sampled(self, relaxed: Relaxation, together: int) -> SampledBound | None:
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
