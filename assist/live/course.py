"""The course of a live session: what has happened so far, what the robot was advised after it, and who sees what of it.

Timing. A decision follows every event: an action, an undo, somebody who comes, goes or begins, the robot's arrival.
People who are idle make no events, and the robot can do only one thing at a decision; so somebody who waits for help
while nobody acts would wait for ever. Therefore time that passes without an event is one as well (`elapsed`), if the
robot then does something that it has not done yet. An action is the answer to a suggestion only if whoever acted can
have known of it.

An event that has happened is a record from which the same can happen again (`Course.again`), advice included: to the
same beliefs, bit for bit, without a decision being worked out anew.
"""

from __future__ import annotations

import math
import re
from array import array
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from sys import intern
from typing import Any

from numpy.typing import ArrayLike

from planner import CostToGo

from ..people.human import Mixture, Population
from ..team.settings import Setting
from ..team.state import TeamPolicy
from .advice import Advice, PersonState, Reason
from .assistant import Assistant
from .live_task import InapplicableError, UnknownError

OF_SOMEBODY = ("joined", "left", "began", "acted", "undone")
KINDS = (*OF_SOMEBODY, "arrived", "elapsed", "paused", "resumed")

NEEDED = ("n", "time", "event", "step")
FIELDS: Mapping[str, type | tuple[type, ...]] = {
    "n": int, "time": (int, float), "event": str, "step": int, "person": str, "task": str, "id": str, "action": str,
    "followed": bool, "unheard": bool, "advice": dict, "answer": dict,
}  # fmt: skip
"""What a record of an event may hold, of which kind."""

NAME = re.compile(r"(?=.*\w)[\w.\- ]{1,64}")
"""What people can be called: it stands in addresses of pages."""

MOST_PEOPLE = 10_000
RECENT = 50
"""Events that the log of a running session shows."""

NOTHING = Advice(None, None, None, arrived=True)


class AbsentError(UnknownError):
    """Nobody of that name is there."""


@dataclass(frozen=True)
class Event:
    """Something that is reported.

    Attributes
    ----------
    kind : str
        "joined", "left", "began", "acted", "undone", "arrived", "elapsed", "paused" or "resumed".
    person : str or None
        Who acted, came or went, or with whom the robot has arrived; None where it is nobody.
    action : str or None
        What was done, in PDDL.
    followed : bool or None
        Whether the suggestion was followed; None where whoever reports does not say.
    seen : int or None
        The `seq` of what the person saw when they acted: a suggestion that came later was not heard.
    task : str or None
        The task of somebody who comes or begins.
    id : str or None
        Made by whoever reports: the same again is answered as the first, and has happened once.
    """

    kind: str
    person: str | None = None
    action: str | None = None
    followed: bool | None = None
    seen: int | None = None
    task: str | None = None
    id: str | None = None


def require_record(record: Mapping[str, Any]) -> None:
    """Refuse what is no record of an event.

    Raises
    ------
    ValueError
    """
    for name, value in record.items():
        expected = FIELDS.get(name, ())
        if not isinstance(value, expected) or (isinstance(value, bool) and expected is not bool):
            raise ValueError(f"'{name[:40]}' is {str(value)[:40]!r}")
    if missing := [name for name in NEEDED if name not in record]:
        raise ValueError(f"there is no '{missing[0]}'")
    kind = record["event"]
    if kind not in KINDS or not math.isfinite(record["time"]):
        raise ValueError(f"event {kind[:40]!r} at time {record['time']}; expected one of {', '.join(KINDS)}")
    needed = {"person": kind in OF_SOMEBODY, "action": kind == "acted", "answer": "id" in record}
    if missing := [name for name, so in needed.items() if so and name not in record]:
        raise ValueError(f"there is no '{missing[0]}'")


