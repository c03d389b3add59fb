"""A chunk of episodes that advance together, one step at a time."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from threading import Event
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..people.decision import NOTHING, Floats
from ..person.beliefs import Acts, Beliefs, Hidden, Seen
from ..person.dynamics import PeopleArrays
from ..team.action_check import check
from ..team.assignment import placed
from ..team.questions import Questions
from ..team.state import BASE, NOBODY, PolicyError, TeamAction, TeamPolicy, TeamState, by_model
from ..team.travel import Travel
from .common_random_numbers import CommonRandomNumbers, from_the_prior
from .episodes import Episodes
from .hidden_goals import GoalKnowledge, HiddenGoals
from .model_group import ModelGroup, World
from .pool import Pool
from .schedule import Schedule
from .task_view import TaskView


class StepTaken(NamedTuple):
    """A step: the people who acted, as flat indices, what each did, and their rows, theta and rewards.

    `before` and `theta` are those before the step, and `x` the rows after it. The other arrays are those of `Run`.
    """

    step: int
    flat: NDArray[np.int64]
    before: NDArray[np.int64]
    x: NDArray[np.int64]
    robot: NDArray[np.int64]
    slot: NDArray[np.int64]
    theta: Floats
    reward: Floats


class Run:
    """A chunk of episodes in progress; the episodes are the first axis of all arrays."""

    keeps_beliefs = False
    """Whether beliefs are kept for policies, too, that do not use them."""

    def __init__(
        self,
        pool: Pool,
        policy: TeamPolicy,
        *,
        teams: NDArray[np.int64] | None,
        numbers: NDArray[np.int64],
        seed: int,
        name: str,
        travel: Travel,
        presence: Schedule,
        world: World,
        over: Event,
        groups: Mapping[int, ModelGroup],
        questions: Questions | None,
        goals: GoalKnowledge,
    ) -> None:
        self.pool, self.policy, self.numbers, self.name = pool, policy, numbers, name
        self.travel, self.presence, self.over = travel, presence, over
        shape = (len(numbers), len(travel))
        self.random_numbers, self.on_grid = CommonRandomNumbers(seed, numbers, len(travel)), world == "model"
        # The array is in C order, and all arrays derived from it are, too. They are changed in place through flat
        # views.
        self.people = np.ascontiguousarray(self.random_numbers.team(len(pool.people)) if teams is None else teams)
        self.model = pool.model[self.people]
        self.mind = np.zeros(shape, dtype=np.int64)
        goal: NDArray[np.int64] | None = None
        self.beta = np.array([human.beta for human in pool.people])[self.people]
        self.theta = np.array([human.theta for human in pool.people])[self.people]
        if self.on_grid:
            drawn = self.random_numbers.draw(0, np.arange(len(numbers)))
            pomdps = [solved.pomdp for solved in pool.policies]
            goal, self.mind, self.beta, self.theta = from_the_prior(pomdps, self.model, drawn)
        self.sigma = np.array([human.sigma for human in pool.people])[self.people]
        self.first_theta, self.seen = self.theta.copy(), np.zeros(shape, dtype=np.int64)

        self.goals: HiddenGoals | None = None
        if pool.goals > 1:
            self.goals = HiddenGoals.of(pool, self.model, goal, self.random_numbers, goals)
        pursued = np.zeros(shape, dtype=np.int64) if self.goals is None else self.goals.goal
        self.groups, self.policies = groups, pool.policies
        self.task_view = TaskView(pool, groups, world, self.model, self.people, self.mind, pursued)
        self.places = self.task_view.initial.copy()
        at_goal = np.array([pool.choices(n).goal[pool.choices(n).initial] for n in range(len(pool.people))])
        self.finished = at_goal[self.people]
        self.fleet, robots = pool.setting.fleet, len(pool.setting.robots)
        self.location = np.full((len(numbers), robots), BASE, dtype=np.int64)
        self.busy_until = np.zeros((len(numbers), robots), dtype=np.int64)
        self.x = self.places.copy()  # the row of each place
        uses_belief = getattr(policy, "uses_belief", True)
        self.beliefs = self._first_beliefs(uses_belief or self.keeps_beliefs)
        self.questions = questions if uses_belief else None
        self.asked = np.zeros(len(numbers), dtype=np.int64)
        self.actions = np.zeros(shape, dtype=np.int64)
        self.costs = np.zeros(shape)
        self.helped = np.zeros(shape, dtype=np.int64)
        self.executed = np.zeros(shape, dtype=np.int64)
        self.moves = np.zeros(len(numbers), dtype=np.int64)
        self.steps = np.zeros(len(numbers), dtype=np.int64)
        self.discounted = np.zeros(len(numbers))

    def _first_beliefs(self, wanted: bool) -> Beliefs:
        """Return what the robot knows at first, with beliefs about people's types if they are wanted."""
        pool, none = self.pool, np.empty((0, 1, 1))
        sight = pool.setting.observation
        belief: Floats = none
        if wanted or sight is not None:
            belief = np.array([policy.pomdp.prior for policy in pool.policies])[self.model]
            if self.goals is not None:
                belief = self.goals.first_beliefs(belief)
            belief = belief.reshape(-1, *belief.shape[2:])
        erred = np.zeros(self.x.size, dtype=bool)
        if sight is None:
            return Seen(self.x.reshape(-1), belief, erred)
        for policy in pool.policies:
            policy.require_enumerated("observation")
        return Hidden(self.x.reshape(-1).copy(), belief, erred, sight)

    def run(self) -> Episodes:
        """Simulate steps until all people have finished or the limit is reached; return the records.

        The simulation also ends once the event `over` is set, as the results are not needed any more.
        """
        for step in range(self.pool.setting.max_steps):
            to_come = ~self.finished & (step < self.presence.leaves)
            running = np.flatnonzero(to_come.any(axis=1))
            if not len(running) or self.over.is_set():
                break
            self._step(step, running, to_come & (step >= self.presence.joins))
        return Episodes(
            policy=self.name, episode=self.numbers, people=self.people, beta=self.beta, theta=self.first_theta,
            sigma=self.sigma, actions=self.actions, costs=self.costs, finished=self.finished, helped=self.helped,
            executed=self.executed, interventions=self.helped.sum(axis=1), moves=self.moves, steps=self.steps,
            discounted_return=self.discounted,
            cut_off=np.asarray((~self.finished & (self.presence.leaves > self.pool.setting.max_steps)).any(axis=1)),
            questions=None if self.questions is None else self.asked,
            pruned=None if self.beliefs.sees_states else self.beliefs.pruned.reshape(self.x.shape).sum(axis=1),
        )  # fmt: skip

    def _step(self, step: int, running: NDArray[np.int64], active: NDArray[np.bool_]) -> None:
        flat = np.flatnonzero(active)
        self.x[:] = self.task_view.rows(self.places, flat)
        said, charged = self._robot(step, running, active)
        groups = by_model(self.model.reshape(-1), flat, len(self.policies))
        robot = self.beliefs.heard(
            said.reshape(-1), self.x.reshape(-1), [(self.policies[number].pomdp, rows) for number, rows in groups]
        ).reshape(said.shape)
        before, theta_before = self.x.copy(), self.theta.copy()
        uniform = np.empty((*self.x.shape, 2))
        for kind in (1, 2) if self.on_grid else (1,):
            uniform[running, :, kind - 1] = self.random_numbers.draw(kind, running)
        people = PeopleArrays.of_teams(self.x, robot, self.task_view.who, self.theta, self.seen, uniform)
        for number, rows in groups:
            group = self.groups[number]
            group.act(rows, people)
            self.finished.reshape(-1)[rows] = group.ended(rows, people)
            self.places.reshape(-1)[rows] = group.policy.places(people.x[rows])
        acts = Acts(before.reshape(-1), people.robot, people.slot, ~self.finished.reshape(-1))
        models = [(self.groups[number].model, rows) for number, rows in groups]
        self.beliefs.observe(acts, said.reshape(-1), models, partial(self._drawn, running))
        slot, cost = people.slot, people.cost.reshape(self.x.shape)
        reward = -charged - cost
        self.discounted += self.pool.setting.gamma**step * reward.sum(axis=1)
        self.actions += slot.reshape(self.x.shape) >= 0
        self.costs += cost
        self.steps[running] += 1
        self.watch(StepTaken(step, flat, before, self.x, robot, slot, theta_before, reward))

    def _drawn(self, running: NDArray[np.int64], kind: int) -> Floats:
        """Return uniform numbers of a kind for all people, 0 in teams that do not run any more."""
        uniform = np.zeros(self.x.shape)
        uniform[running] = self.random_numbers.draw(kind, running)
        return uniform.reshape(-1)

    def watch(self, taken: StepTaken) -> None:
        """See each step that has been taken; a `TracedRun` writes it down."""

    def decided(self, team: TeamState, action: TeamAction, teams: NDArray[np.int64]) -> None:
        """See what the robots of some teams, given by their numbers, do in a step, before it is carried out."""

    def asked_about(self, team: int, place: int, goal: int, *, yes: bool, worth: float) -> None:
        """See a question that was asked, and its answer."""

    def _robot(
        self, step: int, running: NDArray[np.int64], active: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int64], Floats]:
        """Return the robots' action towards each person and its cost, both of shape (N, K), as chosen by the policy."""
        robot, charged = np.zeros_like(self.x), np.zeros(self.x.shape)
        if self.goals is not None and self.questions is not None:
            asked = self.goals.ask(self.questions, active, self.beliefs, self.asked_about)
            charged[asked] += self.questions.cost
            self.asked[asked[0]] += 1
        arrived = self.busy_until <= step
        free = running[arrived[running].any(axis=1) & active[running].any(axis=1)]
        if not len(free):
            return robot, charged
        every = slice(None) if len(free) == len(self.x) else free
        known, K = self.beliefs, self.x.shape[1]
        if len(free) < len(self.x):
            known = known.of((free[:, None] * K + np.arange(K)).reshape(-1))
        if self.goals is not None:
            known = self.goals.acted_on(known)
        team = TeamState(
            step=step, x=known.x.reshape(-1, K), active=active[every], erred=known.erred.reshape(-1, K),
            location=self.location[every], model=self.model[every],
            belief=known.belief.reshape(-1, K, *known.belief.shape[1:]) if len(known.belief) else None,
            policies=self.policies, travel=self.travel, free=arrived[every], fleet=self.fleet, beliefs=known,
        )  # fmt: skip
        action = self.policy(team)
        try:
            check(team, action)
        except PolicyError as error:
            raise PolicyError(f"{getattr(self.policy, 'place', self.name)}: {error}") from None
        self.decided(team, action, free)
        rows, number = np.nonzero(action.person != NOBODY)
        teams, to, does = free[rows], action.person[rows, number], action.robot[rows, number]
        origin = self.location[teams, number]
        charged[teams, to] += self.travel.costs_between(number, origin, to)
        self.busy_until[teams, number] = step + self.travel.steps_between(number, origin, to)
        np.add.at(self.moves, teams, origin != to)
        self.location[free] = placed(self.location[free], action.person)
        robot[teams, to], visible = does, self.beliefs.x.reshape(self.x.shape)
        for model, rows in by_model(self.model[teams, to], np.flatnonzero(does > 0), len(self.policies)):
            at = (teams[rows], to[rows])
            arrays = self.groups[model].arrays
            charged[at] += arrays.robot_costs[visible[at], does[rows]]
            executes = arrays.suggested[visible[at], does[rows]] == NOTHING
            if self.fleet.costs_differ:
                charged[at] += self.fleet.extra_of(number[rows], executes)
            self.executed[at] += executes
        self.helped[teams, to] += does > 0
        return robot, charged
