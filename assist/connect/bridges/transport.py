"""A transport: the part of a bridge that knows a protocol, and what passes between it and the kernel.

A transport connects (`connect`), yields what it receives (`messages`) and sends contents (`send`). What goes where
can be left as it is here, or follow settings: `advice`, `answer` and `instruction` turn what the service tells into
outputs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from ...declare.declared import AnyText, Seldom, View, Whole, declared
from ...declare.refusals import Refusal
from .messages import BridgeSettings, Fields, Report, Source, text_of


def nothing() -> None:
    """Do nothing."""


@dataclass(frozen=True)
class Message:
    """A message that is no report, such as one of an old subscription; it is acknowledged, and that is all.

    Attributes
    ----------
    done : callable
        Acknowledges the message to its sender.
    """

    done: Callable[[], object] = field(default=nothing, kw_only=True)


@declared
class Answer(View):
    """The answer to a report; a sender is told all but the person and the origin."""

    person: Annotated[AnyText | None, Field(exclude=True, description="Who reported.")]
    id: Annotated[AnyText | None, Field(description="That of the report.")]
    status: Annotated[Literal["recorded", "refused"], Field(description="What became of it.")]
    detail: Annotated[AnyText | None, Seldom(), Field(description="Why it was refused.")] = None
    seq: Annotated[Whole | None, Seldom(), Field(description="Number of the view that includes it.")] = None
    number: Annotated[Whole | None, Seldom(), Field(description="Its place among the reports of this person.")] = None
    next: Annotated[Whole | None, Seldom(), Field(description="The number that is expected next.")] = None
    origin: Annotated[
        AnyText | None, Field(exclude=True, description="What the transport said of where the report came from.")
    ] = None


@dataclass(frozen=True)
class Reported(Message):
    """A report of an event.

    Attributes
    ----------
    report : Report
    origin : str or None
        Handed on to the answer.
    answered : callable or None
        Called with the answer, in place of `Transport.answer`.
    """

    report: Report
    origin: str | None = None
    answered: Callable[[Answer], object] | None = None


@dataclass(frozen=True)
class Faulty(Message):
    """A message that reports nothing usable.

    Attributes
    ----------
    why : str
        What is wrong with it.
    person, id : str or None
        As far as they are known.
    origin : str or None
        Handed on to the answer.
    """

    why: str
    person: str | None = None
    id: str | None = None
    origin: str | None = None


@dataclass(frozen=True)
class Located(Message):
    """The location of a robot.

    Attributes
    ----------
    robot : int
        Its number, from 1.
    person : str or None
        Where it is; None at its base.
    id : str or None
        Of the message; a repeated id changes nothing.
    """

    robot: int
    person: str | None
    id: str | None = None


@dataclass(frozen=True)
class Resumed(Message):
    """The number of the next report, as the last answer to a person said it; a broker has kept it.

    Attributes
    ----------
    person : str
    next : int
        The number.
    """

    person: str
    next: int


@dataclass(frozen=True)
class Kept(Message):
    """The other side keeps advice to a person, perhaps of an earlier session; it is removed if they are not present.

    Attributes
    ----------
    person : str
    """

    person: str


@dataclass(frozen=True)
class Drove(Message):
    """A robot has ended a drive that `Transport.drive` began, with success or not.

    Attributes
    ----------
    id : str
        Of the drive.
    reached : bool
        Whether the robot has reached its goal.
    why : str
        Why not.
    """

    id: str
    reached: bool
    why: str = ""


@dataclass(frozen=True)
class Output:
    """What is to be sent.

    Attributes
    ----------
    key : str
        Where it is sent: a topic, a node.
    content : object
        None removes what was sent there before.
    keep : bool
        Whether it stands for the present state of something. It then replaces what still waits there, and is sent again
        after each reconnection.
    passing : bool
        Whether it is forgotten if the connection is lost before it was sent.
    """

    key: str
    content: Any
    keep: bool = False
    passing: bool = False


class Transport(ABC):
    """A protocol that a bridge connects to the service.

    Attributes
    ----------
    name : str
        Its name in messages and metrics.
    reads : type
        The class of its settings, from a file; they and the number of robots make the transport.
    counts : Counter
        Numbers of `messages`, of reports `recorded` and `refused`, of `connections` and of contents `published`; and
        whatever else the transport counts.
    lost : tuple of type
        Errors that mean that there is no connection.
    robots : int
        Number of robots that are instructed; 0 if none are.
    wait : float
        Seconds for which later reports of a person wait for an earlier number.
    at_once : int
        Contents that are sent at a time.
    again : float or None
        Seconds after which what is kept is sent again, to those who have joined meanwhile.
    drives : bool
        Whether robots are sent by `drive`, and not by their instructions alone.
    """

    name: str
    settings: BridgeSettings
    reads: ClassVar[type[BridgeSettings]]
    lost: tuple[type[Exception], ...] = (OSError,)
    robots = 0
    wait = 10.0
    at_once = 1
    again: float | None = None
    drives = False

    def __init__(self) -> None:
        self.counts = Counter[str]()
        self.session = ""  # identifies the session of the service; set by the bridge

    # What each transport has.

    @abstractmethod
    def connect(self) -> AbstractAsyncContextManager[object]:
        """Connect, and subscribe to what is observed, until the context is left."""

    @abstractmethod
    def messages(self) -> AsyncIterator[Message]:
        """Yield what is received, until the connection is lost."""

    @abstractmethod
    async def send(self, key: str, content: Any) -> None:
        """Send a content, and return when it has arrived."""

    # What goes where.

    def address(self) -> str:
        """Return where it connects to, for messages."""
        return self.name

    def reported(
        self, source: Source, read: Callable[[], Fields], known: Fields | None = None, **more: Any
    ) -> Message:  # fmt: skip
        """Return what a message reports, given how its fields are read; those of its topic are known before."""
        fields = known or {}
        try:
            fields = read()
            return Reported(source.report(fields, self.settings.names), **more)
        except Refusal as error:
            return Faulty(str(error), text_of(fields.get("person")), text_of(fields.get("id")), **more)

    def initially(self) -> Iterable[Output]:
        """Yield what is sent before the service has told anything."""
        return ()

    def advice(self, person: str, view: Mapping[str, Any] | None) -> Iterable[Output]:
        """Yield what is sent after a person's view has changed, or, with None, when they have left."""
        yield Output(f"advice/{person}", view, keep=True)

    def answer(self, answer: Answer) -> Iterable[Output]:
        """Yield what is sent as the answer to a report."""
        yield Output(f"answers/{answer.person}", answer.as_dict())

    def instruction(self, robot: int, errand: Mapping[str, Any]) -> Iterable[Output]:
        """Yield what is sent after the instruction of a robot has changed."""
        yield Output(f"robots/{robot}", errand, keep=True)

    def forget(self, person: str) -> Iterable[Output]:
        """Yield what removes the answers to a person who has left, if the other side keeps them."""
        return ()

    def drive(self, robot: int, person: str | None, id: str) -> Iterable[Output]:
        """Yield what sends a robot to a person, or with None what cancels the drive of this id.

        Raises
        ------
        Refusal
            The robot cannot be sent there.
        """
        return ()
