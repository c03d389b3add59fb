"""What a participant withdraws is in no byte of the study's folder, whatever fails; that somebody withdrew remains."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from conftest import thinned
from store_faults import Failing
from test_event_store import content
from userstudies import ALONE, PLAN, SCORES, Open, Part, opened

from assist.cli.user_study import _report
from assist.declare import AbsentError, InapplicableError, Refusal
from assist.live.store import JournalError, stored
from assist.studies.reports.report_files import html_page
from assist.studies.reports.userstudy_report import write_report
from assist.studies.reports.userstudy_summary import summarise
from assist.studies.userstudy.events import Withdrew
from assist.studies.userstudy.session import JOURNAL, REPORT, StudySession
from assist.studies.userstudy.tables import tables

GROUPED = PLAN.replace("simulated = 2", "simulated = 0") + '[group]\nsize = 3\nthen = "start"\n'
__all__ = ["opened"]
SLIDERS = {**SCORES["nasa-tlx"], "mental": 85}


def answered(session: StudySession, *names: str) -> list[Part]:
    """Let participants come and go to the last stage, with words of their own."""
    parts = [Part(session, name) for name in names]
    for part in parts:
        part.come()
        part.to("questionnaire nasa-tlx")
        part.onward(SLIDERS)
        part.to("questionnaire remarks")
        part.onward({"remarks": f"words of {part.name}"})
    return parts


def of_others(session: StudySession, *names: str) -> Any:
    """Return everything that is seen and recorded of all but these."""
    found = tables(session.study, session.folder / JOURNAL)
    rows = [
        row
        for table in (found.participants, found.tasks, found.actions, found.answers, found.events)
        for row in table
        if row["participant"] not in names
    ]
    views = {one: session.entry(one) for one in session.people if one not in names}
    beliefs = {one: belief for one, belief in session.beliefs().items() if not one.startswith(names)}
    return views, rows, beliefs, [row for row in session.log() if row["person"] not in names], session.cohort.begun


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("late", thinned([True, False]))
def test_nothing_of_what_was_withdrawn_is_in_the_folder(opened: Open, late: bool) -> None:
    """Neither in the journal and its log, nor in the export and the report, nor in what a killed process left."""
    session = opened()
    eve = answered(session, "ann", "P-EVE234", "cid")[1]
    if not late:
        eve = Part(session, "P-EVE235")
        eve.come()
        eve.to("practice")
        eve.errs()
    folder, own = session.folder, eve.name
    _report(folder)
    (folder / "report" / "figures").mkdir()
    for name in (".unfinished-1-summary.json", "figures/flow.svg", "figures/.unfinished-2-flow.png"):
        (folder / "report" / name).write_bytes(content(folder))
    place, before = session.people.index(own), of_others(session, own)
    traces = [f"words of {own}"] if late else ["(fetch", '"cost_before"']
    kept = {
        n: record for n, (_, record) in enumerate(stored(folder / JOURNAL)[1]) if record["event"].get("person") == own
    }
    assert all(trace.encode() in content(folder) for trace in traces)
    status = session.cohort.participants[own]
    at, condition = status.at, status.condition
    assert eve.report("withdrew", id="asked once")["study"]["kind"] == "withdrew"
    assert f"words of {own}".encode() not in content(folder)
    for n, (utc, record) in enumerate(stored(folder / JOURNAL)[1]):
        if n in kept:
            assert utc is None
            assert set(record) <= {"n", "time", "event", "status", "condition"}
            assert set(record["event"]) <= {"kind", "person", "reached", "id", "simulated"}
            assert record["event"]["kind"] in ("visited", "erased")
            assert record["time"] <= kept[n]["time"]
    assert sorted(file.name for file in folder.rglob("*") if file.is_file()) == sorted(
        ["journal.lock", "journal.sqlite", "journal.sqlite-shm", "journal.sqlite-wal", "study.toml"]
    )
    assert (folder / "journal.sqlite-wal").stat().st_size < 5000  # the mark that all is removed; no page with records
    assert of_others(session, own) == before
    row = tables(session.study, folder / JOURNAL).participants[place]
    assert {name: value for name, value in row.items() if value not in (None, False, 0)} == {
        "participant": own, "status": "withdrew", "stage": session.study.stages[at].name,
        **({"condition": condition} if condition else {}),
    }  # fmt: skip
    session.close()
    session = opened()
    assert of_others(session, own) == before
    assert session.person(own)["study"]["kind"] == "withdrew"
    assert eve.name in session.people  # who cannot take part again
    again = Part(session, own)
    assert again.come() == {"person": own}  # the same browser is recognised
    for id in ("asked once", "asked once", "asked again", "asked again"):
        assert again.report("withdrew", id=id)["study"]["kind"] == "withdrew"
    for kind, fields in (("returned", {}), ("onward", {"stage": "consent"}), ("acted", {"action": "(fetch box-a)"})):
        with pytest.raises(InapplicableError):
            again.report(kind, **fields)
    with pytest.raises(InapplicableError):
        session.task_and_state(own)
    new = Part(session, "dora")
    new.come()
    new.to("thanks")  # the study goes on
    session.erase(own, "wrote a letter")  # and the row can be erased
    assert own.encode() not in content(folder)
    with pytest.raises(AbsentError):
        session.person(own)
    session.erase("ann", "wrote a letter, too")
    assert [stone.label for stone in session.tombstones()] == ["(erased 1)", "(erased 2)"]


@pytest.mark.parametrize("design", ["between", "within"])
def test_who_came_last_to_a_group_and_withdraws_changes_nothing_of_the_others(opened: Open, design: str) -> None:
    """Her coming began the others' task; within participants, they may be at a later condition by then."""
    text = GROUPED.replace("size = 3", "size = 2").replace("seed = 3", f'seed = 3\ndesign = "{design}"\nminutes = 1')
    session, now = opened(text), [0.0]
    session._clock, session._began = (lambda: now[0]), 0.0
    ann, eve = parts = [Part(session, name) for name in ("ann", "eve")]
    for part in parts:
        now[0] += 30.0
        part.come()
        part.to("practice")
        part.finish()
        part.onward()
    began = now[0]
    for part in parts:
        now[0] += 2.0
        part.errs()
    if design == "within":
        eve.report("left")
        ann.to("task tiny 2")  # nobody is left for whom she would wait
        began = now[0]
        now[0] += 2.0
        ann.errs()
    before = of_others(session, "eve")
    eve.report("withdrew")
    assert of_others(session, "eve")[1:] == before[1:]
    assert session.cohort.participants["ann"].entered == began
    session.erase("eve", "wrote a letter")
    assert of_others(session, "eve", "(erased 1)")[1:] == before[1:]
    session.close()
    assert of_others(opened(text), "eve", "(erased 1)")[1:] == before[1:]


