"""What can happen in a user study: the events of participants, and what researchers do about them.

As in `assist.live.events`, each kind is a class. `facts` says what follows from an event for the cohort, whose record
has it; `change` is what it does to its participant's part, also in tables. A new kind is a new class here.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, StringConstraints, WithJsonSchema

from ...declare.declared import Expected
from ...declare.refusals import InapplicableError, Refusal
from ...live.event_base import INTERNAL, Action, Event, Name, Seq
from ...live.names import LONGEST_REASON
from .participant_team import Subs, own_action
from .plan import WAITING
from .roll import DECLINED, DONE, FULL, GONE, HERE, UNMATCHED, WITHDREW, Participant, Roll
from .teams import Facts, Teams

Reason = Annotated[
    str,
    StringConstraints(strip_whitespace=True, min_length=1, max_length=LONGEST_REASON),
    Expected(f"1 to {LONGEST_REASON} characters"),
]

GivenAnswer = Annotated[
    Any,
    WithJsonSchema({
        "anyOf": [
            {"type": "number"}, {"type": "string"}, {"type": "array", "items": {"type": "string"}}, {"type": "null"},
        ]
    }),
]  # fmt: skip
"""An answer; the questionnaire checks it, with clearer messages than those of a type that is a union."""


class StudyEvent(Event):
    """An event of a participant."""

    person: Name
    """The participant's code."""

    is_tabled: ClassVar[bool] = False
    """Whether it is a row of the table `events`."""
    by_hand: ClassVar[bool] = False
    """Whether the participant causes it, which nobody does too often."""
    takes_place: ClassVar[bool] = False
    """Whether the participant may take one of the places of the study."""
    comes_back: ClassVar[bool] = False
    """Whether a participant who was gone is back by it."""
    of_team: ClassVar[bool] = False
    """Whether one for a group suffices, if time causes it for several members at once."""

    @classmethod
    def is_due(cls, cohort: Teams, who: Participant, now: float, away: float | None) -> bool:  # noqa: ARG003
        """Return whether time has caused the event for a participant who takes part, as `Cohort.caused` asks for it."""
        return False

    def facts(self, cohort: Teams, n: int, time: float) -> Facts | None:
        """Apply the event to the participant's team; return the fields of its record, or None if nothing has changed.

        Raises
        ------
        Refusal
            It is impossible. Nothing has changed.
        """
        who = cohort.known(self.person)
        facts = back(cohort, who) if self.comes_back else {}
        if not facts and who.status != HERE:
            raise InapplicableError("absent", person=who.code)
        found = self.happens(cohort, who, n, time)
        return None if found is None else facts | found

    def happens(self, cohort: Teams, who: Participant, n: int, time: float) -> Facts | None:
        """Return what follows for a participant who takes part."""
        raise NotImplementedError

    def change(self, roll: Roll, who: Participant, time: float, at: str | None) -> None:
        """Change the participant's part in the study, at a time in seconds; `at` is the same in UTC, if it matters."""

    def is_told_by(self, team: Subs) -> bool:  # noqa: ARG002
        """Whether a record of the participant's team agrees with it."""
        return True

    def refused(self, cohort: Teams, who: Participant) -> InapplicableError:
        """Return the refusal of an event that is impossible at the participant's stage."""
        return InapplicableError("not_here", what=self.kind, here=cohort.stages[who.at].name)


def back(cohort: Teams, who: Participant) -> Facts:
    """Return that a participant who was gone is back; nothing if they were not gone.

    Raises
    ------
    InapplicableError
        Others have their place.
    """
    if who.status != GONE:
        return {}
    if not cohort.is_free_for(who):
        raise InapplicableError("full")
    return {"returned": True}


def now() -> str:
    """Return the present time, UTC, in ISO format."""
    return datetime.now(UTC).isoformat(timespec="seconds")


class Visited(StudyEvent):
    """A new participant."""

    kind: Literal["visited"] = "visited"
    simulated: bool = False
    """Whether they are simulated, in a rehearsal."""
    reached: int | None = Field(default=None, json_schema_extra=INTERNAL)
    """After a withdrawal, the stage that was reached, of which nothing else remains."""

    is_tabled: ClassVar[bool] = True
    by_hand: ClassVar[bool] = True
    takes_place: ClassVar[bool] = True

    def facts(self, cohort: Teams, n: int, time: float) -> Facts:  # noqa: ARG002
        """Admit the participant."""
        if self.person in cohort.participants:
            raise InapplicableError("other", why="this code is taken; try again")
        if not cohort.is_free_for():
            raise InapplicableError("full")
        return {"at": now()}

    def change(self, roll: Roll, who: Participant, time: float, at: str | None) -> None:
        """Begin at the first stage."""
        who.simulated, who.arrived, who.removed = self.simulated, at, self.reached is not None
        roll.enter(who, self.reached or 0, time)


