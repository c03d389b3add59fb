"""A live session keeps every acknowledged event, and no event takes effect that could not be recorded."""

from __future__ import annotations

import gc
import json
import shutil
import sqlite3
import threading
import tracemalloc
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pytest
from conftest import costly, kit
from hypothesis import example, given
from hypothesis import strategies as st
from sessions import DOUBTFUL, EASY, HAPPENS, SETTING, WRONG, all_of, happen
from test_unknown_goals import three_goals

from assist.declare import InapplicableError, Refusal
from assist.live import Acted, Assistant, Began, Event, Joined, JournalError, Paused, Session
from assist.live.desk import Desk
from assist.live.event_base import OfPerson, TeamEvent
from assist.live.events import kinds
from assist.live.lines import Line
from assist.live.live_setting import LiveSetting
from assist.live.live_task import LiveTask
from assist.live.store import stored
from assist.live.team import Team
from assist.person import ObservationModel, Policy, Robot, Setting
from assist.web.client import request_of
from planner import InputFileError, Table


@pytest.fixture
def opened(tiny: Table, fixed: Table, tmp_path: Path) -> Callable[..., Session]:
    """Open the session of this test's folder, after its last process ended."""
    held: list[Session] = []

    def open_it(file: Path = tmp_path / "journal.sqlite", **more: Any) -> Session:
        for session in held:
            session.close()
        held[:] = [Session({"tiny": tiny, "fixed": fixed}, file, **({"setting": SETTING, "population": EASY} | more))]
        return held[0]

    yield open_it
    for session in held:
        session.close()


TEAMS: dict[str, Setting] = {
    "one robot": Setting(c_suggest=0.02, c_move=0.01),
    "on its way": Setting(c_suggest=0.02, c_move=0.01, travel_time=1.0),
    "two robots": Setting(trust="paper", robots=(Robot(c_suggest=0.5), Robot(c_suggest=0, c_move=0, travel_time=1))),
    "doubt": Setting(c_suggest=0.0, c_move=0.0, c_ask=0.01, observation=ObservationModel(0.05, 0.1)),
}
ARRIVED = [("arrived", 0, 0), ("elapsed", 0, 0), ("paused", 0, 0), ("elapsed", 0, 0)]
LEFT = [("acted", 0, 0), ("acted", 0, 1), ("left", 0, 0), ("paused", 0, 0), ("joined", 0, 0)]  # a robot under way
ANSWERED = [("doubted", 0, 4), ("answered", 0, 1), ("alike", 0, 0), ("answered", 0, 1)]


@cache
def solved(name: str) -> Policy:
    """Return the task of a team, solved once for all sessions; where there is doubt, of which goal is unknown."""
    task = three_goals("tiny") if name == "doubt" else kit("tiny")
    return LiveTask(task, TEAMS[name].for_real_people(), EASY).policy


@costly(8, 60)
@given(st.sampled_from([*TEAMS]), st.data())
@example("two robots", (ARRIVED, []))
@example("on its way", ([("arrived", 1, 0), ("paused", 0, 0)], []))
@example("on its way", (LEFT, [("resumed", 0, 0)]))
@example("doubt", (ANSWERED, [("acted", 0, 0)]))
def test_a_session_that_goes_on_is_the_same_to_the_bit_and_who_is_erased_changes_nothing_for_the_others(
    tmp_path_factory: pytest.TempPathFactory, name: str, data: Any
) -> None:
    """States, beliefs and later decisions are those of a session in which the person has left."""
    folder = tmp_path_factory.mktemp("sessions")
    some = DOUBTFUL if name == "doubt" else HAPPENS
    events, more = data if isinstance(data, tuple) else (data.draw(some), data.draw(some))

    def opened(file: str) -> Session:
        return Session(solved(name), folder / file, setting=TEAMS[name], population=EASY, clock=lambda: 0.0)

    session = opened("left.sqlite")
    for person in "abc":
        session.join(person)
    happen(session, events)
    before = all_of(session)
    session.close()
    session = opened("left.sqlite")
    assert all_of(session) == before
    if "b" in session.people:
        session.leave("b")
    session.close()
    shutil.copy(folder / "left.sqlite", folder / "erased.sqlite")
    left, erased = opened("left.sqlite"), opened("erased.sqlite")
    erased.erase("b", "as asked")
    for step in ([], [event for event in more if event[1] != 1]):
        found = []
        for session in (left, erased):
            happen(session, step, "later ")
            views = [session.entry(name) for name in session.people]
            rows = [row for row in session.log() if row["person"] != "b"]
            found.append((views, rows, session.recommend(), session.beliefs()))
        assert found[0] == found[1]
        erased.close()
        erased = opened("erased.sqlite")
        assert [erased.entry(name) for name in erased.people] == found[1][0]
        assert erased.beliefs() == found[1][3]
    assert all(row["person"] != "b" for row in erased.log())
    left.close()
    erased.close()