def test_the_tables_of_a_group_whose_policy_failed_are_there_after_a_member_withdraws(
    opened: Open, tmp_path: Path
) -> None:
    (tmp_path / "own.py").write_text("def fails(team):\n    raise RuntimeError('it failed')\n")
    text = GROUPED.replace("size = 3", "size = 2").replace('policy = "attention"', 'policy = "own.py:fails"')
    session = opened(text.replace('policy = "none"', 'policy = "own.py:fails"'))
    for part in (parts := [Part(session, name) for name in ("ann", "eve")]):
        part.come()
        part.to("practice")
        part.finish()
        part.onward()
    for part in parts:
        part.errs()
    before = of_others(session, "eve")
    parts[1].report("withdrew")
    assert of_others(session, "eve")[1:] == before[1:]
    (row,) = tables(session.study, session.folder / JOURNAL).tasks
    assert (row["participant"], "it failed" in row["fault"]) == ("ann", True)


@pytest.mark.parametrize("fails", thinned(["UPDATE events", "COMMIT", "VACUUM", "PRAGMA wal_checkpoint"]))
def test_a_withdrawal_whose_data_cannot_be_removed_says_so_and_is_completed(
    opened: Open, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    session = opened(ALONE)
    (eve,) = answered(session, "eve")
    session.report_all([])
    removing = [False]

    def breaks(sql: str) -> bool:
        removing[0] = removing[0] or sql.startswith("UPDATE events")
        return removing[0] and sql.startswith(fails)

    with monkeypatch.context() as patch:
        patch.setattr(session._store, "_db", Failing(session._store._db, breaks))
        with pytest.raises(JournalError):
            eve.report("withdrew", id="asked")
        reasons = ("disk I/O error at the last attempt", "what a participant withdrew could not be removed yet")
        assert session.fault() in reasons
        with pytest.raises(JournalError):  # the page repeats its request
            eve.report("withdrew", id="asked")
    assert eve.report("withdrew", id="asked")["study"]["kind"] == "withdrew"
    assert b"words of eve" not in content(session.folder)
    assert session.fault() is None


def test_what_could_not_be_removed_is_tried_again_with_later_events(
    opened: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = opened(ALONE)
    (eve,), ann = answered(session, "eve"), Part(session, "ann")
    ann.come()
    with monkeypatch.context() as patch:
        patch.setattr(session._store, "_db", Failing(session._store._db, lambda sql: sql == "VACUUM"))
        with pytest.raises(JournalError):
            eve.report("withdrew")
    ann.onward()  # too early for another attempt
    assert session.fault() is not None
    monkeypatch.setattr(session, "_tried", session._tried - 60)
    ann.onward()
    assert session.fault() is None
    assert b"words of eve" not in content(session.folder)


@pytest.mark.usefixtures("no_figures")
def test_who_withdraws_after_the_end_did_not_complete_the_study(opened: Open) -> None:
    session = opened()
    answered(session, "ann", "eve", "cid")
    Part(session, "eve").report("withdrew")
    late = Part(session, "late")
    late.come()
    late.to("practice")
    late.report("withdrew")
    found = summarise(session.study, tables(session.study, session.folder / JOURNAL))
    assert {name: found["participants"][name] for name in ("enrolled", "completed", "withdrew")} == {
        "enrolled": 4, "completed": 2, "withdrew": 2,
    }  # fmt: skip
    flow = {row["stage"]: row for row in found["flow"]}
    assert {row["reached"] for row in found["flow"]} == {2}
    assert sum(row["withdrew"] for row in found["flow"]) == 2
    assert flow["thanks"] == {"stage": "thanks", "reached": 2, "left": 0, "there": 0, "withdrew": 1}
    assert flow["practice"]["withdrew"] == 1
    assert sum(row["begun"] for row in found["conditions"]) == 3
    assert sum(row["withdrew"] for row in found["conditions"]) == 1
    assert sum(row["left"] for row in found["conditions"]) == 0
    text = write_report(session.folder, session.folder / "elsewhere") and (session.folder / "elsewhere/report.md")
    assert "| withdrew; their data are removed | 2 |" in text.read_text()


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("how", thinned(["withdraw", "erase"]))
def test_a_report_that_is_being_written_has_nothing_of_who_withdraws_meanwhile(
    opened: Open, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    """Another process has read the journal already, and writes its files after those of before were removed."""
    session = opened(ALONE)
    for part in answered(session, "ann", "eve"):
        part.report("excluded", reason=f"words about {part.name}")
    calls = []

    def late(*arguments: Any, **more: Any) -> str:
        calls.append(arguments)
        if len(calls) == 1:
            Part(session, "eve").report("withdrew") if how == "withdraw" else session.erase("eve", "wrote a letter")
        return html_page(*arguments, **more)

    monkeypatch.setattr("assist.studies.reports.userstudy_report.html_page", late)
    write_report(session.folder, session.folder / REPORT)
    assert len(calls) == 2
    assert b"words about ann" in content(session.folder / REPORT)
    assert b"words about eve" not in content(session.folder)


def test_a_flood_of_withdrawals_leaves_others_their_turn_and_all_are_removed(
    opened: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each removal reads the whole journal; while others have their turn, a page is told to ask again."""
    session, now = opened(ALONE), [100.0]
    parts = answered(session, "P-EVE234", "P-EVE235", "P-EVE236", "P-ANN234")

    def ticks() -> float:
        now[0] += 4.0  # so that each removal is a long one
        return now[0]

    monkeypatch.setattr(session, "_clock", ticks)
    outcomes = session.report_all([Withdrew(person=part.name, id="asked") for part in parts[:3]])
    assert [isinstance(one, Refusal) for one in outcomes] == [False, True, True]
    assert b"words of P-EVE234" not in content(session.folder)
    assert session.fault() is not None
    with pytest.raises(Refusal):  # others have their turn
        parts[1].report("withdrew", id="asked")
    assert parts[3].kind == "thanks"
    for part in parts[1:3]:
        now[0] += 600.0
        part.report("withdrew", id="asked")
        assert f"words of {part.name}".encode() not in content(session.folder)
    assert session.fault() is None
    assert b"words of P-ANN234" in content(session.folder)


def test_withdrawals_that_wait_are_removed_when_the_study_is_opened(
    opened: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, now = opened(ALONE), [100.0]
    parts = answered(session, *(f"P-EVE{n}" for n in range(234, 238)))
    monkeypatch.setattr(session, "_clock", lambda: now.append(now[-1] + 4.0) or now[-1])
    session.report_all([Withdrew(person=part.name) for part in parts])
    assert b"words of P-EVE237" in content(session.folder)
    session.close()
    monkeypatch.setattr("assist.studies.userstudy.session.LONG", -1.0)
    session = opened(ALONE)
    assert b"words of P-EVE" not in content(session.folder)
