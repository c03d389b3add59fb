"""Sessions for tests: people, events, and all that can be seen of a session."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from pathlib import Path

from hypothesis import strategies as st

from assist.live.course import Course
from assist.live.events import Event
from assist.live.session import Session
from assist.people.human import Population
from assist.team.settings import Setting

# People to whom the robot says something after one mistake, too, that they made against its advice.
EASY = Population()
SETTING = Setting(c_suggest=0.02, c_move=0.01, trust="paper")
WRONG = "(place hammer slot-2 box-a)"

KINDS = [*["acted"] * 5, "undone", "left", "joined", "began", "arrived", "elapsed", "paused", "resumed"]
HAPPENS = st.lists(
    st.tuples(
        st.sampled_from(KINDS),
        st.integers(0, 2), st.integers(0, 9),
    ),
    max_size=25,
)  # fmt: skip


def former(file: Path) -> Path:
    """Write a session's events as a journal of the former format, remove the database, and return the journal."""
    with closing(sqlite3.connect(file)) as db:
        (header,) = db.execute("SELECT document FROM header").fetchone()
        rows = db.execute("SELECT record, answer FROM events ORDER BY n").fetchall()
    lines = [header]
    for record, answer in rows:
        lines.append(
            json.dumps(
                json.loads(record) | ({} if answer is None else {"answer": json.loads(answer)}), separators=(",", ":")
            )
        )
    journal = file.with_suffix(".jsonl")
    journal.write_text("".join(f"{line}\n" for line in lines))
    for one in file.parent.glob(f"{file.name}*"):
        one.unlink()
    return journal


def happen(session: Session, events: list[tuple[str, int, int]], tag: str = "") -> None:
    """Apply events to a, b and c, as far as they are possible."""
    for number, (kind, who, luck) in enumerate(events):
        name = "abc"[who]
        event = Event(
            kind, None if kind in ("elapsed", "paused", "resumed") else name, id=f"{tag}{session.now()}-{number}"
        )
        if kind == "acted" and name in session.people:
            options = session.person(name)["applicable"]
            action = options[luck % len(options)] if options else "(return box-a)"
            event = Event(kind, name, action, seen=luck if luck < 4 else None, id=event.id)
        session.report([event])


def all_of(session: Session) -> str:
    """Return all views of a session, its beliefs, and the saved team, with the places of robots under way."""
    seen = [session.entry(name) for name in session.people], session.log(), session.recommend(), session.outlook()
    assert isinstance(session._course, Course)
    return repr(seen) + repr(session.beliefs()) + session._course.desk.to_json()
