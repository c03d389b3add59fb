"""A team: participants who share a robot, or one participant and simulated people, who act in step.

Participants of a group act whenever they like, and the robot decides again after each action.

Each simulated person acts once after each action of the participant, as in the simulations. The robot's workload
therefore does not depend on the participant's speed, and results do not depend on a clock. The actions of the whole
team are one event, which is saved as a whole or not at all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from planner import CostToGo

from ..live.course import Course
from ..live.events import Event
from ..live.simulated_person import SimulatedPerson

Sub = dict[str, Any]
"""An event within the team, as a record."""


class ParticipantTeam:
    """The participants of a team, and its simulated people.

    Parameters
    ----------
    name : str
        Of the only participant, or of the group.
    tasks : mapping of str to CostToGo
    course : callable
        Returns a new course of the team, without events.
    mates : callable
        Returns the simulated people in their initial states.
    again : bool
        Whether simulated people begin their task again when they have finished.
    """

    def __init__(
        self,
        name: str,
        tasks: Mapping[str, CostToGo],
        course: Callable[[], Course],
        mates: Callable[[], Sequence[SimulatedPerson]],
        *,
        again: bool,
    ) -> None:
        self.name, self._tasks, self._again = name, tasks, again
        self._course_anew, self._mates_anew = course, mates
        self._past: list[Sub] = []
        self._begin_anew()

    def _begin_anew(self) -> None:
        self.course = self._course_anew()
        self._task: dict[str, str] = {}
        self._mates = {f"{self.name}-{number}": mate for number, mate in enumerate(self._mates_anew(), start=1)}

    # Events.

    def begin(self, person: str, task: str, n: int, time: float) -> list[Sub]:
        """Start a task for a participant and the simulated people; return the records."""
        kind = "began" if person in self._task else "joined"
        events = [Event(kind, name, task=task) for name in (person, *self._mates)]
        return self._all([*self._rejoins(person), *events], n, time)

    def rejoin(self, person: str, n: int, time: float) -> list[Sub]:
        """Let a participant return to their task; return the records, none if they are present."""
        return self._all(self._rejoins(person), n, time)

    def leave(self, person: str, n: int, time: float) -> list[Sub]:
        """Remove a participant, whom the robot then leaves alone; return the records, none if they have left."""
        return self._all([Event("left", person)] if person in self.course.present else [], n, time)

    def _rejoins(self, person: str) -> list[Event]:
        away = person in self._task and person not in self.course.present
        return [Event("joined", person)] if away else []

    def act(self, event: Event, n: int, time: float) -> dict[str, Any]:
        """Record the participant's action, then one action of each simulated person.

        Return the records (`team`) and what the participant saw (`seen`).
        """
        person = event.person or ""
        before = self.course.person(person)
        subs = self._all([*self._rejoins(person), event], n, time, mates=True)
        after = self.course.person(person)
        seen = {
            "suggestion": None if own_action(subs, person).get("unheard") else before["suggestion"],
            "cost_before": before["cost_to_go"], "cost_after": after["cost_to_go"], "finished": after["finished"],
            "optimal": not self.course.desk.erred(person),
        }  # fmt: skip
        return {"team": subs, "seen": seen}

    def elapse(self, n: int, time: float) -> list[Sub]:
        """Let the robot decide again as time has passed; return the records, none if it does nothing new."""
        return self._all([Event("elapsed")], n, time)

    def _all(self, events: Sequence[Event], n: int, time: float, *, mates: bool = False) -> list[Sub]:
        """Apply events, all of them or none."""
        subs: list[Sub] = []
        try:
            for event in events:
                subs += self._one(event, n, time)
            for name, mate in self._mates.items() if mates else ():
                action = self._chosen(name, mate)
                if action is not None:
                    subs += self._one(Event("acted", name, action), n, time)
                elif self._again:
                    subs += self._one(Event("began", name), n, time)
        except Exception:
            past, self._past = self._past, []
            self._begin_anew()
            self.again(past)
            raise
        self._keep(subs)
        return subs

    def _one(self, event: Event, n: int, time: float) -> list[Sub]:
        self.course.count = n - 1
        record = self.course.happen(event, time)
        return [] if record is None else [record]

    def _chosen(self, name: str, mate: SimulatedPerson) -> str | None:
        seen = self.course.person(name)
        if seen["finished"]:
            return None
        task, state = self._tasks[seen["task"]], self.course.place(name)[1]
        return mate.act(task, state, seen["applicable"], seen["suggestion"])

    def again(self, subs: Sequence[Sub]) -> None:
        """Replay recorded events."""
        for sub in subs:
            if sub["event"] == "acted" and sub["person"] in self._mates:
                self._chosen(
                    sub["person"], self._mates[sub["person"]]
                )  # advances the simulated person's random numbers
            self.course.count = sub["n"] - 1
            self.course.again(sub)
        self._keep(subs)

    def _keep(self, subs: Sequence[Sub]) -> None:
        self._past += subs
        for sub in subs:
            if sub.get("task"):
                self._task[sub["person"]] = sub["task"]

    # Views.

    def seen(self, person: str) -> dict[str, Any]:
        """Return a participant's view of the task."""
        return self.course.person(person)

    def place(self, person: str) -> tuple[CostToGo, int]:
        """Return a participant's task, and the number of its present state."""
        return self._tasks[self._task[person]], self.course.place(person)[1]


def own_action(subs: Sequence[Sub], person: str) -> Sub:
    """Return the record of a participant's action among those of the team."""
    return next(sub for sub in subs if sub["event"] == "acted" and sub["person"] == person)
