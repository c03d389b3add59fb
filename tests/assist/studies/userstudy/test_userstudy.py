"""User studies: their files, the assignment of participants, and the data after a kill."""

from __future__ import annotations

import json
import shutil
import sqlite3
import tomllib
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from dataclasses import fields, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from conftest import KITTING, ROOT
from hypothesis import given, settings
from hypothesis import strategies as st
from userstudies import ALONE, PLAN, SCORES, Open, Part, opened, written

from assist.declare import InapplicableError
from assist.live.events import kinds
from assist.live.store import stored
from assist.people.user_code import UserChoiceModel
from assist.studies.reports.userstudy_summary import summarise
from assist.studies.userstudy import Cohort, StudySession, events, read
from assist.studies.userstudy.assignment import balanced_orders
from assist.studies.userstudy.events import StudyEvent
from assist.studies.userstudy.plan_file import FileTable
from assist.studies.userstudy.session import JOURNAL
from assist.studies.userstudy.tables import tables
from planner import InputFileError, Instance, Table

__all__ = ["opened"]


FAULTS = [
    ("[setting]", "[setting]\neta = 0.5", "setting: eta 0.5 has no effect without trust 'paper'; expected 0.2"),
    ('reference = "none"', 'reference = "nobody"', "reference: 'nobody'; expected one of none, attention"),
    ('policy = "attention"', 'policy = "attentive"', r"conditions\[2\].policy: 'attentive'; did you mean 'attention'"),
    ("c_move = 0.01", "c_mov = 0.01", "setting.c_mov: unknown; did you mean 'c_move'"),
    ("c_move = 0.01", "ask_error = 0.1", "setting.ask_error: 0.1; expected 0, as nothing is asked"),
    ("c_move = 0.01", "travel_time = 1", "setting.travel_time: 1; expected 0"),
    ('form = "likert"', 'form = "likart"', r"questionnaires\[2\].form: 'likart'; did you mean 'likert'"),
    ("reversed = true", "reversd = true", r"questionnaires\[2\].items\[2\].reversd: unknown"),
    ('name = "wary"', 'name = "rely"', r"questionnaires\[2\].items\[2\].name: 'rely'; expected a unique name"),
    ("seed = 3", "seed = ", r"not TOML \(column 8: Invalid value\)"),
    ('name = "attention"', 'name = "none"', r"conditions\[2\].name: there are two conditions 'none'"),
    ('practice = "', 'practice = "x', "practice: .*no such file"),
    ("seed = 3", 'withdraw_until = "soon"', 'withdraw_until: "soon"; expected a date such as 2027-03-31'),
    ("seed = 3", "population = {beta = [2, 1]}", r"population.beta: \[2, 1\]; expected two numbers"),
    (
        "seed = 3",
        'population = {file = "p.json"}',
        "population.file: given; expected the ranges in it",
    ),
    ("seed = 3", "population = {weights = {back = [0, 1]}}", "population: weights without theta; expected theta"),
    ("c_move = 0.01", "execute = true", "setting.execute: true; expected a robot that suggests"),
    ('policy = "attention"', 'policy = "own.py:mine"', r"conditions\[2\].policy: .*own.py: no such file"),
    ('name = "trust"', 'name = "1st"', r"questionnaires\[2\].name: '1st'; expected a letter"),
    ('name = "trust"', 'name = "nasa-tlx"', r"questionnaires\[2\].name: there are two questionnaires 'nasa-tlx'"),
    ('form = "likert"', 'form = "nasa-tlx"', r"questionnaires\[2\].items: the form nasa-tlx has fixed items"),
    ('form = "nasa-tlx"', 'form = "text"\nname = "more"', r"questionnaires\[1\]: items: is missing"),
    (
        '/tiny.pddl"]',
        '/tiny.pddl", "kitting/tiny"]',
        "tasks: .*/tiny.pddl and kitting/tiny have the same file name; expected different names",
    ),
    ('/tiny.pddl"]', '"]', r"tasks\[1\]: '.*kitting' matches [1-9]\d+ problems; expected the file of one"),
    ("consent =", "thanks =", r"consent: is missing; expected a text"),
]
"""A part of the plan, what stands there instead, and what is said of it."""
BEGINS = {"].items": "items = [\n", "]: items": "[[questionnaires]]", "consent": "title"}
"""Where in the plan that begins of which something is said, if it is not the part."""


