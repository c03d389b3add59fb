"""Folders, files, clocks, disks and processes that fail under an operator: nothing is lost, and each fault is said."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
from collections.abc import Callable
from datetime import UTC, date, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest
from conftest import thinned
from store_faults import Failing, in_child
from test_cases_withdrawal import answered, of_others
from test_event_store import content
from test_userstudy_pages import Web
from userstudies import PLAN, Part, written

from assist.declare import InapplicableError
from assist.live import JournalError, Session
from assist.studies.reports.userstudy_report import write_report
from assist.studies.userstudy import StudySession, events, read
from assist.studies.userstudy.export import archive
from assist.studies.userstudy.session import JOURNAL
from assist.studies.userstudy.tables import tables
from assist.web.tokens import AccessTokens
from assist.web.user_study.service import StudyService
from planner import InputFileError, Table


def opened(table: Table, folder: Path, text: str = PLAN) -> StudySession:
    study = read(written(folder / "study.toml", text))
    return StudySession(study, {"tiny": table, "practice": table}, folder / "data")


@pytest.fixture(scope="module")
def completed(tiny: Table, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a study in which two participants have come to the end."""
    folder = tmp_path_factory.mktemp("completed")
    session = opened(tiny, folder)
    answered(session, "eve", "ann")
    session.close()
    return folder


@pytest.fixture
def begun(completed: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(completed, tmp_path, dirs_exist_ok=True))


def damaged(change: Callable[[Path], Any]) -> Callable[[Path, Table], Any]:
    """Return what happens when a study is opened again after a change in its folder."""

    def happens(folder: Path, table: Table) -> Any:
        change(folder / "data")
        return opened(table, folder)

    return happens


def as_text(file: Path) -> None:
    file.write_text("participant,condition\n")


def cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:5000])


def no_folder(folder: Path) -> None:
    shutil.rmtree(folder)
    folder.write_text("a file")


def served(folder: Path, table: Table) -> StudyService:
    return StudyService(opened(table, folder), AccessTokens.kept(folder / "data" / "secret", "http://testserver"))


def half_a_secret(folder: Path, table: Table) -> StudyService:
    served(folder, table).session.close()
    (folder / "data" / "secret").write_bytes(b"short")
    return served(folder, table)


