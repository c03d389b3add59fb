"""Nothing acknowledged is lost or doubled, whatever fails; what is erased is nowhere, and others do not change."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path

import pytest
from graphs import graph_task
from sessions import EASY, SETTING
from store_faults import Failing, schedule

from assist.declare import AbsentError
from assist.live import JournalError, Session, TeamRecord
from assist.live.live_task import LiveTask
from assist.live.store import EventStore, stored
from assist.live.team import Team
from assist.team.priority import Priority
from planner import InputFileError, Table, sweep


def content(folder: Path) -> bytes:
    """Return the bytes of all files in a folder."""
    return b"".join(file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file())


# Erasing.


def test_after_an_erasure_the_policy_knows_the_tasks_that_it_knows_after_a_restart(tmp_path: Path) -> None:
    """The price of attention is that of the cheapest action of all tasks: that of the erased person does not count."""
    tasks = {name: sweep(graph_task([(1, 2, cost), (2, 0, cost), (1, 1, cost)])) for name, cost in (("a", 1), ("b", 4))}

    def opened() -> Session:
        return Session(tasks, tmp_path / "one.sqlite", setting=SETTING, policy="priority")

    def price(session: Session) -> list[float]:
        session.recommend()
        assert isinstance(session.history, Team)
        policy = session.history.desk._decisions.team_policy()
        assert isinstance(policy, Priority)
        return policy.price.tolist()

    session = opened()
    session.join("ann", task="b")
    session.join("bob", task="b")
    session.begin("ann", task="a")
    cheap = price(session)
    session.erase("ann", "as asked")
    erased = price(session)
    session.close()
    session = opened()
    assert erased == price(session) == [4 * cheap[0]]
    session.close()


def test_nothing_of_an_erased_person_is_in_the_folder(tiny: Table, fixed: Table, tmp_path: Path) -> None:
    session = Session({"tiny": tiny, "fixed": fixed}, tmp_path / "journal.sqlite", setting=SETTING, population=EASY)
    session.join("ann")
    session.join("Bartholomew", "fixed", id="come-2718")
    for number in range(3):
        session.observe("Bartholomew", "(fetch box-c)", id=f"barts-{number}")
        session.observe("Bartholomew", "(return box-c)")
        session.arrived("Bartholomew", id=f"robot-{number}")
    session.arrived(id="robots")  # the answer says where the robot is
    session.observe("ann", "(fetch box-a)", id="anns")
    traces = (b"Bartholomew", b"barts-", b"come-2718", b"box-c")
    assert all(trace in content(tmp_path) for trace in traces[:3])
    before, mine = session.beliefs()["ann"], session.person("ann")
    with pytest.raises(AbsentError, match="nothing is recorded about 'bob'"):
        session.erase("bob", "as asked")
    for reason in ("", "x" * 201, "bartholomew asked", "asked by BARTHOLOMEW.", "Bartholomew's wish"):
        with pytest.raises(ValueError, match="reason: expected 1 to 200 characters, without the person's name"):
            session.erase("Bartholomew", reason)
    stone = session.erase("Bartholomew", "withdrew by e-mail")
    assert (stone.reason, stone.events) == ("withdrew by e-mail", 11)
    assert datetime.now(UTC).isoformat()[:10] in stone.at
    for _ in range(2):
        assert [trace for trace in traces if trace in content(tmp_path)] == []
        assert (session.beliefs()["ann"], session.person("ann")) == (before, mine)
        assert session.people == ("ann",)
        assert session.observe("ann", "(fetch box-a)", id="anns")["steps"] == 1
        assert session.tombstones() == [stone]
        session.close()
        session = Session({"tiny": tiny, "fixed": fixed}, tmp_path / "journal.sqlite", setting=SETTING, population=EASY)
    assert session.join("Bartholomew")["steps"] == 0  # somebody new
    session.erase("Bartholomew", "again")
    assert [stone.label for stone in session.tombstones()] == ["(erased 1)", "(erased 2)"]
    session.close()


def test_a_short_name_within_the_words_of_a_reason_is_no_name(tiny: Table, tmp_path: Path) -> None:
    session = Session(tiny, tmp_path / "journal.sqlite", setting=SETTING)
    for name, reason in (("e", "withdrew by e-mail"), ("Al", "personal reasons"), ("a.b", "a b")):
        session.join(name)
        with pytest.raises(ValueError, match="without the person's name"):
            session.erase(name, f"as {name.lower()}, wished")
        assert session.erase(name, reason).reason == reason
    session.close()


def test_an_erasure_that_was_interrupted_is_completed(
    tiny: Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session(tiny, tmp_path / "journal.sqlite")
    session.join("Bartholomew")
    with monkeypatch.context() as patch:
        patch.setattr(session._store, "_db", Failing(session._store._db, lambda sql: sql == "VACUUM"))
        with pytest.raises(JournalError, match="the records are erased, but traces may remain"):
            session.erase("Bartholomew", "as asked")
    session.close()
    Session(tiny, tmp_path / "journal.sqlite").close()
    assert b"Bartholomew" not in content(tmp_path)


# Faults.


@pytest.mark.parametrize("first", [0, pytest.param(6, marks=pytest.mark.slow)])
def test_faults_of_the_store_lose_and_double_nothing(tiny: Table, tmp_path: Path, first: int) -> None:
    solved = LiveTask(tiny, SETTING.for_real_people(), EASY).policy  # once for all sessions
    for seed in range(first, 6 if first == 0 else 100):
        schedule(solved, tmp_path, seed)


# Files.


def test_events_have_the_time_and_files_are_the_owners(tiny: Table, tmp_path: Path) -> None:
    session = Session(tiny, tmp_path / "session" / "journal.sqlite")
    begin = datetime.now(UTC)
    session.join("ann")
    session.observe("ann", "(fetch box-a)")
    times = [datetime.fromisoformat(at or "") for at, _ in stored(tmp_path / "session" / "journal.sqlite")[1]]
    assert all(abs((time - begin).total_seconds()) < 60 for time in times)
    assert all(time.utcoffset() is not None for time in times)
    files = list((tmp_path / "session").iterdir())
    assert {file.suffix for file in files} >= {".sqlite", ".sqlite-wal", ".lock"}
    assert [file.name for file in files if file.stat().st_mode & 0o077] == []
    with pytest.raises(InputFileError, match="the folder is in use by a running session; expected another folder"):
        EventStore(tmp_path / "session" / "journal.sqlite", TeamRecord)
    session.close()


def test_a_session_on_a_medium_that_cannot_be_written_can_be_read(
    tiny: Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session(tiny, tmp_path / "journal.sqlite")
    session.join("ann")
    session.close()
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert [record["event"]["person"] for _, record in stored(tmp_path / "journal.sqlite")[1]] == ["ann"]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["journal.lock", "journal.sqlite"]
