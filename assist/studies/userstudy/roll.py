"""Who takes part in a user study, and at which stage: what follows from its records, without the tasks.

The participants of a running study and the tables of its data follow from the same records here.
"""

from __future__ import annotations

from .events import Erased, Excluded, Onward, Vacant, Visited
from .groups import Group
from .participants import DONE, HERE, Participant
from .places import Places
from .plan import UserStudy
from .record import StudyRecord


class Roll(Places):
    """The participants of a study, as its records change them; parameters and attributes as in `Places`.

    Attributes
    ----------
    changed : set of str
        The participants whose views the last event has changed.
    entered : list of str
        The participants who have entered a stage by the last event.
    """

    def __init__(self, study: UserStudy) -> None:
        super().__init__(study)
        self.changed, self.entered = set[str](), list[str]()

    def note(self, record: StudyRecord) -> None:
        """Update the participants after an event."""
        waited = set(self.groups.waiting())
        self.changed, self.entered = set(), []
        if record.event.who is not None:
            self._note_person(record)
        if record.members:
            self._begin(record)
            self.begun += record.condition is not None
        if waited != (waits := set(self.groups.waiting())):
            self.changed |= waited | waits
        if record.group is not None:
            members = self.groups.begun[record.group].members
            self.changed |= set(members)
            for code in members:
                self.participants[code].acted = record.time
        for code in self.changed:
            self.participants[code].seq = record.n
        self.changed = {code for code in self.changed if not self.participants[code].erased}

    def _note_person(self, record: StudyRecord) -> None:
        """Update the participant whose event it is."""
        event = record.event
        if isinstance(event, Visited | Vacant):
            self.participants[event.person] = Participant(
                event.person, event.simulated, erased=isinstance(event, Vacant), arrived=record.at
            )  # fmt: skip
        person = self.participants[event.person]
        self.changed.add(person.code)
        if isinstance(event, Visited):
            if event.reached is not None:
                person.removed, person.at = True, event.reached
            self._enter(person, record.time)
        elif isinstance(event, Onward):
            if self.stage(person).kind == "consent":
                person.consented = record.at
            person.at = self.study.next_stage(person.at, person.condition)
            self._enter(person, record.time)
        elif isinstance(event, Erased) and not person.removed:
            person.at = next(number for number, one in enumerate(self.stages) if one.kind == "task")
        elif isinstance(event, Excluded):
            person.excluded = event.reason
        person.acted = record.time
        person.status = HERE if record.returned else record.status or person.status
        person.expired = person.expired or record.expired
        if record.condition is not None and not record.members:
            person.condition, self.begun = record.condition, self.begun + 1
        if record.completion is not None:
            person.completion, person.status = record.completion, record.status or DONE

    def _enter(self, person: Participant, time: float) -> None:
        person.entered, person.expired = time, False
        self.entered.append(person.code)

    def _begin(self, record: StudyRecord) -> None:
        """Update the members of a group who begin a condition."""
        group = self.group_of(record)
        for code in record.members:
            person = self.participants[code]
            person.condition, person.group = group.condition, record.group
            if not person.removed:
                person.at, person.entered = self.study.begins_at(record.period), record.time
                self.entered.append(code)

    def group_of(self, record: StudyRecord) -> Group:
        """Return the group of a record, which is new unless it has begun."""
        name = str(record.group)
        if name not in self.groups.begun:
            self.groups.begun[name] = Group(record.members, str(record.condition))
        return self.groups.begun[name]
