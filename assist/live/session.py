"""A live session that is saved: events are applied, stored, and acknowledged.

A `Session` is a `Course` with an `EventStore` and a lock, so that any thread may report events. An event is on the disk
before it is acknowledged and before others see it. Events that arrive together are one transaction. An event that
cannot be saved has no effect. A session that is opened again has the same states, beliefs (bit for bit), suggestions
and answers.

Any exception while events are applied undoes the whole batch: the transaction ends without effect, and the state is
restored from the store. Then the other events of the batch are applied again. So the state in memory is always the
stored one.
"""

from __future__ import annotations

import json
import logging
import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from planner import CostToGo
from planner.system.errors import DamagedFileError

from ..people.goals import Goals
from ..people.human import Population
from ..team.settings import Setting
from ..team.state import TeamPolicy
from ..texts.refusals import AbsentError, InapplicableError, InvalidError, Refusal
from .advice import Advice
from .course import Course
from .event_sourced import EventSourced, Outlook
from .events import LONGEST_REASON, VACANT, Event, name_of
from .header import header_of, require_same
from .people_store import PeopleStore, model_of
from .store import EventStore, JournalError, Tombstone, utc

T = TypeVar("T")

"""Errors of an event that is not possible, which leave the session as it was. After any other it is restored."""

Outcome = dict[str, Any] | Exception
"""Outcome of an event: the view of the client who reported it, or the exception because of which it has no effect."""


