"""A participant's team: the participant and simulated people, who share a robot and act in step.

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
    """A participant and the simulated people of their team.

    Parameters
    ----------
    person : str
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
        person: str,
        tasks: Mapping[str, CostToGo],
        course: Callable[[], Course],
        mates: Callable[[], Sequence[SimulatedPerson]],
        *,
        again: bool,
    ) -> None:
        self.name, self._tasks, self._again = person, tasks, again
        self._course_anew, self._mates_anew = course, mates
        self._past: list[Sub] = []
        self.task = ""
        self._begin_anew()

    def _begin_anew(self) -> None:
        self.course = self._course_anew()
        self._mates = {f"{self.name}-{number}": mate for number, mate in enumerate(self._mates_anew(), start=1)}

    # Events.

    def begin(self, task: str, n: int, time: float) -> list[Sub]:
        """Start a task for the whole team; return the records."""
        kind = "began" if self._past else "joined"
        return self._all([Event(kind, name, task=task) for name in (self.name, *self._mates)], n, time)

    def act(self, event: Event, n: int, time: float) -> dict[str, Any]:
        """Record the participant's action, then one action of each simulated person.

        Return the records (`team`) and what the participant saw (`seen`).
        """
        before = self.course.person(self.name)
        subs = self._all([event], n, time, mates=True)
        after = self.course.person(self.name)
        seen = {
            "suggestion": None if subs[0].get("unheard") else before["suggestion"],
            "cost_before": before["cost_to_go"], "cost_after": after["cost_to_go"], "finished": after["finished"],
            "optimal": not self.course.desk.erred(self.name),
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
            if sub.get("task") and sub["person"] == self.name:
                self.task = sub["task"]

    # Views.

    def seen(self) -> dict[str, Any]:
        """Return the participant's view of the task."""
        return self.course.person(self.name)

    def place(self) -> tuple[CostToGo, int]:
        """Return the participant's task, and the number of its present state."""
        return self._tasks[self.task], self.course.place(self.name)[1]
