"""What an event is: its fields, how it is reported, what it changes, and what remains of it.

A class declares the fields of the event, and where it is reported over HTTP. `recorded` checks that it is possible now
and completes it; `change` is what it does to a team, also when a record is applied again; `causes` says which further
events follow from it; `remains` is what is kept of it when a person's records are erased; `take_back` undoes it, which
people ask for with `Undone`. The kinds are in `assist.live.events`, and those of studies in
`assist.studies.userstudy.events`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
)

from ..declare.declared import DeclarationError, Expected, Whole
from ..declare.refusals import Refusal
from .lines import Line
from .names import name_of

if TYPE_CHECKING:
    from .desk import Desk


Name = Annotated[str, AfterValidator(name_of)]
Action = Annotated[
    str, Field(min_length=1, max_length=1000, examples=["(fetch box-a)"]), Expected("an action, as (name argument ...)")
]
Seq = Annotated[Whole, Field(ge=0)]
INTERNAL: Any = {"internal": True}
"""Marks a field that is recorded, but never reported."""


class Recorded(BaseModel):
    """Data of declared fields, which never change; others than these, and numbers such as infinity, are refused."""

    model_config = ConfigDict(
        frozen=True, strict=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True
    )

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise Refusal("other", why=fault_of(type(self), error, fields)) from None

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # data from JSON are validated as such


def fault_of(kind: type[BaseModel], error: ValidationError, given: Any) -> str:
    """Return the first fault of data for a class in one sentence: where it is, what it is, and what would be right."""
    return str(DeclarationError.of(kind, error, given))


class Event(Recorded):
    """Something that happens in a live session, of a team or of a study."""

    kind: str
    """The kind of event."""
    id: Annotated[str, Field(min_length=1, max_length=128), Expected("1 to 128 characters")] | None = None
    """Chosen by the reporter. A repeated report returns the first answer; another one with the same id is refused."""

    path: ClassVar[str | None] = None
    """Where it is reported over HTTP, by POST; None if it is not. `{person}` and `{robot}` stand for these fields."""
    by_operator: ClassVar[bool] = True
    """Whether only operators report it; otherwise also the person themselves."""
    shows: ClassVar[Literal["person", "place", "robot"]] = "person"
    """What its reporter gets then: the view of the person, also with the address of their page, or of the robot."""
    concerns_all: ClassVar[bool] = False
    """Whether it changes the views of everybody."""
    is_shown: ClassVar[bool] = True
    """Whether operators see it in the list of events."""
    ends_task: ClassVar[bool] = False
    """Whether a person's work on a task ends, so that what was learned of them is kept."""
    in_place_of_action: ClassVar[tuple[str, ...]] = ()
    """Fields that may be given where its field `action` is not."""
    is_action: ClassVar[bool] = False
    """Whether it is what a person did in their task."""
    line: ClassVar[Line | None] = None
    """What pages show while `undo` takes it back, with a button for it; {value} is how many there are in the task."""

    never_left_out: ClassVar[tuple[str, ...]] = ()
    """Fields whose value None says something, so that it is written."""

    @model_serializer(mode="wrap")
    def _given(self, given: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: value for name, value in given(self).items() if value is not None or name in self.never_left_out}

    @property
    def who(self) -> str | None:
        """The person of whom it is, if it is of one."""
        found: str | None = getattr(self, "person", None)
        return found

    @property
    def view(self) -> int | None:
        """The number of the view on which it was done, if that is reported."""
        found: int | None = getattr(self, "seq", None)
        return found

    @property
    def reporter(self) -> str:
        """Whose ids its id is one of: those of reports of its person, of a robot, or, if empty, of the team."""
        return self.who or ""

    @property
    def reported(self) -> str:
        """What was reported, as JSON: the same for a report that is repeated."""
        return self.model_dump_json(include={"kind", *self.fields()})

    @property
    def begins(self) -> str | None:
        """The name of the task that the person begins by it, if they do."""
        return None

    @property
    def instead(self) -> Self | None:
        """What its reporter can report in its place if it contradicts what the robots believe."""
        return None

    @classmethod
    def kind_name(cls) -> str:
        """Return the kind of its events."""
        return str(cls.model_fields["kind"].default)

    @classmethod
    def fields(cls) -> Iterator[str]:
        """Yield the names of the fields that are reported."""
        for name, field in cls.model_fields.items():
            if name != "kind" and field.json_schema_extra != INTERNAL:
                yield name


