"""The participants of a user study: their stages and conditions, and their teams.

The condition is assigned when the first task begins, not before (`assignment`).

In a study with groups, participants wait for each other (`roll`). The last one to arrive starts the group, which has
one condition, or order of conditions, and in each condition one team and one robot.

Every event is recorded such that it can be replayed, including random draws and decisions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from planner import CostToGo

from ...declare.refusals import InapplicableError, Refusal
from ...live.advice import Advice
from ...live.desk import IDLE
from ...live.event_base import Event
from ...live.events import kinds
from ...live.explanation import Explanation
from ...live.history import Change, History
from ...live.team import Team
from ...live.views import PersonView, RobotView
from .assignment import assign
from .events import Erased, Expired, Onward, Returned, StudyEvent, Vacant, Visited, Withdrew
from .participant_team import ParticipantTeam
from .plan import WAITING, UserStudy
from .record import StudyRecord
from .roll import DONE, FULL, GONE, HERE, UNMATCHED, WITHDREW, Participant
from .teams import Facts, Teams
from .views import EnrolledView, ParticipantView, Progress, Waiting


class Cohort(Teams, History[StudyRecord]):
    """The participants of a study and all that has happened; parameters as in `Teams`."""

    def __init__(self, study: UserStudy, tasks: Mapping[str, CostToGo], team: Callable[[str | None], Team]) -> None:
        Teams.__init__(self, study, tasks, team)
        History.__init__(self)

    # Events.

    def happen(self, event: Event, time: float) -> StudyRecord | None:
        """Apply an event; return its record, or None if it has no effect: time that passes, a repeated withdrawal.

        Raises
        ------
        Refusal
            The event is impossible. Nothing has changed.
        """
        if not isinstance(event, StudyEvent):
            raise InapplicableError("not_in_study")
        n, time = self.count + 1, round(time, 3)
        facts = event.facts(self, n, time)
        if facts is None:
            return None
        person = self.participants.get(event.person)
        if person is not None:
            if person.group is not None and facts.get("team"):
                facts |= {"group": person.group, "period": person.period}
            facts |= self._starts(person, event, facts, n, time)
            for team in person.teams.values():
                self.fault = team.team.fault or self.fault
        record = StudyRecord(n=n, time=time, event=facts.pop("event", event), **facts)
        self._note(record)
        return record

    def caused(self, now: float, away: Mapping[str, float | None]) -> list[StudyEvent]:
        """Return the first event that time has caused for each participant, or for a group.

        Parameters
        ----------
        now : float
            Seconds since the study began.
        away : mapping of str to float or None
            For each participant who takes part, the seconds for which no page of theirs has been connected; None if
            one is.
        """
        found = dict[Any, StudyEvent]()
        for code, seconds in away.items():
            who = self.participants[code]
            kind = next((one for one in kinds(StudyEvent).values() if one.is_due(self, who, now, seconds)), None)
            if kind is not None:
                team = (who.group, self.stage(who).period) if kind.of_team and who.group else code
                found.setdefault(team, kind(person=code))
        return list(found.values())

    def again(self, record: StudyRecord) -> None:
        """Replay a recorded event."""
        event = record.event
        if not isinstance(event, Visited | Vacant | Erased):
            person = self.known(event.person)
            onward = isinstance(event, Onward)
            at = self.study.next_stage(person.at, person.condition) if onward else person.at
            here = self.stages[person.at].name
            if at >= len(self.stages) or getattr(event, "stage", here) != here:
                raise ValueError(f"{person.code} is at {here}")
            if not event.is_told_by(record.team):
                raise ValueError(f"{person.code} did something else")
            if record.team and record.group is None:
                self._group(person, self.stages[at], record.condition).again(record.team)
        if record.members:
            self._form(record)
        if record.group is not None:
            self.groups[record.group].teams[record.period].again(record.team)
        self._note(record)

    def _note(self, record: StudyRecord) -> None:
        """Update the participants after an event, and the teams of those who begin a condition."""
        self.count = record.n
        record.note(self)
        if record.members:
            team = self.groups[str(record.group)].teams[record.period]
            for code in record.members:
                if not self.participants[code].removed:
                    self.participants[code].teams["task", record.period] = team

    # Groups.

    def _starts(self, person: Participant, event: StudyEvent, before: Facts, n: int, time: float) -> Facts:
        """Begin the task of those who wait, if this event lets them; return the record's fields, none otherwise."""
        at = self.study.next_stage(person.at, person.condition) if isinstance(event, Onward) else person.at
        waits = isinstance(event, Onward | Returned | Expired) and before.get("status", HERE) == HERE
        if not waits or self.stages[at].kind != WAITING:
            return {}
        period = self.stages[at].period
        members = self.ready(person, period, late=isinstance(event, Expired))
        if not members:
            return {}
        facts: Facts = {"group": person.group, "members": tuple(members), "period": period}
        if person.group is None:
            facts["group"] = f"G{len(self.groups) + 1}"
            facts["condition"] = assign(self.by_condition(), self.study.seed, self.begun)
        known = self.groups.get(facts["group"])
        new = known is None or period not in known.teams
        team = self._form(StudyRecord(n=n, time=time, event=event, **facts))
        task = self.study.tasks[0][0]
        try:
            return facts | {"team": tuple(sub for member in members for sub in team.begin(member, task, n, time))}
        except Exception:
            if new:
                del self.groups[facts["group"]].teams[period]
                if not self.groups[facts["group"]].teams:
                    del self.groups[facts["group"]]
            raise

    def _form(self, record: StudyRecord) -> ParticipantTeam:
        """Return the team of a group in a period, which is new unless other members have begun."""
        group, period = record.group_in(self), record.period
        own = self.study.orders[group.condition][period - 1]
        if period not in group.teams:
            group.teams[period] = ParticipantTeam(
                str(record.group), self._tasks, lambda: self._team(own), list, again=False
            )  # fmt: skip
        return group.teams[period]

    # Erasing.

    def farewell(self, person: str) -> Event | None:
        """Return the event by which a participant withdraws; None if the participant has withdrawn already.

        Raises
        ------
        AbsentError
            Nothing is recorded of this participant.
        """
        taking_part = self.known(person).status in (HERE, GONE, FULL, DONE, UNMATCHED)
        return Withdrew(person=person, late=True) if taking_part else None

    def withdrawn(self) -> list[str]:
        """Return the codes of participants who withdrew and whose records are still there."""
        return [
            code
            for code, who in self.participants.items()
            if who.status == WITHDREW and not (who.removed or who.erased)
        ]

    def without(self, person: str, label: str) -> Change:
        """Return a function that removes what is recorded of a participant from a record and its answer.

        The order of arrival and the assigned condition remain, on which the conditions of others depend. So does the
        time at which others began a condition because the participant came.

        Parameters
        ----------
        person : str
        label : str
            Stands for the participant; the participant's code after a withdrawal, which then remains.
        """
        who = self.known(person)
        teams = {} if who.group is None else self.groups[who.group].teams
        of_teams = {period: team.team.without(person, label) for period, team in teams.items()}
        before, here, withdrawn = 0.0, False, label == who.code

        def removed(record: StudyRecord, answer: Any) -> tuple[StudyRecord, Any]:
            nonlocal before, here
            shared: Facts = {}
            if of_teams and record.group == who.group:
                of_team = of_teams[record.period]
                members = tuple(label if code == who.code else code for code in record.members)
                shared = {"members": members, "team": tuple(of_team(sub, None)[0] for sub in record.team)}
                record = record.model_copy(update=shared)
                shared |= {"group": record.group, "period": record.period, "condition": record.condition}
            if record.event.who != who.code or record.begins_for_others:
                before = record.time
            if record.event.who != who.code:
                return record, answer
            event: StudyEvent = Erased()
            if not here:
                here, shared["status"] = True, who.status
                event = Vacant(person=label, simulated=who.simulated)
                if withdrawn:
                    id = record.event.id or f"visit {label}"
                    event = Visited(person=label, simulated=who.simulated, reached=who.at, id=id)
            elif record.condition is not None and not record.members:
                event, shared["condition"] = Erased(person=label), record.condition
            kept = StudyRecord(n=record.n, time=before, event=event, **shared)
            return kept, {"person": label} if isinstance(event, Visited) else None

        return removed

    # Views.

    def followed(self, record: StudyRecord) -> bool | None:
        """Return whether an action followed a suggestion; None if there was none, or it is no action."""
        suggestion = None if record.seen is None else record.seen.suggestion
        return None if suggestion is None else suggestion == getattr(record.event, "action", None)

    def touched(self, record: StudyRecord) -> set[str]:  # noqa: ARG002 it is the latest
        """Return the participants whose views the latest event, which this is, has changed."""
        return set(self.changed)

    def require(self, person: str) -> None:
        """Raise `AbsentError` for an unknown participant."""
        self.known(person)

    @property
    def people(self) -> tuple[str, ...]:
        """Codes of all participants, in order of arrival, without those whose records were erased."""
        return tuple(code for code, person in self.participants.items() if not person.erased)

    def task_and_state(self, person: str) -> tuple[CostToGo, int]:
        """Return a participant's task, and the number of its present state."""
        return self.team_of(self.known(person)).task_and_state(person)

    def person(self, person: str) -> ParticipantView:
        """Return a participant's view: the task, and the progress in the study."""
        seen = self._seen(person)
        return seen if self.study.cost_to_go else replace(seen, cost_to_go=None)

    def _seen(self, person: str) -> ParticipantView:
        who = self.known(person)
        stage, here = self.stages[who.at], who.status in (HERE, DONE)
        seen, over = PersonView(person=person, present=here), False
        if self.is_at_task(who) and not who.removed:
            seen, over = self.team_of(who).seen(person), self.is_over(who)
            if over:
                seen = replace(seen, applicable=(), suggestion=None)
            # Why nothing is suggested would reveal the condition.
            own = self.study.condition_at(stage, who.condition)
            reasons = own is not None and self.study.condition(own).reasons and seen.suggestion is not None
            seen = replace(seen, present=here, explained=reasons, reason=seen.reason if reasons else None)
        # The removal of records moves the last event of a participant before views that were sent.
        seq = self.count if who.removed else who.seq
        return ParticipantView(**vars(seen) | {"seq": seq, "study": self._progress(who, here=here, over=over)})

    def _progress(self, who: Participant, *, here: bool, over: bool) -> Progress:
        stage = self.stages[who.at]
        kind, waiting = stage.kind if here else who.status, None
        if kind == WAITING:
            others, expected = self.company(who)
            waiting = Waiting(here=len(others), of=expected)
        return Progress(
            kind=kind, stage=stage.name, what=stage.what, number=who.at + 1, of=len(self.stages), over=over,
            completion=who.completion, items=tuple(item.name for item in self.items(who)), waiting=waiting,
        )  # fmt: skip

    def explain_later(self, person: str, against: str | None = None) -> Callable[[], Explanation]:
        """Return a function that explains a participant's suggestion, as `Team.explain_later` does.

        Raises
        ------
        InapplicableError
            The participant sees no reasons in this study, or is not at a task.
        """
        if not self.person(person).explained:
            raise InapplicableError("no_reasons")
        return self.team_of(self.known(person)).team.explain_later(person, against)

    def entry(self, person: str) -> EnrolledView:
        """Return the operator's view of a participant."""
        who, seen = self.known(person), self._seen(person)
        return EnrolledView(**vars(seen), condition=who.condition, status=who.status, simulated=who.simulated)

    def beliefs(self) -> dict[str, bytes]:
        """Return the belief about each member of a team that has begun a task, in their latest team, as exact bytes."""
        every = [one for who in self.participants.values() for one in who.teams.items() if one[0][0] == "task"]
        # By period: in the order of participants, the belief in one would depend on who else is there.
        every.sort(key=lambda one: one[0])
        return {person: belief for _, team in every for person, belief in team.team.beliefs().items()}

    @property
    def advices(self) -> tuple[Advice, ...]:
        """Empty, since each participant's team has a robot of its own."""
        return (IDLE,)

    def robot(self, number: int = 1) -> RobotView:  # noqa: ARG002 all say the same
        """Return an instruction without a destination, since each participant's team has a robot of its own."""
        return RobotView(seq=self.count)

    def log(self, task: str | None = None) -> list[dict[str, Any]]:
        """Return all actions in tasks, in the format of `fit`; with `task`, only those in this task."""
        if task is not None and task not in dict(self.study.tasks):
            raise Refusal("other", why=f"task {task[:80]!r}: expected one of {', '.join(dict(self.study.tasks))}")
        rows = []
        for who in self.participants.values():
            before = 0
            for group in who.at_tasks():
                own = [row for row in group.team.log() if row["person"] == who.code]
                rows += [
                    row | {"episode": str(before + int(row["episode"]))} for row in own if task in (None, row["task"])
                ]
                before += len({row["episode"] for row in own})
        return rows
