"""The people's tasks as a step of a simulation sees them.

For an enumerated task, all data are computed once, and array rows correspond to states. Otherwise a step builds a local
problem of the people's states (`Policy.local`). A limited number of these are cached, so that the memory consists
mostly of visited states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..person.policy import Policy
from ..team.state import by_model
from .model_group import Ints, ModelGroup
from .task_parts import TaskParts


@dataclass(frozen=True)
class StepView:
    """All people in one step, as team policies and compiled code see them; arrays of shape (N, K).

    Attributes
    ----------
    policies : sequence of Policy
    groups : mapping of int to ModelGroup
        By the index of the policy.
    x : int array
        Row of each person in their policy's problem.
    model : int array
        Index of each person's policy.
    who : int array
        Row of each person in their group's `Minds`, which has their goal.
    """

    policies: Sequence[Policy]
    groups: Mapping[int, ModelGroup]
    x: Ints
    model: Ints
    who: Ints


class TaskView:
    """The people's tasks in a number of episodes that are simulated together; `view` returns those of a step.

    Parameters
    ----------
    parts : TaskParts
    model, people, mind, goal : int arrays, shape (N, K)
        Each person's model, their number in the pool, the number of their type in the robot's model, and that of their
        goal.
    """

    def __init__(self, parts: TaskParts, model: Ints, people: Ints, mind: Ints, goal: Ints) -> None:
        self.parts, self.model, self.people, self.mind, self.goal = parts, model, people, mind, goal
        policies = parts.pool.policies
        self.initial = np.array([policy.task.initial for policy in policies])[model]
        self._whole: StepView | None = None
        if all(np.isfinite(policies[number].size) for number in np.unique(model)):
            self._whole = self._view(self.initial, np.arange(model.size), deep=True)

    def view(self, x: Ints, active: Ints, *, deep: bool) -> StepView:
        """Return the view of all people in given states.

        Parameters
        ----------
        x : int array, shape (N, K)
            Task state of each person.
        active : int array
            Active people, as indices of the flattened `x`.
        deep : bool
            Whether local problems must have the effect of every suggestion on trust, not only of those that are made.
        """
        return self._view(x, active, deep) if self._whole is None else replace(self._whole, x=x)

    def _view(self, x: Ints, active: Ints, deep: bool) -> StepView:
        policies, groups = list(self.parts.pool.policies), dict[int, ModelGroup]()
        rows, who = np.zeros((2, x.size), dtype=np.int64)
        for number, flat in by_model(self.model.reshape(-1), active, len(policies)):
            states, people = x.reshape(-1)[flat], self.people.reshape(-1)[flat]
            part = self.parts.of(number, np.unique(states), np.unique(people), deep)
            own = part.policy.rows(states, deep=deep)
            assert own is not None
            policies[number], groups[number] = part.policy, part.group
            rows[flat] = own
            if self.parts.world == "model":
                who[flat] = self.mind.reshape(-1)[flat]
            else:
                who[flat] = part.group.mind(people, self.goal.reshape(-1)[flat])
        return StepView(policies, groups, rows.reshape(x.shape), self.model, who.reshape(x.shape))

    def after_suggestions(self, view: StepView, robot: Ints) -> StepView:
        """Return the view after the given robot actions, shape (N, K), which can be simulated from it.

        A local problem has the effect on trust of only those suggestions that are made; they are added here. A view
        of enumerated tasks has all effects, and is returned unchanged.
        """
        if self._whole is not None:
            return view
        groups, policies = dict(view.groups), list(view.policies)
        for number, flat in by_model(view.model.reshape(-1), np.flatnonzero(robot), len(policies)):
            again = policies[number].after_suggestions(view.x.reshape(-1)[flat], robot.reshape(-1)[flat])
            if again is not policies[number]:
                groups[number], policies[number] = self.parts.group(again, groups[number].people), again
        return replace(view, groups=groups, policies=policies)
