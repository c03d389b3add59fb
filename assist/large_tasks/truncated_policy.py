"""One person's policy on a task of any size.

A policy cannot keep values for the states of a task with millions of states, or of a task whose states are solved on
demand. A `TruncatedPolicy` is solved on the states that are most likely to be visited (a `TruncatedTask`). In any state
of the task it does one exact Bellman backup, with the person's misconceptions there. The values of the successors are
those of the truncated task, or estimates by the exact cost-to-go outside it (`large_tasks.leaf_estimates`). So it
suggests optimal actions where the person would err, in the whole task, and it keeps no data of other states.

The next step of people in some states is a problem of its own (`LocalProblem`), whose frontier follows after one step.
Its arrays have a row for each of these states and their successors. Team policies receive the people's states in this
problem.

If people pursue one of several goals, values are computed for one goal after another, each on a truncated task of its
own: QMDP counts the goal as known from the next step on. So the memory for the computation is that of one goal, and a
policy keeps the values of each. The local problem is that of all goals.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo
from planner.system.progress import reporting

from ..people.belief import Grid
from ..people.decision import NOTHING, Floats
from ..people.goals import Goals, each_of, first_of
from ..people.human import Human, Population
from ..people.trust_rules import counts_of
from ..person.policy import Policy
from ..person.policy_iteration import SOLVING
from ..person.pomdp import AssistPOMDP
from ..person.qmdp import QMDP, look_ahead
from ..person.visiting_robot import VisitingRobot
from ..team.attention_subproblem import AttentionSubproblem
from ..team.priority import SolvedSubproblem
from ..team.settings import Setting
from .leaf_estimates import LeafEstimates
from .state_cache import NONE, StateCache
from .truncated_bound import TruncatedProblem, bounded
from .truncated_task import TruncatedTask

REGION = {"sweep": 20_000, "orbits": 3_000, "on-demand": 200}
"""Number of states of a policy's truncated task, by the kind of cost-to-go.

A table answers at once; a query by symmetry takes longer, and a search may take seconds.
"""


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
    prior : Population
        The robot's prior of people.
    size : int, optional
        Number of states of each person's truncated task, for each goal; by default `default_size`.
    """

    def __init__(self, known: CostToGo | Goals, prior: Population, size: int | None = None) -> None:
        self.known, self.prior, self.size = known, prior, size or default_size(known)
        self.visited = StateCache(known)