def test_the_same_id_is_answered_as_the_first_and_happens_once(opened: Callable[..., Session]) -> None:
    session = opened()
    session.join("ann", id="come")
    first = session.observe("ann", "(fetch box-a)", id="1")
    session.observe("ann", WRONG, id="2")
    assert session.observe("ann", "(fetch box-a)", id="1") == first
    together = [Acted(person="ann", action="(return box-a)", id="3")] * 2
    answers = session.report_all(together)
    assert answers[0] == answers[1]
    session = opened()
    assert session.observe("ann", "(fetch box-a)", id="1") == first
    assert session.report_all(together) == answers
    assert len(session.log()) == 3
    for other in (lambda: session.undo("ann", id="1"), lambda: session.observe("ann", WRONG, id="1")):
        with pytest.raises(InapplicableError, match="the id '1' belongs to another event; expected a new id"):
            other()
    session.join("bob", id="1")
    with pytest.raises(Refusal, match="task '': expected one of tiny, fixed"):
        session.join("eve", "")
    session.pause()
    assert session.report(Paused(paused=False, id="1"))["suggestion"] == session.outlook().robots[0].suggestion
    assert not session.outlook().paused


def test_what_changed_nothing_under_an_id_changes_nothing_when_it_is_repeated(opened: Callable[..., Session]) -> None:
    """The answer to a second pause is lost, and suggestions are resumed before the request is sent again."""
    session = opened()
    session.join("ann")
    session.pause()
    again = Paused(paused=True, id="1")
    session.report(again)
    session.pause(False)
    for _ in range(2):
        before = session.outlook()
        assert session.report_all([again, again]) == [before.robots[0].as_dict()] * 2
        assert session.outlook() == before
        with pytest.raises(InapplicableError, match="the id '1' belongs to another event"):
            session.report(Paused(paused=False, id="1"))
        session = opened()
    assert not session.outlook().paused


def test_a_report_is_the_same_in_any_order_of_its_likelihoods(opened: Callable[..., Session]) -> None:
    session = opened(setting=replace(SETTING, observation=ObservationModel(miss=0.1)))
    session.join("ann")
    known = {"(fetch box-a)": 0.9, "(fetch box-b)": 0.1}
    first = session.observe("ann", likelihoods=known, id="1")
    assert session.observe("ann", likelihoods=dict(reversed(known.items())), id="1") == first
    with pytest.raises(InapplicableError, match="the id '1' belongs to another event"):
        session.observe("ann", likelihoods={**known, "(fetch box-b)": 0.2}, id="1")


def test_a_view_counts_the_events_of_a_kind_with_a_line_until_they_are_taken_back(
    opened: Callable[..., Session],
) -> None:
    class Rested(OfPerson):
        kind: Literal["rested"] = "rested"
        reversible: ClassVar[bool] = True
        line: ClassVar[Line | None] = Line(operator="Breaks: {value}")

        def change(self, desk: Any, time: float) -> None: ...
        def take_back(self, desk: Any) -> None: ...

    session = opened()
    session.join("ann")
    session.observe("ann", "(fetch box-a)")
    assert "done" not in session.person("ann"), "actions have a number of their own"
    session.report(Rested(person="ann"))
    assert session.report(Rested(person="ann"))["done"] == {"rested": 2}
    session.undo("ann", of="rested")
    assert session.entry("ann")["done"] == {"rested": 1}
    session.begin("ann")
    assert "done" not in session.person("ann"), "they belong to a task"