@pytest.mark.parametrize(("right", "wrong", "message"), FAULTS)
def test_what_is_wrong_with_a_file_is_said_with_its_line(tmp_path: Path, right: str, wrong: str, message: str) -> None:
    file = written(tmp_path / "study.toml", PLAN.replace(right, wrong, 1))
    begins = next((where for part, where in BEGINS.items() if part in message), right)
    line = PLAN[: PLAN.index(begins)].count("\n") + 1
    with pytest.raises(InputFileError, match=f"study.toml:{line}: {message}") as refused:
        read(file)
    assert "\n" not in str(refused.value)


def test_a_task_that_comes_with_the_package_is_found_by_its_name(tmp_path: Path) -> None:
    study = read(written(tmp_path / "study.toml", PLAN.replace(f"{KITTING}/tiny.pddl", "kitting/tiny")))
    assert study.tasks == (("tiny", Instance(KITTING / "tiny.pddl", KITTING / "domain.pddl")),)


def test_people_may_choose_by_a_model_of_ones_own(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("def choose(choices, q, beta):\n    return -q\n")
    file = written(tmp_path / "study.toml", f'population = {{chooses = "own.py:choose", beta = [1, 2]}}\n{PLAN}')
    parts = read(file).population.parts
    assert {(part.chooses, part.beta) for part in parts} == {(parts[0].chooses, (1.0, 2.0))}
    assert isinstance(parts[0].chooses, UserChoiceModel)
    (tmp_path / "data").mkdir()
    copy = written(tmp_path / "data" / "study.toml", file.read_text())
    with pytest.raises(InputFileError, match=r"own\.py: no such file"):
        read(copy)
    assert read(copy, carried_out=True).population.beta == (1.0, 2.0)  # for the report


KINDS = ["visited"] * 2 + ["onward"] * 12 + ["withdrew", "left", "left", "returned"]
HAPPENS = st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, 9)), min_size=100, max_size=200)
PLACES = 7
ORDER = ["d", "c", "attention", "none", "none", "attention", "c"]


@pytest.fixture(scope="module")
def cohort_of(tiny: Table, tmp_path_factory: pytest.TempPathFactory) -> Callable[[bool], Cohort]:
    """Return a function that makes an empty cohort of four conditions, in which dropouts are replaced or not."""
    folder = tmp_path_factory.mktemp("study")
    four = PLAN + "".join(f'[[conditions]]\nname = "{name}"\npolicy = "none"\n' for name in ("c", "d"))
    four = four.replace("seed = 3", f"seed = 3\nparticipants = {PLACES}", 1).replace("simulated = 2", "simulated = 0")
    study, tasks = read(written(folder / "study.toml", four)), {"tiny": tiny, "practice": tiny}
    session = StudySession(study, tasks, folder / "data")
    session.close()
    return lambda again: Cohort(replace(study, replace=again), tasks, session._team_of)


@settings(max_examples=30, deadline=None)
@given(HAPPENS, st.booleans())
@pytest.mark.slow
def test_conditions_stay_balanced_whoever_comes_and_goes(
    cohort_of: Callable[[bool], Cohort], events: list[tuple[str, int]], replaced: bool
) -> None:
    cohort = cohort_of(replaced)
    given_to: list[str] = []
    for number, (kind, who) in enumerate(events):
        person = cohort.participants.get(f"p{who}")
        stage = None if person is None else cohort.stages[person.at]
        if kind == "onward" and person is not None and stage is not None and stage.kind in ("practice", "task"):
            person.expired = True  # instead of their actions there
        answers = SCORES.get(stage.what) if stage and stage.kind == "questionnaire" else None
        before = {
            name: sum(
                one.condition == name and (one.status in ("here", "done") or not replaced)
                for one in cohort.participants.values()
            )
            for name in ("none", "attention", "c", "d")
        }
        more = {"stage": stage.name if stage else "none", "answers": answers} if kind == "onward" else {}
        event = kinds(StudyEvent)[kind](person=f"p{who}", **more)
        try:
            record = cohort.happen(event, float(number))
        except ValueError:
            continue
        if record is not None and record.condition is not None:
            given_to.append(record.condition)
            assert before[record.condition] == min(before.values())
        taken = [
            one
            for one in cohort.participants.values()
            if one.status in ("here", "done") or (one.condition and not replaced)
        ]
        assert len(taken) <= PLACES
        if not replaced:
            counts = Counter(dict.fromkeys(before, 0)) + Counter(given_to)
            assert max(counts.values(), default=0) - min((counts[name] for name in before), default=0) <= 1
    if not replaced:  # the order follows from the seed alone
        assert given_to == ORDER[: len(given_to)]


