"""A live session that is saved: events are applied, stored, and acknowledged.

A `Session` is a `Team`, or another `History`, with an `EventStore` and a lock, so that any thread may report events. An
event is on the disk before it is acknowledged and before others see it. Events that arrive together are one
transaction. An event that cannot be saved has no effect. A session that is opened again has the same states, beliefs
(bit for bit), suggestions and answers.

Any exception while events are applied undoes the whole batch: the transaction ends without effect, and the state is
restored from the store. Then the other events of the batch are applied again. So the state in memory is always the
stored one.
"""

from __future__ import annotations

import json
import logging
import math
import re
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from planner import CostToGo
from planner.system.errors import InputFileError

from ..declare.refusals import AbsentError, InapplicableError, Refusal
from ..people.goals import Goals
from ..people.ranges import Population
from ..person.settings import Setting
from ..team.state import TeamPolicy
from .advice import Advice
from .event_base import Event
from .events import Joined
from .header import Header, header_of, require_same
from .history import History
from .names import LONGEST_REASON, name_of
from .people_store import PeopleStore, model_of
from .record import Record, TeamRecord, require_database
from .reports import Reports
from .store import EventStore, JournalError, Tombstone, utc
from .team import Team
from .views import Outlook

T = TypeVar("T")

Outcome = dict[str, Any] | Exception
"""Outcome of an event: the view of the client who reported it, or the exception because of which it has no effect."""


