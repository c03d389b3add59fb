"""A task of people in a live session, with the robot's policy for one person.

A small task is enumerated, and its policy is solved once. In a larger one, or one that is solved on demand
(`assist.person.person_problem` decides), a place gets its row when a person comes there. The belief in a person is
the same either way.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from contextlib import suppress
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo

from ..declare.declared import plain
from ..declare.refusals import InapplicableError, Refusal
from ..drawing.picture import Artist
from ..people.action_names import Matcher, Words, words_of
from ..people.arguments import require_goal
from ..people.choices import STAND_STILL, WAIT, Choices
from ..people.goals import Goals, first_of, text_of_goals
from ..people.ranges import Population
from ..people.trust_rules import RULES
from ..person.assumptions import Assumptions
from ..person.person_problem import policy_on
from ..person.policy import Policy
from ..person.settings import Setting, require_setting


class LiveTask:
    """One task with one prior, for any number of people.

    A place identifies where a person is (`person.rows`); it stays the same, while rows without people may be evicted.

    Parameters
    ----------
    task : CostToGo, Goals or Policy
        A task, goals of which people pursue one, or a policy for one person.
    setting : Setting
    prior : Population
        The robot's prior of people.
    policy : Policy, optional
        The policy for one person, if there is one already.

    Attributes
    ----------
    policy : Policy
        The policy for one person.
    initial : int
        The place at which people begin.
    """

    def __init__(
        self,
        task: CostToGo | Goals | Policy,
        setting: Setting,
        prior: Population,
        policy: Policy | None = None,
    ) -> None:
        self.task, self.prior = task, prior
        self.policy = policy or (
            task if isinstance(task, Policy) else policy_on(task, Assumptions.of(setting, None, prior))
        )
        self.initial = self.policy.problem.task.initial
        require_goal(self.choices.h[self.row(self.initial)])
        self.matcher = Matcher(self.choices.names)

    @property
    def choices(self) -> Choices:
        """The choices in each row."""
        return self.policy.pomdp.model.choices

    def row(self, situation: int) -> int:
        """Return the row of a situation."""
        return int(self.policy.rows(np.array([situation]))[0])

    def situation(self, row: int) -> int:
        """Return the situation of a row."""
        return int(self.policy.situations(np.array([row]))[0])

    def state(self, row: int) -> int:
        """Return the task state of a row."""
        return int(self.policy.problem.states(self.policy.situations(np.array([row])))[0])

    def after(self, row: int, slot: int) -> int:
        """Return the row to which a choice leads."""
        return self.row(self.situation(int(self.choices.targets[row, slot])))

    def options(self, row: int) -> NDArray[np.int32]:
        """Return the applicable ground actions in the order of their slots; none where a person can only wait."""
        actions = self.choices.actions[row][self.choices.applicable[row]]
        return actions[actions >= 0].astype(np.int32)

    def slot(self, row: int, action: str) -> int:
        """Return the slot of an action.

        Raises
        ------
        Refusal
            The task has no such action.
        InapplicableError
            It is not applicable there; the message says which actions are.
        """
        words = words_of(action)
        try:
            return self.matcher.slot(words, self.options(row))
        except Refusal as error:
            if self.matcher.unknown(words) is None:
                raise InapplicableError("not_applicable", why=str(error)) from None
            raise

    def ground(self, action: str) -> int:
        """Return the number of a ground action of the task, applicable now or not; `WAIT` for waiting.

        Raises
        ------
        Refusal
            The task has no such action.
        """
        words = words_of(action)
        if words == (STAND_STILL[1:-1],):
            return WAIT
        if words not in self.matcher.number:
            raise Refusal("other", why=self._unknown(words) or self._incomplete(action, words))
        return self.matcher.number[words]

    def _unknown(self, words: Words) -> str | None:
        """Return why words match no action of the task, with the nearest one; None if they may match one."""
        why, meant = self.matcher.unknown(words), self.matcher.meant(words)
        return why if why is None or meant is None else f"{why}; did you mean ({' '.join(meant)})?"

    def _incomplete(self, action: str, words: Words) -> str:
        """Return what is wrong with the beginning of an action where it may be any that begins so."""
        named = zip(self.choices.names, self.matcher.words, strict=True)
        whole = [name for name, known in named if known[: len(words)] == words]
        some = ", ".join(whole[:3]) + (", ..." if len(whole) > 3 else "")
        return f"{action}: with an observation model, and in likelihoods, actions have all arguments; expected {some}"

    def named(self, action: str) -> str:
        """Return an action of the task in PDDL notation; errors as in `ground`."""
        return self.choices.action_name(self.ground(action))

    def said(self, row: int, suggestion: str | None) -> int:
        """Return the robot action that suggests an action; 0 for None."""
        if suggestion is None:
            return 0
        slot = self.slot(row, suggestion)
        found = np.flatnonzero(self.policy.pomdp.suggested[row] == slot)
        if not len(found):
            raise InapplicableError("other", why=f"{suggestion}: the robot cannot suggest this action here")
        return int(found[0])

    def said_at(self, row: int, suggestion: str) -> int:
        """Return the robot action that suggests an action; 0 if the robot cannot suggest it there."""
        with suppress(InapplicableError):
            return self.said(row, suggestion)
        return 0

    def say(self, action: str) -> str:
        """Return an action in the domain's words, or in PDDL if it has none."""
        return self.words([action]).get(action, action)

    def words(self, actions: Iterable[str]) -> dict[str, str]:
        """Return actions in the words of the domain's `drawing.toml`, as far as it has them.

        Raises
        ------
        InputFileError
            The file cannot be used.
        """
        artist = self._artist
        return {} if artist is None else {action: artist.say(action) for action in actions if artist.has_words(action)}

    @cached_property
    def _artist(self) -> Artist | None:
        task = _known(self.task)
        return None if isinstance(task, Choices) else Artist(task.task)