class TeamEvent(Event):
    """An event of a team."""

    reversible: ClassVar[bool] = False
    """Whether all events of this kind can be taken back."""

    @classmethod
    def due(cls, desk: Desk) -> Iterator[tuple[float, Self]]:  # noqa: ARG003
        """Yield the events of this kind that time alone will cause, each with when it does, in seconds.

        They follow from the present state, which is asked again after each event, also after a restart.
        """
        yield from ()

    def recorded(self, desk: Desk) -> Self | None:  # noqa: ARG002
        """Return the event as it is recorded, after checking that it is possible; None if it changes nothing.

        Raises
        ------
        Refusal
            It is not possible now. Nothing has changed.
        """
        return self

    def accepted(self, desk: Desk, count: int) -> Self | None:
        """Return the event as `recorded` does, after so many others; its view may not be a later one."""
        found = self.recorded(desk)
        if self.view is not None and self.view > count:
            raise Refusal("other", why=f"seq {self.view}: there is no such view yet; expected {count} or less")
        return found

    def causes(self, desk: Desk) -> tuple[TeamEvent, ...]:  # noqa: ARG002
        """Return the events that it causes for others, in the present state; the record of the event keeps them.

        They happen right after it, and are not taken back or erased with it.

        Raises
        ------
        Refusal
            It is not possible now.
        """
        return ()

    def happen(self, desk: Desk, time: float = 0.0, *, number: int, caused: Iterable[TeamEvent] = ()) -> Any:
        """Apply it with its number, and what it caused for others; return what was taken back, if anything.

        Raises
        ------
        ValueError
            It is not possible. Nothing has changed.
        """
        desk.begins(number, time)
        found = self.change(desk, time)
        for one in caused:
            one.change(desk, time)
        desk.happened(time, self.concerned, self if self.can_be_taken_back else None)
        return found

    def change(self, desk: Desk, time: float) -> Any:
        """Change what the robot knows of the team, at this time in seconds; return what was taken back, if anything.

        Raises
        ------
        ValueError
            It is not possible. Nothing has changed.
        """
        raise NotImplementedError

    def remains(self, label: str) -> TeamEvent:
        """Return what remains of it when its person's records are erased, for whom the label stands: all but names."""
        return self.model_copy(update={"person": label, "id": None})

    def entry(self) -> dict[str, Any]:
        """Return what the operator's list shows of it beside its kind and person."""
        return {}

    @property
    def concerned(self) -> str | None:
        """The person whose state it may change."""
        return None

    @property
    def can_be_taken_back(self) -> bool:
        """Whether `take_back` undoes it."""
        return self.reversible

    def take_back(self, desk: Desk) -> Any:
        """Undo the event, the last of its kind in the person's task, through the team's `desk`; return what it was."""
        raise NotImplementedError


class OfPerson(TeamEvent):
    """An event of one person, of whom all of it is."""

    person: Name
    """The person, as `name_of` returns the name."""

    by_operator: ClassVar[bool] = False
    nothing: ClassVar[str | None] = None
    """Key of the refusal if there is none of this kind to take back."""

    def recorded(self, desk: Desk) -> Self | None:
        """Check that the person is present."""
        desk.require(self.person)
        return self

    def remains(self, label: str) -> TeamEvent:  # noqa: ARG002
        """Return that something was erased."""
        return Erased()

    @property
    def concerned(self) -> str | None:
        """The person."""
        return self.person


class Kept(TeamEvent):
    """What an event has caused for others, or what is kept of it after its person's records were erased."""

    is_shown: ClassVar[bool] = False

    def recorded(self, desk: Desk) -> Self | None:  # noqa: ARG002
        """Refuse it: nobody reports it."""
        raise Refusal("other", why=f"{self.kind}: expected an event that can be reported")


class Erased(Kept):
    """An event of a person whose records were erased."""

    kind: Literal["erased"] = "erased"

    def change(self, desk: Desk, time: float) -> None:
        """Change nothing; the robots decided again then."""
