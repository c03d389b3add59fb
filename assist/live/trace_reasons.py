"""Explanations of the suggestions in a simulation, the same as those of a live team's advice."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from planner import CostToGo

from ..people.goals import Goals
from ..people.ranges import Population
from ..person.policy import Policy
from ..person.robots import SUGGESTION
from ..person.settings import Setting
from ..team.state import TeamPolicy, TeamState
from .decision_point import DecisionPoint
from .live_task import LiveTask


class TraceReasons:
    """Explains suggestions of a simulated robot, for the trace of `simulate`.

    Parameters
    ----------
    policies : sequence of Policy
        Those of the pool that is simulated.
    task : CostToGo or Goals, optional
        Their task, which has the domain's words; without it, actions are in PDDL notation.
    """

    def __init__(self, policies: Sequence[Policy], task: CostToGo | Goals | None = None) -> None:
        self._policies, self._task = policies, task
        self._problems: dict[int, LiveTask] = {}

    def __call__(
        self, team: TeamState, row: int, place: int, action: int, *, robot: int, names: Sequence[str], rule: str,
        policy: TeamPolicy,
    ) -> dict[str, Any]:  # fmt: skip
        """Return why a person gets a suggestion, as data and as a text; arguments as `simulate` passes them.

        Parameters
        ----------
        team : TeamState
            The teams before the decision.
        row, place : int
            The team, and the person's place in it.
        action : int
            The robot action.
        robot : int
            Which robot of the team it is, from 0.
        names : sequence of str
            Names of the team's people.
        rule : str
            Name of the team's policy.
        policy : TeamPolicy
        """
        # The models of people who are not active may have no problem in this step, and none is looked at.
        model, own = np.unique(np.where(team.active[row], team.model[row], team.model[row, place]), return_inverse=True)
        policies = [team.policies[one] for one in model.tolist()]
        here, travel = int(team.location[row, robot]), team.travel
        count = len(names)
        point = DecisionPoint(
            tuple(names), tuple(self._problem(int(model[one])) for one in own), policies,
            team.beliefs.of(row * count + np.arange(count)), own, np.zeros(count, dtype=np.int64), team.active[row],
            ~team.active[row], {}, here, travel.costs_of(robot, here), rule,
            float(team.fleet.extra[robot, SUGGESTION]), lambda: policy,
        )  # fmt: skip
        found = point.suggested(place, action, arrived=True)
        plain = {name: part for name, part in found.as_dict().items() if part is not None}
        return {"text": found.text(), **plain}

    def _problem(self, model: int) -> LiveTask:
        if model not in self._problems:
            policy = self._policies[model]
            self._problems[model] = LiveTask(self._task or policy, Setting(), Population(), policy)
        return self._problems[model]