@dataclass
class _Note:
    """What a session keeps of somebody beside the team's own record.

    Of all their tasks the names and the time of each action; of the present one also the reason of the suggestion
    that stood at each, and the cost-to-go after each event.
    """

    task: str
    seq: int = 0
    suggested: int = 0
    reason: Reason | None = None
    tasks: list[str] = field(default_factory=list)
    times: array[float] = field(default_factory=lambda: array("d"))
    reasons: list[Reason | None] = field(default_factory=list)
    history: list[tuple[float, float | None]] = field(default_factory=list)


class Course:
    """What has happened in a session.

    Parameters
    ----------
    tasks : mapping of str to CostToGo
        By name; the first is that of everybody for whom no other is named.
    policy, setting, population, distance
        As in `Assistant`.

    Attributes
    ----------
    fault : str or None
        Why the policy could not decide after the last event; the robot then does nothing, and people go on.
    """

    def __init__(
        self,
        tasks: Mapping[str, CostToGo],
        *,
        policy: str | TeamPolicy = "attention",
        setting: Setting | None = None,
        population: Population | Mixture | None = None,
        distance: ArrayLike | None = None,
    ) -> None:
        if not tasks:
            raise ValueError("there is no task; expected one or more")
        self.tasks = dict(tasks)
        self.desk = Assistant(policy=policy, setting=setting, population=population, distance=distance)
        self.count, self.paused, self.advice = 0, False, NOTHING
        self.fault: str | None = None
        self.present: set[str] = set()
        self.recent: deque[dict[str, Any]] = deque(maxlen=RECENT)
        self._notes: dict[str, _Note] = {}
        self._known: dict[str, PersonState] = {}

    # What happens.

    def happen(self, event: Event, time: float) -> dict[str, Any] | None:
        """Let something happen, and decide what the robot does then.

        Parameters
        ----------
        event : Event
        time : float
            Seconds since the session began.

        Returns
        -------
        dict or None
            The record; None for time that has elapsed without anything coming of it.

        Raises
        ------
        UnknownError, InapplicableError, ValueError
            It cannot be. Nothing has changed.
        """
        record = {"n": self.count + 1, "time": round(time, 3), "event": event.kind, **self._facts(event)}
        step = self.desk.step
        self._take(record)
        advice = self._decided()
        self._known.clear()
        if advice == self.advice and event.kind == "elapsed":
            self.desk.follow(advice, step)
            return None
        if advice.person is not None or advice != self.advice:
            record["advice"] = asdict(advice)
        self._note(record, advice)
        return record | {"step": self.desk.step}

    def _decided(self) -> Advice:
        self.fault = None
        if self.paused:
            return NOTHING
        try:
            return self.desk.recommend()
        except Exception as error:  # noqa: BLE001 what somebody did has been done, whatever is wrong with a policy
            self.fault = " ".join(str(error).split()) or type(error).__name__
            return NOTHING

    def again(self, record: Mapping[str, Any]) -> None:
        """Let happen again what has been recorded, the robot's decision included.

        Raises
        ------
        ValueError
            It cannot have happened.
        """
        require_record(record)
        self._take(record)
        advice = Advice.of(record["advice"]) if "advice" in record else self.advice
        if not self.paused:
            self.desk.follow(advice, record["step"])
        self._known.clear()
        self._note(record, advice)

    def _facts(self, event: Event) -> dict[str, Any]:
        """Give what a record says of an event, as far as it is said."""
        facts: dict[str, Any] = {"person": event.person, "task": event.task, "id": event.id}
        if event.kind == "joined":
            facts["task"] = self._joins(event)
        elif event.person is not None:
            self.require(event.person)
        if event.kind == "began" and event.task is not None:
            self._task(event.task)
        if event.kind == "acted":
            assert event.person is not None
            assert event.action is not None
            facts |= {"action": event.action, "followed": event.followed, "unheard": self._unheard(event) or None}
        return {name: fact for name, fact in facts.items() if fact is not None}

    def _joins(self, event: Event) -> str | None:
        name = event.person or ""
        if not NAME.fullmatch(name) or name.strip(" .") != name:
            raise ValueError(
                f"person {name[:80]!r}: expected a name of up to 64 letters, digits, blanks and signs of . _ -"
            )
        if name in self.present:
            raise InapplicableError(f"{name} is there already")
        if name in self._notes:
            if event.task is not None:
                raise InapplicableError(f"{name} comes back to the task that they left")
            return None
        if len(self._notes) >= MOST_PEOPLE:
            raise InapplicableError(f"{MOST_PEOPLE} people have been here; there is no place for {name}")
        task = event.task or next(iter(self.tasks))
        self._task(task)
        return task

    def _task(self, name: str) -> CostToGo:
        if name not in self.tasks:
            raise UnknownError(f"task {name[:80]!r}: expected one of {', '.join(self.tasks)}")
        return self.tasks[name]

    def _unheard(self, event: Event) -> bool:
        """Whether a suggestion stands that whoever acted cannot have known."""
        note, stands = self._notes[event.person or ""], self._state(event.person or "").suggestion
        if event.followed and (stands is None or stands.lower() != (event.action or "").strip().lower()):
            said = "nothing is suggested" if stands is None else f"{stands} is suggested"
            raise InapplicableError(f"followed is true and the action {event.action}, but {said}")
        late = event.seen is not None and event.seen < note.suggested
        return stands is not None and late and event.followed is None

    def _take(self, record: Mapping[str, Any]) -> None:
        kind, desk, person = record["event"], self.desk, record.get("person")
        match kind:
            case "joined":
                task = record.get("task")
                desk.join(person or "", None if task is None else self.tasks[task])
                if task is not None:
                    self._notes[person or ""] = _Note(task)
                self.present.add(person or "")
            case "left":
                desk.leave(person or "")
                self.present.discard(person or "")
            case "began":
                name = intern(record.get("task") or self._notes[person or ""].task)  # one of each
                desk.begin(person or "", self.tasks[name])
                self._began(self._notes[person or ""], name)
            case "acted":
                desk.observe(person or "", record["action"], heard=not record.get("unheard"))
                note = self._notes[person or ""]
                note.times.append(record["time"])
                note.reasons.append(note.reason)
                note.reason = None
            case "undone":
                desk.undo(person or "")
                note = self._notes[person or ""]
                note.times.pop()
                note.reason = note.reasons.pop()
            case "arrived":
                desk.arrived(person)
            case "elapsed":
                desk.elapse()
            case "paused" | "resumed":
                self.paused = kind == "paused"
                desk.elapse()

    def _began(self, note: _Note, task: str) -> None:
        note.tasks.append(note.task)
        note.task, note.reason = task, None
        note.reasons.clear()
        note.history.clear()

    def _note(self, record: Mapping[str, Any], advice: Advice) -> None:
        """Keep what follows from an event for those who watch."""
        self.count, self.advice = record["n"], advice
        for name in self.touched(record):
            self._notes[name].seq = self.count
        person = record.get("person")
        if person is not None and record["event"] != "arrived":
            note = self._notes[person]
            note.history.append((record["time"], _finite(self.desk.cost_to_go(person))))
        entry = {"n": self.count, "time": record["time"], "event": record["event"], "person": person}
        for name in ("action", "followed"):
            entry[name] = record.get(name)
        if record["event"] != "elapsed":
            self.recent.append({**entry, "suggestion": None})
        if advice.person is not None and advice.suggestion is not None:
            self._notes[advice.person].suggested, self._notes[advice.person].reason = self.count, advice.reason
            self.recent.append(
                entry | {"event": "suggested", "person": advice.person, "action": None, "followed": None}
                | {"suggestion": advice.suggestion}
            )  # fmt: skip

    # What is seen.

    def touched(self, record: Mapping[str, Any]) -> set[str]:
        """Name those for whom something has changed with an event."""
        if record["event"] in ("paused", "resumed"):
            return set(self.present)
        advised = (record.get("advice") or {}).get("person")
        return {name for name in (record.get("person"), advised) if name is not None}

    def require(self, person: str) -> None:
        """Refuse whoever is not there.

        Raises
        ------
        AbsentError
        """
        if person not in self.present:
            raise AbsentError(f"{person[:80]!r} is not in the team")

    @property
    def people(self) -> tuple[str, ...]:
        """Who is there, in the order in which they first came."""
        return self.desk.people

    def place(self, person: str) -> tuple[CostToGo, int]:
        """Give somebody's task, and the state in which it is."""
        return self.tasks[self._notes[person].task], self._state(person).state

    def person(self, person: str) -> dict[str, Any]:
        """Give what somebody sees, as JSON has it."""
        return self._seen(self._state(person))

    def _state(self, person: str) -> PersonState:
        """Give what is known of somebody since the last event; it is asked for by several who show it."""
        if person not in self._known:
            self._known[person] = self.desk.person(person)
        return self._known[person]

    def _seen(self, known: PersonState) -> dict[str, Any]:
        note = self._notes[known.person]
        return {
            "person": known.person,
            "task": note.task,
            "present": known.present,
            "paused": self.paused,
            "applicable": list(known.applicable),
            "suggestion": known.suggestion,
            "reason": _plain(note.reason) if known.suggestion is not None else None,
            "cost_to_go": _finite(known.cost_to_go),
            "steps": known.steps,
            "finished": known.finished,
            "seq": note.seq,
        }

    def entry(self, person: str) -> dict[str, Any]:
        """Give what the operator sees of somebody, as JSON has it."""
        known = self._state(person)
        return self._seen(known) | {
            "history": [list(point) for point in self._notes[person].history],
            "beta": [known.beta.low, known.beta.mean, known.beta.high],
            "theta": [known.theta.low, known.theta.mean, known.theta.high],
            "grid": {"beta": known.grid.beta.tolist(), "theta": known.grid.theta.tolist()},
            "belief": known.belief.tolist(),
        }

    def beliefs(self) -> dict[str, bytes]:
        """Give what is believed of everybody who is there, to the bit."""
        return {person: self.desk.person(person).belief.tobytes() for person in self.desk.people}

    def robot(self) -> dict[str, Any]:
        """Give where the robot is to be and what it says there, as JSON has it.

        What it has said stays its errand until it is answered or there is another one.
        """
        here, advice = self.desk.robot, self.advice
        errand: dict[str, Any] = {"person": None, "suggestion": None, "reason": None, "arrived": True}
        if not self.paused and advice.person is not None:
            errand = asdict(advice) | {"reason": _plain(advice.reason)}
        elif not self.paused and here is not None and here in self.present:
            known = self.person(here)
            if known["suggestion"] is not None:
                errand |= {"person": here, "suggestion": known["suggestion"], "reason": known["reason"]}
        return {**errand, "location": here, "seq": self.count}

    def log(self, task: str | None = None) -> list[dict[str, Any]]:
        """Give everybody's actions as `fit` reads them, with their times in seconds since the session began.

        Parameters
        ----------
        task : str, optional
            Only those in this task.

        Raises
        ------
        UnknownError
            There is no such task.
        """
        if task is not None:
            self._task(task)
        rows = []
        times = {name: iter(note.times) for name, note in self._notes.items()}  # in the order of somebody's rows
        for row in self.desk.log():
            note, number, time = self._notes[row["person"]], int(row["episode"]) - 1, next(times[row["person"]])
            own = note.tasks[number] if number < len(note.tasks) else note.task
            if task in (None, own):
                rows.append({**row, "task": own, "time": time})
        return rows


def _plain(reason: Reason | None) -> dict[str, Any] | None:
    """Give a reason as it comes out of JSON again."""
    if reason is None:
        return None
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(reason).items()}


def _finite(cost: float) -> float | None:
    return cost if math.isfinite(cost) else None