def copied(journal: Path) -> dict[str, bytes]:
    """Return the files of a database that a process has open."""
    return {file.name: file.read_bytes() for file in journal.parent.glob(f"{journal.name}*") if "shm" not in file.name}


def done_together(journal: Path) -> list[list[str]]:
    """Return the actions in the task of ann and the simulated people of her team."""
    records = [record for _, record in stored(journal)[1]]
    own = [one for one in records if (one["event"]["person"], one["event"].get("stage")) == ("ann", "task tiny")]
    acted = [[sub["event"] for sub in one["team"]] for one in own if one["event"]["kind"] == "acted"]
    return [[event.get("action", event["kind"]) for event in team] for team in acted]


def test_a_study_is_where_it_was_wherever_it_was_killed(opened: Open, tmp_path: Path) -> None:
    session = opened()
    seen: list[tuple[dict[str, bytes], dict[str, Any]]] = []
    ann, bob = Part(session, "ann"), Part(session, "bob")

    def look() -> None:
        views = {name: session.person(name) for name in session.people}
        seen.append(
            (copied(tmp_path / "data" / JOURNAL), {**views, "log": session.log(), "beliefs": session.beliefs()})
        )

    stages = [stage.name for stage in session.study.stages]
    reached = []
    for part in (ann, bob):
        part.come()
        while part.kind != "thanks":
            if part is ann:
                look()
            reached.append(part.stage)
            if part.kind in ("practice", "task"):
                part.errs()
                if part.kind == "task":
                    look()  # in the middle of it
                part.finish()
            part.onward()
    look()
    assert reached == stages[:-1] * 2
    assert session.log()
    assert set(session.beliefs()) == {"ann", "ann-1", "ann-2", "bob", "bob-1", "bob-2"}
    assert session.recommend().person is None
    session.close()
    for number, (journal, views) in enumerate(seen):
        folder = tmp_path / f"after-{number}"
        folder.mkdir()
        for name, content in journal.items():  # as after a kill, with a transaction that was never completed
            (folder / name).write_bytes(content + b"half a transaction" * name.endswith("-wal"))
        again = opened(folder=folder)
        found = {name: again.person(name) for name in again.people}
        assert {**found, "log": again.log(), "beliefs": again.beliefs()} == views
        if (mine := views.get("ann")) and mine["study"]["kind"] == "task" and mine["steps"] == 1:
            Part(again, "ann").finish()  # and simulated people continue as they would have
            assert done_together(folder / JOURNAL) == done_together(tmp_path / "data" / JOURNAL)
        again.close()
        shutil.rmtree(folder)


@pytest.mark.parametrize("count", [2, 3, 4, 5])
def test_orders_of_conditions_are_balanced(count: int) -> None:
    """Each condition is equally often at each position, and directly after each other one."""
    names = [f"condition {number}" for number in range(count)]
    orders = balanced_orders(names)
    assert all(sorted(order) == names for order in orders)
    places = Counter((place, name) for order in orders for place, name in enumerate(order))
    after = Counter(pair for order in orders for pair in pairwise(order))
    assert (len(places), len(after)) == (count * count, count * (count - 1))
    assert len(set(places.values())) == len(set(after.values())) == 1


