"""A live team whose robots decide after every event, and what pages show of its people and robots.

Timing. A decision follows every event: an action, an undo, a person who joins, leaves or begins a task, the robot's
arrival. Idle people cause no events, and the robot does one thing per decision. So a person who needs help while no one
acts would wait without end. Therefore elapsed time is an event, too (`Elapsed`), if the robot then does something new.
An action counts as the answer to a suggestion only if the person can have seen it.

The record of each event includes the advice. `Team.again` applies a record, and leads to the same beliefs, bit for bit,
without computing a decision again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from numpy.typing import ArrayLike

from planner import CostToGo

from ..declare.refusals import AbsentError, Refusal
from ..people.decision import Floats
from ..people.goals import Goals, require_possible_terms
from ..people.ranges import Population
from ..person.settings import Setting
from ..team.state import TeamPolicy
from .advice import Advice, PersonState
from .desk import IDLE, Desk
from .event_base import Event, TeamEvent
from .events import Elapsed, Left, kinds
from .explanation import Explanation
from .history import Change, History
from .names import is_name
from .record import TeamRecord, without_in_view
from .roster import News
from .views import GoalAnswer, MemberView, PersonView, RobotView


class Team(History[TeamRecord]):
    """The state of a team after its events.

    Parameters
    ----------
    tasks : mapping of str to CostToGo or Goals
        Tasks by name; the first is the default.
    policy, setting, population, distance
        As in `Assistant`.
    like : Team, optional
        Another one with the same arguments, whose tasks need not be solved again.

    Attributes
    ----------
    desk : Desk
        What the robots know.
    """

    def __init__(
        self,
        tasks: Mapping[str, CostToGo | Goals],
        *,
        policy: str | TeamPolicy = "attention",
        setting: Setting | None = None,
        population: Population | None = None,
        distance: ArrayLike | None = None,
        like: Team | None = None,
    ) -> None:
        super().__init__()
        if not tasks:
            raise ValueError("there is no task; expected one or more")
        self.tasks = dict(tasks)
        self.desk = Desk(self.tasks, policy=policy, setting=setting, population=population, distance=distance)
        if like is not None:
            self.desk.share(like.desk)
        for task in self.tasks.values():
            require_possible_terms(task, self.desk.population.weights)  # at once, and not when somebody begins the task
        self._nothing = (IDLE,) * len(self.desk.setting.robots)
        self._advices = self._nothing
        self._known: dict[str, PersonState] = {}

    # Events.

    def happen(self, event: Event, time: float) -> TeamRecord | None:
        """Apply an event, decide what the robots do then, and return the record.

        The record is None if nothing has changed, such as after elapsed time if the robots do nothing new.
        """
        if not isinstance(event, TeamEvent):
            raise Refusal("other", why=f"event {event.kind!r}: expected one of {', '.join(sorted(kinds(TeamEvent)))}")
        found = event.accepted(self.desk, self.count)
        if found is None:
            return None
        step, time = self.desk.step, round(time, 3)
        caused = found.causes(self.desk)
        found.happen(self.desk, time, number=self.count + 1, caused=caused)
        advices = self._decided()
        self._known.clear()
        if isinstance(event, Elapsed) and advices == self.advices:
            if not self.paused:
                self.desk.follow(advices, step)
            return None
        changed = any(advice.person is not None for advice in advices) or advices != self.advices
        record = TeamRecord(
            n=self.count + 1, time=time, event=found, caused=caused, step=self.desk.step,
            advices=advices if changed else (), fault=self.fault,
        )  # fmt: skip
        self._note(record, advices)
        return record

    def due(self) -> Iterator[tuple[float, Event]]:
        """Yield the events that time alone will cause, each with when it does."""
        for kind in kinds(TeamEvent).values():
            yield from kind.due(self.desk)

    def _decided(self) -> tuple[Advice, ...]:
        self.fault = None
        try:
            return self.desk.recommend_all()
        except Exception as error:  # noqa: BLE001 an action is a fact, even if the policy fails
            self.fault = " ".join(str(error).split()) or type(error).__name__
            return self._nothing

    def again(self, record: TeamRecord) -> None:
        """Apply a recorded event, including the robots' decision."""
        record.event.happen(self.desk, record.time, number=record.n, caused=record.caused)
        advices = record.advices or self.advices
        if len(advices) != self.robots:
            raise ValueError(f"advice of {len(advices)} robots; expected {self.robots}")
        if not self.paused:
            self.desk.follow(advices, record.step)
        self._known.clear()
        self._note(record, advices)

    def _note(self, record: TeamRecord, advices: tuple[Advice, ...]) -> None:
        """Update what the views show of people, and the list of recent events, after an event."""
        self.count, self._advices = record.n, advices
        for name in self.touched(record):
            self.desk.entry(name).seq = self.count
        self.recent.extend(record.entries(advices))

    def touched(self, record: TeamRecord) -> set[str]:
        """Return the people whose view an event has changed."""
        there = set(self.people)
        return record.touched() | (there if record.event.concerns_all else there & self.desk.roster.touched)

    def followed(self, record: TeamRecord) -> bool | None:
        """Return whether the last event, which this is, followed a suggestion; None if it answers none."""
        event = record.event
        last = self.desk.entry(event.who).steps[-1] if event.who is not None and event.is_action else None
        return None if last is None or last.offer is None or last.seen else last.action == last.suggestion

    @property
    def paused(self) -> bool:
        """Whether the robots make no suggestions."""
        return self.desk.paused

    @property
    def advices(self) -> tuple[Advice, ...]:
        """The advice of each robot after the last event."""
        return self._advices

    @property
    def people(self) -> tuple[str, ...]:
        """The people who are present, in the order of their first arrival."""
        return self.desk.people

    def require(self, person: str) -> None:
        """Check that a person is present."""
        self.desk.require(person)

    # Erasing.

    def farewell(self, person: str) -> Event | None:
        """Return the event by which a person leaves; None if they have left."""
        if not self.desk.has_met(person) or not is_name(person):
            raise AbsentError("no_records", person=repr(person[:80]))
        return Left(person=person) if self.desk.is_present(person) else None

    def without(self, person: str, label: str) -> Change:
        """Return a function that removes what is recorded of a person from a record and its answer.

        The robots' course remains: where they went, and what they suggested to others. The person's place has the
        label.
        """
        before = 0.0

        def removed(record: TeamRecord, answer: Any) -> tuple[TeamRecord, Any]:
            nonlocal before
            kept = record.without(person, label, before)
            if record.event.who == person:
                return kept, None
            before = record.time
            return kept, None if answer is None else without_in_view(answer, person, label)

        return removed

    # Views.

    def task_and_state(self, person: str) -> tuple[CostToGo | Goals, int]:
        """Return a person's task, and the number of its present state."""
        return self.tasks[self.desk.entry(person).tasks[-1]], self._state(person).state

    def news(self, person: str) -> Sequence[News]:
        """Return what has become known of a person, or moved them, between actions in their task."""
        return tuple(self.desk.entry(person).news)

    def person(self, person: str) -> PersonView:
        """Return a person's view."""
        return PersonView(**self._seen(self._state(person)))

    def _state(self, person: str) -> PersonState:
        """Return the person's state after the last event; it is cached, as several views show it."""
        if person not in self._known:
            self._known[person] = self.desk.person(person)
        return self._known[person]

    def _seen(self, known: PersonState) -> dict[str, Any]:
        entry = self.desk.entry(known.person)
        return {
            "person": known.person, "task": entry.tasks[-1], "present": known.present, "paused": self.paused,
            "applicable": known.applicable, "suggestion": known.suggestion,
            "reason": None if entry.offer is None else entry.offer.reason, "cost_to_go": known.cost_to_go,
            "steps": known.steps, "finished": known.finished, "explained": True, "seq": entry.seq,
            "state_probability": known.states.get(known.state), "question": known.question,
            "answered": None if known.answered is None else GoalAnswer(*known.answered),
            "done": Counter(one.kind for one in entry.done if one.line is not None),
        }  # fmt: skip

    def explain_later(self, person: str, against: str | None = None) -> Callable[[], Explanation]:
        """Return a function that explains a person's suggestion, or why there is none, by the present beliefs.

        The function may be called from another thread, and then raises the errors of `Assistant.explain`.
        """
        return self.desk.explain_later(person, against=against)

    def entry(self, person: str) -> MemberView:
        """Return the operator's view of a person."""
        known = self._state(person)
        return MemberView(
            **self._seen(known), history=self.desk.entry(person).history,
            beta=(known.beta.low, known.beta.mean, known.beta.high),
            theta=(known.theta.low, known.theta.mean, known.theta.high),
            grid={"beta": known.grid.beta.tolist(), "theta": known.grid.theta.tolist()},
            belief=known.hidden.with_theta(known.belief, "beta").tolist(), goals=dict(known.goals),
            sees=self.desk.seen.whom(self.desk.entry(person)),
        )  # fmt: skip

    def learned(self, person: str) -> Floats | None:
        """Return the belief about a person, shape (B, T), present or not; None if no action was observed.

        It is the same for all goals that the person may pursue, as a later task has goals of its own.
        """
        if not self.desk.has_met(person) or not self.desk.entry(person).times:
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

    def robot(self, number: int = 1) -> RobotView:
        """Return where a robot should be and what it suggests there; robots are numbered from 1.

        A suggestion remains until it is answered or replaced by another one. Of several robots with the person, the one
        that was sent makes it, or else the first.
        """
        self.desk.require_robot(number)
        here, advice = self.desk.robots[number - 1], self.advices[number - 1]
        errand: dict[str, Any] = {}
        if not self.paused and advice.person is not None:
            errand = {name: getattr(advice, name) for name in ("person", "suggestion", "reason", "arrived")}
        elif not self.paused and here is not None and self.desk.is_present(here) and self._attends(here) == number - 1:
            offer = self.desk.entry(here).offer
            if offer is not None:
                errand = {"person": here, "suggestion": offer.action, "reason": offer.reason}
        asked = (one for one in self.desk.questions if self.desk.is_present(one.person)) if number == 1 else ()
        return RobotView(**errand, location=here, seq=self.count, questions=tuple(asked))

    def _attends(self, person: str) -> int:
        """Return the index of the robot that attends to a person with whom one or more robots are."""
        there = [m for m, where in enumerate(self.desk.robots) if where == person and self.advices[m].arrived]
        return next((m for m in there if self.advices[m].person == person), min(there, default=0))

    def log(self, task: str | None = None) -> list[dict[str, Any]]:
        """Return all actions as `fit` reads them, with their tasks and times; or only those in one task."""
        if task is not None:
            self.desk.require_task(task)
        return [row for row in self.desk.log() if task in (None, row["task"])]
