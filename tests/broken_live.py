"""A live session without a service, and broken ones: journals that are truncated, changed, or of another task.

Databases are broken as files, too.
"""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assist.live.store import stored
from planner.system.errors import InputFileError

if TYPE_CHECKING:
    from broken import Fuzzer

ARGUMENTS = [
    "problem.pddl", "--humans", "2", "--simulate", "1", "--port", "0", "--c-suggest", "0.05", "--data", "session",
]  # fmt: skip
JOURNAL = Path("session") / "journal.sqlite"
STEPS = 6


def work(plan: Any, session: Any, listening: Any, ready: Callable[..., None], *_: object) -> None:
    """Replace `assist.web.server.serve`: each person acts a few times, pages are drawn, and the session ends."""
    from assist.live.events import Acted, Began, Joined, Left
    from assist.web.task_drawings import Pictures
    from assist.web.tokens import AccessTokens

    try:
        access, pictures, people = AccessTokens.kept(plan.folder / "secret", "http://here"), Pictures(), session.people
        ready(access, people)
        simulated = plan.seats().people
        for number in range(STEPS):
            name = people[number % min(4, len(people))]
            seen = session.person(name)
            task, state = session.task_and_state(name)
            if seen["finished"] or not seen["applicable"]:
                continue
            pictures.of(task, state, seen, 400)
            action = seen["applicable"][0]
            if name in simulated:
                action = simulated[name].act(task, state, seen["applicable"], seen["suggestion"])
            (outcome,) = session.report_all([Acted(person=name, action=action)])
            if isinstance(outcome, Exception):
                raise outcome
        session.report_all([Left(person=people[0]), Joined(person=people[0]), Began(person=people[-1])])
        json.dumps([session.entry(name) for name in session.people])
    finally:
        listening.close()
        session.close()


def spoil(fuzzer: Fuzzer, folder: Path) -> None:
    """Break a journal, or another file of its folder."""
    file = folder / JOURNAL
    chance = fuzzer.rng.random()
    if chance < 0.1:
        fuzzer._spoil_file(folder / "session" / "secret")
    elif chance < 0.2:
        domain = Path(__file__).parent.parent / "domains" / "delivery"
        shutil.copy(domain / "domain.pddl", folder)
        shutil.copy(domain / "one-parcel.pddl", folder / "problem.pddl")
    elif chance < 0.4:
        fuzzer._spoil_file(file)
    elif chance < 0.5:
        content = file.read_bytes()
        file.write_bytes(content[: int(fuzzer.rng.integers(len(content)))])
    else:
        _spoil_record(fuzzer, file)


def _spoil_record(fuzzer: Fuzzer, file: Path) -> None:
    """Change a value of an event or of the header within a database."""
    table, column = ("events", "record") if fuzzer.rng.random() < 0.7 else ("header", "document")
    with closing(sqlite3.connect(file)) as db, db:
        (count,) = db.execute(f"SELECT count(*) FROM {table}").fetchone()
        row = 1 + int(fuzzer.rng.integers(count))
        (text,) = db.execute(f"SELECT {column} FROM {table} WHERE rowid = ?", (row,)).fetchone()
        fuzzer._spoil_value(record := json.loads(text))
        db.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (json.dumps(record), row))


def kept(folder: Path) -> list[Any] | None:
    """Return the header and the records of a session; None if they cannot be read."""
    try:
        header, records = stored(folder / JOURNAL)
    except (InputFileError, OSError):
        return None
    return [header, *(record for _, record in records)]


def wrong(before: list[Any] | None, folder: Path, code: Any) -> list[str]:
    """Return what is wrong with a journal afterwards: one that was refused must be unchanged."""
    after = kept(folder)
    if code != 0 and before is not None and after != before:
        return ["a journal that was refused has changed"]
    if code == 0 and before is not None and (after or [])[: len(before)] != before:
        return ["what had happened is no longer in the journal"]
    return []
