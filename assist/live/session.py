"""A live session that is saved: events are applied, written to a journal, and acknowledged.

A `Session` is a `Course` with a `Journal` and a lock, so that any thread may report events. An event is on the disk
before it is acknowledged and before others see it. Events that arrive together share one write. An event that cannot be
saved has no effect. A session that is opened again on its journal has the same states, beliefs (bit for bit),
suggestions and answers.

Any exception while events are applied undoes the whole batch: the session is restored from the journal, and the other
events of the batch are applied again. So the state in memory is always that of the journal.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from planner import CostToGo, LimitError
from planner.system.errors import DamagedFileError, ResultsExistError

from ..large_tasks.person_problem import WHOLE, is_whole
from ..people.belief import Grid
from ..people.choice_model import chances
from ..people.choices import Choices
from ..people.decision import perceived_cost
from ..people.human import Mixture, Population
from ..team.settings import Setting
from ..team.state import PolicyError, TeamPolicy
from .advice import Advice
from .course import Course, Event
from .idempotency import AnsweredIds, Key, key_of
from .journal import Journal, JournalError
from .live_task import InapplicableError, digest

FORMAT = "kitassist session 1"
"""Format identifier of journals."""

Refused = (ValueError, LimitError, PolicyError)
"""Errors of an event that is not possible, which leave the session as it was; all others are faults of the program."""

Outcome = dict[str, Any] | Exception
"""Outcome of an event: the view of the client who reported it, or the exception because of which it has no effect."""


class EventSourced(Protocol):
    """State that follows from a sequence of events, and its views; `Course` implements it for one team."""

    count: int
    paused: bool
    fault: str | None
    recent: deque[dict[str, Any]]

    def happen(self, event: Event, time: float) -> dict[str, Any] | None:
        """Apply an event, and return its record."""
        ...

    def again(self, record: Mapping[str, Any]) -> None:
        """Apply a recorded event."""
        ...

    def touched(self, record: Mapping[str, Any]) -> set[str]:
        """Return the people whose view an event has changed."""
        ...

    def require(self, person: str) -> None:
        """Check that a person is present."""
        ...

    @property
    def people(self) -> tuple[str, ...]:
        """The people who are present."""
        ...

    @property
    def advice(self) -> Advice:
        """The decision after the last event."""
        ...

    def person(self, person: str) -> dict[str, Any]:
        """Return a person's view."""
        ...

    def entry(self, person: str) -> dict[str, Any]:
        """Return the operator's view of a person."""
        ...

    def place(self, person: str) -> tuple[CostToGo, int]:
        """Return a person's task, and its state."""
        ...

    def robot(self) -> dict[str, Any]:
        """Return where the robot is to be."""
        ...

    def beliefs(self) -> dict[str, bytes]:
        """Return the belief in each person, as bytes."""
        ...

    def log(self, task: str | None = None) -> list[dict[str, Any]]:
        """Return all actions as `fit` reads them."""
        ...


@dataclass(frozen=True)
class Outlook:
    """The view of a session without its people.

    Attributes
    ----------
    events : int
        Number of events.
    paused : bool
        Whether the robot makes no suggestions.
    robot : dict
        Where the robot is to be, and its suggestion there.
    recent : list of dict
        The latest events, the oldest first.
    fault : str or None
        Error of the policy after the last event, if there was one; the robot then does nothing.
    """

    events: int
    paused: bool
    robot: dict[str, Any]
    recent: list[dict[str, Any]]
    fault: str | None