class Onward(StudyEvent):
    """A participant completes a stage and proceeds to the next one."""

    kind: Literal["onward"] = "onward"
    stage: str = Field(min_length=1, max_length=120)
    """The stage that is completed."""
    answers: dict[str, GivenAnswer] | None = None
    """Answers, if the stage is a questionnaire; a list for several choices, null for none."""

    path: ClassVar[str | None] = "/api/study/participants/{person}/onward"
    by_operator: ClassVar[bool] = False
    is_tabled: ClassVar[bool] = True
    by_hand: ClassVar[bool] = True
    takes_place: ClassVar[bool] = True
    comes_back: ClassVar[bool] = True

    def happens(self, cohort: Teams, who: Participant, n: int, time: float) -> Facts:
        """Check the answers, and begin the task of the next stage if it has one."""
        stage = cohort.stages[who.at]
        if self.stage != stage.name:
            raise InapplicableError("stage", person=who.code, here=stage.name, there=repr(self.stage[:80]))
        if stage.kind == "thanks":
            raise InapplicableError("complete")
        if stage.kind == WAITING:
            raise InapplicableError("group_open")
        if stage.kind in ("practice", "task") and not cohort.is_over(who):
            raise InapplicableError("task_open")
        facts: Facts = {}
        if stage.kind == "questionnaire":
            try:
                answers = cohort.study.questionnaire(stage.what).check(self.answers or {}, cohort.items(who))
            except ValueError as error:
                raise Refusal("answer", why=str(error)) from None
            facts["event"] = self.model_copy(update={"answers": answers})
        elif self.answers:
            raise Refusal("no_answers", here=stage.name)
        if stage.kind == "consent":
            facts["at"] = now()
        return facts | cohort.enters_next(who, n, time)

    def change(self, roll: Roll, who: Participant, time: float, at: str | None) -> None:
        """Enter the next stage."""
        if roll.stage(who).kind == "consent":
            who.consented = at
        roll.enter(who, roll.study.next_stage(who.at, who.condition), time)


class Acted(StudyEvent):
    """An action of a participant."""

    kind: Literal["acted"] = "acted"
    action: Action
    """The action, in PDDL notation."""
    followed: bool | None = None
    """Whether the suggestion was followed; null if unknown."""
    seq: Seq | None = None
    """`seq` of the view on which the participant acted; later suggestions are taken as unseen."""
    stage: str | None = Field(default=None, max_length=120)
    """The stage of the view; 409 if the participant is at another one by now."""

    path: ClassVar[str | None] = "/api/people/{person}/actions"
    by_operator: ClassVar[bool] = False
    by_hand: ClassVar[bool] = True
    comes_back: ClassVar[bool] = True
    is_action: ClassVar[bool] = True

    def is_told_by(self, team: Subs) -> bool:
        """Whether the team's record has this action."""
        return own_action(team, self.person).action == self.action

    def happens(self, cohort: Teams, who: Participant, n: int, time: float) -> Facts:
        """Let the participant act, and then the simulated people of the team."""
        stage = cohort.stages[who.at]
        if self.stage is not None and self.stage != stage.name:
            raise InapplicableError("stage", person=who.code, here=stage.name, there=repr(self.stage[:80]))
        if cohort.is_over(who):
            raise InapplicableError("task_over")
        team, seen = cohort.team_of(who).act(who.code, self.action, self.followed, self.seq, n, time)
        own = own_action(team, who.code)
        event = self.model_copy(update={"stage": stage.name, "action": own.action})
        return {"event": event, "team": team, "seen": seen}


class Left(StudyEvent):
    """A participant has been away for too long, or is removed for now."""

    kind: Literal["left"] = "left"

    path: ClassVar[str | None] = "/api/people/{person}/leave"
    is_tabled: ClassVar[bool] = True

    @classmethod
    def is_due(cls, cohort: Teams, who: Participant, now: float, away: float | None) -> bool:
        """Whether they are away, or hold a place and have left an open page alone."""
        study, kind = cohort.study, cohort.stage(who).kind
        holds = study.participants is not None and who.condition is None and kind != WAITING
        return (holds and now - who.acted > 180 * study.away) or (away or 0.0) > 60 * study.patience(kind)

    def happens(self, cohort: Teams, who: Participant, n: int, time: float) -> Facts:
        """Remove the participant from their team."""
        return {"status": GONE, "team": cohort.part(who, n, time)}


class Expired(StudyEvent):
    """The time limit of a task or of waiting for a group is reached."""

    kind: Literal["expired"] = "expired"
    is_tabled: ClassVar[bool] = True

    @classmethod
    def is_due(cls, cohort: Teams, who: Participant, now: float, away: float | None) -> bool:  # noqa: ARG003
        """Whether a time limit is over, or all the others for whom a participant waits have left."""
        study, kind, minutes = cohort.study, cohort.stage(who).kind, (now - who.entered) / 60
        if study.group is not None and kind == WAITING:
            return minutes > study.group.wait or (who.group is not None and cohort.is_complete(who))
        return kind == "task" and study.minutes is not None and minutes > study.minutes and not who.expired

    def happens(self, cohort: Teams, who: Participant, n: int, time: float) -> Facts:
        """End the task, or the waiting."""
        stage = cohort.stages[who.at]
        if stage.kind == "task" and not cohort.is_over(who):
            return {"expired": True, "team": cohort.part(who, n, time)}
        if cohort.study.group is None or stage.kind != WAITING:
            raise self.refused(cohort, who)
        ends = cohort.study.group.then == "end" and who.group is None
        return {"status": UNMATCHED, "completion": cohort.completion()} if ends else {}


