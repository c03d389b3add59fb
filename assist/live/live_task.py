"""A task as people live through it, and what the robot has worked out about it.

Of a task with few states everything is worked out at once. Of a larger one, or one that is only asked on demand
(`assist.large_tasks.person_problem` decides which), there is what the next step needs of the states in which people are
(`assist.large_tasks.truncated_policy`), and it is forgotten when they have left. What is believed of a person does not
depend on that.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any, TypeGuard, cast
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo

from ..large_tasks.person_problem import WHOLE, is_whole
from ..large_tasks.truncated_policy import SharedTask, TruncatedPolicy
from ..people.action_names import Matcher, UnmatchedError, words_of
from ..people.choices import Choices, require_goal
from ..people.human import Mixture, Population
from ..people.memory import choices_of
from ..person.pomdp import Policy
from ..person.problem_arrays import ProblemArrays
from ..person.qmdp import qmdp
from ..team.settings import Setting


class UnknownError(ValueError):
    """A person, or an action, that there is not."""


class InapplicableError(ValueError):
    """Something that cannot be done now; the message says what can."""


@dataclass(frozen=True, eq=False)
class TaskPart:
    """States of a task, with the policy for one person there.

    Attributes
    ----------
    policy : Policy
    arrays : ProblemArrays
        Its problem, as compiled code reads it.
    states : int array, shape (n,), or None
        The number of each state in the task; None if the same.
    """

    policy: Policy
    arrays: ProblemArrays
    states: NDArray[np.int64] | None = None

    @property
    def choices(self) -> Choices:
        """What can be done in each state."""
        return self.policy.pomdp.model.choices

    def state(self, row: int) -> int:
        """Give the task's state of a row."""
        return self.choices.task_state(row) if self.states is None else int(self.states[row])

    def options(self, row: int) -> NDArray[np.int32]:
        """Give the ground actions that can be taken, in the order of their slots; none where one can only wait."""
        actions = self.choices.actions[row][self.choices.applicable[row]]
        return actions[actions >= 0].astype(np.int32)


class LiveTask:
    """One task with one prior, for any number of people.

    A place is where somebody is in it, by which it is found again: a row of a task that is looked at whole, which may
    say what they did before, or else a state of the task.

    Parameters
    ----------
    task : CostToGo or Policy
        A task, or a policy for one person in it.
    setting : Setting
    prior : Population or Mixture
        Of whom people are taken to be.

    Attributes
    ----------
    policy : Policy
        For one person.
    initial : int
        The place in which people begin.
    """

    def __init__(self, task: CostToGo | Policy, setting: Setting, prior: Population | Mixture) -> None:
        self.task, self.prior = task, prior
        self.policy = task if is_policy(task) else _policy_for(cast(CostToGo, task), setting, prior)
        if isinstance(self.policy, TruncatedPolicy):
            self.initial, self._whole = self.policy.ground.known.initial, None
        else:
            self.initial = self.policy.pomdp.model.choices.initial
            self._whole = TaskPart(self.policy, ProblemArrays.of(self.policy.pomdp))
        # Of what is not looked at whole, only where somebody is.
        self._around: WeakValueDictionary[int, TaskPart] = WeakValueDictionary()
        part, row = self.at(self.initial)
        require_goal(part.choices.h[row])
        self.matcher = Matcher(part.choices.names)

    def at(self, place: int) -> tuple[TaskPart, int]:
        """Give the part in which a place is, and its row there."""
        if self._whole is not None:
            return self._whole, place
        part = self._around.get(place)
        if part is None:
            assert isinstance(self.policy, TruncatedPolicy)
            around = self.policy.around(np.array([place]), deep=True)
            self._around[place] = part = TaskPart(around, ProblemArrays.of(around.pomdp), around.region.states)
        return part, 0

    def place(self, part: TaskPart, row: int) -> int:
        """Give the place of a row."""
        return row if part.states is None else part.state(row)

    def after(self, part: TaskPart, row: int, slot: int) -> tuple[TaskPart, int]:
        """Find where a choice leads: the part, and the row there."""
        return self.at(self.place(part, int(part.choices.targets[row, slot])))

    def slot(self, part: TaskPart, row: int, action: str) -> int:
        """Find the slot of an action.

        Raises
        ------
        UnknownError
            The task has no such action.
        InapplicableError
            It cannot be taken there; says what can be.
        """
        try:
            words = words_of(action)
        except UnmatchedError as error:
            raise UnknownError(str(error)) from None
        try:
            return self.matcher.slot(words, part.options(row))
        except UnmatchedError as error:
            kind = InapplicableError if self.matcher.unknown(words) is None else UnknownError
            raise kind(str(error)) from None

    def robot(self, part: TaskPart, row: int, suggestion: str | None) -> int:
        """Find the robot action that suggests an action; 0 for None."""
        if suggestion is None:
            return 0
        slot = self.slot(part, row, suggestion)
        found = np.flatnonzero(part.policy.pomdp.suggested[row] == slot)
        if not len(found):
            raise InapplicableError(f"{suggestion}: not one of the suggestions that there are")
        return int(found[0])


def _policy_for(known: CostToGo, setting: Setting, prior: Population | Mixture) -> Policy:
    """Work out a policy for one person of whom only the task is known, at once where the task is looked at whole."""
    if is_whole(known):
        return qmdp(setting.problem(choices_of(known, tuple(prior.weights)), None, prior))
    if prior.weights:
        raise ValueError(f"people who remember what they did: expected a task of at most {WHOLE:,} states")
    return TruncatedPolicy(SharedTask(known, prior), setting)


def is_policy(task: CostToGo | Policy) -> TypeGuard[Policy]:
    """Tell a policy for one person from a task's cost-to-go."""
    return isinstance(task, TruncatedPolicy) or hasattr(task, "pomdp")


def digest(task: CostToGo | Policy) -> str:
    """Give what tells a task from others, wherever it was loaded; a policy also by all that beliefs depend on."""
    content = hashlib.sha256()
    if isinstance(task, TruncatedPolicy):
        task = task.ground.known
    if is_policy(task):
        pomdp, choices = task.pomdp, task.pomdp.model.choices
        content.update("\n".join(choices.names).encode())
        for array in (
            choices.h, choices.actions, choices.targets, pomdp.model.q, pomdp.chosen, pomdp.suggested, pomdp.low,
            pomdp.weight, pomdp.prior, pomdp.grid.beta, pomdp.grid.theta, np.array(pomdp.model.lapse),
        ):  # fmt: skip
            content.update(np.ascontiguousarray(array).tobytes())
    else:
        content.update(cast(CostToGo, task).task.sas.encode())
    return content.hexdigest()[:32]


def population_of(plain: dict[str, Any]) -> Population | Mixture:
    """Read a population that `Population.as_dict` or `Mixture.as_dict` gave, and JSON may have kept.

    Raises
    ------
    ValueError
        Its people choose by a function, of which there is only the name.
    """
    if "parts" in plain:
        return Mixture(tuple(_ranges(part) for part in plain["parts"]), tuple(plain["shares"]))
    return _ranges(plain)


def _ranges(plain: dict[str, Any]) -> Population:
    if "chooses" in plain:
        raise ValueError(f"people choose by {plain['chooses']}, a function that is not saved; expected ranges, weights")
    weights = {name: (low, high) for name, (low, high) in plain.get("weights", {}).items()}
    return Population(tuple(plain["beta"]), tuple(plain["theta"]), tuple(plain["sigma"]), plain["noise"], weights)