def test_old_answers_and_old_tasks_are_those_of_before(opened: Callable[..., Session]) -> None:
    """The answers are compared with a list of all acknowledged events, before and after the session is resumed."""
    ticks = iter(range(10**6))
    session = opened(clock=lambda: next(ticks))
    rng, log, answers = np.random.default_rng(5), dict[tuple[str, int], list[dict[str, Any]]](), dict[Event, Any]()
    episode, tasks = {"ann": 1, "bob": 1}, {"ann": "tiny", "bob": "fixed"}
    for name, task in tasks.items():
        session.join(name, task)
    for number in range(60):
        name = ("ann", "bob")[number % 2]
        seen, rows = session.person(name), log.setdefault((name, episode[name]), [])
        kind, task, action = "acted", None, None
        if seen["finished"] or rng.random() < 0.1:
            kind, task = "began", ("tiny", "fixed", None)[int(rng.integers(3))]
            tasks[name] = task or tasks[name]
            episode[name] += 1
        elif rng.random() < 0.3:
            kind = "undone"
        else:
            action = seen["suggestion"] or seen["applicable"][int(rng.integers(len(seen["applicable"])))]
        fields = {"acted": {"action": action}, "began": {"task": task}}.get(kind, {})
        event = kinds(TeamEvent)[kind](person=name, id=str(number), **fields)
        (answers[event],) = session.report_all([event])
        if kind == "undone":
            assert isinstance(answers[event], InapplicableError) == (not rows), "nobody goes back into an old task"
            del rows[-1:]
        if kind == "acted":
            time = session.outlook().log[-1]["time"]
            rows.append({
                "person": name, "episode": str(episode[name]), "step": len(rows), "action": action,
                "suggestion": seen["suggestion"], "task": tasks[name], "time": time,
                    "place": list(tasks).index(name), "order": session.outlook().seq,
                    "since": 1 + list(tasks).index(name),
            })  # fmt: skip
    expected = [row for name in episode for e in range(1, episode[name] + 1) for row in log.get((name, e), [])]
    assert max(episode.values()) > 5
    assert any(row["suggestion"] for row in expected)
    for kept in session, opened():
        assert kept.log() == expected
        assert kept.log("fixed") == [row for row in expected if row["task"] == "fixed"]
        for event, answer in answers.items():
            if not isinstance(answer, Exception):
                assert kept.report(event) == answer


@pytest.mark.slow
def test_a_long_session_takes_no_more_memory(opened: Callable[..., Session]) -> None:
    """The session may take about 40 bytes for each event, besides numpy's own buffers."""
    session = opened(policy="none")
    session.join("ann")
    way = ["(fetch box-a)", "(return box-a)"] * 3

    def many(first: int, last: int) -> int:
        """Repeat the actions many times; return the bytes in use afterwards."""
        events = []
        for number in range(first, last):
            events += [Acted(person="ann", action=action, id=f"{number}-{step}") for step, action in enumerate(way)]
            events.append(Began(person="ann", task="tiny", id=str(number)))
        assert not any(isinstance(outcome, Exception) for outcome in session.report_all(events))
        del events
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    many(0, 20)
    tracemalloc.start()
    try:
        before, after = many(20, 50), many(50, 130)
    finally:
        tracemalloc.stop()
    assert after - before < 150 * 80 * (len(way) + 1)


@pytest.mark.parametrize("room", [0, 2])
def test_a_full_disk_is_said_and_nothing_half_remains(
    opened: Callable[..., Session], tmp_path: Path, room: int
) -> None:
    """SQLite's limit on pages has the effect of a full disk."""
    session = opened()
    session.join("ann")
    session.join("bob")
    session.observe("ann", "(fetch box-a)", id="1")
    before, content, db = all_of(session), stored(tmp_path / "journal.sqlite"), session._store._db
    pages = db.execute("PRAGMA page_count").fetchone()[0]
    db.execute(f"PRAGMA max_page_count={pages + room}")
    events = [
        Acted(person="ann", action=WRONG),
        Acted(person="bob", action="(fetch box-b)"),
        Acted(person="bob", action="(fly)"),
    ]
    events += [Began(person="bob", id=f"{number:060}") for number in range(60)]
    for _ in range(2):
        answers = session.report_all(events)
        assert [type(answer) for answer in answers][:2] == [JournalError] * 2
        assert "No space left on device" in str(answers[0])
        assert stored(tmp_path / "journal.sqlite") == content
        assert all_of(session) == before
        assert session.observe("ann", "(fetch box-a)", id="1")["steps"] == 1  # it has happened, and is answered
    db.execute("PRAGMA max_page_count=100000")
    assert session.observe("ann", WRONG)["steps"] == 2
    after = all_of(session)
    assert all_of(opened()) == after


