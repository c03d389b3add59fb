"""The state of a live session after its events: the robot's decision after each, and the views of all.

Timing. A decision follows every event: an action, an undo, a person who joins, leaves or begins a task, the robot's
arrival. Idle people cause no events, and the robot does one thing per decision. So a person who needs help while no one
acts would wait without end. Therefore elapsed time is an event, too (`elapsed`), if the robot then does something new.
An action counts as the answer to a suggestion only if the person can have seen it.

Each event has a record, which includes the advice. `Course.again` applies a record, and leads to the same beliefs, bit
for bit, without computing a decision again.
"""

from __future__ import annotations

import math
from array import array
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from sys import intern
from typing import Any

from numpy.typing import ArrayLike

from planner import CostToGo

from ..explain.explanation import Explanation, WhyNothing
from ..people.action_names import in_pddl
from ..people.decision import Floats
from ..people.goals import Goals
from ..people.human import Population
from ..team.settings import Setting
from ..team.state import TeamPolicy
from ..texts.refusals import AbsentError, InapplicableError, InvalidError
from .advice import Advice, PersonState, Reason
from .assistant import Assistant
from .erasing import without
from .events import KINDS, Event, advised, is_name, require_record
from .live_task import require_usable
from .recent_events import entries
from .store import Change

NOTHING = Advice(None, None, None, arrived=True)


@dataclass
class _Note:
    """The data about a person that only the views need; the rest is in the team's `Roster`.

    For all their tasks: the names, and the time of each action. For the current task also the reason of the suggestion
    that was open at each action, and the cost-to-go after each event.
    """

    task: str
    seq: int = 0
    suggested: int = 0
    asked: int = 0
    reason: Reason | None = None
    tasks: list[str] = field(default_factory=list)
    times: array[float] = field(default_factory=lambda: array("d"))
    reasons: list[Reason | None] = field(default_factory=list)
    history: list[tuple[float, float | None]] = field(default_factory=list)


