"""Faults of a session's store at random statements: exceptions, a full disk, and kill -9.

As a script it runs many schedules, and prints the figures of `docs/results/reliability.md`:

    .venv/bin/python tests/store_faults.py [SCHEDULES] [SEED]
"""

from __future__ import annotations

import json
import logging
import os
import random
import signal
import sqlite3
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sessions import EASY, SETTING, all_of

from assist.live import Acted, Joined, JournalError, Session
from assist.live.event_base import TeamEvent
from assist.live.live_task import LiveTask
from assist.live.store import stored
from assist.person.policy import Policy

KINDS = ("error", "full", "kill")
UNLIMITED = 1 << 30  # pages of a database


class Failing:
    """A connection of which a statement fails, before or after it is carried out."""

    def __init__(
        self, db: sqlite3.Connection, fails: Callable[[str], bool], error: BaseException | None = None, *,
        late: bool = False, kind: str = "error",
    ) -> None:  # fmt: skip
        self._db, self._fails, self._late, self._kind = db, fails, late, kind
        self._error = error or sqlite3.OperationalError("disk I/O error")
        self.count = 0

    def execute(self, sql: str, *given: Any) -> Any:
        fails = self._fails(sql)
        self.count += fails and self._kind != "full"
        if fails and self._kind == "full":  # SQLite itself refuses each further page
            (pages,) = self._db.execute("PRAGMA page_count").fetchone()
            self._db.execute(f"PRAGMA max_page_count={pages}")
        elif fails and not self._late:
            self._fail()
        try:
            found = self._db.execute(sql, *given)
        except sqlite3.OperationalError:  # the disk is full
            self.count += 1
            raise
        if fails and self._kind != "full":
            self._fail()
        return found

    def _fail(self) -> None:
        if self._kind == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        raise self._error.with_traceback(None)  # without those of earlier schedules

    def __getattr__(self, name: str) -> Any:
        return getattr(self._db, name)


ERRORS = [MemoryError(), RuntimeError("a fault"), sqlite3.OperationalError("disk I/O error"), KeyboardInterrupt()]


def failing(session: Session, rng: random.Random, statements: int, kind: str) -> Failing:
    """Let one or two of the next statements of a session's store fail."""
    left, last = [rng.randint(0, statements)], rng.choice([-1, -2])

    def fails(_: str) -> bool:
        left[0] -= 1
        return last <= left[0] <= -1

    return Failing(session._store._db, fails, rng.choice(ERRORS), late=rng.random() < 0.5, kind=kind)


def in_child(work: Callable[[], Any]) -> tuple[Any, bool]:
    """Return what a function returned in another process, None if it was killed before; and whether it was."""
    reading, writing = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads, which the child does not use
        child = os.fork()
    if child == 0:
        try:
            os.write(writing, json.dumps(work()).encode())
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as stream:
        said = stream.read()
    _, status = os.waitpid(child, 0)
    return json.loads(said) if said else None, os.WIFSIGNALED(status)


def schedule(task: Policy, folder: Path, seed: int) -> Counter[str]:
    """Report batches of events and erase people while statements of the store fail, and check the session each time.

    Return how many faults of which kind there were, and how many events were acknowledged.
    """
    rng = random.Random(seed)
    kind = KINDS[seed % len(KINDS)]
    file, counts = folder / f"{seed}.sqlite", Counter[str]()

    def opened() -> Session:
        return Session(task, file, setting=SETTING, population=EASY)  # type: ignore[arg-type]

    session, acknowledged, number = opened(), dict[str, tuple[TeamEvent, Any]](), 0
    session.report_all([Joined(person=name, id=f"join {name}") for name in "abc"])
    for _ in range(rng.randint(2, 5)):
        batch: list[TeamEvent] = []
        for _ in range(rng.randint(1, 5)):
            name, number = rng.choice("abc"), number + 1
            options = session.person(name)["applicable"] if name in session.people else []
            batch.append(Acted(person=name, action=rng.choice(options or ["(fetch box-a)"]), id=str(number)))
        erases = rng.random() < 0.2 and "c" in session.people
        outcomes, stones, beliefs = list[Any](), len(session.tombstones()), session.beliefs()

        def work(session: Session, batch: list[TeamEvent] = batch, *, erases: bool = erases) -> tuple[list[Any], int]:
            whole = session._store._db
            fault = failing(session, rng, 30 if erases else 2 * len(batch) + 2, kind)
            session._store._db = fault  # type: ignore[assignment]
            found: list[Any] = []
            try:
                if erases:
                    session.erase("c", "as asked")
                else:
                    found = session.report_all(batch)
            except (KeyboardInterrupt, MemoryError, RuntimeError, JournalError) as error:
                if not isinstance(error, JournalError) and error not in ERRORS:
                    raise
            if session._store._db is fault:
                session._store._db = whole
            session._store._db.execute(f"PRAGMA max_page_count={UNLIMITED}")
            return found, fault.count

        def in_a_new_process() -> list[Any]:
            return [one if isinstance(one, dict) else None for one in work(opened())[0]]

        if kind == "kill":
            session.close()
            found, killed = in_child(in_a_new_process)
            outcomes, counts[kind] = found or [], counts[kind] + killed
            session = opened()
        else:
            outcomes, faults = work(session)
            counts[kind] += faults
        acknowledged |= {
            event.id or "": (event, outcome)
            for event, outcome in zip(batch, outcomes, strict=False)
            if isinstance(outcome, dict)
        }
        if len(session.tombstones()) > stones:
            counts["acknowledged"] += sum(one[0].person == "c" for one in acknowledged.values())
            acknowledged = {id: one for id, one in acknowledged.items() if one[0].person != "c"}
            assert session.beliefs() == {name: beliefs[name] for name in "ab"}
        ids = [record["event"]["id"] for _, record in stored(file)[1] if "id" in record["event"]]
        assert len(ids) == len(set(ids))
        assert set(acknowledged) <= set(ids)
        before = all_of(session)
        session.close()
        session = opened()
        assert all_of(session) == before, "what is in memory is what is stored"
        if len(session.tombstones()) > stones:  # also if the process was killed then
            assert all(row["person"] != "c" for row in session.log())
        for event, outcome in acknowledged.values():
            assert session.report(event) == outcome
    session.close()
    counts["acknowledged"] += len(acknowledged)
    return counts


def main(schedules: int = 500, seed: int = 0) -> None:
    """Run schedules and print how many faults and acknowledged events they had."""
    from planner import cost_to_go, load

    tiny = Path(__file__).parent.parent / "domains" / "kitting" / "tiny.pddl"
    solved = LiveTask(cost_to_go(load(tiny)), SETTING.for_real_people(), EASY).policy
    logging.disable()  # sessions log each fault
    total = Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        for number in range(seed, seed + schedules):
            total += schedule(solved, Path(folder), number)
    print(
        f"{schedules} schedules: nothing acknowledged lost, nothing doubled, every session opened again; {dict(total)}"
    )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
