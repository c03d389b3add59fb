"""The participants of a user study: their stages and conditions, and the events that are possible.

The condition is assigned when the first task begins, not before (`assignment`).

In a study with groups, participants wait for each other (`groups`). The last one to arrive starts the group, which has
one condition, or order of conditions, and in each condition one team and one robot.

Every event is recorded such that it can be replayed, including random draws and decisions.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np

from planner import CostToGo

from ..explain.explanation import Explanation
from ..live.advice import Advice
from ..live.course import NOTHING, Course
from ..live.events import ERASED, LONGEST_REASON, VACANT, Event
from ..live.simulated_person import SimulatedPerson
from ..live.store import Change
from ..texts.refusals import AbsentError, FullError, InapplicableError, InvalidError
from .assignment import assign
from .codes import drawn
from .erasing import without
from .groups import Group, Groups, period_field
from .participant_team import ParticipantTeam
from .participants import DECLINED, DONE, FULL, GONE, HERE, UNMATCHED, WITHDREW, Participant
from .places import Places
from .plan import WAITING, Stage, UserStudy
from .questionnaires import Item
from .study_events import KINDS, StudyEvent


class Cohort:
    """The participants of a study.

    Parameters
    ----------
    study : UserStudy
    tasks : mapping of str to CostToGo
        Tasks by name, including the practice task.
    course : callable
        Returns a new course, without events, of a team in a condition (None: practice).

    Attributes
    ----------
    fault : str or None
        The latest error message of a condition's policy.
    places : Places
    groups : Groups
    """

    def __init__(self, study: UserStudy, tasks: Mapping[str, CostToGo], course: Callable[[str | None], Course]) -> None:
        self.study, self.stages = study, study.stages
        self._tasks, self._course = tasks, course
        self.count, self.paused, self.begun = 0, False, 0
        self.recent: deque[dict[str, Any]] = deque(maxlen=1)
        self.participants: dict[str, Participant] = {}
        self.places = Places(study, self.participants)
        self.fault: str | None = None
        self.groups = Groups(study, self.participants)
        self._touched: set[str] = set()

    # Events.

    def happen(self, event: Event, time: float) -> dict[str, Any] | None:
        """Apply an event; return its record, or None if it has no effect: time that passes, a repeated withdrawal.

        Raises
        ------
        AbsentError, FullError, InapplicableError, InvalidError
            The event is impossible. Nothing has changed.
        """
        n, time = self.count + 1, round(time, 3)
        record: dict[str, Any] = {"n": n, "time": time, "event": event.kind, "person": event.person}
        if event.id is not None:
            record["id"] = event.id
        if event.kind == "visited":
            record |= self._visits(event)
        elif event.kind not in KINDS:
            raise InapplicableError("not_in_study")
        else:
            person = self.known(event.person)
            facts = self._facts(person, event, n, time)
            if facts is None:
                return None
            record |= facts
            if person.group is not None and "team" in facts:
                record |= {"group": person.group, **period_field(person.period)}
            record |= self._starts(person, record, n, time)
            for group in person.groups.values():
                self.fault = group.course.fault or self.fault
        self._note(record)
        return record

    def again(self, record: Mapping[str, Any]) -> None:
        """Replay a recorded event.

        Raises
        ------
        ValueError
            The record is impossible in the present state.
        """
        if record["event"] not in (*KINDS, VACANT, ERASED) or not isinstance(record["time"], int | float):
            raise ValueError("not an event of a study")
        if record["event"] not in ("visited", VACANT, ERASED):
            person = self.known(record["person"])
            onward = record["event"] == "onward"
            at = self.study.next_stage(person.at, person.condition) if onward else person.at
            here = self.stages[person.at].name
            if at >= len(self.stages) or record.get("stage", here) != here:
                raise ValueError(f"{person.code} is at {here}")
            if "team" in record and "group" not in record:
                stage = self.stages[at]
                self._group(person, stage, record.get("condition")).again(record["team"])
        if "members" in record:
            self._form(record)
        if "group" in record:
            self.groups.begun[record["group"]].teams[record.get("period", 1)].again(record["team"])
        self._note(record)

    def _visits(self, event: Event) -> dict[str, Any]:
        if event.person is None or event.person in self.participants:
            raise InapplicableError("other", why="this code is taken; try again")
        if not self.places.is_free_for():
            raise FullError("full")
        simulated = isinstance(event, StudyEvent) and event.simulated
        return {"at": _now(), **({"simulated": True} if simulated else {})}

    def _facts(self, person: Participant, event: Event, n: int, time: float) -> dict[str, Any] | None:
        """Apply an event to the participant's team; return the record's fields that depend on its kind.

        The result is None for an event without effect.
        """
        stage, kind = self.stages[person.at], event.kind
        if kind == "returned" and person.status in (GONE, FULL):
            here = self.places.is_free_for(person)
            team = self._rejoins(person, n, time) if here else []
            return {"status": HERE if here else FULL, **({"team": team} if team else {})}
        if kind == "elapsed":
            idle = person.status == HERE and stage.kind in ("practice", "task") and not self.is_over(person)
            team = self._at_task(person).elapse(n, time) if idle else []
            return {"team": team} if team else None
        if kind == "left":
            if person.status != HERE:
                raise InapplicableError("absent", person=person.code)
            return {"status": GONE} | self._parts(person, n, time)
        if kind == "excluded":
            return self._excludes(person, event)
        if kind == "withdrew" and person.status in (WITHDREW, DECLINED):
            return None
        if kind == "withdrew" and person.status in (GONE, FULL, DONE, UNMATCHED):
            self._in_time(person, event)
            return {"status": DECLINED if stage.kind == "consent" else WITHDREW} | self._parts(person, n, time)
        facts: dict[str, Any] = {}
        if person.status == GONE and kind in ("acted", "onward"):
            if not self.places.is_free_for(person):
                raise FullError("full")
            facts["returned"] = True
        elif person.status != HERE:
            raise InapplicableError("absent", person=person.code)
        if kind == "withdrew":
            return facts | {"status": DECLINED if stage.kind == "consent" else WITHDREW} | self._parts(person, n, time)
        if kind == "expired" and stage.kind == "task" and not self.is_over(person):
            return facts | {"expired": True} | self._parts(person, n, time)
        if kind == "expired" and self.study.group is not None and stage.kind == WAITING:
            ends = self.study.group.then == "end" and person.group is None
            return facts | ({"status": UNMATCHED, "completion": self._completion()} if ends else {})
        if kind == "acted":
            if event.stage is not None and event.stage != stage.name:
                raise InapplicableError("stage", person=person.code, here=stage.name, there=repr(event.stage[:80]))
            if self.is_over(person):
                raise InapplicableError("task_over")
            own = Event("acted", person.code, event.action, event.followed, event.seen)
            return facts | {"stage": stage.name, **self._at_task(person).act(own, n, time)}
        if kind == "onward" and isinstance(event, StudyEvent):
            return facts | self._onward(person, event, n, time)
        raise InapplicableError("not_here", what=kind, here=stage.name)

    def _excludes(self, person: Participant, event: Event) -> dict[str, Any]:
        reason = event.reason if isinstance(event, StudyEvent) else None
        if person.status in (DECLINED, WITHDREW):
            raise InapplicableError("other", why=f"the data of {person.code} are not part of the analysis")
        if reason is not None and not 0 < len(reason) <= LONGEST_REASON:
            raise InvalidError("other", why=f"reason: expected 1 to {LONGEST_REASON} characters; found {len(reason)}")
        return {"reason": reason}

    def _in_time(self, person: Participant, event: Event) -> None:
        """Refuse a withdrawal after the study's last day for it, in the time zone of this machine."""
        last, late = self.study.withdraw_until, isinstance(event, StudyEvent) and event.late
        if person.status == DONE and last is not None and datetime.now(UTC).astimezone().date() > last and not late:
            raise InapplicableError("too_late", day=last)

    def _onward(self, person: Participant, event: StudyEvent, n: int, time: float) -> dict[str, Any]:
        stage = self.stages[person.at]
        if event.stage != stage.name:
            raise InapplicableError("stage", person=person.code, here=stage.name, there=repr((event.stage or "")[:80]))
        if stage.kind == "thanks":
            raise InapplicableError("complete")
        if stage.kind == WAITING:
            raise InapplicableError("group_open")
        if stage.kind in ("practice", "task") and not self.is_over(person):
            raise InapplicableError("task_open")
        facts: dict[str, Any] = {"stage": stage.name}
        if stage.kind == "questionnaire":
            try:
                facts["answers"] = self.study.questionnaire(stage.what).check(event.answers or {}, self._items(person))
            except ValueError as error:
                raise InvalidError("answer", why=str(error)) from None
        elif event.answers:
            raise InvalidError("no_answers", here=stage.name)
        if stage.kind == "consent":
            facts["at"] = _now()
        to = self.stages[self.study.next_stage(person.at, person.condition)]
        condition = None
        if to.kind == "task" and person.condition is None:
            condition = facts["condition"] = assign(self.places.by_condition(), self.study.seed, self.begun)
        if to.kind in ("practice", "task"):
            new = (to.kind, to.period) not in person.groups
            try:
                facts["team"] = self._group(person, to, condition).begin(person.code, to.what, n, time)
            except Exception:
                if new:
                    person.groups.pop((to.kind, to.period), None)
                raise
        if to.kind == "thanks":
            facts["completion"] = self._completion()
        return facts

    def _completion(self) -> str:
        return self.study.code or drawn(8)

    # Groups.

    def _rejoins(self, person: Participant, n: int, time: float) -> list[dict[str, Any]]:
        """Let a participant return to their group's team; return the records, none outside of a task."""
        at_work = person.group is not None and self.stages[person.at].kind == "task" and not person.expired
        return person.at_tasks()[-1].rejoin(person.code, n, time) if at_work else []

    def _parts(self, person: Participant, n: int, time: float) -> dict[str, Any]:
        """Remove a participant from their group's team, so that the robot attends to the others only."""
        team = [] if person.group is None else person.at_tasks()[-1].leave(person.code, n, time)
        return {"team": team} if team else {}

    def _starts(self, person: Participant, record: Mapping[str, Any], n: int, time: float) -> dict[str, Any]:
        """Begin the task of those who wait, if this event lets them; return the record's fields, none otherwise."""
        kind = record["event"]
        at = self.study.next_stage(person.at, person.condition) if kind == "onward" else person.at
        waits = kind in ("onward", "returned", "expired") and record.get("status", HERE) == HERE
        if not waits or self.stages[at].kind != WAITING:
            return {}
        period = self.stages[at].period
        members = self.groups.ready(person, period, late=kind == "expired")
        if not members:
            return {}
        facts: dict[str, Any] = {"group": person.group, "members": members, **period_field(period)}
        if person.group is None:
            facts["group"] = f"G{len(self.groups.begun) + 1}"
            facts["condition"] = assign(self.places.by_condition(), self.study.seed, self.begun)
        known = self.groups.begun.get(facts["group"])
        new, team = known is None or period not in known.teams, self._form(facts)
        task = self.study.tasks[0][0]
        try:
            return facts | {"team": [sub for member in members for sub in team.begin(member, task, n, time)]}
        except Exception:
            if new:
                self.groups.drop(facts["group"], period)
            raise

    def _form(self, record: Mapping[str, Any]) -> ParticipantTeam:
        """Return the team of a group in a period, which is new unless other members have begun."""
        name, period, begun = record["group"], record.get("period", 1), self.groups.begun
        if name not in begun:
            begun[name] = Group(tuple(record["members"]), record["condition"])
        own = self.study.orders[begun[name].condition][period - 1]
        if period not in begun[name].teams:
            begun[name].teams[period] = ParticipantTeam(name, self._tasks, lambda: self._course(own), list, again=False)
        return begun[name].teams[period]

    def _begin(self, record: Mapping[str, Any]) -> None:
        """Update the members of a group who begin a condition."""
        group, period = self.groups.begun[record["group"]], record.get("period", 1)
        for code in record["members"]:
            person = self.participants[code]
            person.condition, person.group = group.condition, record["group"]
            if person.removed:
                continue
            person.at, person.entered = self.study.begins_at(period), record["time"]
            person.groups["task", period] = group.teams[period]

    def _note(self, record: Mapping[str, Any]) -> None:
        """Update the participants after an event, from its record."""
        self.count, waited = record["n"], set(self.groups.waiting())
        self._note_person(record)
        if "members" in record:
            self._begin(record)
            self.begun += "condition" in record
        if waited != (waits := set(self.groups.waiting())):
            self._touched |= waited | waits
        if "group" in record:
            members = self.groups.begun[record["group"]].members
            self._touched |= set(members)
            for code in members:
                self.participants[code].acted = record["time"]
        for code in self._touched:
            self.participants[code].seq = self.count
        self._touched = {code for code in self._touched if not self.participants[code].erased}

    def _note_person(self, record: Mapping[str, Any]) -> None:
        """Update the participant whose event it is."""
        time, self._touched = record["time"], set()
        if record["event"] == ERASED and "person" not in record:
            return
        if record["event"] in ("visited", VACANT):
            self.participants[record["person"]] = Participant(
                record["person"], bool(record.get("simulated")), erased=record["event"] == VACANT,
                removed="reached" in record, at=record.get("reached", 0),
            )  # fmt: skip
        person = self.participants[record["person"]]
        self._touched.add(person.code)
        if record["event"] in ("visited", "onward"):
            if record["event"] == "onward":
                person.at = self.study.next_stage(person.at, person.condition)
            person.entered, person.expired = time, False
        person.acted = time
        person.status = HERE if record.get("returned") else record.get("status", person.status)
        person.expired = person.expired or bool(record.get("expired"))
        if record["event"] == "excluded":
            person.excluded = record["reason"]
        if "condition" in record and "members" not in record:
            person.condition, self.begun = record["condition"], self.begun + 1
        if "completion" in record:
            person.completion, person.status = record["completion"], record.get("status", DONE)

    def _group(self, person: Participant, stage: Stage, condition: str | None) -> ParticipantTeam:
        key = stage.kind, stage.period
        if key not in person.groups:
            number = list(self.participants).index(person.code)
            practice = stage.kind == "practice"
            own = None if practice else self.study.orders[condition or person.condition or ""][stage.period - 1]
            count = 0 if practice else self.study.simulated
            setting = self.study.setting if own is None else self.study.condition(own).setting

            def mates() -> list[SimulatedPerson]:
                seeds = np.random.SeedSequence([self.study.seed, number]).generate_state(count, np.uint64).tolist()
                return [SimulatedPerson(self.study.population, trust=setting.trust_rule(), seed=seed) for seed in seeds]

            person.groups[key] = ParticipantTeam(
                person.code, self._tasks, lambda: self._course(own), mates, again=self.study.again
            )
        return person.groups[key]

    def _items(self, person: Participant) -> tuple[Item, ...]:
        """Return the questions at the participant's stage, in the order in which the participant sees them."""
        number = list(self.participants).index(person.code)
        return self.study.items_at(person.at, person.condition, number)

    # Erasing.

    def farewell(self, person: str) -> Event | None:
        """Return the event by which a participant withdraws; None if the participant has withdrawn already.

        Raises
        ------
        AbsentError
            Nothing is recorded of this participant.
        """
        taking_part = self.known(person).status in (HERE, GONE, FULL, DONE, UNMATCHED)
        return StudyEvent("withdrew", person, late=True) if taking_part else None

    def withdrawn(self) -> list[str]:
        """Return the codes of participants who withdrew and whose records are still there."""
        return [
            code
            for code, who in self.participants.items()
            if who.status == WITHDREW and not (who.removed or who.erased)
        ]

    def without(self, person: str, label: str) -> Change:
        """Return a function that removes what is recorded of a participant from a record and its answer.

        The order of arrival and the assigned condition remain, on which the conditions of others depend.

        Parameters
        ----------
        person : str
        label : str
            Stands for the participant; the participant's code after a withdrawal, which then remains.
        """
        who = self.known(person)
        teams = {} if who.group is None else self.groups.begun[who.group].teams
        return without(who, label, {period: team.course.without(person, label) for period, team in teams.items()})

    # State.

    def known(self, person: str | None) -> Participant:
        """Return the participant with this code.

        Raises
        ------
        AbsentError
        """
        if person not in self.participants or self.participants[person].erased:
            raise AbsentError("unknown_participant", person=repr((person or "")[:80]))
        return self.participants[person]

    def _at_task(self, person: Participant) -> ParticipantTeam:
        stage = self.stages[person.at]
        if stage.kind not in ("practice", "task") or person.removed:
            raise InapplicableError("action", person=person.code, here=stage.name)
        return person.groups[stage.kind, stage.period]

    def is_over(self, person: Participant) -> bool:
        """Whether the participant's task is over: finished, unsolvable, or beyond the time limit."""
        seen = self._at_task(person).seen(person.code)
        return bool(seen["finished"]) or seen["cost_to_go"] is None or person.expired

    # Views.

    def touched(self, record: Mapping[str, Any]) -> set[str]:  # noqa: ARG002 it is the latest
        """Return the participants whose views the latest event, which this is, has changed."""
        return set(self._touched)

    def require(self, person: str) -> None:
        """Raise `AbsentError` for an unknown participant."""
        self.known(person)

    @property
    def people(self) -> tuple[str, ...]:
        """Codes of all participants, in order of arrival, without those whose records were erased."""
        return tuple(code for code, person in self.participants.items() if not person.erased)

    def place(self, person: str) -> tuple[CostToGo, int]:
        """Return a participant's task, and the number of its present state."""
        return self._at_task(self.known(person)).place(person)

    def person(self, person: str) -> dict[str, Any]:
        """Return a participant's view as JSON data: the task, and the progress in the study."""
        seen = self._seen(person)
        return seen if self.study.cost_to_go else seen | {"cost_to_go": None}

    def _seen(self, person: str) -> dict[str, Any]:
        who = self.known(person)
        stage = self.stages[who.at]
        seen: dict[str, Any] = {
            "person": person, "task": "", "present": True, "paused": False, "applicable": [], "suggestion": None,
            "reason": None, "cost_to_go": None, "steps": 0, "finished": False, "explained": False,
        }  # fmt: skip
        over = False
        if stage.kind in ("practice", "task") and not who.removed:
            seen, over = self._at_task(who).seen(person) | {"present": True}, self.is_over(who)
            if over:
                seen |= {"applicable": [], "suggestion": None, "reason": None}
            own = self.study.condition_at(stage, who.condition)
            reasons = own is not None and self.study.condition(own).reasons
            if not reasons:
                seen["reason"] = None
            # Why nothing is suggested would reveal the condition.
            seen["explained"] = reasons and seen["suggestion"] is not None
        kind = stage.kind if who.status in (HERE, DONE) else who.status
        study = {
            "kind": kind, "stage": stage.name, "what": stage.what, "number": who.at + 1, "of": len(self.stages),
            "over": over, "completion": who.completion, "items": [item.name for item in self._items(who)],
        }  # fmt: skip
        if kind == WAITING and self.study.group is not None:
            waiting, expected = self.groups.company(who)
            study["waiting"] = {"here": len(waiting), "of": expected}
        # The removal of records moves the last event of a participant before views that were sent.
        return seen | {"seq": self.count if who.removed else who.seq, "study": study}

    def explain_later(self, person: str, against: str | None = None) -> Callable[[], Explanation]:
        """Return a function that explains a participant's suggestion, as `Course.explain_later` does.

        Raises
        ------
        InapplicableError
            The participant sees no reasons in this study, or is not at a task.
        """
        if not self.person(person)["explained"]:
            raise InapplicableError("no_reasons")
        return self._at_task(self.known(person)).course.explain_later(person, against)

    def entry(self, person: str) -> dict[str, Any]:
        """Return the operator's view of a participant."""
        who = self.known(person)
        return self._seen(person) | {"condition": who.condition, "status": who.status, "simulated": who.simulated}

    def beliefs(self) -> dict[str, bytes]:
        """Return the beliefs about all members of teams that have begun a task, as exact bytes."""
        groups = (group for who in self.participants.values() for group in who.at_tasks())
        return {person: belief for group in groups for person, belief in group.course.beliefs().items()}

    @property
    def advices(self) -> tuple[Advice, ...]:
        """Empty, since each participant's team has a robot of its own."""
        return (NOTHING,)

    def robot(self, number: int = 1) -> dict[str, Any]:  # noqa: ARG002 all say the same
        """Return an instruction without a destination, since each participant's team has a robot of its own."""
        nobody = {"person": None, "suggestion": None, "reason": None, "arrived": True, "location": None}
        return {**nobody, "seq": self.count}

    def log(self, task: str | None = None) -> list[dict[str, Any]]:
        """Return all actions in tasks, in the format of `fit`; with `task`, only those in this task."""
        if task is not None and task not in dict(self.study.tasks):
            raise InvalidError("other", why=f"task {task[:80]!r}: expected one of {', '.join(dict(self.study.tasks))}")
        rows = []
        for who in self.participants.values():
            before = 0
            for group in who.at_tasks():
                own = [row for row in group.course.log() if row["person"] == who.code]
                rows += [
                    row | {"episode": str(before + int(row["episode"]))} for row in own if task in (None, row["task"])
                ]
                before += len({row["episode"] for row in own})
        return rows


def _now() -> str:
    """Return the present time, UTC, in ISO format."""
    return datetime.now(UTC).isoformat(timespec="seconds")