@dataclass(frozen=True, eq=False)
class TruncatedPolicy(Policy):
    """One person's policy on a task of any size; states have the numbers of the task's cost-to-go.

    Attributes
    ----------
    ground : SharedTask
    setting : Setting
    human : Human or None
        The person, if the robot knows their misconceptions; None if it knows the task only.
    like : TruncatedPolicy or None
        Policy of another person, whose values are the start of value iteration; this saves time for many people.
    solved : dict
        Cached estimates for each goal, by the parameters of the subproblem with a price of attention; the key is ()
        without one.
    bounds : dict
        Cached problems for bounds, by the cost of coming and by whether the outer relaxation is included.
    """

    ground: SharedTask
    setting: Setting
    human: Human | None = None
    like: TruncatedPolicy | None = None
    solved: dict[tuple[float, ...], tuple[LeafEstimates, ...]] = field(default_factory=dict, repr=False)
    bounds: dict[tuple[float, bool], list[tuple[float, TruncatedProblem]]] = field(default_factory=dict, repr=False)

    @classmethod
    def of_people(cls, ground: SharedTask, people: Sequence[Human], setting: Setting) -> list[Policy]:
        """Return a policy for each model of people: for each person, or one if the robot knows the task only."""
        of_task = cls(ground, setting)
        if setting.knowledge == "exact":
            return [of_task]
        return [cls(ground, setting, human, of_task) for human in people]

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

    def require_enumerated(self, what: str) -> None:
        """Raise a `ValueError`, since values of all states are not kept."""
        raise ValueError(
            f"{what}: expected an enumerated task, and this one is too large: it has {len(self.task):,} states or more"
        )

    @cached_property
    def pomdp(self) -> AssistPOMDP:
        """The local problem of the initial state, which is its state 0."""
        return self.local(np.array([self.task.initial]), deep=False).pomdp

    @cached_property
    def regions(self) -> tuple[TruncatedTask, ...]:
        """The truncated task of the states that the person is most likely to visit, for each goal."""
        ground = self.ground
        options: dict[str, Any] = {"states": ground.size, "population": ground.prior, "human": self.human}
        among = ground.known if isinstance(ground.known, Goals) else None
        return tuple(TruncatedTask.of(known, among=among, **options) for known in each_of(ground.known))

    def problem(self, region: TruncatedTask) -> AssistPOMDP:
        """Return the problem on a truncated task, with frontier bounds that hold for the whole task."""
        beyond = region.bounds_of_anybody(self.setting.gamma, len(self.grid.theta))
        return self.setting.problem(region.choices, self.human, self.ground.prior, frontier=beyond)

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
        among = ground.known if isinstance(ground.known, Goals) else None
        shares = list(among.prior.values()) if among else [1.0]
        possible = [number for number, share in enumerate(shares) if share > 0]
        for done, number in enumerate(possible):
            left = len(possible) - done
            found.append((
                shares[number],
                bounded(
                    self.task_of(number), self.setting, self.human, ground.prior, entry=entry, size=ground.size,
                    with_outer=with_outer, until=time.perf_counter() + (until - time.perf_counter()) / left,
                    kept_mb=kept_mb / len(possible), among=among, **more,
                ),
            ))  # fmt: skip
        self.bounds[entry, with_outer] = found
        return found

    @cached_property
    def grid(self) -> Grid:
        """The grid of beta and theta of the robot's belief."""
        return Grid.regular(self.ground.prior).with_counts(counts_of(self.setting.believed_rule()))

    def local(self, states: NDArray[np.int64], *, deep: bool = True, then: NDArray[np.int64] = NONE) -> LocalProblem:
        """Return the problem of the next step of people in some states, with its policy.

        Parameters
        ----------
        states : int array, shape (N,)
            States of the task. Each has a row of its own, in this order; `LocalProblem.rows` needs ascending states.
        deep : bool
            As in `Policy.local`.
        then : int array, shape (M,)
            Successors to which suggestions lead, unless `deep`.
        """
        optimal = self.setting.considered_suggestions == "optimal"
        region = self.ground.visited.around(states, then=then, ahead=deep, advice_is_optimal=optimal)
        return LocalProblem(self, self.problem(region), region, len(states), deep)

    def prepare(self) -> tuple[LeafEstimates, ...]:
        """Return each goal's value estimates for a robot that is always present, computed by the first call."""
        if () not in self.solved:
            with reporting(None) as tell:
                tell(SOLVING, 0, None)
                like = [None] * len(self.regions) if self.like is None else self.like.prepare()
                self.solved[()] = tuple(
                    LeafEstimates.of(self.problem(region), region, like=start, progress=tell)
                    for region, start in zip(self.regions, like, strict=True)
                )
        return self.solved[()]

    def with_robot(self, robot: VisitingRobot) -> tuple[LeafEstimates, ...]:
        """Return each goal's value estimates for a robot that comes and goes, for each position; solved once."""
        if (key := _key(robot)) not in self.solved:
            each = self.prepare() if self.like is None else self.like.with_robot(robot)
            found = []
            for region, like in zip(self.regions, each, strict=True):
                visits = _visits(self.problem(region), robot)
                rows = np.stack([visits.states(0, position) for position in range(visits.layout.positions)])
                found.append(LeafEstimates.of(visits.at_price(key[-1]), region, rows, like=like))
            self.solved[key] = tuple(found)
        return self.solved[key]

    def q_values(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the Q-values of all robot actions, shape (N, R); minus infinity in padding."""
        return self.local(x).q_values(np.arange(len(x)), belief)


@dataclass(frozen=True, eq=False)
class LocalProblem(Policy):
    """The problem of the next step of people in some states, with its policy.

    Attributes
    ----------
    source : TruncatedPolicy
        The policy of the whole task.
    pomdp : AssistPOMDP
        Its first `count` states are the states of people. The other rows exist only as successors.
    region : TruncatedTask
        The states and choices of the problem.
    count : int
    deep : bool
        Whether the effect on trust is known for every suggestion in these states.
    solved : dict
        Cached problems with a robot that comes and goes, by its costs and its number of steps.
    """

    source: TruncatedPolicy
    pomdp: AssistPOMDP
    region: TruncatedTask
    count: int
    deep: bool
    solved: dict[tuple[float, ...], SolvedSubproblem] = field(default_factory=dict, repr=False)

    @property
    def states(self) -> NDArray[np.int64]:
        """The task state of each row of the problem, shape (n,)."""
        return self.region.states

    @cached_property
    def _policy(self) -> QMDP:
        return self._look_ahead(self.pomdp, self._values(self.source.prepare())[:, 0], np.arange(self.count))

    def _values(self, each: tuple[LeafEstimates, ...]) -> Floats:
        """Return estimates of the value of all states, shape (n, P, H, T), from those of each goal."""
        h = self.region.choices.goals.h
        return np.concatenate([one.at(self.states, own) for one, own in zip(each, h, strict=True)], axis=2)

    def with_robot(self, robot: VisitingRobot) -> SolvedSubproblem:
        """Return the solved problem of a robot that comes and goes, computed by the first call for this robot."""
        if (key := _key(robot)) not in self.solved:
            visits = _visits(self.pomdp, robot)
            layout = visits.layout
            value = self._values(self.source.with_robot(robot))[layout.x, layout.position]
            here = np.flatnonzero(layout.x < self.count)
            policy = self._look_ahead(visits.at_price(key[-1]), value, here)
            self.solved[key] = SolvedSubproblem.of(visits, policy)
        return self.solved[key]

    def _look_ahead(self, pomdp: AssistPOMDP, value: Floats, states: NDArray[np.int64]) -> QMDP:
        value[pomdp.model.choices.goals.goal[pomdp.hidden.goal_of].T] = 0.0
        return look_ahead(pomdp, value, states)

    def rows(self, states: NDArray[np.int64], *, deep: bool = True) -> NDArray[np.int64] | None:
        """Return the row of each state, shape (N,); None if the problem does not cover all of them."""
        own = self.states[: self.count]
        row = np.minimum(np.searchsorted(own, states), self.count - 1)
        return row if (self.deep or not deep) and (own[row] == states).all() else None

    def after_suggestions(self, x: NDArray[np.int64], robot: NDArray[np.int64]) -> LocalProblem:
        """Return the problem with the effects on trust of robot actions in some rows, both of shape (N,)."""
        if self.deep:
            return self
        slot = self.pomdp.suggested[x, robot]
        then = self.states[self.pomdp.model.choices.targets[x, slot][slot != NOTHING]]
        return self.source.local(self.states[: self.count], deep=False, then=then)

    def q_values(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the Q-values of all robot actions, shape (N, R), for people in rows `x`."""
        return self._policy.q_values(x, belief)


def _key(robot: VisitingRobot) -> tuple[float, ...]:
    """Return the parameters of the problem with a robot that comes and goes; the last is its only price."""
    return robot.entry, robot.entry_steps, robot.longest, float(robot.price[0])


def _visits(pomdp: AssistPOMDP, robot: VisitingRobot) -> AttentionSubproblem:
    return AttentionSubproblem.of(pomdp, robot.entry, robot.entry_steps, longest=robot.longest)
