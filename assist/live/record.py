"""The record of an event: what happened, when, and what the robots decided then."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeVar

from pydantic import (
    AfterValidator,
    Field,
    PlainValidator,
    SerializeAsAny,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
)

from planner.system.errors import InputFileError

from ..declare.declared import Number, Whole
from .advice import Advice
from .event_base import Event, Recorded, TeamEvent, fault_of
from .events import kinds

E = TypeVar("E", bound=Event)

FIRST = "1.0"
"""The version whose sessions are files of lines."""


def event_of(base: type[E], given: Any) -> E:
    """Return an event below a class: the given one, or that of data from JSON, whose field `kind` names its class.

    Raises
    ------
    ValueError
        There is no such kind, or the data are not those of its events.
    """
    if isinstance(given, base):
        return given
    every = kinds(base)
    kind = given.get("kind") if isinstance(given, dict) else None
    if kind not in every:
        raise ValueError(f"{str(kind)[:40]!r} is no kind of event; expected one of {', '.join(sorted(every))}")
    try:
        found: E = every[kind].model_validate_json(json.dumps(given))
    except ValidationError as error:
        raise ValueError(fault_of(every[kind], error, given)) from None
    return found


class Record(Recorded):
    """The record of an event of a live session."""

    n: Whole = Field(ge=1)
    """Number of the event, from 1."""
    time: Number = 0.0
    """Seconds since the session began."""
    event: Any
    """What happened."""

    format: ClassVar[str]
    """Format identifier of the sessions that have such records."""

    @classmethod
    def of(cls, text: str) -> Self:
        """Return the record that `text` wrote.

        Raises
        ------
        ValueError
            It is no record. The message is one line.
        """
        try:
            return cls.model_validate_json(text)
        except ValidationError as error:
            raise ValueError(fault_of(cls, error, text)) from None

    @property
    def begins_for_others(self) -> bool:
        """Whether others begin something by it, so that its time is theirs, too."""
        return False

    def text(self) -> str:
        """Return the record as JSON."""
        return self.model_dump_json()

    def touched(self) -> set[str]:
        """Return the people whose views the event has changed, apart from events that concern everybody."""
        event: Event = self.event
        return set() if event.who is None else {event.who}


def _for_somebody(advices: tuple[Advice, ...]) -> tuple[Advice, ...]:
    if any(one.person is None and (one.suggestion or one.reason) for one in advices):
        raise ValueError("advice for nobody")
    return advices


RecordedEvent = Annotated[SerializeAsAny[TeamEvent], PlainValidator(partial(event_of, TeamEvent))]


class TeamRecord(Record):
    """The record of an event of a team."""

    event: RecordedEvent
    """What happened."""
    caused: tuple[RecordedEvent, ...] = ()
    """What it caused for others; empty for most."""
    step: Whole = Field(ge=0)
    """Number of decisions of the robots, this one included."""
    advices: Annotated[tuple[Advice, ...], AfterValidator(_for_somebody)] = ()
    """The advice of each robot after the event; empty if it is the same as before, or nothing was decided."""
    fault: str | None = None
    """Why the policy decided nothing after the event; none unless it failed."""

    format: ClassVar[str] = "kitassist session 4"

    @model_serializer(mode="wrap")
    def _short(self, given: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {
            name: value for name, value in given(self).items() if value or name not in ("advices", "caused", "fault")
        }

    def touched(self) -> set[str]:
        """Return the people whose views the event and the decision have changed."""
        asked = {one.question.person for one in self.advices if one.question is not None}
        return super().touched() | asked | {one.person for one in self.advices if one.person is not None}

    def without(self, person: str, label: str, before: float) -> Self:
        """Return what remains of the record when a person's records are erased.

        The robots' course remains: where they went, and what they suggested to others. The label stands for the person.

        Parameters
        ----------
        person, label : str
        before : float
            Time of the event before: the person's own times are theirs.
        """
        changes: dict[str, Any] = {}
        if self.event.who == person:
            caused = tuple(one.remains(label) for one in self.caused)
            changes = {"event": self.event.remains(label), "caused": caused, "time": before}
        return self.model_copy(
            update={**changes, "advices": tuple(_unnamed(one, person, label) for one in self.advices)}
        )

    def entries(self, advices: tuple[Advice, ...]) -> Iterator[dict[str, Any]]:
        """Yield what the operator's list shows: the event, if people notice it, and the questions and suggestions."""
        entry: dict[str, Any] = {"n": self.n, "time": self.time, "event": self.event.kind, "person": self.event.who}
        entry |= {"action": None, "followed": None, "suggestion": None}
        if self.event.is_shown:
            yield entry | self.event.entry()
        for advice in advices:
            if advice.question is not None:
                yield entry | {"event": "asked", "person": advice.question.person, "goal": advice.question.goal}
            if advice.person is not None and advice.suggestion is not None:
                yield entry | {"event": "suggested", "person": advice.person, "suggestion": advice.suggestion}


def _unnamed(advice: Advice, person: str, label: str) -> Advice:
    """Return a recorded advice without what concerns a person; the label stands for them."""
    asked = None if advice.question is not None and advice.question.person == person else advice.question
    if advice.person == person:
        return Advice(label, None, None, advice.arrived, asked)
    return (
        advice
        if asked is advice.question
        else Advice(advice.person, advice.suggestion, advice.reason, advice.arrived, asked)
    )


def without_in_view(answer: dict[str, Any], person: str, label: str) -> dict[str, Any]:
    """Return a stored answer to somebody else, a person's or a robot's view, without what concerns a person."""
    if "questions" in answer:
        answer = answer | {"questions": [one for one in answer["questions"] if one["person"] != person]}
    if "location" in answer and person in (answer["person"], answer["location"]):
        answer = answer | {"location": label if answer["location"] == person else answer["location"]}
        if answer["person"] == person:
            answer |= {"person": label, "suggestion": None, "reason": None}
    return answer


def require_version(file: Path, found: Mapping[str, Any], format: str) -> None:
    """Check that a saved session is not one of another version.

    Parameters
    ----------
    file : Path
    found : mapping
        Its header.
    format : str
        The format identifier of this version.

    Raises
    ------
    InputFileError
        It is; the message states which version reads it.
    """
    known = str(found.get("format", ""))
    if known != format and _kind(known) == _kind(format):
        raise _other_version(file, str(found.get("version", FIRST)))


def require_database(journal: Path) -> None:
    """Check that no session of the first version, a file of lines, stands where a database is expected.

    Raises
    ------
    InputFileError
        It does; the message states which version reads it.
    """
    lines = journal.with_suffix(".jsonl")
    if lines.exists() and not journal.exists():
        raise _other_version(lines, FIRST)


def _other_version(file: Path, version: str) -> InputFileError:
    return InputFileError(
        f"{file}: was recorded by kitassist {version}, and only that version reads it; expected another folder"
    )


def _kind(format: str) -> str:
    """Return a format identifier without its number."""
    return format.rpartition(" ")[0]