def test_clocks_that_jump_change_nothing_but_times(opened: Callable[..., Session], tmp_path: Path) -> None:
    found = []
    for number, jumps in enumerate(([0.0] * 9, [0.0, 1e9, 5.0, -1e9, 2.0, 2.0, 1e12, 0.0, 3.0])):
        clock = iter([*jumps, *[7.0] * 99])
        session = opened(tmp_path / f"{number}.jsonl", clock=lambda clock=clock: next(clock))
        for name in ("ann", "bob"):
            session.join(name)
        for action in ("(fetch box-a)", WRONG):
            session.observe("ann", action)
        found.append((session.beliefs(), session.recommend(), session.person("ann")))
    assert found[0] == found[1]


def test_a_suggestion_that_came_too_late_was_not_heard(opened: Callable[..., Session]) -> None:
    session = opened()
    session.join("ann")
    seen = session.observe("ann", "(fetch box-a)")
    seen = session.observe("ann", WRONG)
    assert seen["suggestion"] == "(remove hammer slot-2 box-a)"
    session.observe("ann", seen["suggestion"], seq=seen["seq"] - 1)
    assert session.log()[-1]["suggestion"] is None
    assert session.undo("ann")["suggestion"] == seen["suggestion"]
    assert session.person("ann")["reason"] == seen["reason"]
    with pytest.raises(InapplicableError, match="followed is true and the action"):
        session.observe("ann", "(return box-a)", followed=True)
    for followed, late, answered in ((True, 0, True), (True, 1, True), (False, 0, True), (False, 1, False)):
        action, now = seen["suggestion"] if followed else "(return box-a)", session.person("ann")["seq"]
        session.observe("ann", action, followed=followed, seq=now - late)
        assert session.log()[-1]["suggestion"] == (seen["suggestion"] if answered else None)
        session.undo("ann")


def test_whoever_waits_is_served_when_time_elapses(opened: Callable[..., Session]) -> None:
    """The robot acts once at each decision; without actions of people there is none, unless time elapses."""
    session = opened()
    names = ["ann", "bob", "cleo"]
    session.report_all([Joined(person=name) for name in names])
    session.pause()
    for name in names:
        for action in ("(fetch box-a)", WRONG):
            session.observe(name, action)
    assert session.recommend().person is None
    session.pause(False)
    served = [session.recommend().person]
    for _ in range(2):
        session.elapse()
        served.append(session.recommend().person)
    assert sorted(served) == names
    session.elapse()  # no person is left to be served, which is recorded once
    count = session.outlook().seq
    session.elapse()
    assert session.outlook().seq == count