FAULTS: dict[str, tuple[Callable[[Path, Table], Any], type[Exception], str]] = {
    "a journal that is a text": (damaged(lambda d: as_text(d / JOURNAL)), InputFileError, "is damaged"),
    "half a journal": (damaged(lambda d: cut(d / JOURNAL)), InputFileError, "is damaged"),
    "a folder that is a file": (damaged(no_folder), OSError, "File exists"),
    "a team's session on a study's folder": (
        lambda folder, table: Session(table, folder / "data" / JOURNAL), InputFileError, "the session there has",
    ),
    "half a secret": (half_a_secret, OSError, "expected the 32 bytes of the session's secret; found 5"),
    "a report of a journal that is a text": (
        lambda folder, _: (as_text(folder / "data" / JOURNAL), write_report(folder / "data", folder / "report")),
        InputFileError, "is damaged",
    ),
    "an export without the study's file": (
        lambda folder, _: ((folder / "data" / "study.toml").unlink(), archive(folder / "data")), InputFileError,
        "no such file",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_in_the_folder_is_said_in_one_sentence(begun: Path, tiny: Table, fault: str) -> None:
    happens, kind, said = FAULTS[fault]
    with pytest.raises(kind) as refused:
        happens(begun, tiny)
    text = str(refused.value)
    assert said in text
    assert "\n" not in text.strip()
    assert str(begun) in text


def test_after_a_refusal_the_folder_is_free_and_whole(begun: Path, tiny: Table) -> None:
    before = (begun / "data" / JOURNAL).read_bytes()
    with pytest.raises(InputFileError, match=r"study than .*study.toml, line 7 of which is 'seed = 4', not 'seed = 3'"):
        opened(tiny, begun, PLAN.replace("seed = 3", "seed = 4"))
    assert (begun / "data" / JOURNAL).read_bytes() == before
    opened(tiny, begun).close()


def test_a_lost_key_of_codes_changes_no_row_of_those_who_came(begun: Path, tiny: Table) -> None:
    session = opened(tiny, begun)
    rows = of_others(session, "nobody")
    session.close()
    service = served(begun, tiny)
    (begun / "data" / "codes.key").unlink()
    assert of_others(service.session, "nobody") == rows  # type: ignore[arg-type]
    service.session.close()


# Disks. Each participant is told, and goes on when there is room.


def test_a_full_disk_is_said_to_participants_and_researchers(
    tiny: Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    web = Web(tiny, tmp_path, PLAN.replace("seed = 3", 'seed = 3\nlanguage = "de"'))
    with web.client:
        ann = web.take_part("ann")
        store = web.service.session._store
        with monkeypatch.context() as patch:
            full = Failing(store._db, lambda sql: sql.startswith("INSERT INTO events"), kind="full")
            patch.setattr(store, "_db", full)
            seen = web.onward(ann, "consent", id="once")
            if seen.status_code == 200:  # there was room on the last page
                seen = web.onward(ann, "instructions", id="twice")
            while seen.status_code == 200:
                seen = web.come(os.urandom(8).hex())
            assert seen.status_code == 507
            assert seen.json()["detail"].startswith("Der Server kann im Moment nichts speichern.")
            problems = web.ask("GET", "/api/study").json()["problems"]
            assert problems == ["events cannot be saved: No space left on device at the last attempt"]
            assert web.client.get("/api/health", params={"ready": True}).status_code == 503
            assert web.ask("GET", "/api/study/export").status_code == 200  # which is made in memory
        store._db.execute(f"PRAGMA max_page_count={1 << 30}")
        assert web.come("bob").status_code == 200
        assert web.ask("GET", "/api/study").json()["problems"] == []


def test_a_report_that_cannot_be_removed_stops_a_withdrawal_which_is_then_complete(begun: Path, tiny: Table) -> None:
    (begun / "data" / "report" / "summary.json").mkdir(parents=True)  # a folder where the report has a file
    session = opened(tiny, begun)
    with pytest.raises(OSError, match=r"summary\.json"):
        Part(session, "eve").report("withdrew", id="asked")
    assert session.fault() == "what a participant withdrew could not be removed yet"
    shutil.rmtree(begun / "data" / "report")
    Part(session, "eve").report("withdrew", id="asked")
    assert b"words of eve" not in content(begun / "data")
    session.close()


def test_who_reads_the_journal_delays_a_withdrawal_and_keeps_nothing(begun: Path, tiny: Table) -> None:
    """A program with an open transaction holds back the last pages; the withdrawal is complete when it has ended."""
    session = opened(tiny, begun)
    session._store._db.execute("PRAGMA busy_timeout=50")
    reader = sqlite3.connect(begun / "data" / JOURNAL, isolation_level=None)
    reader.execute("BEGIN")
    reader.execute("SELECT count(*) FROM events").fetchone()
    with pytest.raises(JournalError, match="traces may remain"):
        Part(session, "eve").report("withdrew", id="asked")
    reader.close()
    assert Part(session, "eve").report("withdrew", id="asked")["study"]["kind"] == "withdrew"
    assert b"words of eve" not in content(begun / "data")
    session.close()


# Clocks.


def test_a_clock_that_is_set_back_changes_no_order_and_no_result(
    begun: Path, tiny: Table, monkeypatch: pytest.MonkeyPatch
) -> None:
    back = type("Clock", (datetime,), {"now": classmethod(lambda *_: datetime(1999, 1, 1, tzinfo=UTC))})
    monkeypatch.setattr(events, "datetime", back)
    session = opened(tiny, begun)
    late = Part(session, "late")
    late.come()
    late.to("thanks")
    rows = tables(session.study, begun / "data" / JOURNAL)
    assert [row["participant"] for row in rows.participants] == ["eve", "ann", "late"]
    assert all(row["seconds"] >= 0 for row in rows.tasks)
    times = [row["time"] for row in rows.actions]
    assert times == sorted(times)
    session.close()


@pytest.mark.parametrize("hours", thinned([14, 0, -12], every=3))
def test_the_last_day_for_withdrawals_is_a_day_where_the_service_is(
    tiny: Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hours: int
) -> None:
    last = date(2027, 3, 31)
    session = opened(tiny, tmp_path, PLAN.replace("seed = 3", f"seed = 3\nwithdraw_until = {last}"))
    parts = [Part(session, name) for name in ("ann", "bob")]
    for part in parts:
        part.come()
        part.to("thanks")
    zone = timezone(timedelta(hours=hours))

    class Clock(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> Any:  # noqa: ARG003
            return cls.fromtimestamp(instant.timestamp(), UTC)

        def astimezone(self, tz: Any = None) -> Any:
            return datetime.fromtimestamp(self.timestamp(), tz or zone)

    monkeypatch.setattr(events, "datetime", Clock)
    midnight = datetime(2027, 4, 1, tzinfo=UTC) - timedelta(hours=hours)
    instant = midnight - timedelta(minutes=1)
    assert parts[0].report("withdrew")["study"]["kind"] == "withdrew"
    instant = midnight + timedelta(minutes=1)
    with pytest.raises(InapplicableError, match="data could be withdrawn until 2027-03-31"):
        parts[1].report("withdrew")
    session.close()


# Two tabs.


def test_an_action_counts_at_the_stage_that_its_page_shows_only(tiny: Table, tmp_path: Path) -> None:
    """A tab that still shows practice does not act in the task, in which another tab of the participant is."""
    web = Web(tiny, tmp_path)
    with web.client:
        ann = web.take_part("ann", "consent", "instructions")
        path = f"/api/people/{ann}/actions"
        for action in tiny.optimal_plan(tiny.initial) or ():
            assert web.ask("POST", path, ann, json={"action": action, "stage": "practice"}).status_code == 200
        assert web.onward(ann, "practice").json()["study"]["stage"] == "task tiny"
        first = (tiny.optimal_plan(tiny.initial) or [""])[0]
        late = web.ask("POST", path, ann, json={"action": first, "stage": "practice"})
        assert (late.status_code, late.json()["detail"]) == (409, f"{ann} is at task tiny, not at 'practice'")
        assert web.ask("GET", f"/api/people/{ann}", ann).json()["steps"] == 0
        assert web.ask("POST", path, ann, json={"action": first, "stage": "task tiny"}).json()["steps"] == 1
        assert web.ask("POST", path, ann, json={"action": "(return box-a)"}).json()["steps"] == 2  # programs need none


# Kills, at each statement by which something is removed.

STATEMENTS = (
    "UPDATE events", "DELETE FROM erased", "INSERT INTO erased", "COMMIT", "SELECT count(*) FROM erased", "VACUUM",
    "PRAGMA wal_checkpoint", "UPDATE erased",
)  # fmt: skip


def removes(statement: str, how: str, table: Table, folder: Path) -> Callable[[], None]:
    def work() -> None:
        session = opened(table, folder)
        removing = [False]

        def dies(sql: str) -> bool:
            removing[0] = removing[0] or sql.startswith(("DELETE FROM erased", "UPDATE events"))  # in this order
            if removing[0] and sql.startswith(statement):
                os.kill(os.getpid(), signal.SIGKILL)
            return False

        session._store._db = Failing(session._store._db, dies)  # type: ignore[assignment]
        if how == "withdraw":
            Part(session, "eve").report("withdrew", id="asked")
        else:
            session.erase("eve", "wrote a letter")

    return work


@pytest.mark.parametrize("how", thinned(["erase", "withdraw"]))
@pytest.mark.parametrize(
    "statement", [one if one == "VACUUM" else pytest.param(one, marks=pytest.mark.slow) for one in STATEMENTS]
)
def test_a_kill_at_any_statement_of_a_removal_is_made_good(begun: Path, tiny: Table, statement: str, how: str) -> None:
    """A withdrawal is complete when the study goes on; an erasure is, or can be asked for again."""
    session = opened(tiny, begun)
    before = of_others(session, "eve")[1:]
    session.close()
    _, killed = in_child(removes(statement, how, tiny, begun))
    assert killed
    session = opened(tiny, begun)
    committed = STATEMENTS.index(statement) > STATEMENTS.index("COMMIT")
    if how == "erase" and not committed:
        assert session.person("eve")["study"]["kind"] == "withdrew"  # an erasure begins with a withdrawal
        session.erase("eve", "wrote a letter")
    assert b"words of eve" not in content(begun / "data")
    assert of_others(session, "eve")[1:] == before or how == "erase"
    assert {row["participant"] for row in tables(session.study, begun / "data" / JOURNAL).tasks} == {"ann"}
    session.close()
