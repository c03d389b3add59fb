"""A task as people live through it, and what the robot has worked out about it.

Of a task with few states everything is worked out at once. Of a larger one, or one that is only asked on demand
(`assist.person.problem` decides which), the `Region` is that people most likely get to; whoever leaves it has another
one begun where they are. What is believed of a person does not depend on where regions end.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any, TypeGuard, cast

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo

from ..learning.actions import Matcher, UnmatchedError, words_of
from ..people.choices import Choices, require_goal
from ..people.human import Mixture, Population
from ..person.pomdp import Policy
from ..person.problem import PersonProblem
from ..person.qmdp import Arrays, qmdp
from ..team.settings import Setting


class UnknownError(ValueError):
    """A person, or an action, that there is not."""


class InapplicableError(ValueError):
    """Something that cannot be done now; the message says what can."""


@dataclass(frozen=True)
class Part:
    """States of a task, with the policy for one person there.

    Attributes
    ----------
    policy : Policy
    arrays : Arrays
        Its problem, as compiled code reads it.
    states : int array, shape (n,), or None
        The number of each state in the task; None if the same.
    rows : dict of int, or None
        The other way round, of states that are not on the region's frontier.
    """

    policy: Policy
    arrays: Arrays
    states: NDArray[np.int64] | None = None
    rows: dict[int, int] | None = None

    @classmethod
    def whole(cls, policy: Policy) -> Part:
        """All states of a task."""
        return cls(policy, Arrays.of(policy.pomdp))

    @classmethod
    def of(cls, problem: PersonProblem) -> Part:
        """Those that a problem covers."""
        pomdp, states = problem.pomdp, problem.states
        if pomdp.frontier is None:
            return cls.whole(qmdp(pomdp))
        kept = np.ones(len(states), dtype=bool)
        kept[pomdp.frontier.states] = False
        rows = {int(states[row]): int(row) for row in np.flatnonzero(kept)}
        return cls(qmdp(pomdp), Arrays.of(pomdp), states, rows)

    @property
    def choices(self) -> Choices:
        """What can be done in each state."""
        return self.policy.pomdp.model.choices

    def row(self, state: int) -> int | None:
        """Give the row of a task's state as if nothing had come before it; None if it is not in this part."""
        return self.choices.row(state) if self.rows is None else self.rows.get(state)

    def state(self, row: int) -> int:
        """Give the task's state of a row."""
        return self.choices.task_state(row) if self.states is None else int(self.states[row])

    def options(self, row: int) -> NDArray[np.int32]:
        """Give the ground actions that can be taken, in the order of their slots; none where one can only wait."""
        actions = self.choices.actions[row][self.choices.applicable[row]]
        return actions[actions >= 0].astype(np.int32)


class Problem:
    """One task with one prior, for any number of people.

    Parameters
    ----------
    task : CostToGo or Policy
        A task, or a policy for one person in it.
    setting : Setting
    prior : Population or Mixture
        Of whom people are taken to be.
    parts : list of Part
        To which those of this task are added; a part is known by its place there.
    """

    def __init__(
        self, task: CostToGo | Policy, setting: Setting, prior: Population | Mixture, parts: list[Part]
    ) -> None:
        self.task, self.setting, self.prior, self.parts = task, setting, prior, parts
        self.own: list[int] = []
        if is_policy(task):
            choices = task.pomdp.model.choices
            self.initial = choices.task_state(choices.initial)
            self._add(Part.whole(task))
        else:
            self.initial = cast(CostToGo, task).initial
        number, row = self.at(self.initial)
        require_goal(parts[number].choices.h[row])
        self.matcher = Matcher(parts[number].choices.names)

    def _add(self, part: Part) -> int:
        self.parts.append(part)
        self.own.append(len(self.parts) - 1)
        return self.own[-1]

    def at(self, state: int) -> tuple[int, int]:
        """Find the part in which a state is, and its row there; one is worked out if there is none."""
        for number in self.own:
            row = self.parts[number].row(state)
            if row is not None:
                return number, row
        s = self.setting
        part = Part.of(
            PersonProblem.of(
                cast(CostToGo, self.task), start=state, population=self.prior, eta=s.eta, lapse=s.lapse,
                utility_scale=s.utility_scale, gamma=s.gamma, c_suggest=s.c_suggest, suggestions=s.suggestions,
            )
        )  # fmt: skip
        row = part.row(state)
        assert row is not None, "a region holds the state in which it begins"
        return self._add(part), row

    def after(self, number: int, row: int, slot: int) -> tuple[int, int]:
        """Find where a choice leads: the part, and the row there."""
        part = self.parts[number]
        to = int(part.choices.targets[row, slot])
        return (number, to) if part.rows is None else self.at(part.state(to))

    def slot(self, number: int, row: int, action: str) -> int:
        """Find the slot of an action.

        Raises
        ------
        UnknownError
            The task has no such action.
        InapplicableError
            It cannot be taken there; says what can be.
        """
        words = words_of(action)
        try:
            return self.matcher.slot(words, self.parts[number].options(row))
        except UnmatchedError as error:
            kind = InapplicableError if self.matcher.unknown(words) is None else UnknownError
            raise kind(str(error)) from None

    def robot(self, number: int, row: int, suggestion: str | None) -> int:
        """Find the robot action that suggests an action; 0 for None."""
        if suggestion is None:
            return 0
        slot = self.slot(number, row, suggestion)
        found = np.flatnonzero(self.parts[number].policy.pomdp.suggested[row] == slot)
        if not len(found):
            raise InapplicableError(f"{suggestion}: not one of the suggestions that there are")
        return int(found[0])


def is_policy(task: CostToGo | Policy) -> TypeGuard[Policy]:
    """Tell a policy for one person from a task's cost-to-go."""
    return hasattr(task, "pomdp")


def digest(task: CostToGo | Policy) -> str:
    """Give what tells a task from others, wherever it was loaded; a policy also by all that beliefs depend on."""
    content = hashlib.sha256()
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