def test_only_one_process_has_it_and_only_with_the_same_tasks_and_settings(
    opened: Callable[..., Session], tiny: Table, fixed: Table, tmp_path: Path
) -> None:
    session = opened()
    file = tmp_path / "journal.sqlite"
    with pytest.raises(InputFileError, match="in use by a running session"):
        Session(fixed, file)
    session.join("ann")
    session.close()
    before, other = r"the session there is of the task tiny \(\S+tiny\.pddl\)", r"paper-fixed\.pddl\)"
    with pytest.raises(InputFileError, match=rf"{before}, .*not other \(\S+{other}; expected the same, or another"):
        Session({"other": fixed}, file, setting=SETTING, population=EASY)
    with pytest.raises(InputFileError, match=rf"{before}, fixed \(\S+{other}, not tiny \(\S+\); expected the same"):
        Session({"tiny": tiny}, file, setting=SETTING, population=EASY)
    with pytest.raises(InputFileError, match=r"has population beta \S+ \S+, not \[0\.1, 9\.0\]; expected the same"):
        opened(population=replace(EASY, beta=(0.1, 9.0)))
    with pytest.raises(InputFileError, match=r"has setting c_suggest 0\.02, not 1\.0"):
        opened(setting=Setting())
    with pytest.raises(InputFileError, match=r"not 1\.0; setting c_move .*; setting trust paper, not constant; exp"):
        opened(setting=Setting())
    with closing(sqlite3.connect(file)) as db, db:
        db.execute("""UPDATE header SET document = json_set(document, '$.tasks.tiny', 'another')""")
    with pytest.raises(InputFileError, match=r"the task tiny is another than when the session began; expected the"):
        opened()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (b"UPDATE events SET record = 'half a li' WHERE n = 1", "event 1 cannot have happened: 'half a li': expected"),
        (b"UPDATE events SET record = '{}' WHERE n = 1", "event 1 cannot have happened"),
        (b"DELETE FROM events WHERE n = 1", "event 1 cannot have happened: event 2; expected 1"),
        (b"DROP TABLE events", "event 1 cannot have happened"),
        (b"not a database, but something longer than SQLite's header of one hundred bytes" * 9, "is damaged"),
    ],
)
def test_a_damaged_database_is_refused(
    opened: Callable[..., Session], tmp_path: Path, change: bytes, message: str
) -> None:
    session, file = opened(), tmp_path / "journal.sqlite"
    session.join("ann")
    session.observe("ann", "(fetch box-a)")
    session.close()
    if change.startswith(b"not"):
        file.write_bytes(change)
    else:
        with closing(sqlite3.connect(file)) as db, db:
            db.execute(change.decode())
    if b"DROP" in change:
        assert opened().people == ()
        return
    with pytest.raises(InputFileError, match=message):
        opened()


IMPOSSIBLE: list[tuple[str, Any]] = [
    ("event.kind", "flew"), ("event.kind", None), ("time", "soon"), ("event.id", [1]), ("event.person", None),
    ("event.action", "(fly)"), ("event.action", None), ("step", True), ("n", 9), ("more", 1), ("advices", {}),
    ("event.of", "acted"),
    ("advices", [{"person": None, "suggestion": "(return box-a)", "reason": None, "arrived": True}]),
    ("advices", [{"person": "ann", "suggestion": None, "reason": {"saving": "a lot"}, "arrived": True}]),
]  # fmt: skip


def test_a_journal_with_what_cannot_have_happened_is_refused_with_its_event(
    opened: Callable[..., Session], tmp_path: Path
) -> None:
    session = opened()
    session.join("ann", id="come")
    session.observe("ann", "(fetch box-a)", id="1")
    session.close()
    file = tmp_path / "journal.sqlite"
    with closing(sqlite3.connect(file)) as db:
        (right,) = db.execute("SELECT record FROM events WHERE n = 2").fetchone()
    for place, value in IMPOSSIBLE:
        changed = "json_remove(?, ?)" if value is None else "json_set(?, ?, json(?))"
        given = right, f"$.{place}", *(() if value is None else (json.dumps(value),))
        with closing(sqlite3.connect(file)) as db, db:
            db.execute(f"UPDATE events SET record = {changed} WHERE n = 2", given)
            kept = db.execute("SELECT * FROM events").fetchall()
        with pytest.raises(InputFileError, match=r"journal\.sqlite: event 2 cannot have happened: ") as error:
            opened()
        assert "\n" not in str(error.value)
        with closing(sqlite3.connect(file)) as db:
            assert db.execute("SELECT * FROM events").fetchall() == kept, (place, value)


def test_a_folder_of_an_earlier_version_is_refused_in_one_line_that_names_it(
    opened: Callable[..., Session], tmp_path: Path
) -> None:
    opened().close()
    with closing(sqlite3.connect(tmp_path / "journal.sqlite")) as db, db:
        db.execute(
            """UPDATE header SET document =
            json_remove(json_set(document, '$.format', 'kitassist session 1'), '$.version')"""
        )
    with pytest.raises(InputFileError, match=r"recorded by kitassist 1\.0, and only that version reads it") as error:
        opened()
    assert "\n" not in str(error.value)


