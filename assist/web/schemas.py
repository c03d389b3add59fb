"""Answers of the live assistant's HTTP interface: their fields. Requests follow from the classes of events."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

from pydantic import Field

from ..declare.declared import AnyNumber, AnyText, Truth, View, Whole, declared
from ..live.explanation import Explanation
from ..live.views import MemberView, Outlook, PersonView
from ..studies.userstudy.views import EnrolledView


@declared
class Problem(View):
    """The reason for a refusal."""

    detail: AnyText


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


@declared
class Reloaded(View):
    """What reading the configuration again has changed."""

    changes: Annotated[Whole, Field(description="Number of changes: of distances, and of people's tasks.")]
    restart: Annotated[
        tuple[AnyText, ...], Field(description="Other changed fields of the file, for which a restart is needed.")
    ]
    new_session: Annotated[
        tuple[AnyText, ...],
        Field(description="Other changed fields of the file, for which a new session is needed, in another folder."),
    ]


@declared(kw_only=True)
class Me(View):
    """The owner of a token."""

    person: AnyText | None
    operator: Truth


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


@declared(kw_only=True)
class Explained(Explanation):
    """Why there is this suggestion for this person now, or none, by the latest decision: sentences, and their data."""

    sentences: tuple[AnyText, ...] = field()  # type: ignore[assignment]  # no longer a method
    seq: Whole


@declared(kw_only=True)
class Place(PersonView):
    """The view of a person who joined, and the address of the person's page."""

    join: AnyText


@declared(kw_only=True)
class Member(MemberView):
    """A person of the team as the operator sees them."""

    connected: Annotated[Truth, Field(description="Whether a page or a program follows the person's view.")]
    simulated: Annotated[Truth, Field(description="Whether the person is simulated.")]
    join: Annotated[AnyText, Field(description="The person's link.")]


@declared(kw_only=True)
class Attending(EnrolledView):
    """A participant of a user study as the operator sees them: their progress, without beliefs."""

    connected: Truth
    join: AnyText


@declared(kw_only=True)
class Team(Outlook):
    """The operator's view of the team."""

    time: Annotated[AnyNumber, Field(description="Seconds since the session began, as in `history`.")]
    problems: Annotated[
        tuple[AnyText, ...], Field(description="What keeps events from being saved or delivered, as in `/api/health`.")
    ] = ()
    tasks: Annotated[tuple[AnyText, ...], Field(description="The names of the tasks that people may have.")]
    people: Annotated[tuple[Member | Attending, ...], Field(description="The people who are present.")]
