"""The robot's next step: the person to whom it goes, its suggestion, the reason in numbers, and what it asks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Annotated, Any

from pydantic import Field

from ..declare.declared import AnyNumber, AnyText, Seldom, Truth, View, Whole, declared
from ..people.belief import Grid
from ..people.decision import Floats
from ..people.hidden_type import HiddenType
from ..people.spread import Spread
from .explanation import Explanation


@declared
class Reason(View):
    """The reason for helping a person: the numbers of Algorithm 1, also if the team has another policy."""

    saving: Annotated[
        AnyNumber,
        Field(
            description=(
                "Increase of the person's expected discounted return by the suggestion, compared with no "
                "suggestion in this step, in cost units. The cost of the suggestion is included. While the robot "
                "is on its way, it is that of the best suggestion at present."
            )
        ),
    ]
    moving: Annotated[AnyNumber, Field(description="Cost of going there, in cost units.")]
    score: Annotated[AnyNumber, Field(description="`saving` minus `moving`.")]
    beta: Annotated[AnyNumber, Field(description="Mean of the belief about the person's expertise.")]
    beta_interval: Annotated[
        tuple[AnyNumber, AnyNumber], Field(description="Interval that contains 90 % of the belief, and its mean.")
    ]
    theta: Annotated[AnyNumber, Field(description="Mean of the belief about the robot's influence on the person.")]
    theta_interval: Annotated[
        tuple[AnyNumber, AnyNumber], Field(description="Interval that contains 90 % of the belief, and its mean.")
    ]
    suggestions: Annotated[
        Whole, Field(description="Number of suggestions that the person has answered in this task.")
    ] = 0
    followed: Annotated[Whole, Field(description="Number of those that were followed.")] = 0
    follow: Annotated[
        AnyNumber, Field(description="Probability that the person follows this suggestion, under the belief.")
    ] = 0.0
    follow_interval: Annotated[
        tuple[AnyNumber, AnyNumber],
        Field(
            description=(
                "Central interval with 90 % of the belief in the probability of following, and its mean; each pair of "
                "beta and theta stands for the probabilities around its own."
            )
        ),
    ] = (0.0, 1.0)
    goals: Annotated[
        dict[str, AnyNumber],
        Seldom(),
        Field(description="Probability of each goal, if the person pursues one of several."),
    ] = field(default_factory=dict, hash=False)


@declared
class Question(View):
    """A question to a person that is worth its cost; `Assistant.answer` takes the answer."""

    person: Annotated[AnyText, Field(description="Who is asked.")]
    goal: Annotated[
        AnyText | None,
        Field(description='The robot asks "is this your goal?"; None if it asks "what did you do last?".'),
    ]
    options: Annotated[
        tuple[AnyText, ...],
        Field(description="The actions that the person may have taken last, the most probable first."),
    ]
    worth: Annotated[
        AnyNumber,
        Field(
            description="Worth of the answer minus the cost of the question, in cost units. What an answer about a "
            "goal saves counts with the share of a robot's attention that each person at work gets."
        ),
    ]

    @property
    def kind(self) -> str:
        """What is asked about: "goal" or "action"."""
        return "action" if self.goal is None else "goal"


@declared
class Advice(View):
    """The next step of the robot."""

    person: Annotated[
        AnyText | None, Field(description="The person to whom the robot goes; None if no suggestion is worth its cost.")
    ]
    suggestion: Annotated[
        AnyText | None,
        Field(
            description=(
                "The action that the robot suggests to this person, in PDDL; None while it is on its way or only "
                "waits there."
            )
        ),
    ]
    reason: Annotated[Reason | None, Field(description="None if `person` is None.")]
    arrived: Annotated[
        Truth,
        Field(
            description=(
                "Whether the robot is there. If travel takes time, it is False until `Assistant.arrived` is called."
            )
        ),
    ]
    question: Annotated[
        Question | None,
        Seldom(),
        Field(
            description=(
                "What the robot asks anybody of the team before that, if the setting has a cost of questions "
                "(`c_ask`). With several robots it is in the advice of the first."
            )
        ),
    ] = None

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
