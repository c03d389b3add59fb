"""All participants of a user study: who is where in the procedure, in which condition, and what may happen next.

A place is taken by whoever is on their way or done, and by whoever's task has begun; one that is left before that is
free again. The condition is drawn when the first task begins, not before (`assignment`).

An event that has happened is a record from which the same can happen again, draws and decisions included.
"""

from __future__ import annotations

import secrets
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np

from planner import CostToGo

from ..live.advice import Advice
from ..live.course import NOTHING, AbsentError, Course, Event
from ..live.live_task import InapplicableError, UnknownError
from ..live.simulated_person import SimulatedPerson
from .assignment import assign
from .participant_team import ParticipantTeam
from .plan import Stage, UserStudy

HERE, GONE, DECLINED, WITHDREW, FULL, DONE = "here", "gone", "declined", "withdrew", "full", "done"

KINDS = {"visited", "onward", "acted", "elapsed", "expired", "withdrew", "left", "returned"}
"""What may happen."""

LETTERS = "23456789BCDFGHJKLMNPQRSTVWXYZ"
"""Of completion codes: no vowels, and nothing that looks like something else."""


class FullError(InapplicableError):
    """There is no place left."""


@dataclass(frozen=True)
class StudyEvent(Event):
    """Something that is reported of a participant.

    Attributes
    ----------
    stage : str or None
        The one that they go on from.
    answers : mapping of str, or None
        To the questionnaire that this is.
    simulated : bool
        Whether whoever comes is.
    """

    stage: str | None = None
    answers: Mapping[str, Any] | None = None
    simulated: bool = False


@dataclass
class Participant:
    """Somebody who takes part, or did.

    Attributes
    ----------
    code : str
        By which alone they are known.
    simulated : bool
    status : str
    at : int
        The stage.
    seq : int
        The number of the last event that changed what they see.
    entered : float
        When they came to the stage, in seconds since the study began.
    acted : float
        When something last happened in their task.
    expired : bool
        Whether the time for the task is up.
    condition : str or None
        Which was drawn; where each participant has all, the name of their order (`UserStudy.orders`).
    completion : str or None
        What they are given at the end.
    groups : dict of ParticipantTeam
        By kind of stage and period: in practice, and in the tasks of each condition.
    """

    code: str
    simulated: bool = False
    status: str = HERE
    at: int = 0
    seq: int = 0
    entered: float = 0.0
    acted: float = 0.0
    expired: bool = False
    condition: str | None = None
    completion: str | None = None
    groups: dict[tuple[str, int], ParticipantTeam] = field(default_factory=dict)

    def at_tasks(self) -> list[ParticipantTeam]:
        """Give their teams at the tasks that they have begun, in the order of their conditions."""
        return [group for (kind, _), group in self.groups.items() if kind == "task"]


