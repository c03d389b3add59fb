"""A live session: people act, the robot is advised, and nothing that was acknowledged is ever lost.

`Session` is a `Course` with a `Journal` and a lock: any thread may report what has happened. An event is on the disk
before it is acknowledged, and seen by others only then; events that come together share one wait for the disk. What
could not be recorded has not happened. Opened again on the same journal, a session is where it was: the same states,
beliefs, bit for bit, suggestions and answers.
"""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
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
"""Of journals."""

Refused = (ValueError, LimitError, PolicyError)
"""What is wrong with an event, as against with the program."""

Outcome = dict[str, Any] | Exception
"""What has come of an event: what whoever reported it sees now, or why it has not happened."""


class EventSourced(Protocol):
    """What a session keeps: what happens, and what is seen of it, as described at `Course`, that of one team."""

    count: int
    paused: bool
    fault: str | None
    recent: deque[dict[str, Any]]

    def happen(self, event: Event, time: float) -> dict[str, Any] | None:
        """Let something happen; give the record of it."""
        ...

    def again(self, record: Mapping[str, Any]) -> None:
        """Let happen again what has been recorded."""
        ...

    def touched(self, record: Mapping[str, Any]) -> set[str]:
        """Name those for whom something has changed with an event."""
        ...

    def require(self, person: str) -> None:
        """Refuse whoever is not there."""
        ...

    @property
    def people(self) -> tuple[str, ...]:
        """Who is there."""
        ...

    @property
    def advice(self) -> Advice:
        """What was decided after the last event."""
        ...

    def person(self, person: str) -> dict[str, Any]:
        """Give what somebody sees."""
        ...

    def entry(self, person: str) -> dict[str, Any]:
        """Give what the operator sees of somebody."""
        ...

    def place(self, person: str) -> tuple[CostToGo, int]:
        """Give somebody's task, and the state in which it is."""
        ...

    def robot(self) -> dict[str, Any]:
        """Give where the robot is to be."""
        ...

    def beliefs(self) -> dict[str, bytes]:
        """Give what is believed of everybody, to the bit."""
        ...

    def log(self, task: str | None = None) -> list[dict[str, Any]]:
        """Give everybody's actions as `fit` reads them."""
        ...


@dataclass(frozen=True)
class Outlook:
    """What there is to see of a session beside its people.

    Attributes
    ----------
    events : int
        How many there have been.
    paused : bool
        Whether the robot says nothing.
    robot : dict
        Where it is to be, and what it says there.
    recent : list of dict
        The last events, the oldest first.
    fault : str or None
        Why the policy could not decide, if it could not: the robot then does nothing.
    """

    events: int
    paused: bool
    robot: dict[str, Any]
    recent: list[dict[str, Any]]
    fault: str | None