def test_within_participants_all_conditions_are_compared(opened: Open) -> None:
    session = opened(PLAN.replace("seed = 3", 'seed = 3\ndesign = "within"'))
    parts = [Part(session, name) for name in ("ann", "bob", "cleo")]
    for number, part in enumerate(parts):
        part.come()
        part.to("task tiny 1")
        for _ in range(number):
            part.errs()
        part.to("task tiny 2")
        part.errs()
        part.to("thanks")
    assert [stage.name for stage in session.study.stages][3:] == [
        "task tiny 1", "questionnaire nasa-tlx 1", "questionnaire trust 1", "questionnaire remarks 1", "task tiny 2",
        "questionnaire nasa-tlx 2", "questionnaire trust 2", "questionnaire remarks 2", "thanks",
    ]  # fmt: skip
    drawn = [str(session.cohort.participants[part.name].condition) for part in parts]
    assert set(drawn[:2]) == {"none > attention", "attention > none"}
    found = tables(session.study, session.folder / JOURNAL)
    assert [(row["participant"], row["condition"], row["period"]) for row in found.tasks] == [
        (part.name, condition, number)
        for part, order in zip(parts, drawn, strict=True)
        for number, condition in enumerate(order.split(" > "), start=1)
    ]
    told = Counter(row["condition"] for row in found.actions if row["suggestion"] is not None)
    assert set(told) == {"attention"}  # the policy "none" makes no suggestion
    (_, log), *_ = found.logs()
    assert {(row["person"], row["episode"]) for row in map(json.loads, log.splitlines())} == {
        (part.name, episode) for part in parts for episode in ("1", "2")
    }
    assert [row["episode"] for row in session.log() if row["person"] == "ann"].count("2") == found.tasks[1]["actions"]

    summary = summarise(session.study, found)
    assert {one["condition"]: one["done"] for one in summary["conditions"]} == Counter(drawn)
    before = {name: session.person(name) for name in session.people}, session.log(), session.beliefs()
    session.close()
    again = opened(session.study.file.read_text())
    assert ({name: again.person(name) for name in again.people}, again.log(), again.beliefs()) == before


def test_a_journal_that_cannot_have_been_is_refused_with_its_event(opened: Open, tmp_path: Path) -> None:
    session = opened()
    ann = Part(session, "ann")
    ann.come()
    ann.to("questionnaire trust")
    session.close()
    lines = [json.dumps(record, separators=(",", ":")) for _, record in stored(tmp_path / "data" / JOURNAL)[1]]
    for number, (old, new) in enumerate([
        ('"kind":"onward"', '"kind":"onwards"'), ('"stage":"instructions"', '"stage":"thanks"'),
        ('"person":"ann"', '"person":"bob"'), ('"time":', '"time":"x","was":'), ('"action":"(', '"action":"(un'),
    ]):  # fmt: skip
        line = next(n for n, one in enumerate(lines) if old in one and n > 0)
        folder = tmp_path / f"broken-{number}"
        shutil.copytree(tmp_path / "data", folder)
        with closing(sqlite3.connect(folder / JOURNAL)) as db, db:
            broken = lines[line].replace(old, new, 1)
            db.execute("UPDATE events SET record = ? WHERE n = ?", (broken, line + 1))
        with pytest.raises(InputFileError, match=rf"journal.sqlite: event {line + 1} cannot have happened"):
            opened(folder=folder)


def test_tables_of_another_version_are_refused_in_one_line_that_names_it(opened: Open, tmp_path: Path) -> None:
    session = opened()
    study = session.study
    session.close()
    with closing(sqlite3.connect(tmp_path / "data" / JOURNAL)) as db, db:
        db.execute(
            """UPDATE header SET document =
            json_remove(json_set(document, '$.format', 'kitassist user study 1'), '$.version')"""
        )
    with pytest.raises(InputFileError, match=r"recorded by kitassist 1\.0, and only that version reads it"):
        tables(study, tmp_path / "data" / JOURNAL)