class Session(Reports):
    """A saved live session of people at work, and of the robot that assists them.

    Parameters
    ----------
    tasks : CostToGo or Goals, or mapping of str to these
        Tasks by name; the first is the default.
    journal : Path
        The file in which the session is saved, an SQLite database. If it exists, the session continues from it.
    policy : str or callable
        A team policy, as in `Assistant`.
    setting, population, distance
        As in `Assistant`.
    humans : int, optional
        How many people it is served for. A session that continues was begun for as many, if a number is given.
    people : PeopleStore, optional
        Where the beliefs in people are kept for later sessions, and taken from when they join for the first time.
    clock : callable
        Returns ascending seconds from any origin. No result depends on it.

    Attributes
    ----------
    changed : callable or None
        Called with the people whose view has changed, and whether each suggestion that was answered was followed. The
        events are on the disk then, and the session is locked.

    Raises
    ------
    InputFileError
        The journal belongs to a running session, to one with other tasks or settings, or to another version, or
        something else has changed it.
    OSError
        The journal cannot be written.
    """

    kind: ClassVar[type[Record]] = TeamRecord

    def __init__(
        self,
        tasks: CostToGo | Goals | Mapping[str, CostToGo | Goals],
        journal: str | Path,
        *,
        policy: str | TeamPolicy = "attention",
        setting: Setting | None = None,
        population: Population | None = None,
        distance: ArrayLike | None = None,
        humans: int | None = None,
        people: PeopleStore | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._tasks = dict(tasks) if isinstance(tasks, Mapping) else {"task": tasks}
        self._options: dict[str, Any] = {
            "policy": policy, "setting": setting, "population": population, "distance": distance,
        }  # fmt: skip
        self._humans, self._clock, self._people, self._learned = humans, clock, people, set[str]()
        self.changed: Callable[[set[str], Sequence[bool]], None] | None = None
        self.lock = threading.RLock()
        require_database(Path(journal))
        self._store: EventStore[Any] = EventStore(Path(journal), self.kind)
        try:
            self._open()
        except BaseException:
            self._store.close()
            raise
        self._began = clock() - self._last

    def _open(self) -> None:
        """Restore the state, or begin a new session."""
        expected = self._header().as_dict()
        self._meaning = model_of(expected.get("population", {}), expected.get("setting", {}), expected)
        with self._store.transaction():
            found = self._store.header()
            if found is None:
                self._store.begin(expected)
            else:
                begun = {name: found.get(name) for name in ("distance",) if name in expected}
                uncounted = {"humans": found.get("humans")} if self._humans is None else {}
                self._check(found, expected | begun | uncounted)
                self._options |= begun  # events begin with these; those in force after the last one are to be the given
            self._resume()
            if isinstance(self._restored, Team) and self._restored.distance != expected["distance"]:
                self._check({"distance": self._restored.distance}, {"distance": expected["distance"]})

    def _header(self) -> Header:
        team = Team(self._tasks, **self._options)
        return header_of(team.desk, self._tasks, self._options["distance"], self._humans)

    def _check(self, found: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
        require_same(self._store.file, found, expected)

    def _anew(self, like: History[Any] | None = None) -> History[Any]:
        """Return the state before the first event, with what another one, if it is given, has solved."""
        return Team(self._tasks, **self._options, like=like if isinstance(like, Team) else None)

    def _resume(self, history: History[Any] | None = None, records: Iterable[Record] | None = None) -> None:
        """Restore the state by applying all events of the store, or records of these, to the state before the first."""
        history, last = history or self._anew(), 0.0
        for record in self._store if records is None else records:
            number = history.count + 1
            try:
                if record.n != number:
                    raise ValueError(f"event {record.n}; expected {number}")
                history.again(record)
                last = record.time
            except (KeyError, TypeError, AttributeError, ValueError) as error:
                raise self._store.damaged(number, error) from error
        self._restored, self._last, self._unsaved = history, last, False

    @property
    def history(self) -> History[Any]:
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

    def _carried(self, history: History[Any], event: Joined) -> Joined:
        """Return the event by which a person joins, with the belief of an earlier session if there is one."""
        if self._people is None or not isinstance(history, Team) or history.desk.has_met(event.person):
            return event
        try:
            belief = self._people.belief(event.person, self._meaning)
        except (JournalError, InputFileError) as error:
            logging.getLogger(__name__).warning("a person joins without what was learned before: %s", error)
            return event
        return event if belief is None else event.model_copy(update={"belief": tuple(belief.ravel().tolist())})

    def _keep(self) -> None:
        """Save the beliefs in people from whose actions something was learned.

        Failures are only logged: the events are on the disk, and are to be acknowledged.
        """
        team, learned = self._restored, self._learned
        self._learned = set()
        if self._people is None or not isinstance(team, Team):
            return
        for person in sorted(learned):
            try:
                belief = team.learned(person)
                if belief is not None:
                    self._people.save(person, self._meaning, belief)
            except Exception as error:  # noqa: BLE001
                logging.getLogger(__name__).warning("what was learned about a person is not kept: %s", error)

    # Events.

    def report(self, event: Event) -> dict[str, Any]:
        """Apply an event, wait until it is on the disk, and return the view of the person or robot concerned.

        Raises
        ------
        Exception
            Any of `report_all`.
        """
        outcome = self.report_all([event])[0]
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def report_all(self, events: Sequence[Event]) -> list[Outcome]:
        """Apply events one after the other, wait until they are on the disk, and return their outcomes.

        Returns
        -------
        list
            For each event the view of its person after it, or that of the robot, or the exception because of which it
            has no effect: a `Refusal`, another ValueError, a `LimitError`, a
            `JournalError` if the disk is full, or any other exception of the program.
        """
        failed: dict[int, Exception] = {}
        with self.lock:
            while True:
                outcomes = self._attempt(events, failed)
                if outcomes is not None:
                    return outcomes

    def _attempt(self, events: Sequence[Event], failed: dict[int, Exception]) -> list[Outcome] | None:
        """Apply and save all events but those that failed before; return None if another one fails."""
        history, outcomes, number = self.history, list[Outcome](), -1
        touched, followed = set[str](), list[bool]()
        try:
            self._store.check()
            self._unsaved = True
            with self._store.transaction():
                for number, event in enumerate(events):
                    outcomes.append(failed.get(number) or self._outcome(history, event, touched, followed))
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
                outcome
                if isinstance(outcome, Exception) and outcome is not error
                else self._known(event, self.history) or error
                for event, outcome in zip(events, done, strict=True)
            ]
        self._unsaved = False
        if touched and self.changed is not None:
            self.changed(touched, followed)
        self._keep()
        return outcomes

    def _outcome(self, history: History[Any], event: Event, touched: set[str], followed: list[bool]) -> Outcome:
        """Apply an event within the transaction, and return its outcome."""
        try:
            known = self._known(event, history)
            if known is None and isinstance(event, Joined):
                event = self._carried(history, event)
            record = None if known is not None else history.happen(event, self.now())
        except Refusal as error:
            return error
        if known is not None:
            return known
        answer = _answer(history, event)
        if record is None:
            self._store.remember(event)
            return answer
        self._store.add(record, answer, event, at=utc())
        touched |= history.touched(record)
        if (said := history.followed(record)) is not None:
            followed.append(said)
        if event.ends_task or answer.get("finished"):
            self._learned.add(event.who or "")
        return answer

    def _known(self, event: Event, history: History[Any]) -> Outcome | None:
        """Return the answer if this event was reported before under its id, a refusal if another was, or None.

        It is the first answer; that of an event which changed nothing is the present view.
        """
        try:
            found = self._store.answer(event)
        except UnicodeEncodeError:
            return Refusal("other", why=f"the id {event.id!r} is no text; expected letters, digits and signs")
        if found is None:
            return None
        reported, answer = found
        if json.loads(reported) != json.loads(event.reported):  # in any order of their fields
            return InapplicableError("other", why=f"the id {event.id!r} belongs to another event; expected a new id")
        return _answer(history, event) if answer is None else answer

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
            raise Refusal("other", why=why)
        with self.lock:
            try:
                leaves = self.history.farewell(person)
                if leaves is not None:
                    self.report(leaves)
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
        before = self.history
        believed = before.beliefs()
        self._unsaved = True
        with self._store.transaction():
            stone = self._store.bury(person, label, reason)
            self._resume(self._anew(before), self._store.rewrite(person, before.without(person, label)))
            self._unsaved = True
            kept = self._restored.beliefs()
            if any(not _same(believed.get(name, belief), belief) for name, belief in kept.items()):
                raise RuntimeError("the others' beliefs would change; nothing was erased")
        self._unsaved = False
        if self.changed is not None:
            self.changed({person}, ())
        return stone

    def tombstones(self) -> list[Tombstone]:
        """Return what remains of the people whose records were erased."""
        with self.lock:
            return self._store.tombstones()

    def due(self) -> tuple[list[Event], float]:
        """Return the events that time has caused by now, and the seconds until it causes the next one."""
        with self.lock:
            now, every = self.now(), list(self.history.due())
        later = min((at - now for at, _ in every if at > now), default=math.inf)
        return [event for at, event in every if at <= now], later

    def now(self) -> float:
        """Return the seconds since the session began, without those in which it did not run."""
        return self._clock() - self._began

    # Views. They show saved events only.

    def see(self, look: Callable[[Any], T]) -> T:
        """Return the result of a function of the state, which is called under the lock."""
        with self.lock:
            return look(self.history)

    @property
    def people(self) -> tuple[str, ...]:
        """The people who are present, in the order of their first arrival."""
        return self.see(lambda history: history.people)

    def recommend(self, robot: int = 1) -> Advice:
        """Return the decision after the last event: to whom a robot goes, what it suggests, and why."""
        with self.lock:
            self.history.robot(robot)  # raises an error for a robot that there is not
            return self.history.advices[robot - 1]

    def person(self, person: str) -> dict[str, Any]:
        """Return a person's view, as the service sends it.

        Raises
        ------
        AbsentError
            The person is not present.
        """
        return self._of(person, lambda history: history.person(person).as_dict())

    def entry(self, person: str) -> dict[str, Any]:
        """Return the operator's view of a person, including beliefs.

        Raises
        ------
        AbsentError
            The person is not present.
        """
        return self._of(person, lambda history: history.entry(person).as_dict())

    def outlook(self) -> Outlook:
        """Return the team's part of the operator's view: the robots, the last events, and whether it is paused."""
        return self.see(lambda history: history.outlook())

    def fault(self) -> str | None:
        """Return why events cannot be saved now, as far as it is known; None if they can."""
        return self._store.fault()

    @property
    def distance(self) -> list[list[float]] | None:
        """The distances in force; None if all are 1."""
        return self.see(lambda history: history.distance if isinstance(history, Team) else None)

    @property
    def tasks(self) -> tuple[str, ...]:
        """The names of the tasks; the first is the default."""
        return tuple(self._tasks)

    def log(self, task: str | None = None) -> list[dict[str, Any]]:
        """Return all actions as `fit` reads them, or those in one task.

        Raises
        ------
        Refusal
            There is no such task.
        """
        return self.see(lambda history: history.log(task))

    def task_and_state(self, person: str) -> tuple[CostToGo | Goals, int]:
        """Return a person's task, and the number of its present state."""
        return self._of(person, lambda history: history.task_and_state(person))

    def _of(self, person: str, view: Callable[[Any], T]) -> T:
        """Return a view of a person who is present."""
        with self.lock:
            self.history.require(person)
            return self.see(view)

    def beliefs(self) -> dict[str, bytes]:
        """Return the belief about each present person, as the bytes of its array."""
        return self.see(lambda history: history.beliefs())


def _answer(history: History[Any], event: Event) -> dict[str, Any]:
    """Return the view of the person or robot whom an event concerns."""
    if event.shows == "robot" or event.who is None:
        return history.robot(getattr(event, "robot", 1)).as_dict()
    return history.person(event.who).as_dict()


def _same(before: bytes, after: bytes) -> bool:
    """Return whether two beliefs are the same; on another processor, some last bits may differ."""
    return before == after or np.allclose(np.frombuffer(before), np.frombuffer(after), rtol=0, atol=1e-9)