class Elapsed(StudyEvent):
    """Time that passes while a participant is idle, so that the robot decides again."""

    kind: Literal["elapsed"] = "elapsed"
    of_team: ClassVar[bool] = True

    @classmethod
    def is_due(cls, cohort: Teams, who: Participant, now: float, away: float | None) -> bool:
        """Whether a participant is idle at a task, with a connected page."""
        idle = cohort.stage(who).kind == "task" and now - who.acted > cohort.study.tick and away is None
        return idle and (who.group is None or not cohort.is_over(who))

    def facts(self, cohort: Teams, n: int, time: float) -> Facts | None:
        """Let the robot of the participant's team decide again."""
        who = cohort.known(self.person)
        idle = who.status == HERE and cohort.is_at_task(who) and not cohort.is_over(who)
        team = cohort.team_of(who).elapse(n, time) if idle else ()
        return {"team": team} if team else None


class Withdrew(StudyEvent):
    """A participant withdraws from the study for good; at the consent stage, this declines consent."""

    kind: Literal["withdrew"] = "withdrew"
    late: bool = Field(default=False, json_schema_extra=INTERNAL)
    """Whether the researchers withdraw the data, which they may do after the study's last day for withdrawals."""

    path: ClassVar[str | None] = "/api/study/participants/{person}/withdraw"
    by_operator: ClassVar[bool] = False
    is_tabled: ClassVar[bool] = True

    def facts(self, cohort: Teams, n: int, time: float) -> Facts | None:
        """End the participant's part; a repetition changes nothing."""
        who = cohort.known(self.person)
        if who.status in (WITHDREW, DECLINED):
            return None
        last = cohort.study.withdraw_until
        if who.status == DONE and last is not None and datetime.now(UTC).astimezone().date() > last and not self.late:
            raise InapplicableError("too_late", day=last)
        declines = cohort.stages[who.at].kind == "consent"
        return {"status": DECLINED if declines else WITHDREW, "team": cohort.part(who, n, time)}


class Returned(StudyEvent):
    """A participant rejoins after an absence, if the study is not full."""

    kind: Literal["returned"] = "returned"

    path: ClassVar[str | None] = "/api/study/participants/{person}/return"
    by_operator: ClassVar[bool] = False
    is_tabled: ClassVar[bool] = True
    by_hand: ClassVar[bool] = True
    takes_place: ClassVar[bool] = True

    def facts(self, cohort: Teams, n: int, time: float) -> Facts:
        """Let the participant return to their place and team."""
        who = cohort.known(self.person)
        if who.status not in (GONE, FULL):
            raise self.refused(cohort, who) if who.status == HERE else InapplicableError("absent", person=who.code)
        if not cohort.is_free_for(who):
            return {"status": FULL}
        return {"status": HERE, "team": cohort.rejoin(who, n, time)}


class Excluded(StudyEvent):
    """The researchers exclude a participant from the analysis; the report states the reason."""

    kind: Literal["excluded"] = "excluded"
    reason: Reason | None
    """The reason; null includes the participant again."""

    path: ClassVar[str | None] = "/api/study/participants/{person}/exclude"
    never_left_out: ClassVar[tuple[str, ...]] = ("reason",)

    def facts(self, cohort: Teams, n: int, time: float) -> Facts:  # noqa: ARG002
        """Check that there are data to exclude."""
        who = cohort.known(self.person)
        if who.status in (DECLINED, WITHDREW):
            raise InapplicableError("other", why=f"the data of {who.code} are not part of the analysis")
        return {}

    def change(self, roll: Roll, who: Participant, time: float, at: str | None) -> None:  # noqa: ARG002
        """Note the reason."""
        who.excluded = self.reason


class Kept(StudyEvent):
    """What is kept of an event whose participant's records were erased."""

    def facts(self, cohort: Teams, n: int, time: float) -> Facts | None:  # noqa: ARG002
        """Refuse it: nobody reports it."""
        raise InapplicableError("not_in_study")


class Vacant(Kept):
    """The place of a participant whose records were erased: a label has it, so that the order of arrival stays."""

    kind: Literal["vacant"] = "vacant"
    simulated: bool = False
    """Whether the participant was simulated."""

    def change(self, roll: Roll, who: Participant, time: float, at: str | None) -> None:  # noqa: ARG002
        """Keep the place."""
        who.simulated, who.erased = self.simulated, True


class Erased(Kept):
    """An event of a participant whose records were erased; the assigned condition, if it was assigned then, remains."""

    kind: Literal["erased"] = "erased"
    person: Name | None = None  # type: ignore[assignment]
    """The label, if a condition was assigned."""

    def change(self, roll: Roll, who: Participant, time: float, at: str | None) -> None:  # noqa: ARG002
        """Keep that a task was reached."""
        if not who.removed:
            who.at = roll.study.begins_at(1)
