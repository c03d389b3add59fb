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

from ...live.event_base import Recorded, TeamEvent
from ...live.events import Acted, Began, Elapsed, Joined, Left
from ...live.record import TeamRecord
from ...live.simulated_person import SimulatedPerson
from ...live.team import Team
from ...live.views import PersonView

Subs = tuple[TeamRecord, ...]
"""Events within a team."""


class Seen(Recorded):
    """What a participant saw when they acted, and what came of it."""

    suggestion: str | None = None
    """The suggestion that they saw."""
    cost_before: float | None = None
    """Cost-to-go before the action; none in a dead end."""
    cost_after: float | None = None
    """Cost-to-go after the action; none in a dead end."""
    finished: bool
    """Whether the goal was reached."""
    optimal: bool
    """Whether the action was an optimal choice."""


class ParticipantTeam:
    """The participants of a team, and its simulated people.

    Parameters
    ----------
    name : str
        Of the only participant, or of the group.
    tasks : mapping of str to CostToGo
    team : callable
        Returns the team without events.
    mates : callable
        Returns the simulated people in their initial states.
    again : bool
        Whether simulated people begin their task again when they have finished.
    """

    def __init__(
        self, name: str, tasks: Mapping[str, CostToGo], team: Callable[[], Team],
        mates: Callable[[], Sequence[SimulatedPerson]], *, again: bool,
    ) -> None:  # fmt: skip
        self.name, self._tasks, self._again = name, tasks, again
        self._team_anew, self._mates_anew = team, mates
        self._past: list[TeamRecord] = []
        self._begin_anew()

    def _begin_anew(self) -> None:
        self.team = self._team_anew()
        self._task: dict[str, str] = {}
        self._mates = {f"{self.name}-{number}": mate for number, mate in enumerate(self._mates_anew(), start=1)}

    # Events.

    def begin(self, person: str, task: str, n: int, time: float) -> Subs:
        """Start a task for a participant and the simulated people; return the records."""
        kind = Began if person in self._task else Joined
        events = [kind(person=name, task=task) for name in (person, *self._mates)]
        return self._all([*self._rejoins(person), *events], n, time)

    def rejoin(self, person: str, n: int, time: float) -> Subs:
        """Let a participant return to their task; return the records, none if they are present."""
        return self._all(self._rejoins(person), n, time)

    def leave(self, person: str, n: int, time: float) -> Subs:
        """Remove a participant, whom the robot then leaves alone; return the records, none if they have left."""
        return self._all([Left(person=person)] if self.team.desk.is_present(person) else [], n, time)

    def _rejoins(self, person: str) -> list[TeamEvent]:
        away = person in self._task and not self.team.desk.is_present(person)
        return [Joined(person=person)] if away else []

    def act(
        self, person: str, action: str, followed: bool | None, seq: int | None, n: int, time: float
    ) -> tuple[Subs, Seen]:
        """Record the participant's action, then one action of each simulated person.

        Return the records, and what the participant saw.
        """
        before = self.team.person(person)
        own = Acted(person=person, action=action, followed=followed, seq=seq)
        subs = self._all([*self._rejoins(person), own], n, time, mates=True)
        after = self.team.person(person)
        seen = Seen(
            suggestion=before.suggestion if own_action(subs, person).heard else None,
            cost_before=before.remaining, cost_after=after.remaining, finished=after.finished,
            optimal=not self.team.desk.erred(person),
        )  # fmt: skip
        return subs, seen

    def elapse(self, n: int, time: float) -> Subs:
        """Let the robot decide again as time has passed; return the records, none if it does nothing new."""
        return self._all([Elapsed()], n, time)

    def _all(self, events: Sequence[TeamEvent], n: int, time: float, *, mates: bool = False) -> Subs:
        """Apply events, all of them or none."""
        subs: list[TeamRecord] = []
        try:
            for event in events:
                subs += self._one(event, n, time)
            for name, mate in self._mates.items() if mates else ():
                action = self._chosen(name, mate)
                if action is not None:
                    subs += self._one(Acted(person=name, action=action), n, time)
                elif self._again:
                    subs += self._one(Began(person=name), n, time)
        except Exception:
            past, self._past = self._past, []
            self._begin_anew()
            self.again(past)
            raise
        self._keep(subs)
        return tuple(subs)

    def _one(self, event: TeamEvent, n: int, time: float) -> list[TeamRecord]:
        self.team.count = n - 1
        record = self.team.happen(event, time)
        return [] if record is None else [record]

    def _chosen(self, name: str, mate: SimulatedPerson) -> str | None:
        seen = self.team.person(name)
        mate.hear(self.team.news(name))
        if seen.finished:
            return None
        task, state = self._tasks[seen.task], self.team.task_and_state(name)[1]
        return mate.act(task, state, seen.applicable, seen.suggestion)

    def again(self, subs: Sequence[TeamRecord]) -> None:
        """Replay recorded events."""
        for sub in subs:
            event = sub.event
            if event.is_action and event.who in self._mates:
                self._chosen(event.who, self._mates[event.who])  # advances the person's random numbers
            self.team.count = sub.n - 1
            self.team.again(sub)
        self._keep(subs)

    def _keep(self, subs: Sequence[TeamRecord]) -> None:
        self._past += subs
        for sub in subs:
            if sub.event.who is not None and sub.event.begins is not None:
                self._task[sub.event.who] = sub.event.begins

    # Views.

    def seen(self, person: str) -> PersonView:
        """Return a participant's view of the task."""
        return self.team.person(person)

    def task_and_state(self, person: str) -> tuple[CostToGo, int]:
        """Return a participant's task, and the number of its present state."""
        return self._tasks[self._task[person]], self.team.task_and_state(person)[1]


def own_action(team: Sequence[TeamRecord], person: str) -> Acted:
    """Return a participant's action among the events of the team."""
    found: Any = next(record.event for record in team if record.event.is_action and record.event.who == person)
    own: Acted = found
    return own
