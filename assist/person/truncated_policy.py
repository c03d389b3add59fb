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

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from planner import CostToGo
from planner.system.limits import available_memory
from planner.system.progress import reporting

from ..people.decision import Floats, Ints
from ..people.goals import Goals, each_of
from ..people.hidden_type import HiddenType, OfGoals
from .assumptions import Assumptions
from .attention_subproblem import AttentionSubproblem
from .closed_problem import closed_problem
from .growing_problem import Backup, GrowingProblem
from .leaf_estimates import LeafEstimates
from .memory_needed import require_room
from .policy import OfRows, Policy
from .policy_iteration import SOLVING
from .pomdp import AssistPOMDP
from .qmdp import look_ahead
from .shared_task import SharedTask
from .truncated_task import TruncatedTask
from .visiting_robot import VisitingRobot

NEVER = (-1.0,)
"""The key of estimates for a robot that never helps."""


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
    found : dict
        Cached truncated tasks, by the id of the goal's cost-to-go or of all `Goals`.
    """

    ground: SharedTask
    assumed: Assumptions
    like: TruncatedPolicy | None = None
    solver: Callable[[AssistPOMDP], Policy] | None = None
    solved: dict[tuple[float, ...], tuple[LeafEstimates, ...]] = field(default_factory=dict, repr=False)
    found: dict[int, TruncatedTask] = field(default_factory=dict, repr=False)

    @cached_property
    def problem(self) -> GrowingProblem:
        """The problem on the rows in which people have been."""
        return GrowingProblem(self.ground, self.assumed)

    @property
    def pomdp(self) -> AssistPOMDP:
        """The problem on all rows so far."""
        return self.problem.now.pomdp

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

    def prepare(self) -> tuple[LeafEstimates, ...]:
        """Return each goal's value estimates for a robot that is always present, computed by the first call."""
        if self.solver is not None:
            self._own  # noqa: B018  # solved now
        if () not in self.solved:
            with reporting(None) as tell:
                tell(SOLVING, 0, None)
                like = [None] * len(self.regions) if self.like is None else self.like.prepare()
                self.solved[()] = tuple(
                    LeafEstimates.of(self.problem.on(region), region, like=start, progress=tell)
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
                visits = _visits(self.problem.on(region), robot)
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
            problems = [self.problem.on(region).unattended() for region in self.regions]
            self.solved[NEVER] = tuple(
                LeafEstimates.of(replace(problem, robot_actions=np.ones_like(problem.robot_actions)), region)
                for problem, region in zip(problems, self.regions, strict=True)
            )
        return partial(self._in_rows, self.solved[NEVER])

    def _in_rows(self, each: tuple[LeafEstimates, ...], x: Ints) -> Floats:
        pomdp = self.pomdp
        return _values(each, self.situations(x), pomdp.model.choices.goals.of_rows(x), pomdp.hidden)[:, 0]

    def q_values(self, x: Ints, belief: Floats) -> Floats:
        """Return the Q-values of all robot actions, shape (N, R); minus infinity in padding."""
        if self.solver is None:
            return self.problem.q_values("", self._backup, 0, x, belief)
        region, policy = self._own
        at, q = region.local(self.situations(x)), np.full((len(x), self.pomdp.suggested.shape[1]), -np.inf)
        known = (at >= 0) & ~np.isin(at, region.frontier)
        inside, outside = np.flatnonzero(known), np.flatnonzero(~known)
        if len(inside):
            found = policy.q_values(at[inside], belief[inside])
            q[inside, : found.shape[1]] = found[:, : q.shape[1]]
        if len(outside):
            found = self.problem.q_values("", self._backup, 0, x[outside], belief[outside])
            q[outside, : found.shape[1]] = found
        return q

    @cached_property
    def _own(self) -> tuple[TruncatedTask, Policy]:
        """A truncated task with all goals, and the policy of the solver on it."""
        assert self.solver is not None
        region = self._region(self.ground.known)
        return region, self.solver(closed_problem(region, self.assumed))

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

    def advantage(self, before: Ints, now: Ints, x: Ints, move: Ints, h: Ints, was: Ints, t: Ints) -> Floats:
        """Return Q-values minus values, shape (N,); arguments as in `SolvedSubproblem.advantage`."""
        table, _ = self.policy.problem.values(*self._table(0), x)
        return np.asarray(table[x, now, move, h, t] - table[x, before, :, h, was].max(axis=1))

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
