"""Answers of the live assistant's HTTP interface: their fields. Requests follow from the classes of events."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, Field, SkipValidation

from ..declare.declared import AnyText, Truth, declared
from ..live.contrast import Contrast
from ..live.explanation import WhyNothing, WhyPerson, WhyStep
from ..live.views import MemberView, PersonView, RobotView


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


@declared(kw_only=True)
class Member(MemberView):
    """A person of the team as the operator sees them."""

    connected: Truth
    simulated: Truth
    join: AnyText


@declared(kw_only=True)
class Attending(PersonView):
    """A participant of a user study as the operator sees them: their progress, without beliefs."""

    status: AnyText
    condition: AnyText | None = None
    study: Annotated[dict[str, Any], SkipValidation()]
    connected: Truth
    simulated: Truth
    join: AnyText


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
    robots: list[RobotView]
    log: list[dict[str, Any]]
    people: list[Member | Attending]