def test_many_threads_report_and_everything_happens_once(opened: Callable[..., Session], tmp_path: Path) -> None:
    session = opened()
    names = [f"p{number}" for number in range(8)]
    session.report_all([Joined(person=name) for name in names])

    def work(name: str) -> None:
        for number in range(10):
            session.observe(name, "(fetch box-a)" if number % 2 == 0 else "(return box-a)", id=str(number))

    threads = [threading.Thread(target=work, args=(name,)) for name in names]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [session.person(name)["steps"] for name in names] == [10] * 8
    assert len(stored(tmp_path / "journal.sqlite")[1]) == 8 + 80


def test_a_folder_of_the_first_version_is_refused(opened: Callable[..., Session], tmp_path: Path) -> None:
    (tmp_path / "journal.jsonl").write_text("{}\n")
    with pytest.raises(InputFileError, match=r"journal\.jsonl: was recorded by kitassist 1\.0, and only that version"):
        opened()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["journal.jsonl"]


@pytest.mark.parametrize(
    ("place", "error"),
    [
        ("before the belief changes", MemoryError()),
        ("after it has changed", MemoryError()),
        ("while the view is made", MemoryError()),
        ("while the view is made", ValueError("shapes do not match")),  # which looks like a refusal
    ],
)
def test_a_fault_of_the_program_undoes_its_event_only(
    opened: Callable[..., Session], monkeypatch: pytest.MonkeyPatch, place: str, error: Exception
) -> None:
    """Of three events in a batch the second fails: the others are saved, and the session can be opened again."""
    session = opened()
    for name in ("ann", "bob", "cid"):
        session.join(name)
    whole: dict[str, Any] = {
        "before the belief changes": (Desk, "acted"),
        "after it has changed": (Desk, "recommend_all"),
        "while the view is made": (Team, "person"),
    }
    kind, method = whole[place]
    calls, work = [0], getattr(kind, method)

    def breaks(self: Any, *given: Any, **options: Any) -> Any:
        calls[0] += 1
        if calls[0] == 2:
            raise error
        return work(self, *given, **options)

    batch = [Acted(person=name, action="(fetch box-a)", id=name) for name in ("ann", "bob", "cid")]
    with monkeypatch.context() as patch:
        patch.setattr(kind, method, breaks)
        outcomes = session.report_all(batch)
    failed = [outcome is error for outcome in outcomes]
    if place == "after it has changed":  # a policy that fails stops nobody
        assert failed == [False, False, False]
    else:
        assert failed == [False, True, False]
    steps = {name: session.person(name)["steps"] for name in ("ann", "bob", "cid")}
    assert steps == {"ann": 1, "bob": int(not failed[1]), "cid": 1}
    before = all_of(session)
    again = opened()
    assert repr(again.beliefs()) in before
    assert {name: again.person(name)["steps"] for name in steps} == steps
    # The failed event can be reported again under its id; the others are not applied twice.
    assert all(isinstance(outcome, dict) for outcome in again.report_all(batch))
    assert {name: again.person(name)["steps"] for name in steps} == dict.fromkeys(steps, 1)


def test_an_interrupted_batch_leaves_nothing_unsaved(
    opened: Callable[..., Session], monkeypatch: pytest.MonkeyPatch
) -> None:
    session = opened()
    session.join("ann")

    def interrupted(*_: Any, **__: Any) -> Any:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(session._store, "add", interrupted)
        with pytest.raises(KeyboardInterrupt):
            session.observe("ann", "(fetch box-a)")
    session.pause(False)
    assert session.person("ann")["steps"] == 0
    session.observe("ann", "(fetch box-a)")
    assert opened().person("ann")["steps"] == 1


