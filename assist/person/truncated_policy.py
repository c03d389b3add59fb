"""One person's policy on a task of any size.

A policy cannot keep values for the states of a task with millions of states, or of a task whose states are solved on
demand. A `TruncatedPolicy` is solved on the states that are most likely to be visited (a `TruncatedTask`). In any state
of the task it does one exact Bellman backup, with the person's misconceptions there. The values of the successors are
those of the truncated task, or estimates by the exact cost-to-go outside it (`person.leaf_estimates`). So it
suggests optimal actions where the person would err, in the whole task, and it keeps no values of states in which
nobody has been (`person.growing_problem`).

If people pursue one of several goals, values are computed for one goal after another, each on a truncated task of its
own: QMDP counts the goal as known from the next step on. So the memory for the computation is that of one goal, and a
policy keeps the values of each. The Q-values are those of all goals together.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo, Table
from planner.system.limits import available_memory
from planner.system.progress import reporting

from ..people.belief import Grid
from ..people.decision import Floats
from ..people.goals import Goals, each_of, first_of, goals_reached, optimal_for_each, prior_of
from ..people.hidden_type import HiddenType, OfGoals
from ..people.memory_on_demand import Remembering
from .assumptions import Assumptions
from .attention_subproblem import AttentionSubproblem
from .closed_problem import closed_problem
from .growing_problem import Backup, GrowingProblem
from .leaf_estimates import LeafEstimates
from .memory_needed import require_room
from .policy import Extent, OfRows, Policy
from .policy_iteration import SOLVING
from .pomdp import AssistPOMDP
from .qmdp import look_ahead
from .state_cache import StateCache
from .truncated_bound import TruncatedProblem, bounded
from .truncated_task import TruncatedTask
from .visiting_robot import VisitingRobot

REGION = {"sweep": 20_000, "orbits": 3_000, "on-demand": 200}
"""Number of states of a policy's truncated task, by the kind of cost-to-go.

A table answers at once; a query by symmetry takes longer, and a search may take seconds.
"""

NEVER = (-1.0,)
"""The key of estimates for a robot that never helps."""

MOST_STATES = 1 << 62
"""Number of states that an extent has at most, so that it fits the integers of an environment's space."""

SCANNED = 1 << 16
"""Number of states of a table that are looked at together."""

ROWS = 20_000
"""Number of rows, of some kilobytes each, that all policies for the people of a task keep together."""

Ints = NDArray[np.int64]


def lookup_kind(known: CostToGo) -> str:
    """Return how cost-to-go is computed: "sweep" (a table), "orbits" (by symmetry) or "on-demand" (a search)."""
    return "orbits" if known.method == "on-demand" and not known.searches else known.method


