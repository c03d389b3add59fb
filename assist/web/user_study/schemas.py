"""Requests and answers of a user study over HTTP, beside its events: their fields and allowed values."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from ...studies.userstudy.views import Progress


class Visit(BaseModel):
    """A visitor who joins the study."""

    model_config = ConfigDict(extra="forbid", strict=True)

    id: str = Field(
        min_length=1,
        max_length=128,
        description="Chosen by the visitor's browser. A repeated id returns the same participant.",
    )
    key: str | None = Field(
        None, min_length=16, max_length=128,
        description="Drawn by the browser; required for an id 'participant ID' without a signature.",
    )  # fmt: skip
    signature: str | None = Field(None, max_length=128, description="Signature of the id, from a signed link.")
    simulated: bool = Field(False, description="Whether this is a rehearsal's simulated participant.")


class Identified(BaseModel):
    """Ids of participants in another system."""

    participants: list[Annotated[str, Field(min_length=1, max_length=100)]] = Field(max_length=1000)


class Links(BaseModel):
    """A signed join link for each participant, valid on any device."""

    links: dict[str, str]


class Withdrawal(BaseModel):
    """A participant's withdrawal code, the address at which it is entered, and the last day for it."""

    code: str
    address: str
    until: str | None


class Withdrawn(BaseModel):
    """A withdrawal code."""

    code: str = Field(min_length=1, max_length=64, examples=["P-2B4C6D-23456789"])


class Done(BaseModel):
    """The request has been carried out."""

    done: bool


class Seat(BaseModel):
    """An admitted participant, and the path of the participant's page within the service."""

    person: str
    part: str
    study: Progress
