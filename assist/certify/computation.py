"""The computation of a bound on all team policies: prices and people's problems, within given limits.

`assist.certify.team_bound` states and proves the bound. A `Computation` holds a team and the limits of time and memory.
A `Relaxation` holds the solutions of the people's subproblems at some prices. What only truncated tasks and sample
paths need is in `truncated_prices` and `sample_paths`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from threading import Event
from typing import TypeAlias

import numpy as np

from planner.system.limits import processors
from planner.system.processes import on_threads
from planner.system.progress import Progress, adding

from ..people.arguments import fraction, positive, require_options, whole
from ..people.decision import Floats, Ints
from ..person.attention_subproblem import AttentionSubproblem
from ..person.memory_needed import MEMORY_LIMIT_MB, depth_within
from ..person.policy import Policy
from ..person.rounding import rounding
from ..person.search import SolverOptions
from ..person.solver import solve
from ..person.travel import Travel
from ..team.pool import Pool
from .action_prices import paid
from .options import BoundOptions, Effort
from .priced_steps import window_of
from .prices import PersonBound, SubproblemGroup, groups_of, search

Visited: TypeAlias = Callable[[tuple[int, ...], AttentionSubproblem], tuple[Ints, Floats]]
"""Returns states and beliefs that people at some places of a team visit in their subproblem."""


class InterruptedBound(KeyboardInterrupt):
    """Ctrl-C during the computation of a bound, after some people's problems have been bounded.

    Attributes
    ----------
    upper : float
        Upper bound on the value of every team policy, in cost units. It takes the robot's attention as free for people
        whose problems have not been bounded.
    bounded, people : int
        Number of people whose problems have been bounded, and of all people.
    """

    def __init__(self, upper: float, bounded: int, people: int, interrupt: KeyboardInterrupt) -> None:
        super().__init__(*interrupt.args)
        self.upper, self.bounded, self.people = upper, bounded, people


@dataclass(frozen=True)
class Relaxation:
    """The Lagrangian relaxation of a team: its subproblems at some prices, with their solutions."""

    groups: list[SubproblemGroup]
    parts: list[tuple[AttentionSubproblem, PersonBound]]
    price: Floats
    """Prices of attention, of a suggestion and of an execution at each step, shape (3, W)."""

    def _all(self, each: Callable[[PersonBound], float]) -> float:
        return sum(group.count * each(solution) for group, (_, solution) in zip(self.groups, self.parts, strict=True))

    @property
    def paid(self) -> float:
        """The discounted sum of the prices that all robots pay, in cost units."""
        return paid(self.price, self.groups[0].pool.setting)

    @property
    def upper(self) -> float:
        """The upper bound on the value of every team policy."""
        return summed(
            self.paid, [(group.count, one.upper) for group, (_, one) in zip(self.groups, self.parts, strict=True)]
        )

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


def summed(paid: float, bounds: Sequence[tuple[float, float]]) -> float:
    """Return what robots pay plus the bounds of groups of people, moved up by what rounding may take."""
    terms = [paid, *(count * upper for count, upper in bounds)]
    return sum(terms) + rounding(len(terms)) * sum(map(abs, terms))


@dataclass(frozen=True, kw_only=True)
class Computation:
    """The computation of a bound: its team, its limits, and its steps; other attributes as in `Effort`.

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

    @classmethod
    def of(
        cls, pool: Pool, team: tuple[int, ...], travel: Travel | None, seed: int, tell: Progress, effort: Effort
    ) -> Computation:
        """Return a computation that begins now.

        Raises
        ------
        ValueError, TypeError
            A number is out of its range, or there is no such option.
        """
        require_options(effort, Effort.__annotations__)
        seconds = effort.get("time_limit")
        travel = travel or pool.setting.travel(len(team))
        if len(travel) != len(team):
            raise ValueError(f"travel for {len(travel)}: expected {len(team)} people")
        return cls(
            pool, team, travel, gap=fraction("gap", effort.get("gap", 1e-3)), start=time.perf_counter(),
            limit=math.inf if seconds is None else positive("time_limit", seconds),
            memory_limit_mb=effort.get("memory_limit_mb", MEMORY_LIMIT_MB),
            paths=whole("paths", effort.get("paths", 0)), workers=whole("jobs", effort.get("jobs") or processors(), 1),
            seed=seed, options=effort.get("options") or BoundOptions(), tell=tell,
        )  # fmt: skip

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
        return not all(policy.problem.whole for policy in self.policies)

    def groups(self, steps: int, with_outer: bool) -> list[SubproblemGroup]:
        """Return the groups of people by their subproblem, with prices on some steps."""
        return groups_of(
            self.pool, self.team, self.travel, steps, with_outer=with_outer, memory_limit_mb=self.memory_limit_mb,
            until=self.start + 0.3 * self.for_people, tell=self.tell,
        )  # fmt: skip

    def prices(self, window: int | None) -> tuple[int, list[SubproblemGroup], Floats]:
        """Optimise the prices on whole tasks; return the number of steps with prices, the subproblems and the prices.

        `window` is the requested number of steps with prices, if any.
        """
        steps = window_of(self.pool, self.team, self.seed) if window is None else whole("window", window)
        groups = self.groups(steps, False)
        return steps, groups, self.optimised(groups, steps, 0.4)

    @property
    def prices_actions(self) -> bool:
        """Whether actions have prices: on whole tasks, without sample paths, where the costs of robots differ."""
        return not self.paths and not self.needs_outer and self.pool.setting.fleet.costs_differ

    def needs_prices(self, steps: int) -> bool:
        """Return whether prices of some steps can lower the bound; otherwise robots never have to choose."""
        return steps > 0 and (self.pool.setting.fleet.scarce_for(len(self.team)) or self.prices_actions)

    def optimised(self, groups: list[SubproblemGroup], steps: int, share: float) -> Floats:
        """Return prices that are optimised until a share of the time for people's problems has passed."""
        if not self.needs_prices(steps):
            return np.zeros((3, 0))
        return search(
            groups, steps, self.options, seed=self.seed, deadline=self.start + share * self.for_people, tell=self.tell,
            extra=self.pool.setting.fleet.extra, on_actions=self.prices_actions,
        )  # fmt: skip

    def relaxed(
        self, groups: list[SubproblemGroup], price: Floats, until: float, visited: Visited | None
    ) -> Relaxation:
        """Return the relaxation at these prices, with bounds computed by a time on the clock.

        Raises
        ------
        InterruptedBound
            Ctrl-C, after some of the bounds.
        """
        parts: dict[int, tuple[AttentionSubproblem, PersonBound]] = {}
        over, advance = Event(), adding(self.tell, "bounding people's problems", len(groups))

        def go_on(*_: float) -> None:
            if over.is_set():
                raise KeyboardInterrupt

        def one(number: int) -> None:
            group = groups[number]
            visits = group.at(price)
            still = math.ceil((len(groups) - number) / self.workers)  # rounds that remain, including this one
            ends = time.perf_counter() + (until - time.perf_counter()) / still
            best, memory = group.best(visits, ends), self.memory_limit_mb
            options = None if visited is None else SolverOptions(
                depth=depth_within(visits.pomdp, memory), further_beliefs=visited(group.places, visits)
            )  # fmt: skip
            share = (until - time.perf_counter()) / still
            parts[number] = visits, group.bound(best, lambda best: solve(
                visits.pomdp, gap=self.gap, time_limit=None if until == math.inf else max(0.0, share),
                memory_limit_mb=memory, best=best, options=options, bounds=go_on,
            ))  # fmt: skip
            advance(1)

        try:
            on_threads(one, range(len(groups)), self.workers, over)
        except KeyboardInterrupt as error:
            if not parts:
                raise
            upper = summed(paid(price, self.pool.setting), [
                (group.count, parts[number][1].upper if number in parts else group.with_free_attention())
                for number, group in enumerate(groups)
            ])  # fmt: skip
            unknown = {place for number, group in enumerate(groups) if number not in parts for place in group.places}
            raise InterruptedBound(upper, len(self.team) - len(unknown), len(self.team), error) from error
        return Relaxation(groups, [parts[number] for number in range(len(groups))], price)