def test_what_time_causes_is_due_also_after_a_restart(tiny: Table, tmp_path: Path) -> None:
    """The time in which a session does not run does not count, and an event begins the time anew."""
    clock, setting = [0.0], LiveSetting(c_suggest=0.02, c_move=0.01, tick=30.0)

    def opened() -> Session:
        return Session(tiny, tmp_path / "journal.sqlite", setting=setting, population=EASY, clock=lambda: clock[0])

    session = opened()
    session.join("ann")
    assert session.due() == ([], 30.0)
    clock[0] = 20.0
    session.join("bob")
    session.close()
    session, clock[0] = opened(), 29.0
    assert session.due() == ([], 21.0)
    clock[0] = 51.0
    (event,), _ = session.due()
    assert event.kind == "elapsed"
    session.report(event)
    assert session.due() == ([], 30.0)  # also if the robot did nothing new, of which nothing is recorded
    session.close()


def test_a_suggestion_that_is_open_again_is_answered_on_a_view_with_it(tiny: Table, tmp_path: Path) -> None:
    session = Session(tiny, tmp_path / "journal.sqlite", setting=SETTING, population=EASY)
    session.join("ann")
    first = session.person("ann")
    action = first["suggestion"]
    later = session.observe("ann", action)
    again = session.undo("ann")
    assert action is not None
    there = first["reason"] | {"moving": 0.0, "score": first["reason"]["saving"]}  # the robot has come
    assert (again["suggestion"], again["reason"]) == (action, there)
    assert later["seq"] < again["seq"]
    for seq, answered in ((again["seq"], action), (later["seq"], None)):
        session.observe("ann", action, seq=seq)
        assert session.log()[-1]["suggestion"] == answered
        session.undo("ann")
    session.close()


@pytest.mark.cases
def test_a_suggestion_may_be_followed_by_an_action_without_its_last_arguments(opened: Callable[..., Session]) -> None:
    session = opened()
    session.join("ann")
    assert session.observe("ann", "(fetch box-a)")["suggestion"] == "(place hammer slot-1 box-a)"
    with pytest.raises(InapplicableError, match="followed is true"):
        session.observe("ann", "(place hammer slot-2)", followed=True)
    session.observe("ann", "(place hammer slot-1)", followed=True)
    assert session.log()[-1]["suggestion"] == session.log()[-1]["action"] == "(place hammer slot-1 box-a)"


@pytest.mark.cases
def test_a_team_in_memory_takes_and_refuses_what_a_saved_session_does(
    opened: Callable[..., Session], tiny: Table
) -> None:
    """Whether a suggestion was heard or followed, the view on which somebody acted, and where a robot has arrived."""
    session, desk = opened(), Assistant(tiny, setting=SETTING, population=EASY)

    def both(tell: Callable[[Session | Assistant], Any]) -> None:
        tell(desk)
        desk.recommend()
        tell(session)

    both(lambda team: team.join("ann"))
    both(lambda team: team.observe("ann", "(fetch box-a)", seq=1))
    assert desk.person("ann").suggestion == session.person("ann")["suggestion"] is not None
    for refused in (
        {"seq": 3},
        {"action": "(return box-a)", "followed": True},
        {"followed": True, "heard": False},
        {"action": None, "missed": 0.1, "followed": True},
    ):
        told = []
        for team in (desk, session):
            with pytest.raises(Refusal) as error:
                team.observe("ann", **{"action": desk.person("ann").suggestion} | refused)
            told.append(str(error.value))
        assert told[0] == told[1]
    both(lambda team: team.observe("ann", WRONG, heard=False))
    assert session.beliefs()["ann"] == desk.person("ann").belief.tobytes()
    assert [row["suggestion"] for row in session.log()] == [row["suggestion"] for row in desk.log()]
    assert desk.log()[1]["suggestion"] is None
    both(lambda team: team.leave("ann"))
    both(lambda team: team.arrived("ann"))
    assert session.recommend() == desk.recommend()
    both(lambda team: team.join("bob"))
    for action in ("(fetch box-a)", WRONG):
        both(lambda team, action=action: team.observe("bob", action))
        assert session.recommend() == desk.recommend()
    assert session.person("bob")["suggestion"] == desk.person("bob").suggestion is not None
    heard = request_of(Acted(person="ann", action="(fetch box-a)", heard=False))
    assert heard[2] == {"action": "(fetch box-a)", "heard": False}
