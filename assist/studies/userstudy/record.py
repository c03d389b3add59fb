"""The record of an event of a user study: what happened, and what followed, random draws and decisions included."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any, ClassVar

from pydantic import PlainValidator, SerializeAsAny, SerializerFunctionWrapHandler, model_serializer

from ...live.record import Record, TeamRecord, event_of
from .events import StudyEvent
from .participant_team import Seen


class StudyRecord(Record):
    """The record of an event of a user study."""

    event: Annotated[SerializeAsAny[StudyEvent], PlainValidator(partial(event_of, StudyEvent))]
    at: str | None = None
    """Time of an arrival or a consent, UTC."""
    status: str | None = None
    """The participant's new status."""
    returned: bool = False
    """Whether the participant was gone, and is back by this event."""
    expired: bool = False
    """Whether the time limit of the participant's task is reached."""
    condition: str | None = None
    """The condition that was drawn."""
    completion: str | None = None
    """The participant's completion code."""
    group: str | None = None
    """The group of whose team the records are."""
    period: int = 1
    """The period of the group's condition."""
    members: tuple[str, ...] = ()
    """Who of the group begins a condition by this event."""
    team: tuple[TeamRecord, ...] = ()
    """What happened in the participant's team, or in the group's."""
    seen: Seen | None = None
    """What a participant saw who acted."""

    format: ClassVar[str] = "kitassist user study 3"

    @model_serializer(mode="wrap")
    def _short(self, given: SerializerFunctionWrapHandler) -> dict[str, Any]:
        usual = {name: field.default for name, field in type(self).model_fields.items() if not field.is_required()}
        return {
            name: value for name, value in given(self).items() if name not in usual or value not in (usual[name], [])
        }
