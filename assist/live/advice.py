"""The robot's next step: the person to whom it goes, its suggestion, the reason in numbers, and what it asks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

from ..people.belief import Grid
from ..people.decision import Floats
from ..people.hidden_type import HiddenType
from ..people.spread import Spread
from .explanation import Explanation


@dataclass(frozen=True, slots=True)
class Reason:
    """The reason for helping a person: the numbers of Algorithm 1, also if the team has another policy.

    Attributes
    ----------
    saving : float
        Increase of the person's expected discounted return by the suggestion, compared with no suggestion in this
        step, in cost units. The cost of the suggestion is included. While the robot is on its way, it is that of
        the best suggestion at present.
    moving : float
        Cost of going there, in cost units.
    score : float
        `saving` minus `moving`.
    beta, theta : float
        Means of the belief about the person's expertise, and about the robot's influence on the person.
    beta_interval, theta_interval : pair of float
        Intervals that contain 90 % of the belief, and its mean.
    suggestions, followed : int
        Number of suggestions that the person has answered in this task, and number of those that were followed.
    follow : float
        Probability that the person follows this suggestion, under the belief.
    follow_interval : pair of float
        Interval that contains the mean, and 90 % of the probabilities of following, one for each pair of beta and
        theta, weighted by the belief.
    goals : mapping of str to float
        Probability of each goal, if the person pursues one of several.
    """

    saving: float
    moving: float
    score: float
    beta: float
    beta_interval: tuple[float, float]
    theta: float
    theta_interval: tuple[float, float]
    suggestions: int = 0
    followed: int = 0
    follow: float = 0.0
    follow_interval: tuple[float, float] = (0.0, 1.0)
    goals: Mapping[str, float] = field(default_factory=dict, hash=False)

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers as plain data; goals only if there are several."""
        plain = {one.name: getattr(self, one.name) for one in fields(self)}
        plain["goals"] = dict(self.goals)
        return plain if self.goals else {name: value for name, value in plain.items() if name != "goals"}


@dataclass(frozen=True)
class Question:
    """A question to a person that is worth its cost; `Assistant.answer` takes the answer.

    Attributes
    ----------
    person : str
    goal : str or None
        The robot asks "is this your goal?"; None if it asks "what did you do last?".
    options : tuple of str
        The actions that the person may have taken last, the most probable first.
    worth : float
        Worth of the answer minus the cost of the question, in cost units.
    """

    person: str
    goal: str | None
    options: tuple[str, ...]
    worth: float

    @property
    def kind(self) -> str:
        """What is asked about: "goal" or "action"."""
        return "action" if self.goal is None else "goal"

    def as_dict(self) -> dict[str, Any]:
        """Return the question as plain data."""
        return {"person": self.person, "goal": self.goal, "options": list(self.options), "worth": self.worth}


@dataclass(frozen=True)
class Advice:
    """The next step of the robot.

    Attributes
    ----------
    person : str or None
        The person to whom the robot goes; None if no suggestion is worth its cost.
    suggestion : str or None
        The action that the robot suggests to this person, in PDDL; None while it is on its way or only waits there.
    reason : Reason or None
        None if `person` is None.
    arrived : bool
        Whether the robot is there. If travel takes time, it is False until `Assistant.arrived` is called.
    question : Question or None
        What the robot asks anybody of the team before that, if the setting has a cost of questions (`c_ask`). With
        several robots it is in the advice of the first.
    """

    person: str | None
    suggestion: str | None
    reason: Reason | None
    arrived: bool
    question: Question | None = None

    def asking(self, question: Question | None) -> Advice:
        """Return the advice with a question, and with the same source of its explanation."""
        if question is None:
            return self
        return replace(self, question=question).explained_by(vars(self)["_source"])

    def explained_by(self, source: Callable[[], Explanation]) -> Advice:
        """Set the function that computes `explanation` on first use; return the advice."""
        vars(self)["_source"] = source
        return self

    @cached_property
    def explanation(self) -> Explanation:
        """The explanation of the decision, at the time of the decision; computed on first use.

        Raises
        ------
        ValueError
            The advice is from a record. `Assistant.explain` explains what is suggested now.
        """
        source = vars(self).pop("_source", None)
        if source is None:
            raise ValueError("this advice is from a record, and has no explanation; `Assistant.explain` gives one")
        return source()

    def as_dict(self) -> dict[str, Any]:
        """Return the advice as plain data; a question only if there is one."""
        plain: dict[str, Any] = {name: getattr(self, name) for name in ("person", "suggestion", "reason", "arrived")}
        plain["reason"] = None if self.reason is None else self.reason.as_dict()
        return plain if self.question is None else plain | {"question": self.question.as_dict()}

    def __getstate__(self) -> dict[str, Any]:
        return {one.name: getattr(self, one.name) for one in fields(self)}


@dataclass(frozen=True)
class PersonState:
    """The state of one person of a live team, and the belief about the person.

    Attributes
    ----------
    person : str
    present : bool
        Whether the person is in the team; people who have left can return.
    finished : bool
        Whether the goal of the person's task has been reached; if it is one of several, whether it probably has.
    state : int
        State of the task, as its `CostToGo` numbers it.
    applicable : tuple of str
        The applicable actions, in PDDL.
    suggestion : str or None
        The open suggestion: what has been suggested since the person's last action.
    cost_to_go : float
        Exact, in cost units; infinite in a dead end. That of the most probable goal if there are several.
    steps : int
        Number of the person's actions in this task.
    grid : Grid
        The values of beta and theta that the belief distinguishes.
    hidden : HiddenType
        The types that the belief distinguishes.
    belief : float array, shape (H, T)
        Probability of each type and theta.
    goals : mapping of str to float
        Probability of each goal, if the person pursues one of several.
    states : mapping of int to float
        Probability of each possible task state, if actions are uncertain; `state` is then the most probable one.
    question : Question or None
        The open question to the person.
    answered : pair of str and bool, or None
        The last answer about the goal of this task: the goal, and whether it is the person's.
    """

    person: str
    present: bool
    finished: bool
    state: int
    applicable: tuple[str, ...]
    suggestion: str | None
    cost_to_go: float
    steps: int
    grid: Grid
    hidden: HiddenType
    belief: Floats
    goals: Mapping[str, float] = field(default_factory=dict)
    states: Mapping[int, float] = field(default_factory=dict)
    question: Question | None = None
    answered: tuple[str, bool] | None = None

    def __post_init__(self) -> None:
        self.belief.flags.writeable = False

    @property
    def beta(self) -> Spread:
        """The belief about the person's expertise beta: its mean and interval."""
        return self.grid.spreads(self.belief, self.hidden)[0]

    @property
    def theta(self) -> Spread:
        """The belief about the robot's influence theta on the person: its mean and interval."""
        return self.grid.spreads(self.belief, self.hidden)[1]