class Session:
    """A saved live session of people at work, and of the robot that assists them.

    Parameters
    ----------
    tasks : CostToGo, or mapping of str to CostToGo
        Tasks by name; the first is the default.
    journal : Path
        The file in which the session is saved. If it exists, the session continues from it.
    policy : str or callable
        A team policy, as in `Assistant`.
    setting, population, distance
        As in `Assistant`.
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
        tasks: CostToGo | Mapping[str, CostToGo],
        journal: str | Path,
        *,
        policy: str | TeamPolicy = "attention",
        setting: Setting | None = None,
        population: Population | Mixture | None = None,
        distance: ArrayLike | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._tasks = dict(tasks) if isinstance(tasks, Mapping) else {"task": tasks}
        self._options: dict[str, Any] = {
            "policy": policy, "setting": setting, "population": population, "distance": distance,
        }  # fmt: skip
        self._clock = clock
        self.changed: Callable[[set[str]], None] | None = None
        self.lock = threading.RLock()
        self._journal = Journal(Path(journal))
        try:
            self._resume()
            if not len(self._journal):
                self._journal.append([_line(self._header())])
        except BaseException:
            self._journal.close()
            raise
        self._began = clock() - self._last

    def _header(self) -> dict[str, Any]:
        desk, distance = Course(self._tasks, **self._options).desk, self._options["distance"]
        return {
            "format": FORMAT,
            "policy": desk.policy if isinstance(desk.policy, str) else getattr(desk.policy, "name", None),
            "setting": desk.setting.as_dict(),
            "population": desk.population.as_dict(),
            "distance": None if distance is None else np.asarray(distance, dtype=float).tolist(),
            "tasks": {name: digest(task) for name, task in self._tasks.items()},
            "files": self._files(),
            "chances": None
            if desk.population.chooses is None
            else {name: _chances(task, desk.population) for name, task in self._tasks.items()},
        }

    def _files(self) -> dict[str, str | None]:
        """The problem file of each task; None for that of a policy."""
        known = {name: getattr(task, "task", None) for name, task in self._tasks.items()}
        return {name: None if task is None else str(task.instance.problem) for name, task in known.items()}

    def _course_anew(self) -> EventSourced:
        """Return the state before the first event."""
        return Course(self._tasks, **self._options)

    def _resume(self) -> None:
        """Restore the state by applying all events of the journal."""
        course, answered, last = self._course_anew(), AnsweredIds(self._journal), 0.0
        for number, (begin, record) in enumerate(self._journal, start=1):
            if begin == 0:
                self._check(record)
                continue
            try:
                if record.get("n") != course.count + 1:
                    raise ValueError(f"event {record.get('n')}; expected {course.count + 1}")
                course.again(record)
                last = record["time"]
            except (KeyError, TypeError, AttributeError, ValueError) as error:
                raise DamagedFileError(self._journal.file, number, f"cannot have happened: {error}") from error
            if "id" in record:
                answered.add(key_of(record), begin)
        self._course, self._answered, self._last, self._unsaved = course, answered, last, False

    def _check(self, header: dict[str, Any]) -> None:
        expected = json.loads(_line(self._header()))
        files = expected.pop("files", {})
        for name, value in expected.items():
            if header.get(name) != value:
                if name == "tasks" and isinstance(header.get(name), dict):
                    raise ResultsExistError(f"{self._journal.file}: {_others(header, value, files)}")
                raise ResultsExistError(
                    f"{self._journal.file}: the session there has {_shown(name, header.get(name), value)}; "
                    "expected the same, or another folder"
                )

    def close(self) -> None:
        """Close the journal."""
        with self.lock:
            self._journal.close()

    # Events.

    def report(self, events: Sequence[Event]) -> list[Outcome]:
        """Apply events one after the other, wait until they are on the disk, and return their outcomes.

        Returns
        -------
        list
            For each event the view of its person after it (`person`; `robot` for an event without a person), or the
            exception because of which it has no effect: an `UnknownError`, `AbsentError`, `InapplicableError`, another
            ValueError, a `LimitError`, a `JournalError` if the disk is full, or any other exception of the program.
        """
        failed: dict[int, Exception] = {}
        with self.lock:
            while True:
                outcomes = self._attempt(events, failed)
                if outcomes is not None:
                    return outcomes

    def _attempt(self, events: Sequence[Event], failed: dict[int, Exception]) -> list[Outcome] | None:
        """Apply and save all events but those that failed before; return None if another one fails.

        An unexpected exception may leave an event applied in part. Then the state is restored from the journal.
        """
        if self._unsaved:  # an earlier batch was interrupted
            self._resume()
        try:
            self._journal.check()
        except JournalError as error:
            return [self._known(event) or error for event in events]
        outcomes: list[Outcome] = []
        lines: list[bytes] = []
        records: dict[Key, dict[str, Any]] = {}
        answered: list[tuple[Key, int]] = []
        touched: set[str] = set()
        self._unsaved = True
        for number, event in enumerate(events):
            key = (event.person or "", event.id or "")
            if number in failed:
                outcomes.append(failed[number])
                continue
            if event.id and key in records:
                outcomes.append(_same(event, records[key]))
                continue
            try:
                outcome = self._known(event) or self._happen(event, records, lines, touched)
            except Refused as error:
                outcome = error
            except Exception as error:
                logging.getLogger(__name__).exception("an event of kind %s failed and has no effect", event.kind)
                failed[number] = error
                self._resume()
                return None
            outcomes.append(outcome)
            if event.id and key in records:
                answered.append((key, len(lines) - 1))
        return self._commit(outcomes, lines, answered, touched)

    def _happen(
        self,
        event: Event,
        records: dict[Key, dict[str, Any]],
        lines: list[bytes],
        touched: set[str],
    ) -> Outcome:
        record = self._course.happen(event, self.now())
        if record is None:
            return self._course.robot()
        answer = self._course.robot() if event.person is None else self._course.person(event.person)
        if event.kind == "arrived":
            answer = self._course.robot()
        if event.id:
            record["answer"] = answer
            records[event.person or "", event.id] = record
        lines.append(_line(record))
        touched |= self._course.touched(record)
        return answer

    def _known(self, event: Event) -> Outcome | None:
        """Return the stored answer if an event with this person and id was applied before, else None."""
        record = self._answered.find((event.person or "", event.id)) if event.id else None
        return None if record is None else _same(event, record)

    def _commit(
        self, outcomes: list[Any], lines: list[bytes], answered: list[tuple[Key, int]], touched: set[str]
    ) -> list[Outcome]:
        if lines:
            try:
                begins = self._journal.append(lines)
            except JournalError as error:
                self._resume()  # events that are not on the disk have no effect
                return [outcome if isinstance(outcome, Exception) else error for outcome in outcomes]
            for key, number in answered:
                self._answered.add(key, begins[number])
            if self.changed is not None:
                self.changed(touched)
        self._unsaved = False
        return outcomes

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
        """Let a person begin the next task; by default the same again."""
        return self._one(Event("began", person, task=task, id=id))

    def observe(
        self,
        person: str,
        action: str,
        *,
        id: str | None = None,
        followed: bool | None = None,
        seen: int | None = None,
    ) -> dict[str, Any]:
        """Record a person's action; arguments as in `Event`."""
        return self._one(Event("acted", person, action, followed, seen, id=id))

    def undo(self, person: str, *, id: str | None = None) -> dict[str, Any]:
        """Take back a person's last action, as if it had not been observed."""
        return self._one(Event("undone", person, id=id))

    def arrived(self, person: str | None = None, *, id: str | None = None) -> dict[str, Any]:
        """Record where the robot is, at a person or at its base; return where it is to go next."""
        return self._one(Event("arrived", person, id=id))

    def elapse(self) -> dict[str, Any]:
        """Record that time has passed without an action; return where the robot is to go."""
        return self._one(Event("elapsed"))

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

    def recommend(self) -> Advice:
        """Return the decision after the last event: to whom the robot goes, what it suggests, and why."""
        with self.lock:
            return self._course.advice

    def person(self, person: str) -> dict[str, Any]:
        """Return a person's view, as the service sends it.

        Raises
        ------
        AbsentError
            The person is not present.
        """
        with self.lock:
            self._course.require(person)
            return self._course.person(person)

    def entry(self, person: str) -> dict[str, Any]:
        """Return the operator's view of a person, including beliefs.

        Raises
        ------
        AbsentError
            The person is not present.
        """
        with self.lock:
            self._course.require(person)
            return self._course.entry(person)

    def outlook(self) -> Outlook:
        """Return the view of the session without its people."""
        with self.lock:
            course = self._course
            return Outlook(course.count, course.paused, course.robot(), list(course.recent), course.fault)

    @property
    def tasks(self) -> tuple[str, ...]:
        """The names of the tasks; the first is the default."""
        return tuple(self._tasks)

    def log(self, task: str | None = None) -> list[dict[str, Any]]:
        """Return all actions as `fit` reads them, or those in one task.

        Raises
        ------
        UnknownError
            There is no such task.
        """
        with self.lock:
            return self._course.log(task)

    def place(self, person: str) -> tuple[CostToGo, int]:
        """Return a person's task, and its state."""
        with self.lock:
            self._course.require(person)
            return self._course.place(person)

    def beliefs(self) -> dict[str, bytes]:
        """Return the belief in each present person, as bytes."""
        with self.lock:
            return self._course.beliefs()