class Cohort:
    """The participants of a study.

    Parameters
    ----------
    study : UserStudy
    tasks : mapping of str to CostToGo
        By name, that of the practice among them.
    course : callable
        Gives the course of a team in a condition, None for practice, in which nothing has happened yet.

    Attributes
    ----------
    fault : str or None
        Why the policy of a condition could not decide, the last time that one could not.
    """

    def __init__(self, study: UserStudy, tasks: Mapping[str, CostToGo], course: Callable[[str | None], Course]) -> None:
        self.study, self.stages = study, study.stages
        self._tasks, self._course = tasks, course
        self.count, self.paused, self.begun = 0, False, 0
        self.recent: deque[dict[str, Any]] = deque(maxlen=1)
        self.participants: dict[str, Participant] = {}
        self.fault: str | None = None

    # What happens.

    def happen(self, event: Event, time: float) -> dict[str, Any] | None:
        """Let something happen; give the record, None for time that has elapsed without anything coming of it.

        Raises
        ------
        AbsentError, FullError, InapplicableError, ValueError
            It cannot be. Nothing has changed.
        """
        n, time = self.count + 1, round(time, 3)
        record: dict[str, Any] = {"n": n, "time": time, "event": event.kind, "person": event.person}
        if event.id is not None:
            record["id"] = event.id
        if event.kind == "visited":
            record |= self._visits(event)
        elif event.kind not in KINDS:
            raise InapplicableError("this cannot be done within a user study")
        else:
            person = self.known(event.person)
            facts = self._facts(person, event, n, time)
            if facts is None:
                return None
            record |= facts
            for group in person.groups.values():
                self.fault = group.course.fault or self.fault
        self._note(record)
        return record

    def again(self, record: Mapping[str, Any]) -> None:
        """Let happen again what has been recorded.

        Raises
        ------
        ValueError
            It cannot have happened.
        """
        if record["event"] not in KINDS or not isinstance(record["time"], int | float):
            raise ValueError("no event of a study")
        if record["event"] != "visited":
            person = self.known(record["person"])
            at = person.at + (record["event"] == "onward")
            here = self.stages[person.at].name
            if at >= len(self.stages) or record.get("stage", here) != here:
                raise ValueError(f"{person.code} is at {here}")
            if "team" in record:
                stage = self.stages[at]
                self._group(person, stage, record.get("condition")).again(record["team"])
        self._note(record)

    def _visits(self, event: Event) -> dict[str, Any]:
        if event.person is None or event.person in self.participants:
            raise InapplicableError("somebody has this code already; to be tried again")
        if not self._room():
            raise FullError("there is no place left at the moment")
        simulated = isinstance(event, StudyEvent) and event.simulated
        at = datetime.now(UTC).isoformat(timespec="seconds")
        return {"at": at, **({"simulated": True} if simulated else {})}

    def _facts(self, person: Participant, event: Event, n: int, time: float) -> dict[str, Any] | None:
        """Give what a record says of an event; what happens in the participant's team has happened then."""
        stage, kind = self.stages[person.at], event.kind
        if kind == "returned" and person.status in (GONE, FULL):
            return {"status": HERE if self._room(person) else FULL}
        if kind == "elapsed":
            idle = person.status == HERE and stage.kind in ("practice", "task") and not self._over(person)
            team = self._at_task(person).elapse(n, time) if idle else []
            return {"team": team} if team else None
        if kind == "left":
            if person.status != HERE:
                raise InapplicableError(f"{person.code} is not under way")
            return {"status": GONE}
        facts: dict[str, Any] = {}
        if person.status == GONE and kind in ("acted", "onward", "withdrew"):
            if not self._room(person):
                raise FullError("there is no place left at the moment")
            facts["returned"] = True
        elif person.status != HERE:
            raise InapplicableError(f"{person.code} is not under way")
        if kind == "withdrew":
            return facts | {"status": DECLINED if stage.kind == "consent" else WITHDREW}
        if kind == "expired" and stage.kind == "task" and not self._over(person):
            return facts | {"expired": True}
        if kind == "acted":
            if self._over(person):
                raise InapplicableError("this task is over")
            own = Event("acted", person.code, event.action, event.followed, event.seen)
            return facts | {"stage": stage.name, **self._at_task(person).act(own, n, time)}
        if kind == "onward" and isinstance(event, StudyEvent):
            return facts | self._onward(person, event, n, time)
        raise InapplicableError(f"{kind}: not at {stage.name}")

    def _onward(self, person: Participant, event: StudyEvent, n: int, time: float) -> dict[str, Any]:
        stage = self.stages[person.at]
        if event.stage != stage.name:
            raise InapplicableError(f"{person.code} is at {stage.name}, not at {(event.stage or '')[:80]!r}")
        if stage.kind == "thanks":
            raise InapplicableError("this is the end")
        if stage.kind in ("practice", "task") and not self._over(person):
            raise InapplicableError("the task is not finished")
        facts: dict[str, Any] = {"stage": stage.name}
        if stage.kind == "questionnaire":
            facts["answers"] = self.study.questionnaire(stage.what).check(event.answers or {})
        elif event.answers:
            raise ValueError(f"answers: expected none at {stage.name}")
        to = self.stages[person.at + 1]
        condition = None
        if to.kind == "task" and person.condition is None:
            condition = facts["condition"] = assign(self.counts(), self.study.seed, self.begun)
        if to.kind in ("practice", "task"):
            new = (to.kind, to.period) not in person.groups
            try:
                facts["team"] = self._group(person, to, condition).begin(to.what, n, time)
            except Exception:
                if new:
                    person.groups.pop((to.kind, to.period), None)
                raise
        if to.kind == "thanks":
            facts["completion"] = self.study.code or "".join(secrets.choice(LETTERS) for _ in range(8))
        return facts

    def _note(self, record: Mapping[str, Any]) -> None:
        """Keep what follows from an event."""
        self.count, time = record["n"], record["time"]
        if record["event"] == "visited":
            self.participants[record["person"]] = Participant(record["person"], bool(record.get("simulated")))
        person = self.participants[record["person"]]
        person.seq = self.count
        if record["event"] in ("visited", "onward"):
            person.at += record["event"] == "onward"
            person.entered, person.expired = time, False
        person.acted = time
        person.status = HERE if record.get("returned") else record.get("status", person.status)
        person.expired = person.expired or bool(record.get("expired"))
        if "condition" in record:
            person.condition, self.begun = record["condition"], self.begun + 1
        if "completion" in record:
            person.completion, person.status = record["completion"], DONE

    def _group(self, person: Participant, stage: Stage, condition: str | None) -> ParticipantTeam:
        key = stage.kind, stage.period
        if key not in person.groups:
            number = list(self.participants).index(person.code)
            practice = stage.kind == "practice"
            own = None if practice else self.study.orders[condition or person.condition or ""][stage.period - 1]
            count = 0 if practice else self.study.simulated
            setting = self.study.setting

            def mates() -> list[SimulatedPerson]:
                seeds = np.random.SeedSequence([self.study.seed, number]).generate_state(count, np.uint64).tolist()
                return [
                    SimulatedPerson(
                        self.study.population, eta=setting.eta, utility_scale=setting.utility_scale, seed=seed
                    )
                    for seed in seeds
                ]

            person.groups[key] = ParticipantTeam(
                person.code, self._tasks, lambda: self._course(own), mates, again=self.study.again
            )
        return person.groups[key]

    # What is so.

    def known(self, person: str | None) -> Participant:
        """Give a participant.

        Raises
        ------
        AbsentError
        """
        if person not in self.participants:
            raise AbsentError(f"{(person or '')[:80]!r} is not in the study")
        return self.participants[person]

    def counts(self) -> dict[str, int]:
        """Count the participants of each condition, or order; those who are gone only if they are not replaced."""
        counts = dict.fromkeys(self.study.orders, 0)
        for person in self.participants.values():
            if person.condition is not None:
                counts[person.condition] += self._counts(person)
        return counts

    def _counts(self, person: Participant) -> bool:
        """Whether somebody has a place."""
        if person.status in (HERE, DONE):
            return True
        return person.condition is not None and not self.study.replace

    @property
    def taken(self) -> int:
        """How many places are taken."""
        return sum(map(self._counts, self.participants.values()))

    def _room(self, person: Participant | None = None) -> bool:
        """Whether there is a place, for somebody new, or who comes back and may have theirs."""
        most = self.study.participants
        return most is None or (person is not None and self._counts(person)) or self.taken < most

    def _at_task(self, person: Participant) -> ParticipantTeam:
        stage = self.stages[person.at]
        if stage.kind not in ("practice", "task"):
            raise InapplicableError(f"{person.code} is at {stage.name}; nothing can be done there")
        return person.groups[stage.kind, stage.period]

    def _over(self, person: Participant) -> bool:
        """Whether somebody's task is: finished, impossible by now, or its time is up."""
        seen = self._at_task(person).seen()
        return bool(seen["finished"]) or seen["cost_to_go"] is None or person.expired

    # What is seen.

    def touched(self, record: Mapping[str, Any]) -> set[str]:
        """Name those for whom something has changed with an event."""
        return {record["person"]}

    def require(self, person: str) -> None:
        """Refuse whoever does not take part."""
        self.known(person)

    @property
    def people(self) -> tuple[str, ...]:
        """Who has come, in that order."""
        return tuple(self.participants)

    def place(self, person: str) -> tuple[CostToGo, int]:
        """Give somebody's task, and the state in which it is."""
        return self._at_task(self.known(person)).place()

    def person(self, person: str) -> dict[str, Any]:
        """Give what somebody sees, as JSON has it: their task as elsewhere, and where in the study they are."""
        who = self.known(person)
        stage = self.stages[who.at]
        seen: dict[str, Any] = {
            "person": person, "task": "", "present": True, "paused": False, "applicable": [], "suggestion": None,
            "reason": None, "cost_to_go": None, "steps": 0, "finished": False,
        }  # fmt: skip
        over = False
        if stage.kind in ("practice", "task"):
            seen, over = self._at_task(who).seen(), self._over(who)
            if over:
                seen |= {"applicable": [], "suggestion": None, "reason": None}
            if not self.study.reasons:
                seen["reason"] = None
        kind = stage.kind if who.status in (HERE, DONE) else who.status
        study = {
            "kind": kind, "stage": stage.name, "what": stage.what, "number": who.at + 1, "of": len(self.stages),
            "over": over, "completion": who.completion,
        }  # fmt: skip
        return seen | {"seq": who.seq, "study": study}

    def entry(self, person: str) -> dict[str, Any]:
        """Give what the operator sees of somebody."""
        who = self.known(person)
        return self.person(person) | {"condition": who.condition, "status": who.status, "simulated": who.simulated}

    def beliefs(self) -> dict[str, bytes]:
        """Give what is believed of everybody in a team that has begun a task, simulated people included, to the bit."""
        groups = (group for who in self.participants.values() for group in who.at_tasks())
        return {person: belief for group in groups for person, belief in group.course.beliefs().items()}

    @property
    def advice(self) -> Advice:
        """Every team has a robot: there is nothing that one of them is to do for all."""
        return NOTHING

    def robot(self) -> dict[str, Any]:
        """Every team has one: there is nothing to be said of all of them."""
        return {
            "person": None,
            "suggestion": None,
            "reason": None,
            "arrived": True,
            "location": None,
            "seq": self.count,
        }

    def log(self, task: str | None = None) -> list[dict[str, Any]]:
        """Give the actions of all participants at their tasks, as `fit` reads them; those in one, if it is named."""
        if task is not None and task not in dict(self.study.tasks):
            raise UnknownError(f"task {task[:80]!r}: expected one of {', '.join(dict(self.study.tasks))}")
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