class Session:
    """People at work, live, and the robot that assists them.

    Parameters
    ----------
    tasks : CostToGo, or mapping of str to CostToGo
        By name; the first is that of everybody for whom no other is named.
    journal : Path
        The file in which the session is kept, and from which it goes on.
    policy : str or callable
        A team policy, as in `Assistant`.
    setting, population, distance
        As in `Assistant`.
    clock : callable
        Seconds from any beginning, never less than before. No result depends on it.

    Attributes
    ----------
    changed : callable or None
        Called with those for whom something has changed, after it is on the disk, while the session is locked.

    Raises
    ------
    ResultsExistError
        The journal is of a session that runs, or of one with other tasks or settings.
    DamagedFileError
        It was changed by somebody else.
    OSError
        It cannot be written.
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
            "setting": asdict(desk.setting),
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
        """Give one in which nothing has happened yet."""
        return Course(self._tasks, **self._options)

    def _resume(self) -> None:
        """Let all happen again that is in the journal."""
        course, answered, last = self._course_anew(), AnsweredIds(self._journal), 0.0
        self._course = course
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
        self._answered, self._last = answered, last

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
        """Let go of the journal."""
        with self.lock:
            self._journal.close()

    # What happens.

    def report(self, events: Sequence[Event]) -> list[Outcome]:
        """Let events happen, one after the other, and wait until those that can be are on the disk.

        Returns
        -------
        list
            For each what whoever it is about sees after it (`person`, or `robot` where it is about nobody), or the
            exception that says why it has not happened: an `UnknownError`, `AbsentError`, `InapplicableError`, another
            ValueError, a `LimitError`, or a `JournalError`, where the disk is full.
        """
        with self.lock:
            try:
                self._journal.check()
            except JournalError as error:
                return [self._known(event) or error for event in events]
            outcomes: list[Outcome | tuple[str, str]] = []
            lines: list[bytes] = []
            records: dict[Key, dict[str, Any]] = {}
            answered: list[tuple[Key, int]] = []
            touched: set[str] = set()
            for event in events:
                key = (event.person or "", event.id or "")
                if event.id and key in records:
                    outcomes.append(_same(event, records[key]))
                    continue
                try:
                    outcome = self._known(event) or self._happen(event, records, lines, touched)
                except Refused as error:
                    outcome = error
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
        """Give the answer of an event that has happened already."""
        record = self._answered.find((event.person or "", event.id)) if event.id else None
        return None if record is None else _same(event, record)

    def _commit(
        self, outcomes: list[Any], lines: list[bytes], answered: list[tuple[Key, int]], touched: set[str]
    ) -> list[Outcome]:
        if lines:
            try:
                begins = self._journal.append(lines)
            except JournalError as error:
                self._resume()  # what is not on the disk has not happened
                return [outcome if isinstance(outcome, Exception) else error for outcome in outcomes]
            for key, number in answered:
                self._answered.add(key, begins[number])
            if self.changed is not None:
                self.changed(touched)
        return outcomes

    def _one(self, event: Event) -> dict[str, Any]:
        outcome = self.report([event])[0]
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def join(self, person: str, task: str | None = None, *, id: str | None = None) -> dict[str, Any]:
        """Let somebody come, or come back to what they left; give what they see, as all that follow do."""
        return self._one(Event("joined", person, task=task, id=id))

    def leave(self, person: str, *, id: str | None = None) -> dict[str, Any]:
        """Let somebody go."""
        return self._one(Event("left", person, id=id))

    def begin(self, person: str, task: str | None = None, *, id: str | None = None) -> dict[str, Any]:
        """Let somebody begin the next task, the same again unless named."""
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
        """Take note of what somebody did; what is not listed is as in `Event`."""
        return self._one(Event("acted", person, action, followed, seen, id=id))

    def undo(self, person: str, *, id: str | None = None) -> dict[str, Any]:
        """Take somebody's last action back, as if it had not been observed."""
        return self._one(Event("undone", person, id=id))

    def arrived(self, person: str | None = None, *, id: str | None = None) -> dict[str, Any]:
        """Take note of where the robot is: with somebody, or at its base; give where it is to go next."""
        return self._one(Event("arrived", person, id=id))

    def elapse(self) -> dict[str, Any]:
        """Take note that time has passed in which nobody acted; give where the robot is to go."""
        return self._one(Event("elapsed"))

    def pause(self, paused: bool = True) -> dict[str, Any]:
        """Let the robot say nothing, or speak again; people can go on acting."""
        return self._one(Event("paused" if paused else "resumed"))

    def now(self) -> float:
        """Give the seconds since the session began, without those in which it did not run."""
        return self._clock() - self._began

    # What is seen. All of it is on the disk.

    @property
    def people(self) -> tuple[str, ...]:
        """Who is there, in the order in which they first came."""
        with self.lock:
            return self._course.people

    def recommend(self) -> Advice:
        """Give what was decided after the last event: to whom the robot goes, what it suggests, and why."""
        with self.lock:
            return self._course.advice

    def person(self, person: str) -> dict[str, Any]:
        """Give what somebody sees, as the service sends it.

        Raises
        ------
        AbsentError
        """
        with self.lock:
            self._course.require(person)
            return self._course.person(person)

    def entry(self, person: str) -> dict[str, Any]:
        """Give what the operator sees of somebody, beliefs included.

        Raises
        ------
        AbsentError
        """
        with self.lock:
            self._course.require(person)
            return self._course.entry(person)

    def outlook(self) -> Outlook:
        """Give what there is to see beside the people."""
        with self.lock:
            course = self._course
            return Outlook(course.count, course.paused, course.robot(), list(course.recent), course.fault)

    @property
    def tasks(self) -> tuple[str, ...]:
        """The names of the tasks; the first is that of everybody for whom no other is named."""
        return tuple(self._tasks)

    def log(self, task: str | None = None) -> list[dict[str, Any]]:
        """Give everybody's actions as `fit` reads them; only those in a task, if one is named.

        Raises
        ------
        UnknownError
            There is no such task.
        """
        with self.lock:
            return self._course.log(task)

    def place(self, person: str) -> tuple[CostToGo, int]:
        """Give somebody's task, and the state in which it is."""
        with self.lock:
            self._course.require(person)
            return self._course.place(person)

    def beliefs(self) -> dict[str, bytes]:
        """Give what is believed of everybody who is there, to the bit."""
        with self.lock:
            return self._course.beliefs()


def _chances(task: CostToGo, population: Population | Mixture) -> str:
    """Tell how people choose by a function from what another one of that name says."""
    if not is_whole(task):
        raise ValueError(f"people who choose by a function: expected a task of at most {WHOLE:,} states, all known")
    choices = Choices.of(task)
    q = perceived_cost(choices, choices.h)
    p = chances(population.typical, choices, q, Grid.regular(population).beta)
    return sha256(p.tobytes()).hexdigest()[:32]


def _line(record: Mapping[str, Any]) -> bytes:
    return json.dumps(record, separators=(",", ":"), default=str).encode() + b"\n"


def _same(event: Event, record: Mapping[str, Any]) -> Outcome:
    """Answer what was reported before under the same id."""
    if record["event"] != event.kind:
        return InapplicableError(f"the id {event.id!r} stands for something else that has happened; expected a new one")
    answer: dict[str, Any] = record["answer"]
    return answer


def _others(header: dict[str, Any], tasks: dict[str, str], files: dict[str, str | None]) -> str:
    """Say of which tasks a session is, and of which others it was to be."""
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
    """Say which part differs, in few words."""
    with suppress(AttributeError):
        for part, value in expected.items():
            if found.get(part) != value:
                return f"{name} {part} {str(found.get(part))[:60]}, not {str(value)[:60]}"
    return f"{name} {str(found)[:60]}, not {str(expected)[:60]}"