def _known(task: CostToGo | Goals | Policy) -> CostToGo | Choices:
    """Return a task's cost-to-go, that of the first goal if there are several; of an enumerated policy, the choices."""
    return task.problem.task if isinstance(task, Policy) else first_of(task)


def digest(task: CostToGo | Goals | Policy) -> str:
    """Return a hash of a task, independent of where it was loaded; for a policy, of all that beliefs depend on."""
    content = hashlib.sha256()
    known = _known(task)
    if isinstance(known, Choices):
        pomdp, choices = cast(Policy, task).pomdp, known
        content.update("\n".join(choices.names).encode())
        for array in (
            choices.h, choices.actions, choices.targets, pomdp.model.q, pomdp.chosen, pomdp.suggested, pomdp.low,
            pomdp.weight, pomdp.prior, pomdp.grid.beta, pomdp.grid.theta, np.array(pomdp.model.lapse),
        ):  # fmt: skip
            content.update(np.ascontiguousarray(array).tobytes())
    else:
        content.update(known.task.sas.encode())
    content.update(text_of_goals(task).encode())
    return content.hexdigest()[:32]


def population_of(saved: dict[str, Any]) -> Population:
    """Return the population that `declare.plain` described, directly or through JSON.

    Raises
    ------
    ValueError
        Its people choose by a function, whose name alone was saved.
    """
    if "chooses" in saved:
        raise ValueError(f"people choose by {saved['chooses']}, a function that is not saved; expected ranges, weights")
    return Population(**saved)


def setting_of(saved: dict[str, Any], given: Setting | None) -> Setting:
    """Return the setting that `declare.plain` described, or the given one if it is the same.

    Raises
    ------
    ValueError
        It is another one; or none is given, and the saved one has a rule of the user's own, whose name alone was saved.
    """
    if given is None:
        rules = {name: saved.get(name) for name in ("trust", "believed_trust")}
        rules["neighbours.rule"] = saved.get("neighbours", {}).get("rule")  # a text only if it is the user's own
        for name, rule in rules.items():
            if isinstance(rule, str) and rule not in RULES:
                raise ValueError(f"{name} was {rule}, a rule of your own; expected the team's setting as `setting`")
        return Setting(**{"trust": "paper"} | saved)
    require_setting(given)
    if plain(Setting.of(given.for_real_people())) != saved:
        raise ValueError("setting: it is another than that of the saved team; expected the same")
    return given
