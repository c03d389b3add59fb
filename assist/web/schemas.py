"""Answers of the live assistant's HTTP interface: their fields. Requests follow from the classes of events."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, Field

from ..live.advice import Question, Reason
from ..live.contrast import Contrast
from ..live.explanation import WhyNothing, WhyPerson, WhyStep


class Erased(BaseModel):
    """What remains of a person whose records were erased: a label, the time (UTC), and the reason."""

    label: str
    at: str
    reason: str
    events: int


class Problem(BaseModel):
    """The reason for a refusal."""

    detail: str


class Health(BaseModel):
    """The state of the service."""

    status: str
    ready: bool
    reasons: list[str] = Field(description="Why the service is not ready: what is not connected, or cannot be saved.")
    people: int
    events: int


class Reloaded(BaseModel):
    """What reading the configuration again has changed."""

    changes: int = Field(description="Number of changes: of distances, and of people's tasks.")
    ignored: list[str] = Field(description="Changed fields of the file for which a restart is needed.")


class Me(BaseModel):
    """The owner of a token."""

    person: str | None
    operator: bool


class GoalAnswer(BaseModel):
    """A person's answer to "is this your goal?"."""

    goal: str
    yes: bool


class Person(BaseModel):
    """A person's view. `seq` increases with every change.

    `cost_to_go` is null in a dead end, and for participants unless the study shows it.
    """

    person: str
    task: str
    present: bool
    paused: bool
    applicable: list[str]
    suggestion: str | None
    reason: Reason | None
    cost_to_go: float | None
    steps: int
    finished: bool
    explained: bool = Field(description="Whether the explanation can be asked for.")
    seq: int
    state_probability: float | None = Field(
        None, description="Probability of the state that is shown, the most probable one, after doubtful actions."
    )
    question: Question | None = Field(None, description="The open question to the person, if there is one.")
    answered: GoalAnswer | None = Field(None, description="The last answer about the goal of this task, if any.")


class Wanted(BaseModel):
    """One condition of the goal, in words."""

    text: str
    done: bool


class Drawn(BaseModel):
    """The present state of a person's task: a drawing, a description, the goal, and the applicable actions in words."""

    svg: str
    text: str
    goal: list[Wanted]
    words: dict[str, str]
    language: str = Field(description="The tag of the language of these texts.")
    seq: int


class Explained(BaseModel):
    """Why there is this suggestion for this person now, or none: sentences, and their data."""

    sentences: list[str]
    step: WhyStep | None
    now: WhyPerson | None
    nothing: WhyNothing | None
    against: Contrast | None
    state_probability: float = Field(1.0, description="Probability of the task state for which steps are compared.")
    seq: int


class Place(BaseModel):
    """A person who joined, and the address of the person's page."""

    person: str
    join: str
    seq: int


class Robot(BaseModel):
    """Where the robot should be and what it suggests there. `location` is where it is, or where it is going."""

    person: str | None
    suggestion: str | None
    reason: Reason | None
    arrived: bool
    location: str | None
    seq: int
    questions: list[Question] = Field(
        default_factory=list, description="The open questions, in the first robot's view."
    )


class Member(Person):
    """The operator's view of a person: interval and mean of beta and theta, and the whole belief.

    `goals` has the probability of each goal, if the person pursues one of several.
    Participants of a user study are in teams of their own; for them the fields of the belief are omitted.
    """

    history: list[tuple[float, float | None]] = Field(default_factory=list)
    beta: tuple[float, float, float] | None = None
    theta: tuple[float, float, float] | None = None
    grid: dict[str, list[float]] | None = None
    belief: list[list[float]] | None = None
    connected: bool
    simulated: bool
    goals: dict[str, float] | None = None
    sees: dict[str, float] | None = Field(
        None, description="Whom the person sees being helped, with the weight of each, if that moves theta."
    )
    join: str


class Team(BaseModel):
    """The operator's view of the team. `fault` is the policy's error message if the policy failed."""

    seq: int
    time: float
    paused: bool
    fault: str | None
    problems: list[str] = Field(
        default_factory=list, description="What keeps events from being saved or delivered, as in `/api/health`."
    )
    tasks: list[str]
    robots: list[Robot]
    log: list[dict[str, Any]]
    people: list[Member]