def default_size(known: CostToGo | Goals, *, least: int = 1_000) -> int:
    """Return the number of states of a truncated task for each goal: a share of `REGION`, but at least `least`."""
    one = REGION[lookup_kind(first_of(known))]
    return max(one // len(each_of(known)), min(one, least))


class SharedTask:
    """The task of a pool of people, and the cache of its visited states.

    Parameters
    ----------
    known : CostToGo or Goals
    size : int, optional
        Number of states of each person's truncated task, for each goal; by default `default_size`.
    policies : int
        Number of policies that keep rows in memory at the same time.
    """

    def __init__(self, known: CostToGo | Goals, size: int | None = None, policies: int = 1) -> None:
        self.known, self.size = known, size or default_size(known)
        self.rows = ROWS // policies
        self.visited = StateCache(known)


@dataclass(frozen=True, eq=False)
class SolvedRegion:
    """A policy in the states of a truncated task.

    Attributes
    ----------
    states : int array, shape (m,)
        These states in ascending order, without the frontier.
    row : int array, shape (m,)
        The row of each in the problem of the policy.
    policy : Policy
    """

    states: Ints
    row: Ints
    policy: Policy

    @classmethod
    def of(cls, region: TruncatedTask, policy: Policy) -> SolvedRegion:
        """Return the states of a truncated task with the policy for its problem."""
        return cls(region.states[region.inside], region.inside, policy)

    def find(self, states: Ints) -> Ints:
        """Return the row of each state, shape (N,); -1 for others."""
        at = np.minimum(np.searchsorted(self.states, states), len(self.states) - 1)
        return np.where(self.states[at] == states, self.row[at], -1)


@dataclass(frozen=True, eq=False)
class TruncatedPolicy(Policy):
    """One person's policy on a task of any size; states have the numbers of the task's cost-to-go.

    Attributes
    ----------
    ground : SharedTask
    assumed : Assumptions
        What the robot assumes of the person.
    like : TruncatedPolicy or None
        Policy of another person, whose values are the start of value iteration; this saves time for many people.
    solver : callable or None
        Solves the problem on the truncated task, if not by QMDP; its policy acts there.
    solved : dict
        Cached estimates for each goal, by the parameters of the subproblem with a price of attention. The key is () for
        a robot that is always present, and `NEVER` for one that does not help.
    bounds : dict
        Cached problems for bounds, by the cost of coming and by whether the outer relaxation is included.
    found : dict
        Cached truncated tasks, by the id of the goal's cost-to-go or of all `Goals`.
    """

    ground: SharedTask
    assumed: Assumptions
    like: TruncatedPolicy | None = None
    solver: Callable[[AssistPOMDP], Policy] | None = None
    solved: dict[tuple[float, ...], tuple[LeafEstimates, ...]] = field(default_factory=dict, repr=False)
    bounds: dict[tuple[float, bool], list[tuple[float, TruncatedProblem]]] = field(default_factory=dict, repr=False)
    found: dict[int, TruncatedTask] = field(default_factory=dict, repr=False)

    @property
    def task(self) -> CostToGo:
        """The cost-to-go of the whole task, that of the first goal if there are several."""
        return first_of(self.ground.known)

    def task_of(self, goal: int) -> CostToGo:
        """Return the cost-to-go of the whole task for one of the goals."""
        return each_of(self.ground.known)[goal]

    @property
    def size(self) -> float:
        """Infinity: values of other states than those of the truncated task are not kept."""
        return math.inf

    @cached_property
    def extent(self) -> Extent:
        """The largest numbers that occur anywhere in the task, from all states of a table or from the task's facts."""
        known = self.task.known if isinstance(self.task, Remembering) else self.ground.known
        tables = each_of(known)
        if not all(isinstance(one, Table) for one in tables):
            task = self.task.task  # no state has more values than the variables
            return Extent(min(math.prod(task.sizes), MOST_STATES), self._robot_actions(task.most_at_once), math.inf)
        states, most, farthest = len(tables[0]), 0, 0.0
        for begin in range(0, states, SCANNED):
            block = np.arange(begin, min(begin + SCANNED, states))
            rows = tables[0].choices(block)
            source = np.repeat(np.arange(len(block)), np.diff(rows.offsets))
            goes_on = ~goals_reached(known, block)[source]
            if self.assumed.suggestions == "optimal":
                goes_on &= optimal_for_each(known, block, rows)
            most = max(most, int(np.bincount(source[goes_on.any(axis=1)]).max(initial=0)))
            h = np.concatenate([one.lookup(block) for one in tables])
            farthest = max(farthest, float(h[np.isfinite(h)].max(initial=0.0)))
        return Extent(states, self._robot_actions(most), farthest)

    def _robot_actions(self, suggestions: int) -> int:
        return 1 + suggestions * (1 + self.assumed.robot.execute)

    @property
    def searches(self) -> bool:
        """Whether a state that was not visited before takes a slow search."""
        return self.task.searches

    @property
    def cheapest(self) -> float:
        """The smallest positive cost of an action, in cost units; 1 if all actions are free."""
        costs = self.task.task.action_costs
        return float(costs[costs > 0].min()) if (costs > 0).any() else 1.0

    @property
    def dearest(self) -> float:
        """The largest cost of an action or a wait, in cost units."""
        return float(self.task.task.action_costs.max(initial=1.0))

    def require_enumerated(self, what: str, why: str) -> None:
        """Raise a `ValueError`, since not all states are enumerated."""
        size = f"{len(self.task):,} states or more"
        raise ValueError(f"{what}: expected an enumerated task, as {why}; this one is too large, with {size}")

    @cached_property
    def problem(self) -> GrowingProblem:
        """The problem on the rows in which people have been; the initial state has row 0."""
        ground, optimal = self.ground, self.assumed.suggestions == "optimal"
        around = partial(ground.visited.around, advice_is_optimal=optimal)
        return GrowingProblem(around, self.on, self.task.initial, most=ground.rows, ahead=not self.searches)

    @property
    def pomdp(self) -> AssistPOMDP:
        """The problem on all rows so far."""
        return self.problem.now.pomdp

    def states(self, places: Ints) -> Ints:
        """Return the task state of each place, shape (N,)."""
        return self.task.state_of(places) if isinstance(self.task, Remembering) else places

    @cached_property
    def regions(self) -> tuple[TruncatedTask, ...]:
        """The truncated task of the states that the person is most likely to visit, for each goal."""
        return tuple(map(self._region, each_of(self.ground.known)))

    def _region(self, known: CostToGo | Goals) -> TruncatedTask:
        """Return the truncated task of one goal, or of all; it is collected once, also if these are the same."""
        if id(known) not in self.found:
            assumed, ground = self.assumed, self.ground
            self.found[id(known)] = TruncatedTask.of(
                known, states=ground.size, population=assumed.population, human=assumed.human, among=ground.known
            )
        return self.found[id(known)]

    def on(self, region: TruncatedTask) -> AssistPOMDP:
        """Return the problem on a truncated task, with frontier bounds that hold for the whole task."""
        beyond = region.bounds_of_anybody(self.assumed)
        return self.assumed.problem(region.choices, beyond)

    def bounded(
        self, entry: float, *, with_outer: bool = False, until: float = math.inf, kept_mb: float = math.inf, **more: Any
    ) -> list[tuple[float, TruncatedProblem]]:
        """Return each goal's probability and its problem for an upper bound, computed once.

        The arguments are those of `truncated_bound.bounded`, for all goals together.
        """
        for key in (entry, True), (entry, with_outer):  # with the outer relaxation it includes everything
            if key in self.bounds:
                return self.bounds[key]
        ground, found = self.ground, list[tuple[float, TruncatedProblem]]()
        shares = list(prior_of(ground.known).values())
        possible = [number for number, share in enumerate(shares) if share > 0]
        for done, number in enumerate(possible):
            left = len(possible) - done
            found.append((
                shares[number],
                bounded(
                    self.task_of(number), self.assumed, entry=entry, size=ground.size, with_outer=with_outer,
                    until=time.perf_counter() + (until - time.perf_counter()) / left,
                    kept_mb=kept_mb / len(possible), among=ground.known, **more,
                ),
            ))  # fmt: skip
        self.bounds[entry, with_outer] = found
        return found

    @cached_property
    def grid(self) -> Grid:
        """The grid of beta and theta of the robot's belief."""
        return self.assumed.grid

    def prepare(self) -> tuple[LeafEstimates, ...]:
        """Return each goal's value estimates for a robot that is always present, computed by the first call."""
        if self.solver is not None:
            self._own  # noqa: B018  # solved now
        if () not in self.solved:
            with reporting(None) as tell:
                tell(SOLVING, 0, None)
                like = [None] * len(self.regions) if self.like is None else self.like.prepare()
                self.solved[()] = tuple(
                    LeafEstimates.of(self.on(region), region, like=start, progress=tell)
                    for region, start in zip(self.regions, like, strict=True)
                )
        return self.solved[()]

    def with_robot(self, robot: VisitingRobot) -> VisitedRows:
        """Return the values of a robot that comes and goes; their estimates are computed by the first call."""
        self._visited(robot)
        return VisitedRows(self, robot)

    def _visited(self, robot: VisitingRobot, step: int = 0) -> tuple[LeafEstimates, ...]:
        """Return each goal's value estimates for a robot that comes and goes, from a step on, for each position.

        They are solved once: first for the last price, which applies to all later steps, then one step before another.
        """
        last = len(robot.price) - 1
        for now in range(last, min(step, last) - 1, -1):
            if (key := _key(robot, now)) in self.solved:
                continue
            found = []
            for goal, region in enumerate(self.regions):
                visits = _visits(self.on(region), robot)
                rows = np.stack([visits.states(0, position) for position in range(visits.layout.positions)])
                problem = visits.at_price(float(robot.price[now]))
                if now < last:
                    after = self.solved[_key(robot, now + 1)][goal]
                    _require_room(after, last)
                    found.append(after.a_step_before(problem, region, rows))
                else:
                    each = self.prepare() if self.like is None else self.like._visited(robot, last)
                    found.append(LeafEstimates.of(problem, region, rows, like=each[goal]))
            self.solved[key] = tuple(found)
        return self.solved[_key(robot, min(step, last))]

    @property
    def helped(self) -> OfRows:
        """Estimates of the values of a robot that helps a person whose type and theta it knows."""
        return partial(self._in_rows, self.prepare())

    @property
    def unhelped(self) -> OfRows:
        """Estimates of the values of a robot that never helps; they are computed by the first call."""
        if NEVER not in self.solved:
            problems = [self.on(region).unattended() for region in self.regions]
            self.solved[NEVER] = tuple(
                LeafEstimates.of(replace(problem, robot_actions=np.ones_like(problem.robot_actions)), region)
                for problem, region in zip(problems, self.regions, strict=True)
            )
        return partial(self._in_rows, self.solved[NEVER])

    def _in_rows(self, each: tuple[LeafEstimates, ...], x: Ints) -> Floats:
        pomdp = self.pomdp
        return _values(each, self.places(x), pomdp.model.choices.goals.of_rows(x), pomdp.hidden)[:, 0]

    def q_values(self, x: Ints, belief: Floats) -> Floats:
        """Return the Q-values of all robot actions, shape (N, R); minus infinity in padding."""
        if self.solver is None:
            return self.problem.q_values("", self._backup, 0, x, belief)
        at, q = self._own.find(self.places(x)), np.full((len(x), self.pomdp.suggested.shape[1]), -np.inf)
        inside, outside = np.flatnonzero(at >= 0), np.flatnonzero(at < 0)
        if len(inside):
            found = self._own.policy.q_values(at[inside], belief[inside])
            q[inside, : found.shape[1]] = found[:, : q.shape[1]]
        if len(outside):
            found = self.problem.q_values("", self._backup, 0, x[outside], belief[outside])
            q[outside, : found.shape[1]] = found
        return q

    @cached_property
    def _own(self) -> SolvedRegion:
        """The policy of the solver on a truncated task, with all goals."""
        assert self.solver is not None
        region = self._region(self.ground.known)
        return SolvedRegion.of(region, self.solver(closed_problem(region, self.assumed)))

    def _backup(self, pomdp: AssistPOMDP, region: TruncatedTask, count: int) -> tuple[Floats, Ints]:
        """Return Q-values in the first rows of a problem of one step, and their numbers, as `Backup` does."""
        value = _values(self.prepare(), region.states, region.choices.goals, pomdp.hidden)[:, 0]
        return _look_ahead(pomdp, value, np.arange(count)[:, None])


@dataclass(frozen=True, eq=False)
class VisitedRows:
    """The Q-values of a robot that comes to a person and goes away, in the rows of their problem."""

    policy: TruncatedPolicy
    robot: VisitingRobot

    def q_values(self, step: int, position: int, x: Ints, belief: Floats) -> Floats:
        """Return the Q-values of the robot's moves, shape (N, R + 1); arguments as in `SolvedSubproblem.q_values`."""
        return self.policy.problem.q_values(*self._table(step), position, x, belief)

    def advantage(self, before: Ints, now: Ints, x: Ints, move: Ints, h: Ints, t: Ints) -> Floats:
        """Return Q-values minus values, shape (N,); arguments as in `SolvedSubproblem.advantage`."""
        table, _ = self.policy.problem.values(*self._table(0), x)
        return np.asarray(table[x, now, move, h, t] - table[x, before, :, h, t].max(axis=1))

    def _table(self, step: int) -> tuple[str, Backup]:
        """Return the name of the Q-values at a step, and how they are computed."""
        return " ".join(map(repr, _key(self.robot, step))), partial(self._backup, step)

    def _backup(self, step: int, pomdp: AssistPOMDP, region: TruncatedTask, count: int) -> tuple[Floats, Ints]:
        visits = _visits(pomdp, self.robot)
        layout = visits.layout
        each = _values(self.policy._visited(self.robot, step + 1), region.states, region.choices.goals, pomdp.hidden)
        value = each[layout.x, layout.position]
        here = layout.number(0, np.arange(layout.positions), np.arange(count)[:, None])
        return _look_ahead(visits.at_price(float(self.robot.price[step])), value, here)


def _values(each: tuple[LeafEstimates, ...], states: Ints, goals: OfGoals, hidden: HiddenType) -> Floats:
    """Return estimates of the value of states, shape (N, P, H, T), from those of each goal."""
    found = np.concatenate([one.at(states, own) for one, own in zip(each, goals.h, strict=True)], axis=2)
    return np.where(goals.goal[hidden.goal_of].T[:, None, :, None], 0.0, found)


def _look_ahead(pomdp: AssistPOMDP, value: Floats, states: Ints) -> tuple[Floats, Ints]:
    """Return the Q-values in some states by one Bellman backup, shape (..., R, H, T), and the numbers of actions."""
    found = look_ahead(pomdp, np.ascontiguousarray(value), np.sort(states, axis=None))
    return found.q_mdp[states], pomdp.robot_actions[states]


def _key(robot: VisitingRobot, step: int) -> tuple[float, ...]:
    """Return the parameters of the problem with a robot that comes and goes; the prices from a step on are last."""
    return robot.entry, robot.entry_steps, robot.longest, *robot.price[step:].tolist()


def _require_room(values: LeafEstimates, steps: int) -> None:
    """Raise a `LimitError` if values for each step exceed the available memory."""
    if (needed := steps * values.value.nbytes) > 100e6:  # below this, the available memory is not queried
        expected = "prices on fewer steps, or fewer states (region)"
        require_room(f"values at {steps:,} prices take", needed, available_memory() / 1e6, expected)


def _visits(pomdp: AssistPOMDP, robot: VisitingRobot) -> AttentionSubproblem:
    return AttentionSubproblem.of(pomdp, robot.entry, robot.entry_steps, longest=robot.longest)