def test_what_cannot_be_is_refused_and_changes_nothing(opened: Open) -> None:
    session = opened(PLAN.replace("seed = 3", "seed = 3\nparticipants = 1"))
    ann = Part(session, "ann")
    first = ann.come()
    assert ann.report("visited", id="visit ann") == first  # a reload
    with pytest.raises(InapplicableError, match="study is full"):
        Part(session, "bob").come()
    before = session.person("ann")
    for kind, more, message in [
        ("onward", {"stage": "instructions"}, "ann is at consent, not at 'instructions'"),
        ("acted", {"action": "(fetch box-a)"}, "no action is possible there"),
        ("undone", {}, "not possible within a user study"),
        ("onward", {"stage": "consent", "answers": {"a": 1}}, "expected none at consent"),
    ]:
        with pytest.raises(ValueError, match=message):
            ann.report(kind, **more)
    assert session.person("ann") == before
    ann.to("practice")
    with pytest.raises(InapplicableError, match="the task is not finished"):
        ann.onward()
    ann.to("questionnaire nasa-tlx")
    for answers, message in [
        ({}, "answers.mental: expected a whole number from 0 to 100 in steps of 5"),
        ({**SCORES["nasa-tlx"], "effort": 42}, "answers.effort"),
        ({**SCORES["nasa-tlx"], "luck": 5}, "answers.luck: unknown"),
        ({**SCORES["nasa-tlx"], "effort": True}, "answers.effort"),
    ]:
        with pytest.raises(ValueError, match=message):
            ann.report("onward", stage="questionnaire nasa-tlx", answers=answers)


