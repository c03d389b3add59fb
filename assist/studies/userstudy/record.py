"""The record of an event of a user study: what happened, and what followed, random draws and decisions included."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any, ClassVar

from pydantic import PlainValidator, SerializeAsAny, SerializerFunctionWrapHandler, model_serializer

from ...live.record import Record, TeamRecord, event_of
from .events import StudyEvent
from .participant_team import Seen
from .roll import DONE, HERE, Group, Participant, Roll


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

    format: ClassVar[str] = "kitassist user study 4"

    def note(self, roll: Roll) -> None:
        """Change who takes part in the study, and at which stage."""
        waited = set(roll.waiting())
        roll.changed, roll.entered = set(), []
        if self.event.who is not None:
            self._note_person(roll, self.event.who)
        if self.members:
            self._begin(roll)
            roll.begun += self.condition is not None
        if waited != (waits := set(roll.waiting())):
            roll.changed |= waited | waits
        if self.group is not None:
            members = roll.groups[self.group].members
            roll.changed |= set(members)
            for code in members:
                roll.participants[code].acted = self.time
        for code in roll.changed:
            roll.participants[code].seq = self.n
        roll.changed = {code for code in roll.changed if not roll.participants[code].erased}

    def _note_person(self, roll: Roll, who: str) -> None:
        person = roll.participants.setdefault(who, Participant(who))
        roll.changed.add(who)
        self.event.change(roll, person, self.time, self.at)
        person.acted = self.time
        person.status = HERE if self.returned else self.status or person.status
        person.expired = person.expired or self.expired
        if self.condition is not None and not self.members:
            person.condition, roll.begun = self.condition, roll.begun + 1
        if self.completion is not None:
            person.completion, person.status = self.completion, self.status or DONE

    def _begin(self, roll: Roll) -> None:
        """Let the members of a group begin a condition."""
        group = self.group_in(roll)
        for code in self.members:
            person = roll.participants[code]
            person.condition, person.group = group.condition, self.group
            if not person.removed:
                roll.enter(person, roll.study.begins_at(self.period), self.time)

    @property
    def begins_for_others(self) -> bool:
        """Whether others of a group begin a condition by it."""
        return len(self.members) > 1

    def group_in(self, roll: Roll) -> Group:
        """Return the group of the record, which is new unless it has begun."""
        return roll.groups.setdefault(str(self.group), Group(self.members, str(self.condition)))

    @model_serializer(mode="wrap")
    def _short(self, given: SerializerFunctionWrapHandler) -> dict[str, Any]:
        usual = {name: field.default for name, field in type(self).model_fields.items() if not field.is_required()}
        return {
            name: value for name, value in given(self).items() if name not in usual or value not in (usual[name], [])
        }
