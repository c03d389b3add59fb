"""Answers of the live assistant's HTTP interface: their fields. Requests follow from the classes of events."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field

from ..declare.declared import AnyNumber, AnyText, Truth, View, Whole, declared
from ..live.contrast import Contrast
from ..live.explanation import WhyNothing, WhyPerson, WhyStep
from ..live.views import MemberView, Outlook, PersonView
from ..studies.userstudy.views import ParticipantView


class Problem(BaseModel):
    """The reason for a refusal."""

    detail: str


@declared(kw_only=True)
class Health(View):
    """The state of the service."""

    status: AnyText = "ok"
    ready: Truth
    reasons: Annotated[
        tuple[AnyText, ...],
        Field(description="Why the service is not ready: what is not connected, or cannot be saved."),
    ]
    people: Whole
    events: Whole


class Reloaded(BaseModel):
    """What reading the configuration again has changed."""

    changes: int = Field(description="Number of changes: of distances, and of people's tasks.")
    restart: list[str] = Field(description="Other changed fields of the file, for which a restart is needed.")
    new_session: list[str] = Field(
        description="Other changed fields of the file, for which a new session is needed, in another folder."
    )


class Me(BaseModel):
    """The owner of a token."""

    person: str | None
    operator: bool


@declared
class Wanted(View):
    """One condition of the goal, in words."""

    text: AnyText
    done: Truth


@declared(kw_only=True)
class Drawn(View):
    """The present state of a person's task: a drawing, a description, the goal, and the applicable actions in words."""

    svg: AnyText
    text: AnyText
    goal: tuple[Wanted, ...]
    words: dict[str, AnyText]
    language: Annotated[AnyText, Field(description="The tag of the language of these texts.")]
    seq: Whole


class Explained(BaseModel):
    """Why there is this suggestion for this person now, or none, by the latest decision: sentences, and their data."""

    sentences: list[str]
    step: WhyStep | None
    now: WhyPerson | None
    nothing: WhyNothing | None
    against: Contrast | None
    state_probability: float = Field(1.0, description="Probability of the task state for which steps are compared.")
    seq: int


@declared(kw_only=True)
class Place(PersonView):
    """The view of a person who joined, and the address of the person's page."""

    join: AnyText


@declared(kw_only=True)
class Member(MemberView):
    """A person of the team as the operator sees them."""

    connected: Truth
    simulated: Truth
    join: AnyText


@declared(kw_only=True)
class Attending(ParticipantView):
    """A participant of a user study as the operator sees them: their progress, without beliefs."""

    status: AnyText
    condition: AnyText | None = None
    connected: Truth
    simulated: Truth
    join: AnyText


@declared(kw_only=True)
class Team(Outlook):
    """The operator's view of the team."""

    time: AnyNumber
    problems: Annotated[
        tuple[AnyText, ...], Field(description="What keeps events from being saved or delivered, as in `/api/health`.")
    ] = ()
    tasks: tuple[AnyText, ...]
    people: tuple[Member | Attending, ...]
