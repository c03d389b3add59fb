"""Views: what is told of a person, and of a robot, to those who may see it. JSON and the HTTP schema follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from typing import Annotated, Any

from pydantic import Field, SkipValidation

from planner.system.files import finite

from ..declare.declared import AnyNumber, AnyText, Seldom, Truth, View, Whole, declared
from .advice import Question, Reason
from .lines import Line

Rows = Annotated[Sequence[Sequence[float | None]], SkipValidation()]
"""Rows of numbers, as arrays give them."""
Interval = tuple[AnyNumber, AnyNumber, AnyNumber]


@declared
class GoalAnswer(View):
    """A person's answer to "is this your goal?"."""

    goal: AnyText
    yes: Truth


@declared(kw_only=True)
class PersonView(View):
    """A person's view."""

    person: Annotated[AnyText, Field(description="The name of the person.")]
    task: Annotated[AnyText, Field(description="The name of the person's task.")] = ""
    present: Annotated[Truth, Field(description="Whether the person is in the team.")]
    paused: Annotated[
        Truth, Line(person="task.paused"), Field(description="Whether the robots make no suggestions at present.")
    ] = False
    applicable: Annotated[tuple[AnyText, ...], Field(description="The actions that are possible now, in PDDL.")] = ()
    suggestion: Annotated[
        AnyText | None, Line(operator="Suggested: {value}"), Field(description="The open suggestion, in PDDL.")
    ] = None
    reason: Annotated[
        Reason | None,
        Field(description="Why, in the numbers of the decision, or of the undo by which it is open again."),
    ] = None
    cost_to_go: Annotated[
        AnyNumber | None,
        Field(
            description="Exact, in cost units; of several goals, that of the most probable one. Null in a dead end, "
            "and for participants unless the study shows it."
        ),
    ] = None
    steps: Annotated[Whole, Field(description="Number of the person's actions in this task.")] = 0
    finished: Annotated[
        Truth,
        Field(
            description="Whether the goal of the task is reached, or probably is, where goal or state are uncertain."
        ),
    ] = False
    explained: Annotated[Truth, Field(description="Whether the explanation can be asked for.")] = False
    seq: Annotated[
        Whole,
        Field(
            description="Number of the last event that changed the view; the larger of two is newer. It may fall "
            "when the records of a neighbour are erased."
        ),
    ] = 0
    state_probability: Annotated[
        AnyNumber | None, Seldom(),
        Field(description="Only after doubtful actions: probability of the state that is shown, the likeliest one."),
    ] = None  # fmt: skip
    question: Annotated[
        Question | None, Seldom(), Field(description="Only if one is open: the question to the person.")
    ] = None
    answered: Annotated[
        GoalAnswer | None,
        Seldom(),
        Field(description="Only if there is one: the last answer about the goal of the task."),
    ] = None
    done: Annotated[
        dict[str, Whole], Seldom(),
        Field(description="Only if there are any: how many events that pages show `undo` takes back, by their kind."),
    ] = field(default_factory=dict)  # fmt: skip

    @property
    def remaining(self) -> float | None:
        """The cost-to-go; None in a dead end."""
        return None if self.cost_to_go is None else finite(self.cost_to_go)


@declared(kw_only=True)
class MemberView(PersonView):
    """The operator's view of a person: what the robots believe of them, beside what the person sees."""

    history: Annotated[
        Rows,
        Field(description="Time and cost-to-go after each event of the person in this task; null in a dead end."),
    ]
    beta: Annotated[
        Interval, Field(description="Expertise: low end, mean and high end of what contains 90 % of the belief.")
    ]
    theta: Annotated[Interval, Field(description="Influence of the robot, in the same way.")]
    grid: Annotated[
        dict[str, list[float]],
        SkipValidation(),
        Field(description="The values of `beta` and of `theta` that the belief is about."),
    ]
    belief: Annotated[
        Rows, Field(description="Probability of each pair of them: a row for each beta, a column for each theta.")
    ]
    goals: Annotated[
        dict[str, AnyNumber],
        Seldom(),
        Field(description="Probability of each goal, if the person pursues one of several."),
    ] = field(default_factory=dict)
    sees: Annotated[
        dict[str, AnyNumber], Seldom(), Line(operator="Sees: {value}"),
        Field(description="Whom the person sees being helped, with the weight of each, if that moves theta."),
    ] = field(default_factory=dict)  # fmt: skip


@declared(kw_only=True)
class RobotView(View):
    """Where the robot should be and what it suggests there."""

    person: Annotated[
        AnyText | None, Field(description="With whom it should be; null if nothing is to be suggested.")
    ] = None
    suggestion: Annotated[AnyText | None, Field(description="What it suggests there, in PDDL.")] = None
    reason: Annotated[Reason | None, Field(description="Why, in the numbers of the decision.")] = None
    arrived: Annotated[Truth, Field(description="Whether it is there already.")] = True
    location: Annotated[
        AnyText | None, Field(description="With whom it is, or to whom it is going; null at its base.")
    ] = None
    seq: Annotated[Whole, Field(description="Number of events.")]
    questions: Annotated[
        tuple[Question, ...], Seldom(), Field(description="The open questions, in the first robot's view.")
    ] = ()


@declared(kw_only=True)
class Outlook(View):
    """The team's part of the operator's view."""

    seq: Annotated[Whole, Field(description="Number of events.")]
    paused: Annotated[Truth, Field(description="Whether the robots make no suggestions at present.")]
    fault: Annotated[AnyText | None, Field(description="The policy's error after the last event, if it failed.")]
    robots: Annotated[
        tuple[RobotView, ...],
        SkipValidation(),
        Field(description="Where each robot is to be, and its suggestion there."),
    ]
    log: Annotated[
        tuple[dict[str, Any], ...], SkipValidation(), Field(description="The latest events, the oldest first.")
    ]