def _chances(task: CostToGo, population: Population | Mixture) -> str:
    """Return a hash of the choice probabilities of a function, which identifies it better than its name."""
    if not is_whole(task):
        raise ValueError(f"people who choose by a function: expected a task of at most {WHOLE:,} states, all known")
    choices = Choices.of(task)
    q = perceived_cost(choices, choices.h)
    p = chances(population.typical, choices, q, Grid.regular(population).beta)
    return sha256(p.tobytes()).hexdigest()[:32]


def _line(record: Mapping[str, Any]) -> bytes:
    return json.dumps(record, separators=(",", ":"), default=str).encode() + b"\n"


def _same(event: Event, record: Mapping[str, Any]) -> Outcome:
    """Return the answer to an event that is reported again under the same id."""
    if record["event"] != event.kind:
        return InapplicableError(f"the id {event.id!r} belongs to another event; expected a new id")
    answer: dict[str, Any] = record["answer"]
    return answer


def _others(header: dict[str, Any], tasks: dict[str, str], files: dict[str, str | None]) -> str:
    """Return a message that names the session's tasks and the expected ones."""
    before, kept = header["tasks"], header.get("files") or {}
    wrong = [name for name in tasks if before.get(name) != tasks[name]] or list(tasks)
    same = [name for name in wrong if name in before and kept.get(name, files.get(name)) == files.get(name)]
    if same:
        return f"the task {same[0]} is another than when the session began; expected the same files, or another folder"

    def named(names: Iterable[str], where: Mapping[str, str | None]) -> str:
        return ", ".join(f"{name} ({where[name]})" if where.get(name) else name for name in names)

    return (
        f"the session there is of the task {named(before, kept)}, not {named(tasks, files)}; "
        "expected the same, or another folder"
    )


def _shown(name: str, found: Any, expected: Any) -> str:
    """Return a short description of the difference."""
    with suppress(AttributeError):
        for part, value in expected.items():
            if found.get(part) != value:
                return f"{name} {part} {str(found.get(part))[:60]}, not {str(value)[:60]}"
    return f"{name} {str(found)[:60]}, not {str(expected)[:60]}"
