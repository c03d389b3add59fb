"""What is learned about people is carried to later sessions, expires, and can be erased for good."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from conftest import kit
from serving import TINY

from assist.cli import main
from assist.declare import AbsentError
from assist.live import Assistant, Joined, PeopleStore, Session
from assist.people import Goals, Population
from assist.person.settings import Setting
from planner import InputFileError, Table, sweep_goals

SETTING = Setting(c_suggest=0.05)
WALK = ["(fetch box-b)", "(fetch box-a)", "(place hammer slot-1 box-a)"]


@pytest.fixture
def tiny() -> Table:
    return kit("tiny")


def work(task: Table, folder: Path, people: PeopleStore | None, *names: str, setting: Setting = SETTING) -> Session:
    """Return a session in which some people have acted."""
    session = Session(task, folder / "journal.sqlite", setting=setting, people=people)
    for name in names:
        session.join(name)
        for action in WALK:
            if action in session.person(name)["applicable"]:
                session.observe(name, action)
    return session


def test_a_later_session_begins_with_the_beliefs_that_were_saved(tiny: Table, tmp_path: Path) -> None:
    store = PeopleStore(tmp_path / "people.sqlite")
    first = work(tiny, tmp_path / "monday", store, "ann", "bob")
    first.leave("bob")
    assert store.names() == ["bob"]  # those who stay are saved at the end
    believed = first.beliefs()
    first.close()
    first.close()
    assert store.names() == ["ann", "bob"]
    second = Session(tiny, tmp_path / "tuesday" / "journal.sqlite", setting=SETTING, people=store)
    anew = Session(tiny, tmp_path / "other" / "journal.sqlite", setting=SETTING)
    for session in (second, anew):
        session.report_all([Joined(person="ann"), Joined(person="eve")])
    assert second.beliefs()["ann"] == believed["ann"] != anew.beliefs()["ann"]
    assert second.beliefs()["eve"] == anew.beliefs()["eve"]
    second.observe("ann", "(fetch box-a)")
    believed = second.beliefs()
    second.close()
    again = Session(tiny, tmp_path / "tuesday" / "journal.sqlite", setting=SETTING)  # without the store
    assert again.beliefs() == believed
    kept = PeopleStore(store.file).belief("ann", second._meaning)
    assert kept is not None
    assert kept.tobytes() == believed["ann"]
    assert store.belief("eve", second._meaning) is None  # nothing was observed of her
    again.close()
    anew.close()


def test_a_belief_is_saved_when_a_task_is_finished(tiny: Table, tmp_path: Path) -> None:
    store = PeopleStore(tmp_path / "people.sqlite")
    session = Session(tiny, tmp_path / "journal.sqlite", setting=SETTING, people=store)
    seen = session.join("ann")
    while not seen["finished"]:
        assert store.names() == []
        seen = session.observe("ann", seen["suggestion"] or seen["applicable"][0])
    assert store.names() == ["ann"]
    session.close()


def test_what_cannot_be_kept_takes_nothing_from_the_session(tiny: Table, tmp_path: Path) -> None:
    """The day on which the belief would expire is no date, so that it cannot be saved."""
    store = PeopleStore(tmp_path / "people.sqlite", now=lambda: datetime(9999, 12, 31, tzinfo=UTC))
    session, changed = Session(tiny, tmp_path / "journal.sqlite", setting=SETTING, people=store), list[set[str]]()
    session.changed = lambda people, _: changed.append(people)
    seen, events = session.join("ann"), 1
    while not seen["finished"]:
        seen, events = session.observe("ann", seen["suggestion"] or seen["applicable"][0]), events + 1
    assert changed == [{"ann"}] * events
    session.leave("ann")
    session.close()
    again = Session(tiny, tmp_path / "journal.sqlite", setting=SETTING)
    assert (again.outlook().seq, again.people) == (events + 1, ())
    again.close()


def test_beliefs_are_kept_for_up_to_a_hundred_years(tmp_path: Path) -> None:
    for days in (0, -1.0, 36_501, 1e9, float("nan")):
        with pytest.raises(ValueError, match=r"days .*: expected a number above 0 and up to 36,500"):
            PeopleStore(tmp_path / "people.sqlite", days)
    options = ["--set", f"people_store={tmp_path / 'people.sqlite'}", "--set", "keep_people=36501"]
    result = CliRunner().invoke(main, ["serve", str(TINY), "--humans", "1", *options])
    assert (result.exit_code, "keep_people" in result.stderr, "36500" in result.stderr) == (2, True, True)
    PeopleStore(tmp_path / "people.sqlite", 36_500).save("ann", "m", np.full((1, 2), 0.5))


def test_beliefs_with_another_meaning_are_not_used(tiny: Table, tmp_path: Path) -> None:
    store = PeopleStore(tmp_path / "people.sqlite")
    first = work(tiny, tmp_path / "monday", store, "ann")
    first.close()
    other = Session(tiny, tmp_path / "a.sqlite", setting=Setting(c_suggest=0.05, trust="outcome"), people=store)
    narrow = Session(tiny, tmp_path / "b.sqlite", setting=SETTING, population=Population(beta=(1, 2)), people=store)
    same = Session(tiny, tmp_path / "c.sqlite", setting=Setting(c_suggest=0.5), people=store)  # costs do not matter
    for session in (other, narrow, same):
        session.join("ann")
    assert other.beliefs()["ann"] != same.beliefs()["ann"]
    assert narrow.beliefs()["ann"] != same.beliefs()["ann"]
    for session in (other, narrow, same):
        session.close()


def test_erasing_removes_every_byte(tiny: Table, tmp_path: Path) -> None:
    store = PeopleStore(tmp_path / "people.sqlite")
    session = work(tiny, tmp_path / "monday", store, "Bartholomew", *(f"person-{n}" for n in range(9)))
    session.leave("Bartholomew")
    belief = store.belief("Bartholomew", session._meaning)
    assert belief is not None
    traces = [b"Bartholomew", belief.astype("<f8").tobytes()[:64]]

    def left() -> list[bool]:
        files = [file for file in tmp_path.rglob("*") if file.is_file()]
        return [any(trace in file.read_bytes() for file in files) for trace in traces]

    assert left()[0]
    session.erase("Bartholomew", "asked to")
    session.close()
    assert left() == [False, left()[1]]
    assert len(store.names()) == 9
    later = Session(tiny, tmp_path / "tuesday" / "journal.sqlite", setting=SETTING, people=store)
    assert later.erase("person-3", "asked to").events == 0  # who is in the store only
    assert "person-3" not in store.names()
    with pytest.raises(AbsentError):
        later.erase("person-3", "asked to")
    later.close()
    assert all(store.erase(name) for name in store.names())
    assert not store.erase("nobody")
    assert b"person-" not in store.file.read_bytes()


def test_beliefs_expire_for_good(tmp_path: Path) -> None:
    now = datetime(2026, 1, 1, tzinfo=UTC)
    store = PeopleStore(tmp_path / "people.sqlite", days=2, now=lambda: now)
    belief = np.full((2, 3), 1 / 6)
    store.save("ann", "m", belief)
    now += timedelta(days=1)
    store.save("bob", "m", belief)
    now += timedelta(days=1)
    assert store.belief("ann", "m") is None
    assert store.names() == ["bob"]
    assert b"ann" not in store.file.read_bytes()
    found = store.belief("bob", "m")
    assert found is not None
    assert (found == belief).all()
    now += timedelta(days=1)
    PeopleStore(store.file, now=lambda: now)
    assert b"bob" not in store.file.read_bytes()


def test_a_store_is_its_owners_and_leaves_out_who_is_simulated(tmp_path: Path) -> None:
    store = PeopleStore(tmp_path / "people.sqlite", except_for=["simulated-1"])
    store.save("simulated-1", "m", np.full((1, 2), 0.5))
    assert store.names() == []
    assert store.file.stat().st_mode & 0o777 == 0o600
    (other := tmp_path / "other").write_text("no database " * 100)
    with pytest.raises(InputFileError, match="is no store of people"):
        PeopleStore(other)
    result = CliRunner().invoke(main, ["serve", str(TINY), "--humans", "1", "--set", f"people_store={other}"])
    assert result.exit_code == 2
    assert "is no store of people" in " ".join(result.stderr.split())


def test_a_belief_with_which_a_person_joins_is_checked_and_saved(tiny: Table) -> None:
    team = Assistant(tiny, ["bob"], setting=SETTING)
    team.observe("bob", "(fetch box-b)")
    belief = team.person("bob").belief
    team.join("ann", belief=belief)
    assert (team.person("ann").belief == belief).all()
    again = Assistant.from_json(team.to_json(), tiny)
    assert (again.person("ann").belief == belief).all()
    for wrong in (belief * 2, belief[:1], -belief, np.full_like(belief, np.nan)):
        with pytest.raises(ValueError, match=r"with the sum 1|belief.* nan: expected"):
            team.join("eve", belief=wrong)


def test_what_is_carried_says_nothing_about_the_goal_of_the_next_task(tiny: Table) -> None:
    task = tiny.task
    open_facts = tuple((variable, value) for variable, value in task.goal if task.initial[variable] != value)
    every, some = sweep_goals([task, replace(task, goal=open_facts[:1])])
    goals = Goals({"all": every, "some": some}, {"all": 0.75, "some": 0.25})
    alone = np.random.default_rng(0).dirichlet(np.ones(60)).reshape(6, 10)
    team = Assistant(goals, setting=SETTING)
    team.join("ann", belief=alone)
    found = team.person("ann")
    np.testing.assert_allclose(found.belief.reshape(2, 6, 10), [0.75 * alone, 0.25 * alone])