def test_data_can_be_withdrawn_until_the_studys_date_and_the_report_counts_everybody(
    opened: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who withdrew or was excluded is in no mean; the report says how many, and why."""
    session = opened(ALONE.replace("seed = 3", "seed = 3\nwithdraw_until = 2027-03-31"))
    parts = {name: Part(session, name) for name in ("ann", "bob", "cid", "dora", "eve", "fay")}
    for name, part in parts.items():
        part.come()
        if name not in ("eve", "fay"):
            part.to("thanks")
    parts["eve"].to("task tiny")
    for reason in ("", " "):
        with pytest.raises(ValueError, match=f"reason '{reason}': expected 1 to 200 characters"):
            parts["cid"].report("excluded", reason=reason)
    parts["cid"].report("excluded", reason="did another study")
    with pytest.raises(ValueError, match="reason: is missing"):
        parts["cid"].report("excluded")  # as a request with an empty body, which would have included them again
    parts["dora"].report("excluded", reason="by mistake")
    parts["dora"].report("excluded", reason=None)
    parts["fay"].report("withdrew")

    def it_is(now: datetime) -> None:
        clock = type("Clock", (datetime,), {"now": classmethod(lambda *_: now)})
        monkeypatch.setattr(events, "datetime", clock)

    it_is(datetime(2027, 3, 31, 23, 59, tzinfo=UTC))
    parts["ann"].report("withdrew")
    it_is(datetime(2027, 4, 1, 0, 1, tzinfo=UTC))
    with pytest.raises(InapplicableError, match="data could be withdrawn until 2027-03-31"):
        parts["bob"].report("withdrew")
    with pytest.raises(InapplicableError, match="the data of ann are not part of the analysis"):
        parts["ann"].report("excluded", reason="late")
    parts["eve"].report("withdrew")  # who takes part can leave at any time
    session.erase("cid", "wrote a letter")  # and the researchers can erase at any time
    parts["bob"].report("excluded", reason="did another study")
    found = tables(session.study, session.folder / JOURNAL)
    summary = summarise(session.study, found)
    assert summary["participants"] == {
        "planned": None,
        "enrolled": 6, "declined": 1, "full": 0, "randomised": 5, "completed": 2, "withdrew": 3, "gone": 0, "here": 0,
        "erased": 1, "excluded": {"did another study": 1}, "analysed": 1,
    }  # fmt: skip
    assert {row["participant"] for row in found.tasks} == {"bob", "dora"}  # what is excluded stays in the export
    assert [sum(cell["n"] for cell in one["cells"]) for one in summary["measures"]][:2] == [1, 1]
    assert [one["n"] for one in summary["questionnaires"]] == [1, 1]
    session.close()
    text = session.study.file.read_text()
    again = opened(text)
    assert again.cohort.participants["bob"].excluded == "did another study"
    assert again.cohort.participants["dora"].excluded is None


def test_who_leaves_before_the_task_gives_the_place_free_and_may_come_back(opened: Open) -> None:
    session = opened(PLAN.replace("seed = 3", "seed = 3\nparticipants = 1"))
    ann, bob = Part(session, "ann"), Part(session, "bob")
    ann.come()
    ann.to("practice")
    assert ann.report("left")["present"] is False
    bob.come()  # a place is free again
    assert ann.report("returned")["study"]["kind"] == "full"
    with pytest.raises(InapplicableError):
        ann.onward()
    assert bob.report("withdrew")["study"]["kind"] == "declined"
    assert ann.report("returned")["study"]["kind"] == "practice"
    ann.to("task tiny")
    ann.report("left")
    assert session.cohort.taken == 1  # whose task has begun keeps it
    with pytest.raises(InapplicableError):
        Part(session, "cleo").come()
    ann.finish()  # finishing a task readmits her
    assert session.person("ann")["present"]
    assert session.person("ann")["study"]["over"]
    assert session.cohort.participants["ann"].status == "here"


def test_an_expired_or_impossible_task_is_over(opened: Open) -> None:
    session = opened()
    ann = Part(session, "ann")
    ann.come()
    ann.to("task tiny")
    assert ann.report("expired")["study"]["over"]
    assert session.person("ann")["applicable"] == []
    with pytest.raises(InapplicableError, match="this task is over"):
        ann.report("acted", action="(fetch box-a)")
    ann.onward()
    assert ann.stage == "questionnaire nasa-tlx"


def test_conditions_may_differ_in_any_setting_and_in_what_is_explained(opened: Open) -> None:
    text = PLAN.replace('policy = "none"', 'policy = "attention"\nsetting = { c_suggest = 50 }\nreasons = true')
    told = text.replace('name = "attention"', 'name = "attention"\nreasons = true', 1)
    session = opened(told)
    assert [one.setting.c_suggest for one in session.study.conditions] == [50, 0.02]
    assert {one.setting.c_move for one in session.study.conditions} == {0.01}  # as in the study
    parts = [Part(session, name) for name in ("ann", "bob")]
    seen = {}
    for part in parts:
        part.come()
        part.to("task tiny")
        part.errs()
        seen[session.cohort.participants[part.name].condition] = session.person(part.name)
    assert seen["none"]["suggestion"] is None  # it costs more than it saves
    assert seen["attention"]["suggestion"] is not None
    assert (seen["attention"]["reason"] is not None, seen["attention"]["explained"]) == (True, True)
    before = {part.name: session.person(part.name) for part in parts}
    session.close()
    again = opened(told)
    assert {name: again.person(name) for name in before} == before
    again.close()
    wrong = "setting = { c_sugest = 50 }"
    with pytest.raises(InputFileError, match=r"conditions\[1\].setting.c_sugest: unknown; did you mean 'c_suggest'"):
        opened(text.replace("setting = { c_suggest = 50 }", wrong))


def test_simulated_people_act_in_step_and_share_the_robot(opened: Open) -> None:
    session = opened(PLAN.replace('policy = "none"', 'policy = "reactive"'))
    ann = Part(session, "ann")
    ann.come()
    ann.to("task tiny")
    for _ in range(4):
        ann.errs()
    lines = [record for _, record in stored(session.folder / JOURNAL)[1]]
    acted = [line for line in lines if line["event"]["kind"] == "acted" and line["event"]["stage"] == "task tiny"]
    assert [[sub["event"]["person"] for sub in line["team"]] for line in acted] == [["ann", "ann-1", "ann-2"]] * 4
    assert {row["person"] for row in session.log()} == {"ann"}


def test_the_example_is_a_study_and_the_documentation_shows_it() -> None:
    file = ROOT / "docs" / "examples" / "kitting-study.toml"
    assert [one.name for one in read(file).conditions] == ["none", "reactive", "attention", "priority"]
    promise = " ".join(
        read(file).texts["thanks"].split()
    )  # codes can be traced as long as there is the key, and not after
    assert "we delete the key that connects codes with browsers. Then nobody can trace the code to you." in promise
    whole, page = tomllib.loads(file.read_text()), (ROOT / "docs" / "userstudy.md").read_text()
    shown = tomllib.loads(page.split("```toml\n")[1].split("```")[0])
    assert shown
    assert shown.items() <= whole.items()
    keys = {field.name for field in fields(FileTable)} - {"title"}
    assert [key for key in keys if f"`{key}`" not in page and f"[{key}]" not in page] == []