class Session:
    """A saved live session of people at work, and of the robot that assists them.

    Parameters
    ----------
    tasks : CostToGo or Goals, or mapping of str to these
        Tasks by name; the first is the default.
    journal : Path
        The file in which the session is saved, an SQLite database. If it exists, the session continues from it. The
        ending `.jsonl` stands for `.sqlite`; events of a former journal with that ending are imported.
    policy : str or callable
        A team policy, as in `Assistant`.
    setting, population, distance
        As in `Assistant`.
    people : PeopleStore, optional
        Where the beliefs in people are kept for later sessions, and taken from when they join for the first time.
    clock : callable
        Returns ascending seconds from any origin. No result depends on it.

    Attributes
    ----------
    changed : callable or None
        Called with the people whose view has changed, after the events are on the disk, while the session is locked.

    Raises
    ------
    ResultsExistError
        The journal belongs to a running session, or to one with other tasks or settings.
    DamagedFileError
        Something else has changed the journal.
    OSError
        The journal cannot be written.
    """

    def __init__(
        self,
        tasks: CostToGo | Goals | Mapping[str, CostToGo | Goals],
        journal: str | Path,
        *,
        policy: str | TeamPolicy = "attention",
        setting: Setting | None = None,
        population: Population | None = None,
        distance: ArrayLike | None = None,
        people: PeopleStore | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._tasks = dict(tasks) if isinstance(tasks, Mapping) else {"task": tasks}
        self._options: dict[str, Any] = {
            "policy": policy, "setting": setting, "population": population, "distance": distance,
        }  # fmt: skip
        self._clock, self._people, self._learned = clock, people, set[str]()
        self.changed: Callable[[set[str]], None] | None = None
        self.lock = threading.RLock()
        self._store = EventStore(Path(journal))
        try:
            self._open()
        except BaseException:
            self._store.close()
            raise
        self._began = clock() - self._last

    def _open(self) -> None:
        """Restore the state, after the events of an old journal were imported; or begin a new session."""
        expected: dict[str, Any] = json.loads(json.dumps(self._header(), default=str))
        self._meaning = model_of(expected.get("population", {}), expected.get("setting", {}), expected.get("chances"))
        with self._store.transaction():
            if self._store.old is not None:
                self._store.import_old()
            found = self._store.header()
            if found is None:
                self._store.begin(expected)
            else:
                begun = {name: found.get(name) for name in ("distance",) if name in expected}
                self._check(found, expected | begun)
                self._options |= begun  # events begin with these; those in force after the last one are to be the given
            self._resume()
            if isinstance(self._restored, Course) and self._restored.distance != expected["distance"]:
                self._check({"distance": self._restored.distance}, {"distance": expected["distance"]})
        self._store.imported()

    def _header(self) -> dict[str, Any]:
        return header_of(Course(self._tasks, **self._options).desk, self._tasks, self._options["distance"])

    def _check(self, found: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
        require_same(self._store.old or self._store.file, found, expected)

    def _course_anew(self) -> EventSourced:
        """Return the state before the first event."""
        return Course(self._tasks, **self._options)

    def _resume(self) -> None:
        """Restore the state by applying all events of the store."""
        course, last = self._course_anew(), 0.0
        for record in self._store:
            number = course.count + 1
            try:
                if record.get("n") != number:
                    raise ValueError(f"event {record.get('n')}; expected {number}")
                course.again(record)
                last = record["time"]
            except (KeyError, TypeError, AttributeError, ValueError) as error:
                raise self._store.damaged(number, error) from error
        self._restored, self._last, self._unsaved = course, last, False

    @property
    def _course(self) -> EventSourced:
        """The state after all saved events. Callers must hold the lock."""
        if self._unsaved:  # a batch was interrupted
            self._resume()
        return self._restored

    def close(self) -> None:
        """Save what was learned about people, if it is to be kept, and close the store; repeated calls do nothing."""
        with self.lock:
            try:
                if self._people is not None and not self._unsaved:
                    self._learned |= set(self._restored.people)
                    self._keep()
                    self._people = None
            finally:
                self._store.close()

    # What is learned about people.

    def _carried(self, course: EventSourced, event: Event) -> Event:
        """Return the event by which a person joins, with the belief of an earlier session if there is one."""
        person = event.person or ""
        if self._people is None or not isinstance(course, Course) or course.knows(person):
            return event
        try:
            belief = self._people.belief(person, self._meaning)
        except (JournalError, DamagedFileError) as error:
            logging.getLogger(__name__).warning("a person joins without what was learned before: %s", error)
            return event
        return event if belief is None else replace(event, belief=tuple(belief.ravel().tolist()))

    def _keep(self) -> None:
        """Save the beliefs in people from whose actions something was learned.

        Failures are only logged: the events are on the disk, and are to be acknowledged.
        """
        course, learned = self._restored, self._learned
        self._learned = set()
        if self._people is None or not isinstance(course, Course):
            return
        for person in sorted(learned):
            try:
                belief = course.learned(person) if course.knows(person) else None
                if belief is not None:
                    self._people.save(person, self._meaning, belief)
            except Exception as error:  # noqa: BLE001
                logging.getLogger(__name__).warning("what was learned about a person is not kept: %s", error)

    # Events.

    def report(self, events: Sequence[Event]) -> list[Outcome]:
        """Apply events one after the other, wait until they are on the disk, and return their outcomes.

        Returns
        -------
        list
            For each event the view of its person after it (`person`; `robot` for an event without a person), or the
            exception because of which it has no effect: an `InvalidError`, `AbsentError`, `InapplicableError`, another
            ValueError, a `LimitError`, a `JournalError` if the disk is full, or any other exception of the program.
        """
        failed: dict[int, Exception] = {}
        with self.lock:
            while True:
                outcomes = self._attempt(events, failed)
                if outcomes is not None:
                    return outcomes

    def _attempt(self, events: Sequence[Event], failed: dict[int, Exception]) -> list[Outcome] | None:
        """Apply and save all events but those that failed before; return None if another one fails."""
        course, outcomes, touched, number = self._course, list[Outcome](), set[str](), -1
        try:
            self._store.check()
            self._unsaved = True
            with self._store.transaction():
                for number, event in enumerate(events):
                    outcomes.append(failed.get(number) or self._outcome(course, event, touched))
                number = -1
        except Exception as error:
            known = isinstance(error, JournalError)
            if not known:
                logging.getLogger(__name__).exception("a batch of events failed and has no effect")
            if number >= 0 and not known:
                failed[number] = error
                return None
            # The batch cannot be saved. What is answered already is answered again.
            done = outcomes + [error] * (len(events) - len(outcomes))
            return [
                outcome if isinstance(outcome, Exception) and outcome is not error else self._known(event) or error
                for event, outcome in zip(events, done, strict=True)
            ]
        self._unsaved = False
        if touched and self.changed is not None:
            self.changed(touched)
        self._keep()
        return outcomes

    def _outcome(self, course: EventSourced, event: Event, touched: set[str]) -> Outcome:
        """Apply an event within the transaction, and return its outcome."""
        try:
            known = self._known(event)
            if known is None and event.kind == "joined":
                event = self._carried(course, event)
            record = None if known is not None else course.happen(event, self.now())
        except Refusal as error:
            return error
        if known is not None:
            return known
        arrival = event.person is None or event.kind == "arrived"
        answer = course.robot(event.robot) if arrival else course.person(event.person or "")
        if record is None:
            return answer
        self._store.add(record, answer, at=utc())
        touched |= course.touched(record)
        if event.kind in ("left", "began") or answer.get("finished"):
            self._learned.add(event.person or "")
        return answer

    def _known(self, event: Event) -> Outcome | None:
        """Return the stored answer if an event with this person, id and robot was applied before, else None."""
        try:
            found = self._store.answer(event.person, event.id) if event.id else None
        except UnicodeEncodeError:
            return InvalidError("other", why=f"the id {event.id!r} is no text; expected letters, digits and signs")
        if found is None:
            return None
        record, answer = found
        # Robots that count their reports on their own use the same ids.
        if (record["event"], record.get("robot", 1)) != (event.kind, event.robot):
            return InapplicableError("other", why=f"the id {event.id!r} belongs to another event; expected a new id")
        return answer

    def erase(self, person: str, reason: str) -> Tombstone:
        """Erase all that is recorded of a person, for good, and return what remains: when and why.

        The person leaves first. The others' states and beliefs stay the same, and so does the robot's course: the place
        of the person remains, without a name. A person who joins again counts as a new one.

        Parameters
        ----------
        person : str
            Present or not.
        reason : str
            Without the person's name.

        Raises
        ------
        AbsentError
            Nothing is recorded of this person.
        ValueError
            There is no reason, or it is too long or names the person.
        JournalError
            The disk is full. If the message says that traces may remain, they are removed when the session is opened
            again.
        """
        person, reason = name_of(person), " ".join(reason.split())
        named = re.search(rf"(?<![\w-]){re.escape(person.casefold())}(?![\w-])", reason.casefold())
        if named or not 0 < len(reason) <= LONGEST_REASON:
            why = f"reason: expected 1 to {LONGEST_REASON} characters, without the person's name; found {len(reason)}"
            raise InvalidError("other", why=why)
        with self.lock:
            try:
                leaves = self._course.farewell(person)
                if leaves is not None:
                    self._one(leaves)
            except AbsentError:
                if self._people is None or not self._people.erase(person):
                    raise
                return Tombstone("", utc(), reason, 0)
            if self._people is not None:
                self._people.erase(person)
            stone = self._remove(person, self._store.next_label(), reason)
            self._store.purge()
        return stone

    def _remove(self, person: str, label: str, reason: str) -> Tombstone:
        """Remove what is recorded of a person who has left, and check that the others' beliefs stay as they are."""
        before = self._course
        believed = before.beliefs()
        self._unsaved = True
        with self._store.transaction():
            stone = self._store.rewrite(person, label, reason, before.without(person, label))
            self._resume()
            self._unsaved = True
            kept = self._restored.beliefs()
            if any(not _same(believed.get(name, belief), belief) for name, belief in kept.items()):
                raise RuntimeError("the others' beliefs would change; nothing was erased")
        self._unsaved = False
        if self.changed is not None:
            self.changed({person})
        return stone

    @property
    def was_imported(self) -> bool:
        """Whether the session was begun in the format of earlier versions, JSON Lines."""
        return self._store.was_imported

    def tombstones(self) -> list[Tombstone]:
        """Return what remains of the people whose records were erased."""
        with self.lock:
            return self._store.tombstones()

    def _one(self, event: Event) -> dict[str, Any]:
        outcome = self.report([event])[0]
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def join(self, person: str, task: str | None = None, *, id: str | None = None) -> dict[str, Any]:
        """Add a person, or let one return to their task; return their view, as all following methods do."""
        return self._one(Event("joined", person, task=task, id=id))

    def leave(self, person: str, *, id: str | None = None) -> dict[str, Any]:
        """Remove a person from the team."""
        return self._one(Event("left", person, id=id))

    def begin(self, person: str, task: str | None = None, *, id: str | None = None) -> dict[str, Any]:
        """Let a person begin the next task: the named one, or the same task again."""
        return self._one(Event("began", person, task=task, id=id))

    def observe(
        self,
        person: str,
        action: str | None = None,
        *,
        likelihoods: Mapping[str, float] | None = None,
        missed: float | None = None,
        id: str | None = None,
        followed: bool | None = None,
        seen: int | None = None,
    ) -> dict[str, Any]:
        """Record a person's action, or what is known of it; arguments as in `Event`."""
        uncertain: dict[str, Any] = {"likelihoods": likelihoods, "missed": missed}
        return self._one(Event("acted", person, action, followed, seen, id=id, **uncertain))

    def answer(
        self, person: str, answer: str | bool | None, *, id: str | None = None, seen: int | None = None
    ) -> dict[str, Any]:
        """Record a person's answer to a question of the robot, as `Assistant.answer` does."""
        return self._one(Event("answered", person, answer=answer, seen=seen, id=id))

    def retract(self, person: str, *, id: str | None = None) -> dict[str, Any]:
        """Take back a person's last answer about the goal of their task."""
        return self._one(Event("retracted", person, id=id))

    def undo(self, person: str, *, id: str | None = None) -> dict[str, Any]:
        """Take back a person's last action, as if it had not been observed."""
        return self._one(Event("undone", person, id=id))

    def arrived(self, person: str | None = None, *, robot: int = 1, id: str | None = None) -> dict[str, Any]:
        """Record where a robot is, at a person or at its base; return where it is to go next."""
        return self._one(Event("arrived", person, id=id, robot=robot))

    def elapse(self) -> dict[str, Any]:
        """Record that time has passed without an action; return where the robot is to go."""
        return self._one(Event("elapsed"))

    def rearrange(self, distance: ArrayLike) -> dict[str, Any]:
        """Record that distances have changed, as by `Assistant.rearrange`; return where the robot is to go."""
        rows = np.asarray(distance, dtype=float).tolist()
        return self._one(Event("rearranged", distance=tuple(map(tuple, rows))))

    def pause(self, paused: bool = True) -> dict[str, Any]:
        """Stop the robot's suggestions, or resume them; people can still act."""
        return self._one(Event("paused" if paused else "resumed"))

    def now(self) -> float:
        """Return the seconds since the session began, without those in which it did not run."""
        return self._clock() - self._began

    # Views. They show saved events only.

    @property
    def people(self) -> tuple[str, ...]:
        """The people who are present, in the order of their first arrival."""
        with self.lock:
            return self._course.people

    def recommend(self, robot: int = 1) -> Advice:
        """Return the decision after the last event: to whom a robot goes, what it suggests, and why."""
        with self.lock:
            self._course.robot(robot)  # raises an error for a robot that there is not
            return self._course.advices[robot - 1]

    def person(self, person: str) -> dict[str, Any]:
        """Return a person's view, as the service sends it.

        Raises
        ------
        AbsentError
            The person is not present.
        """
        return self._of(person, lambda course: course.person(person))

    def entry(self, person: str) -> dict[str, Any]:
        """Return the operator's view of a person, including beliefs.

        Raises
        ------
        AbsentError
            The person is not present.
        """
        return self._of(person, lambda course: course.entry(person))

    def outlook(self) -> Outlook:
        """Return the team's part of the operator's view: the robots, the last events, and whether it is paused."""
        with self.lock:
            course = self._course
            robots = tuple(course.robot(number) for number in range(1, 1 + len(course.advices)))
            return Outlook(course.count, course.paused, list(course.recent), course.fault, robots)

    def began_with(self) -> list[str | None]:
        """Return the people who joined before anything else happened; None for those whose records were erased."""
        with self.lock:
            first = takewhile(lambda record: record["event"] in ("joined", VACANT), self._store)
            return [record["person"] if record["event"] == "joined" else None for record in first]

    def fault(self) -> str | None:
        """Return why events cannot be saved now, as far as it is known; None if they can."""
        return self._store.fault()

    @property
    def distance(self) -> list[list[float]] | None:
        """The distances in force; None if all are 1."""
        with self.lock:
            return self._course.distance if isinstance(self._course, Course) else None

    @property
    def tasks(self) -> tuple[str, ...]:
        """The names of the tasks; the first is the default."""
        return tuple(self._tasks)

    def log(self, task: str | None = None) -> list[dict[str, Any]]:
        """Return all actions as `fit` reads them, or those in one task.

        Raises
        ------
        InvalidError
            There is no such task.
        """
        with self.lock:
            return self._course.log(task)

    def place(self, person: str) -> tuple[CostToGo | Goals, int]:
        """Return a person's task, and the number of its present state."""
        return self._of(person, lambda course: course.place(person))

    def _of(self, person: str, view: Callable[[EventSourced], T]) -> T:
        """Return a view of a person who is present."""
        with self.lock:
            self._course.require(person)
            return view(self._course)

    def beliefs(self) -> dict[str, bytes]:
        """Return the belief about each present person, as the bytes of its array."""
        with self.lock:
            return self._course.beliefs()


def _same(before: bytes, after: bytes) -> bool:
    """Return whether two beliefs are the same; on another processor, some last bits may differ."""
    return before == after or np.allclose(np.frombuffer(before), np.frombuffer(after), rtol=0, atol=1e-9)
