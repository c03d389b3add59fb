"""Requests and answers of a user study over HTTP, beside its events: their fields and allowed values."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ...declare.declared import AnyText, Truth, View, Whole, declared
from ...live.event_base import Recorded
from ...studies.userstudy.views import Progress


class Visit(Recorded):
    """A visitor who joins the study."""

    id: str = Field(min_length=1, max_length=128)
    """Chosen by the visitor's browser. A repeated id returns the same participant."""
    key: str | None = Field(None, min_length=16, max_length=128)
    """Drawn by the browser; required for an id 'participant ID' without a signature."""
    signature: str | None = Field(None, max_length=128)
    """Signature of the id, from a signed link."""
    simulated: bool = False
    """Whether this is a rehearsal's simulated participant."""


class Identified(Recorded):
    """Ids of participants in another system."""

    participants: list[Annotated[str, Field(min_length=1, max_length=100)]] = Field(max_length=1000)
    """The ids."""


class Withdrawn(Recorded):
    """A withdrawal code."""

    code: str = Field(min_length=1, max_length=64, examples=["P-2B4C6D-23456789"])
    """As the participant's page shows it."""


@declared
class Links(View):
    """A signed join link for each participant, valid on any device."""

    links: Annotated[dict[str, AnyText], Field(description="The links, by the ids.")]


@declared
class Withdrawal(View):
    """How a participant's data can be withdrawn later."""

    code: Annotated[AnyText, Field(description="The withdrawal code.")]
    address: Annotated[AnyText, Field(description="Where it is entered.")]
    until: Annotated[AnyText | None, Field(description="The last day for it; null without a limit.")]


@declared
class Done(View):
    """The request has been carried out."""

    done: Truth = True


@declared
class Seat(View):
    """An admitted participant."""

    person: Annotated[AnyText, Field(description="Their code.")]
    part: Annotated[AnyText, Field(description="The path of their page within the service.")]
    study: Annotated[Progress, Field(description="Where they are in the study.")]


@declared(kw_only=True)
class Enrolled(View):
    """A participant in the experimenter's overview, also one who has left."""

    code: Annotated[AnyText, Field(description="The participant's code, or the label of erased records.")]
    status: Annotated[AnyText, Field(description="As in the table `participants`.")]
    stage: Annotated[AnyText, Field(description="The name of their stage.")]
    number: Annotated[Whole, Field(description="Its number, from 1.")]
    condition: Annotated[AnyText | None, Field(description="The condition, or the order of conditions, once assigned.")]
    connected: Annotated[Truth, Field(description="Whether a page of theirs is connected.")]
    seconds: Annotated[Whole | None, Field(description="Seconds since the stage began; null for who has left.")]
    steps: Annotated[Whole | None, Field(description="Actions in their latest task; null before the first.")]
    simulated: Annotated[Truth, Field(description="Whether they are simulated, in a rehearsal.")]
    erased: Annotated[Truth, Field(description="Whether their records were erased.")]
    excluded: Annotated[AnyText | None, Field(description="Why they are excluded from the analysis.")]
    group: Annotated[AnyText | None, Field(description="Their group, once it has begun.")]


@declared(kw_only=True)
class Assigned(View):
    """A condition, or an order of conditions, in the experimenter's overview."""

    name: Annotated[AnyText, Field(description="The name.")]
    policy: Annotated[AnyText, Field(description="The policy, or the policies in their order.")]
    counting: Annotated[Whole, Field(description="Participants, or groups, who count when the next one is assigned.")]
    begun: Annotated[Whole, Field(description="Participants to whom it was assigned.")]
    done: Annotated[Whole, Field(description="Those of them who have completed the study.")]


@declared(kw_only=True)
class Overview(View):
    """The experimenter's overview of a study."""

    title: Annotated[AnyText, Field(description="The title of the study.")]
    design: Annotated[AnyText, Field(description="As `design` in the study's file.")]
    join: Annotated[AnyText, Field(description="The address at which participants join.")]
    places: Annotated[Whole | None, Field(description="Number of places; null without a limit.")]
    taken: Annotated[Whole, Field(description="Number of places that are taken.")]
    stages: Annotated[tuple[AnyText, ...], Field(description="The names of all stages.")]
    conditions: tuple[Assigned, ...]
    participants: tuple[Enrolled, ...]
    events: Annotated[Whole, Field(description="Number of events.")]
    fault: Annotated[AnyText | None, Field(description="The error of a policy after the last event, if it failed.")]
    problems: Annotated[tuple[AnyText, ...], Field(description="What keeps events from being saved.")]
