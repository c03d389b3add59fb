"""What is sent to the live assistant over HTTP, and what it answers: the fields, and what they may be."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from ..live.advice import Reason

Id = Annotated[
    str | None,
    Field(min_length=1, max_length=128, description="Made by the client; repeated, the answer is the first."),
]
Action = Annotated[str, Field(min_length=1, max_length=1000, examples=["(fetch box-a)"])]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class Acted(_Body):
    """What somebody did."""

    action: Action
    id: Id = None
    followed: bool | None = Field(None, description="Whether the suggestion was followed; null: not said.")
    seq: int | None = Field(
        None, ge=0, description="Of what the person saw when they acted: a later suggestion was not heard."
    )


class Once(_Body):
    """Something that happens once."""

    id: Id = None


class Begun(Once):
    """The beginning of a task, the same again unless named."""

    task: str | None = Field(None, max_length=200)


class Joined(Begun):
    """Somebody who comes, or comes back."""

    person: str = Field(min_length=1, max_length=64, examples=["ann"])


class Arrived(Once):
    """Where the robot is: with somebody, or at its base (null)."""

    person: str | None = Field(None, max_length=64)


class Paused(_Body):
    """Whether the robot says nothing."""

    paused: bool


class Problem(BaseModel):
    """Why something was refused."""

    detail: str


class Health(BaseModel):
    """Whether the service is well."""

    status: str
    people: int
    events: int


class Me(BaseModel):
    """Whose the token is."""

    person: str | None
    operator: bool


class Person(BaseModel):
    """What somebody sees. `seq` grows whenever it changes; `cost_to_go` is null in a dead end."""

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
    seq: int


class Wanted(BaseModel):
    """A part of the goal, in words."""

    text: str
    done: bool


class Drawn(BaseModel):
    """Somebody's task as it is: a drawing, the same in words, the goal, and what applicable actions are called."""

    svg: str
    text: str
    goal: list[Wanted]
    words: dict[str, str]
    seq: int


class Place(BaseModel):
    """Somebody who has come, with the address of their page."""

    person: str
    join: str
    seq: int


class Robot(BaseModel):
    """Where the robot is to be and what it says there; `location` is where it is, or to whom it is under way."""

    person: str | None
    suggestion: str | None
    reason: Reason | None
    arrived: bool
    location: str | None
    seq: int


class Member(Person):
    """What the operator sees of somebody: low end, mean and high end of beta and theta, and all of the belief.

    Of participants of a user study, who are in teams of their own, these are not shown.
    """

    history: list[tuple[float, float | None]] = Field(default_factory=list)
    beta: tuple[float, float, float] | None = None
    theta: tuple[float, float, float] | None = None
    grid: dict[str, list[float]] | None = None
    belief: list[list[float]] | None = None
    connected: bool
    simulated: bool
    join: str


class Team(BaseModel):
    """What the operator sees. `fault` says why the policy could not decide, if it could not."""

    seq: int
    time: float
    paused: bool
    fault: str | None
    tasks: list[str]
    robot: Robot
    log: list[dict[str, Any]]
    people: list[Member]
