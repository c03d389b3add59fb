"""The decisions of a live team: to whom its robots go, with which suggestions, and what they ask."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo

from ..people.decision import Floats
from ..people.goals import Goals
from ..people.ranges import Population
from ..person.beliefs import Ask
from ..person.policy import Policy
from ..person.robots import SUGGESTION
from ..person.settings import Setting
from ..team.action_check import check
from ..team.policies import named, prepare
from ..team.policy_names import POLICIES
from ..team.state import NOBODY, TeamPolicy, TeamState
from .advice import Advice, Question, Reason
from .beliefs import reason_of
from .decision_point import DecisionPoint
from .live_questions import LiveQuestions
from .live_task import LiveTask
from .robot_places import RobotPlaces
from .roster import Roster
from .uncertain_actions import allows_uncertain, prepare_uncertain


@dataclass(frozen=True)
class _LiveTeam(TeamState):
    """A team state that caches the answers about people who have not acted since."""

    roster: Roster

    def of_each(self, ask: Ask) -> Floats:
        """Return the answers about each person, as `TeamState.of_each` does."""
        return np.where(self.active[:, :, None], self.roster.of_each(ask, self.active[0])[None], -np.inf)


class Decisions:
    """Decides for the robots of a live team.

    Parameters
    ----------
    setting : Setting
    policy : str or callable
        A team policy, as in `Assistant`.
    team : Roster
    places : RobotPlaces

    Attributes
    ----------
    solved : dict
        The problems that were solved so far, by task and prior; those of several teams, if they share them.
    """

    def __init__(self, setting: Setting, policy: str | TeamPolicy, team: Roster, places: RobotPlaces) -> None:
        self._setting, self._rule, self._team, self._places = setting, policy, team, places
        self.solved: dict[tuple[int, Population], LiveTask] = {}
        self._problems: dict[tuple[int, Population], LiveTask] = {}  # of people of this team
        self._made: TeamPolicy | None = None if isinstance(policy, str) else policy
        self._asks: LiveQuestions | None = None
        if isinstance(policy, str) and policy not in POLICIES:
            named(policy, (), setting.travel(1))  # raises an error that lists the names

    def problem(self, task: CostToGo | Goals | Policy, population: Population) -> LiveTask:
        """Return the problem of a task with a prior, which is kept: people with the same task share it."""
        key = (id(task), population)
        if key not in self._problems:
            if key not in self.solved:
                made = LiveTask(task, self._setting, population)
                if self._setting.observation is not None:
                    self._setting.observation.require_actions_of(made.choices)
                if allows_uncertain(self._setting):
                    prepare_uncertain(made)
                self.solved[key] = made
            self._problems[key] = self.solved[key]
            self.renew()
            self._asks = None
        return self._problems[key]

    def renew(self) -> None:
        """Build the team policy again, because problems or distances have changed."""
        if isinstance(self._rule, str):
            self._made = None

    def point(self, number: int, asked: Question | None = None) -> DecisionPoint:
        """Return the present team, from which a decision about a robot is explained later.

        `asked` is a question that the decision opens.
        """
        policy: Any = self._rule
        rule = policy if isinstance(policy, str) else getattr(policy, "name", getattr(policy, "__name__", "your own"))
        location = self._places.at[number]
        moving = self._places.cost(number, location)
        return DecisionPoint.of(self._team, location, moving, str(rule), self._extra(number), self.team_policy, asked)

    def _extra(self, number: int) -> float:
        """Return what a suggestion by a robot costs more than in people's problems."""
        return float(self._setting.fleet.extra[number, SUGGESTION])

    def decide(self, step: int) -> tuple[Advice, ...]:
        """Return what each robot does next; `step` is the number of decisions before.

        Nothing is suggested or asked yet: if the policy fails, no view shows what the record lacks.
        """
        places = self._places
        places.stop_for_absent(self._team.present)
        active, question = self._team.present & ~self._team.ended & (self._team.said == 0), None
        if not all(places.under_way) and active.any():
            active, question = self._asking(active)
        points = [self.point(number, question) for number in range(len(places.at))]
        advice = [Advice(None, None, None, arrived=True).explained_by(point.nothing) for point in points]
        for number, location in enumerate(places.at):
            if places.under_way[number]:
                going_to = self._team.records[location]
                reason = reason_of(self._team, going_to.place, 0, 0.0, self._extra(number))
                on_its_way = Advice(going_to.name, None, reason, arrived=False)
                source = partial(points[number].suggested, going_to.place, 0, arrived=False)
                advice[number] = on_its_way.explained_by(source)
        if all(places.under_way) or not active.any():
            return (advice[0].asking(question), *advice[1:])
        team = self._as_policies_see_it(active, step)
        action = self.team_policy()(team)
        check(team, action)
        chosen = zip(action.person[0].tolist(), action.action[0].tolist(), strict=True)
        for number, (k, said) in enumerate(chosen):
            if k != NOBODY:
                advice[number] = self._sent(number, k, said, points[number])
        return (advice[0].asking(question), *advice[1:])

    def reason(self, number: int, k: int, said: int) -> Reason:
        """Return the reason for a robot's action towards the person at a place, in the numbers of the present."""
        moving = float(self._places.cost(number, self._places.at[number])[k])
        return reason_of(self._team, k, said, moving, self._extra(number))

    def _asking(self, active: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], Question | None]:
        """Return who may get a suggestion, as nothing is asked of them, and the question that is worth most."""
        if self._setting.c_ask is None or self._rule == "none":
            return active, None
        if self._asks is None:
            self._asks = LiveQuestions(self._setting, [problem.policy for problem in self._problems.values()])
        active = active.copy()
        active[list(self._team.questions)] = False
        question = self._asks.best(self._team, active)
        if question is not None:
            active[self._team.by_name[question.person].place] = False
        return active, question

    def _sent(self, number: int, k: int, said: int, point: DecisionPoint) -> Advice:
        """Return the advice of a robot that is sent from where it is to a person."""
        record, there = self._team.records[k], not self._places.takes_time(number, k)
        row, pomdp = self._team.row(record), record.problem.policy.pomdp
        reason = self.reason(number, k, said)
        advice = Advice(record.name, pomdp.suggestion(row, said), reason, arrived=there)
        return advice.explained_by(partial(point.suggested, k, said, arrived=there))

    def _as_policies_see_it(self, active: NDArray[np.bool_], step: int) -> TeamState:
        t = self._team
        return _LiveTeam(
            np.array([step]), active[None], np.array([self._places.at]), t.model[None], t.beliefs,
            [task.policy for task in t.tasks], self._places.travel, t,
            ready=~np.array([self._places.under_way]), fleet=self._setting.fleet,
        )  # fmt: skip

    def team_policy(self) -> TeamPolicy:
        """Return the team policy, built for all problems of the team."""
        if self._made is None:
            assert isinstance(self._rule, str)
            # Without given distances all places are equally far, so that two represent any number.
            travel = self._places.travel if self._places.distance is not None else self._setting.travel(2)
            policies = [problem.policy for problem in self._problems.values()]
            prepare(made := named(self._rule, policies, travel), policies)
            self._made = made
        return self._made