class Course:
    """The state of a session after its events.

    Parameters
    ----------
    tasks : mapping of str to CostToGo
        Tasks by name; the first is the default.
    policy, setting, population, distance
        As in `Assistant`.

    Attributes
    ----------
    advices : tuple of Advice
        The advice of each robot after the last event.
    fault : str or None
        Error of the policy after the last event; the robot then does nothing, and people continue to act.
    """

    def __init__(
        self,
        tasks: Mapping[str, CostToGo | Goals],
        *,
        policy: str | TeamPolicy = "attention",
        setting: Setting | None = None,
        population: Population | None = None,
        distance: ArrayLike | None = None,
    ) -> None:
        if not tasks:
            raise ValueError("there is no task; expected one or more")
        self.tasks = dict(tasks)
        self.desk = Assistant(policy=policy, setting=setting, population=population, distance=distance)
        for task in self.tasks.values():
            require_usable(task, self.desk.setting, self.desk.population)
        self.count, self.paused = 0, False
        self._nothing = (NOTHING,) * len(self.desk.setting.robots)
        self.advices = self._nothing
        self.fault: str | None = None
        self.present: set[str] = set()
        self.recent: deque[dict[str, Any]] = deque(maxlen=50)  # shown on the operator's page
        self._notes: dict[str, _Note] = {}
        self._known: dict[str, PersonState] = {}

    # Events.

    def happen(self, event: Event, time: float) -> dict[str, Any] | None:
        """Apply an event, decide what the robot does then, and return the record.

        Parameters
        ----------
        event : Event
        time : float
            Seconds since the session began.

        Returns
        -------
        dict or None
            The record; None for elapsed time after which the robot does nothing new.

        Raises
        ------
        InvalidError, InapplicableError, InvalidError
            The event is not possible. Nothing has changed.
        """
        if event.kind not in KINDS:
            raise InvalidError("other", why=f"event {event.kind[:40]!r}: expected one of {', '.join(sorted(KINDS))}")
        if event.stage is not None:
            raise InvalidError("other", why=f"stage {event.stage[:80]!r}: expected none outside of a user study")
        record = {"n": self.count + 1, "time": round(time, 3), "event": event.kind, **self._facts(event)}
        step = self.desk.step
        self._take(record)
        advices = self._decided()
        self._known.clear()
        if advices == self.advices and event.kind == "elapsed":
            if not self.paused:
                self.desk.follow(advices, step)
            return None
        if any(advice.person is not None for advice in advices) or advices != self.advices:
            record["advices"] = [advice.as_dict() for advice in advices]
        self._note(record, advices)
        return record | {"step": self.desk.step}

    def _decided(self) -> tuple[Advice, ...]:
        self.fault = None
        if self.paused:
            return self._nothing
        try:
            return self.desk.recommend_all()
        except Exception as error:  # noqa: BLE001 an action is a fact, even if the policy fails
            self.fault = " ".join(str(error).split()) or type(error).__name__
            return self._nothing

    def again(self, record: Mapping[str, Any]) -> None:
        """Apply a recorded event, including the robot's decision.

        Raises
        ------
        ValueError
            The record is not possible here.
        """
        require_record(record)
        self._take({**record, "event": "elapsed"} if self._is_unasked(record) else record)
        advices = tuple(map(Advice.of, advised(record))) or self.advices
        if len(advices) != self.robots:
            raise ValueError(f"advice of {len(advices)} robots; expected {self.robots}")
        if not self.paused:
            self.desk.follow(advices, record["step"])
        self._known.clear()
        self._note(record, advices)

    def _is_unasked(self, record: Mapping[str, Any]) -> bool:
        """Return whether a record is an answer to a question that is in no record, or takes such an answer back.

        Earlier versions let people answer a question that was asked before their policy failed.
        """
        kind, person = record["event"], record.get("person") or ""
        if person not in self.present or kind not in ("answered", "retracted"):
            return False
        if kind == "retracted":
            return self._state(person).answered is None
        return self._state(person).question is None and not isinstance(record.get("answer"), str)

    def _facts(self, event: Event) -> dict[str, Any]:
        """Return the fields of an event's record that follow from the event alone, without those that are None."""
        facts: dict[str, Any] = {"person": event.person, "task": event.task, "id": event.id}
        if event.kind == "joined":
            facts["task"] = self._joins(event)
            facts["belief"] = None if event.belief is None or facts["task"] is None else list(event.belief)
        elif event.person is not None:
            self.require(event.person)
        if event.kind == "began" and event.task is not None:
            self._task(event.task)
        if event.kind == "acted":
            facts |= {"action": event.action, "followed": event.followed, "unheard": self._unheard(event) or None}
            facts |= self.desk.seen_of(event.person or "", event.action, event.likelihoods, event.missed)
            if event.action is not None:
                facts["action"] = in_pddl(event.action)
        if event.kind == "answered":
            self._require_asked(event)
            facts["answer"] = event.answer
        if event.kind == "rearranged":
            try:
                self.desk.other_travel(event.distance or ())
            except (TypeError, ValueError) as error:
                raise InvalidError("other", why=str(error)) from None
            facts["distance"] = list(map(list, event.distance or ()))
        if event.kind == "arrived":
            self.require_robot(event.robot)
            facts["robot"] = event.robot
        return {name: fact for name, fact in facts.items() if fact is not None}

    def _joins(self, event: Event) -> str | None:
        name = event.person or ""
        if not is_name(name):
            raise InvalidError("no_name", person=repr(name[:80]))
        if name in self.present:
            raise InapplicableError("there_already", person=name)
        if name in self._notes:
            if event.task is not None:
                raise InapplicableError("other", why=f"{name} returns to the task that they left")
            return None
        most = 10_000  # people over a whole session, which bounds its memory
        if len(self._notes) >= most:
            raise InapplicableError("other", why=f"{most} people have been here; there is no place for {name}")
        task = event.task or next(iter(self.tasks))
        self._task(task)
        return task

    def _task(self, name: str) -> CostToGo | Goals:
        if name not in self.tasks:
            raise InvalidError("other", why=f"task {name[:80]!r}: expected one of {', '.join(self.tasks)}")
        return self.tasks[name]

    def _require_asked(self, event: Event) -> None:
        """Check that an answer is to the question that is open, unless it is an action."""
        late = event.seen is not None and event.seen < self._notes[event.person or ""].asked
        if late and not isinstance(event.answer, str):
            raise InapplicableError("later_question")

    def _unheard(self, event: Event) -> bool:
        """Return whether there is an open suggestion that the person cannot have seen."""
        if event.action is None and event.followed is not None:
            raise InvalidError("other", why="followed: expected an action that was seen")
        note, stands = self._notes[event.person or ""], self._state(event.person or "").suggestion
        if event.followed and (stands is None or stands.lower() != in_pddl(event.action or "")):
            said = "nothing is suggested" if stands is None else f"{stands} is suggested"
            raise InapplicableError("other", why=f"followed is true and the action {event.action}, but {said}")
        late = event.seen is not None and event.seen < note.suggested
        return stands is not None and late and event.followed is None

    def _take(self, record: Mapping[str, Any]) -> None:
        kind, desk, person = record["event"], self.desk, record.get("person")
        match kind:
            case "joined":
                task = record.get("task")
                desk.join(person or "", None if task is None else self.tasks[task], belief=record.get("belief"))
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
                desk.observe(
                    person or "", record.get("action"), heard=not record.get("unheard"),
                    likelihoods=record.get("likelihoods"), missed=record.get("missed"),
                )  # fmt: skip
                note = self._notes[person or ""]
                note.times.append(record["time"])
                note.reasons.append(note.reason)
                note.reason = None
            case "undone":
                desk.undo(person or "")
                note = self._notes[person or ""]
                note.times.pop()
                note.reason = note.reasons.pop()
            case "answered":
                desk.answer(person or "", record.get("answer"))
            case "retracted":
                desk.retract(person or "")
                self._notes[person or ""].reason = None
            case "arrived":
                desk.arrived(person, robot=record.get("robot", 1))
            case "elapsed":
                desk.elapse()
            case "rearranged":
                desk.rearrange(record["distance"])
            case "paused" | "resumed":
                self.paused = kind == "paused"
                desk.elapse()
            case "vacant":
                desk.join(person or "", self.tasks[record["task"]])
                desk.leave(person or "")
                self._notes[person or ""] = _Note(record["task"])
            case "erased":
                desk.elapse()

    def _began(self, note: _Note, task: str) -> None:
        note.tasks.append(note.task)
        note.task, note.reason = task, None
        note.reasons.clear()
        note.history.clear()

    def _note(self, record: Mapping[str, Any], advices: tuple[Advice, ...]) -> None:
        """Update what the views show of people, and the list of recent events, after an event."""
        self.count, self.advices = record["n"], advices
        for name in self.touched(record):
            self._notes[name].seq = self.count
        person = record.get("person")
        if person is not None and record["event"] != "arrived":
            note = self._notes[person]
            note.history.append((record["time"], _finite(self.desk.cost_to_go(person))))
        for advice in advices:
            if advice.question is not None:
                self._notes[advice.question.person].asked = self.count
            if advice.person is not None and advice.suggestion is not None:
                self._notes[advice.person].suggested, self._notes[advice.person].reason = self.count, advice.reason
        self.recent.extend(entries(record, advices))

    # Erasing.

    def farewell(self, person: str) -> Event | None:
        """Return the event by which a person leaves; None if they have left.

        Raises
        ------
        AbsentError
            Nothing is recorded of this person.
        """
        if person not in self._notes or not is_name(person):
            raise AbsentError("no_records", person=repr(person[:80]))
        return Event("left", person) if person in self.present else None

    def without(self, person: str, label: str) -> Change:
        """Return a function that removes what is recorded of a person from a record and its answer.

        The robot's course remains: where it went, and what it suggested to others. The person's place has the label.
        """
        return without(person, label)

    # Views.

    def touched(self, record: Mapping[str, Any]) -> set[str]:
        """Return the people whose view an event has changed."""
        if record["event"] in ("paused", "resumed"):
            return set(self.present)
        names = [record.get("person"), *(advice["person"] for advice in advised(record))]
        names += [advice["question"]["person"] for advice in advised(record) if "question" in advice]
        return {name for name in names if name is not None}

    def require(self, person: str) -> None:
        """Check that a person is present.

        Raises
        ------
        AbsentError
            The person is not present.
        """
        if person not in self.present:
            raise AbsentError("unknown", person=repr(person[:80]))

    @property
    def people(self) -> tuple[str, ...]:
        """The people who are present, in the order of their first arrival."""
        return self.desk.people

    def place(self, person: str) -> tuple[CostToGo | Goals, int]:
        """Return a person's task, and the number of its present state."""
        return self.tasks[self._notes[person].task], self._state(person).state

    def person(self, person: str) -> dict[str, Any]:
        """Return a person's view, as JSON."""
        return self._seen(self._state(person))

    def _state(self, person: str) -> PersonState:
        """Return the person's state after the last event; it is cached, as several views show it."""
        if person not in self._known:
            self._known[person] = self.desk.person(person)
        return self._known[person]

    def _seen(self, known: PersonState) -> dict[str, Any]:
        note = self._notes[known.person]
        return {
            "person": known.person, "task": note.task, "present": known.present, "paused": self.paused,
            "applicable": list(known.applicable), "suggestion": known.suggestion,
            "reason": _plain(note.reason) if known.suggestion is not None else None,
            "cost_to_go": _finite(known.cost_to_go), "steps": known.steps, "finished": known.finished,
            "explained": True, "seq": note.seq,
            **({} if known.question is None else {"question": known.question.as_dict()}),
            **({} if known.answered is None else {"answered": dict(zip(("goal", "yes"), known.answered, strict=True))}),
        }  # fmt: skip

    def explain_later(self, person: str, against: str | None = None) -> Callable[[], Explanation]:
        """Return a function that explains a person's suggestion, or why there is none, by the present beliefs.

        The function may be called from another thread, and then raises the errors of `Assistant.explain`.
        """
        known = self._state(person)
        if self.paused and known.suggestion is None and against is None:
            paused = WhyNothing("paused", "", about=person)
            return lambda: Explanation(nothing=paused)
        return self.desk.explain_later(person, against=against)

    def entry(self, person: str) -> dict[str, Any]:
        """Return the operator's view of a person, as JSON."""
        known = self._state(person)
        return self._seen(known) | {
            "history": [list(point) for point in self._notes[person].history],
            "beta": [known.beta.low, known.beta.mean, known.beta.high],
            "theta": [known.theta.low, known.theta.mean, known.theta.high],
            "grid": {"beta": known.grid.beta.tolist(), "theta": known.grid.theta.tolist()},
            "belief": known.hidden.with_theta(known.belief, "beta").tolist(),
            **({"goals": dict(known.goals)} if known.goals else {}),
        }

    def knows(self, person: str) -> bool:
        """Return whether a person has been in this session, present or not."""
        return person in self._notes

    def learned(self, person: str) -> Floats | None:
        """Return the belief about a person, shape (B, T), present or not; None if no action was observed.

        It is the same for all goals that the person may pursue, as a later task has goals of its own.
        """
        if not self._notes[person].times:
            return None
        known = self._state(person)
        return known.hidden.of_people(known.belief)

    def beliefs(self) -> dict[str, bytes]:
        """Return the belief about each present person, as the bytes of its array."""
        return {person: self.desk.person(person).belief.tobytes() for person in self.desk.people}

    @property
    def distance(self) -> list[list[float]] | None:
        """The distances in force; None if all are 1."""
        return self.desk.distance

    @property
    def robots(self) -> int:
        """The number of robots."""
        return len(self._nothing)

    def require_robot(self, number: int) -> None:
        """Check the number of a robot.

        Raises
        ------
        AbsentError
            There is no robot of this number.
        """
        if not 1 <= number <= self.robots:
            raise AbsentError("other", why=f"robot {number}: expected a number from 1 to {self.robots}")

    def robot(self, number: int = 1) -> dict[str, Any]:
        """Return where a robot should be and what it suggests there, as JSON; robots are numbered from 1.

        A suggestion remains until it is answered or replaced by another one. Of several robots with the person, the one
        that was sent makes it, or else the first.
        """
        self.require_robot(number)
        here, advice = self.desk.robots[number - 1], self.advices[number - 1]
        errand: dict[str, Any] = {"person": None, "suggestion": None, "reason": None, "arrived": True}
        if not self.paused and advice.person is not None:
            errand = advice.as_dict() | {"reason": _plain(advice.reason)}
        elif not self.paused and here is not None and here in self.present and self._attends(here) == number - 1:
            known = self.person(here)
            if known["suggestion"] is not None:
                errand |= {"person": here, "suggestion": known["suggestion"], "reason": known["reason"]}
        errand.pop("question", None)  # which may have been asked some events ago
        asked = [one.as_dict() for one in self.desk.questions if one.person in self.present] if number == 1 else []
        return {**errand, "location": here, "seq": self.count, **({"questions": asked} if asked else {})}

    def _attends(self, person: str) -> int:
        """Return the index of the robot that attends to a person with whom one or more robots are."""
        there = [m for m, where in enumerate(self.desk.robots) if where == person and self.advices[m].arrived]
        return next((m for m in there if self.advices[m].person == person), min(there, default=0))

    def log(self, task: str | None = None) -> list[dict[str, Any]]:
        """Return all actions as `fit` reads them, with their times in seconds since the session began.

        Parameters
        ----------
        task : str, optional
            Return the actions in this task only.

        Raises
        ------
        InvalidError
            There is no such task.
        """
        if task is not None:
            self._task(task)
        rows = []
        times = {name: iter(note.times) for name, note in self._notes.items()}  # in the order of one person's rows
        for row in self.desk.log(missed=True):
            note, number, time = self._notes[row["person"]], int(row["episode"]) - 1, next(times[row["person"]])
            own = note.tasks[number] if number < len(note.tasks) else note.task
            if task in (None, own) and row["action"] is not None:
                rows.append({**row, "task": own, "time": time})
        return rows


def _plain(reason: Reason | None) -> dict[str, Any] | None:
    """Return a reason in the types that JSON has."""
    if reason is None:
        return None
    return {name: list(value) if isinstance(value, tuple) else value for name, value in reason.as_dict().items()}


def _finite(cost: float) -> float | None:
    return cost if math.isfinite(cost) else None
