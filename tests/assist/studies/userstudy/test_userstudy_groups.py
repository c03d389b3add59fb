"""User studies in which several participants share one robot: they wait for each other, and are analysed as groups."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import thinned
from serving import served
from test_live_pages import violations
from userstudies import WITHOUT_PRACTICE, Open, Part, opened, written

from assist.declare import Catalogue, InapplicableError, catalogue, languages
from assist.live.store import stored
from assist.studies.reports.userstudy_summary import summarise
from assist.studies.userstudy import read
from assist.studies.userstudy.session import JOURNAL, StudySession
from assist.studies.userstudy.tables import tables
from assist.web.user_study.rehearsal import SimulatedParticipant
from planner import InputFileError, Table

__all__ = ["opened"]
GROUPS = (
    WITHOUT_PRACTICE.replace("simulated = 2\n", "")
    .replace("[setting]", "[group]\nsize = 3\nwait = 5\n\n[setting]")
    .replace('name = "none"\npolicy = "none"', 'name = "none"\npolicy = "attention"')
)
WITHIN = GROUPS.replace("seed = 3", 'seed = 3\ndesign = "within"')
EAGER = GROUPS.replace("wait = 5", 'wait = 5\nthen = "start"')


def waiting(session: StudySession, *names: str) -> list[Part]:
    """Return participants who have come to the waiting page, or whose group began when they came."""
    parts = [Part(session, name) for name in names]
    for part in parts:
        part.come()
        for _ in ("consent", "instructions"):
            part.onward()
    return parts


def test_a_group_waits_for_its_members_and_shares_one_robot(opened: Open) -> None:
    session = opened(GROUPS)
    ann, bob = waiting(session, "ann", "bob")
    assert session.person("ann")["study"]["waiting"] == {"here": 2, "of": 3}
    assert session.person("ann")["seq"] == session.person("bob")["seq"]  # the page shows who came
    with pytest.raises(InapplicableError, match="the task begins when the group is complete"):
        ann.onward()
    bob.report("left")
    assert session.person("ann")["study"]["waiting"] == {"here": 1, "of": 3}
    changed: set[str] = set()
    session.changed = lambda people, _: changed.update(people)
    (cyd,) = waiting(session, "cyd")
    assert ann.stage == "waiting"
    changed.clear()
    bob.report("returned")
    assert {part.stage for part in (ann, bob, cyd)} == {"task tiny"}
    assert changed == {"ann", "bob", "cyd"}
    who = session.cohort.participants
    assert len({who[name].condition for name in who}) == 1
    assert session.cohort.by_condition()[who["ann"].condition or ""] == 1  # a group, not three people
    told = set()
    for _ in range(3):
        for part in (ann, bob, cyd):
            part.errs()
            asked = [name for name in who if session.person(name)["suggestion"] is not None]
            told |= set(asked)
    assert told == {"ann", "bob", "cyd"}  # the robot attends to one after the other
    (group,) = session.cohort.groups.values()
    assert {advice.person for advice in group.teams[1].team.advices} <= {"ann", "bob", "cyd", None}
    assert all(session.person(name)["steps"] == 3 for name in who)


@pytest.mark.parametrize("goes", thinned(["left", "withdrew", "expired"]))
def test_a_member_who_leaves_does_not_stop_the_others(opened: Open, goes: str) -> None:
    session = opened(GROUPS)
    ann, bob, cyd = waiting(session, "ann", "bob", "cyd")
    bob.errs()
    bob.report(goes)
    for part in (ann, cyd):
        for _ in range(2):
            part.errs()
            assert session.cohort.groups["G1"].teams[1].team.advices[0].person in (ann.name, cyd.name, None)
        part.finish()
    views = {part.name: session.person(part.name) for part in (ann, bob, cyd)}
    session.close()
    again = opened(GROUPS)
    assert {name: again.person(name) for name in views} == views
    bob, ann = Part(again, "bob"), Part(again, "ann")
    if goes == "left":
        bob.report("returned")
        assert again.person("bob")["steps"] == 1
        bob.finish()
    if goes != "withdrew":
        bob.to("thanks")
    ann.to("thanks")
    found = tables(again.study, again.folder / JOURNAL)
    assert {row["group"] for row in found.participants} == {"G1"}
    assert {row["participant"]: row["finished"] for row in found.tasks}["ann"]


class Offline:
    """The client of a participant who rehearses, without a network."""

    def __init__(self, session: StudySession, _: str) -> None:
        self.session = session

    def ask(self, _: str, path: str, body: dict[str, Any]) -> dict[str, Any]:
        if path.endswith("/seats"):
            name = f"P{len(self.session.people)}"
            Part(self.session, name).come()
            return {"person": name, "part": ""}
        name, kind = path.split("/")[-2:]
        return Part(self.session, name).report(kind, **body)

    def see(self) -> dict[str, Any]:
        return self.session.person("P0")

    def observe(self, person: str, action: str, seq: int) -> dict[str, Any]:
        return Part(self.session, person).report("acted", action=action, seq=seq)


def test_theta_of_who_rehearses_moves_by_what_the_condition_shows_of_others(opened: Open, tiny: Table) -> None:
    shown = 'setting = { neighbours = { rule = { rule = "followed", rise = 0.1, fall = 0.05 } } }'
    session = opened(GROUPS.replace('name = "attention"', f'name = "attention"\n{shown}'))
    service: Any = SimpleNamespace(study=session.study, session=session, join_url=str)
    client: Any = partial(Offline, session)
    tasks = {"tiny": tiny, "practice": tiny}
    everybody = {f"P{n}": SimulatedParticipant(service, tasks, n, None, "", client) for n in range(6)}
    while {session.person(name)["study"]["kind"] for name in everybody} != {"thanks"}:
        for name, one in everybody.items():
            seen = session.person(name)
            if seen["study"]["kind"] not in ("waiting", "thanks"):
                one._step(seen)
    moved = set()
    for group in session.cohort.groups.values():
        team, neighbours = group.teams[1].team, session.study.condition(group.condition).setting.neighbours
        for name in group.members:
            person, acted = everybody[name]._person, len(team.desk.entry(name).steps)
            theta = np.array(person.human.theta)
            for saw in team.news(name):
                if neighbours is not None and saw.steps < acted:  # before an action of one's own
                    theta = neighbours.rule.update(theta, saw.event)
            assert person.theta == theta
            moved |= {group.condition} if theta != person.human.theta else set()
    assert moved == {"attention"}


def test_who_rehearses_goes_on_when_the_time_is_up_while_they_choose(opened: Open, tiny: Table) -> None:
    session = opened(WITHOUT_PRACTICE)
    service: Any = SimpleNamespace(study=session.study, session=session, join_url=str)
    client: Any = partial(Offline, session)
    one = SimulatedParticipant(service, {"tiny": tiny, "practice": tiny}, 0, None, "", client)
    part = Part(session, "P0")
    part.to("task tiny")
    seen = session.person("P0")
    part.report("expired")
    assert one._step(seen) == session.person("P0")
    part.onward()
    with pytest.raises(InapplicableError):  # what nothing but a fault explains
        one._step(seen)


def test_time_causes_departures_limits_and_decisions(opened: Open) -> None:
    session = opened(GROUPS.replace("away = 10", "away = 10\nminutes = 20"))
    Part(session, "ann").come()

    def caused(seconds: float, **away: float | None) -> list[tuple[str, str]]:
        """Return what is due at some seconds after the last stage of anybody began, and the last action."""
        here = session.cohort.participants.values()
        now = max(max(who.entered, who.acted) for who in here) + seconds
        return [(event.kind, event.person) for event in session.cohort.caused(now, away)]

    assert caused(0, ann=599.0) == caused(10**6, ann=None) == []
    assert caused(0, ann=601.0) == [("left", "ann")]
    waiting(session, "bob", "cyd")
    assert caused(299, bob=29.0, cyd=None) == []
    assert caused(0, bob=31.0, cyd=None) == [("left", "bob")]  # who waits has to be there when the group begins
    assert caused(301, bob=None, cyd=31.0) == [("expired", "bob"), ("left", "cyd")]
    waiting(session, "dan")
    tick = session.study.tick
    here: dict[str, float | None] = dict.fromkeys(("bob", "cyd", "dan"))
    assert caused(tick - 1, **here) == []
    assert caused(tick + 1, **here) == [("elapsed", "bob")]  # once for the group
    assert caused(tick + 1, **here | {"bob": 1.0}) == [("elapsed", "cyd")]
    assert caused(1201, **here) == [("expired", name) for name in here]


def test_nobody_comes_in_time(opened: Open) -> None:
    session = opened(GROUPS)
    (ann,) = waiting(session, "ann")
    ann.report("expired")
    seen = session.person("ann")["study"]
    assert (seen["kind"], len(seen["completion"])) == ("unmatched", 8)
    bob, cyd = waiting(session, "bob", "cyd")
    assert bob.stage == cyd.stage == "waiting"  # ann no longer counts
    found = tables(session.study, session.folder / JOURNAL)
    (row,) = (row for row in found.participants if row["participant"] == "ann")
    assert (row["status"], row["group"], row["completion_code"]) == ("unmatched", None, seen["completion"])
    ann.report("withdrew")
    assert ann.kind == "withdrew"


def test_after_the_time_a_smaller_group_may_start(opened: Open) -> None:
    session = opened(EAGER)
    ann, bob = waiting(session, "ann", "bob")
    ann.report("expired")
    assert ann.stage == bob.stage == "task tiny"
    assert not session.person("ann")["study"]["over"]
    for part in (ann, bob):
        part.to("thanks")
    (cyd,) = waiting(session, "cyd")
    assert cyd.stage == "waiting"
    cyd.report("expired")
    assert cyd.stage == "task tiny"  # alone
    cyd.errs()
    assert session.cohort.groups["G2"].teams[1].team.advices[0].person in ("cyd", None)
    before = {name: session.person(name) for name in ("ann", "bob", "cyd")}
    session.close()
    again = opened(EAGER)
    assert {name: again.person(name) for name in before} == before
    found = summarise(again.study, tables(again.study, again.folder / JOURNAL))
    assert found["groups"] == {"size": 3, "began": 2, "smaller": 2, "unmatched": 0}


def test_after_the_time_one_may_go_on_alone_while_the_others_wait(opened: Open) -> None:
    lonely = EAGER.replace('"start"', '"alone"')
    session = opened(lonely)
    ann, bob = waiting(session, "ann", "bob")
    ann.report("expired")
    assert (ann.stage, bob.stage) == ("task tiny", "waiting")
    assert session.person("bob")["study"]["waiting"] == {"here": 1, "of": 3}
    ann.errs()
    assert session.cohort.groups["G1"].members == ("ann",)
    waiting(session, "cyd", "dan")
    assert session.cohort.groups["G2"].members == ("bob", "cyd", "dan")  # who waits on can still find a group
    before = {name: session.person(name) for name in ("ann", "bob", "cyd", "dan")}
    session.close()
    again = opened(lonely)
    assert {name: again.person(name) for name in before} == before
    found = summarise(again.study, tables(again.study, again.folder / JOURNAL))
    assert found["groups"] == {"size": 3, "began": 2, "smaller": 1, "unmatched": 0}


@pytest.mark.parametrize(
    ("gone", "how"), [("cyd", "erase"), pytest.param("ann", "erase", marks=pytest.mark.slow), ("bob", "withdraw")]
)
def test_a_member_is_removed_and_the_others_are_as_before(opened: Open, gone: str, how: str) -> None:
    """Also the last to come, whose event began the group, and the first."""
    session = opened(GROUPS)
    parts = waiting(session, "ann", "bob", "cyd")
    for part in parts * 3:
        part.errs()
    stay = [part for part in parts if part.name != gone]
    stay[0].finish()
    before = {part.name: session.person(part.name) for part in stay}
    Part(session, gone).report("withdrew")  # after which an erasure changes no view
    views = {part.name: session.person(part.name) for part in stay}
    for name, view in views.items():
        assert {**view, "seq": 0, "suggestion": None} == {**before[name], "seq": 0, "suggestion": None}
    beliefs = session.cohort.beliefs()
    if how == "erase":
        session.erase(gone, "asked for it")
        assert not any(gone.encode() in file.read_bytes() for file in session.folder.glob("journal*"))
    assert {part.name: session.person(part.name) for part in stay} == views
    assert {name: session.cohort.beliefs()[name] for name in views} == {name: beliefs[name] for name in views}
    events = [sub["event"] for _, record in stored(session.folder / JOURNAL)[1] for sub in record.get("team", ())]
    assert {event["kind"] for event in events if event.get("person") == gone} <= {"vacant"}
    session.close()
    session = opened(GROUPS)
    assert {part.name: session.person(part.name) for part in stay} == views
    for part in stay:
        Part(session, part.name).to("thanks")
    found = tables(session.study, session.folder / JOURNAL)
    assert {row["participant"] for row in found.tasks} == {part.name for part in stay}
    rows = {row["participant"]: (row["status"], row["group"], row["stage"]) for row in found.participants}
    assert rows.pop(gone, ("withdrew", "G1", "task tiny")) == ("withdrew", "G1", "task tiny")
    assert [row[1] for row in rows.values()].count("G1") == len(rows)


def test_within_participants_a_group_waits_again_and_has_another_robot(opened: Open) -> None:
    session = opened(WITHIN)
    parts = ann, bob, cyd = waiting(session, "ann", "bob", "cyd")
    who = session.cohort.participants
    assert {part.stage for part in parts} == {"task tiny 1"}
    order = session.study.orders[who["ann"].condition or ""]
    assert session.cohort.by_condition()[" > ".join(order)] == 1
    for part in parts:
        part.errs()
    ann.to("waiting 2")
    assert session.person("ann")["study"]["waiting"] == {"here": 1, "of": 3}
    bob.to("waiting 2")
    assert not session.cohort.is_complete(who["ann"])
    cyd.report("left")
    assert session.person("ann")["study"]["waiting"] == {"here": 2, "of": 2}
    assert session.cohort.is_complete(who["ann"])
    ann.report("expired")  # which ends nobody's study here
    assert (ann.stage, bob.stage, cyd.stage) == ("task tiny 2", "task tiny 2", "task tiny 1")
    ann.errs()
    views = [session.person(part.name) for part in parts]
    session.close()
    session = opened(WITHIN)
    assert [session.person(part.name) for part in parts] == views
    parts = ann, bob, cyd = [Part(session, name) for name in ("ann", "bob", "cyd")]
    cyd.report("returned")
    assert session.person("cyd")["steps"] == 1
    cyd.to("task tiny 2")  # the others have begun, so that there is nobody to wait for
    (group,) = session.cohort.groups.values()
    assert set(group.teams[2].team.people) == {"ann", "bob", "cyd"}
    assert group.teams[1].team is not group.teams[2].team
    for part in parts:
        part.to("thanks")
    found = tables(session.study, session.folder / JOURNAL)
    rows = {(row["participant"], row["period"], row["condition"], row["finished"]) for row in found.tasks}
    assert rows == {(part.name, period, order[period - 1], True) for part in parts for period in (1, 2)}
    assert {row["group"] for row in found.participants} == {"G1"}
    bob.report("withdrew")
    views, beliefs = [session.person(part.name) for part in (ann, cyd)], session.cohort.beliefs()
    session.erase("bob", "asked for it")
    for _ in range(2):
        assert [session.person(part.name) for part in (ann, cyd)] == views
        assert all(session.cohort.beliefs()[name] == beliefs[name] for name in ("ann", "cyd"))
        session.close()
        session = opened(WITHIN)
    assert not any(b"bob" in file.read_bytes() for file in session.folder.glob("journal*"))
    rows = {(row["participant"], row["period"]) for row in tables(session.study, session.folder / JOURNAL).tasks}
    assert rows == {(name, period) for name in ("ann", "cyd") for period in (1, 2)}


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ("size = 3", "size = 1", "group.size: 1; expected a whole number from 2 to 20"),
        ("wait = 5", 'then = "later"', 'group.then: "later"; expected "end" or "alone" or "start"'),
        ("seed = 3", "seed = 3\nsimulated = 1", "simulated: 1; expected 0 in a study with groups"),
        ("seed = 3", "seed = 3\nparticipants = 4", "participants: 4; expected a multiple of 3"),
    ],
)
def test_a_group_that_cannot_be_is_refused(tmp_path: Path, right: str, wrong: str, message: str) -> None:
    with pytest.raises(InputFileError) as refused:
        read(written(tmp_path / "study.toml", GROUPS.replace(right, wrong, 1)))
    assert message in str(refused.value)


def spoken(language: str) -> str:
    return GROUPS.replace("seed = 3", f'seed = 3\nlanguage = "{language}"')


def begins(page: Any, said: Catalogue) -> None:
    """Consent and read the instructions."""
    page.click(f"text={said('study.agree')}")
    page.click(f'h2:text("{said("study.instructions")}") ~ form >> button')


@pytest.mark.slow
@pytest.mark.parametrize("language", languages())
def test_who_waits_in_vain_gets_a_code_and_may_withdraw(chromium: Any, tmp_path: Path, language: str) -> None:
    said = catalogue(language)
    text = spoken(language).replace("wait = 5", "wait = 0.02")
    context = chromium.new_context(viewport={"width": 360, "height": 740})
    page = context.new_page()
    page.set_default_timeout(60_000)
    with served("--study", written(tmp_path / "study.toml", text), "--data", tmp_path / "data", instance=None) as study:
        page.goto(study.links["everybody"])
        begins(page, said)
        page.wait_for_selector(f'h2:text("{said("study.unmatched")}")')
        assert page.get_attribute("html", "lang") == language
        assert len(page.input_value("#code")) == 8
        other = context.new_page()  # of the same browser: somebody else may begin
        other.goto(study.links["everybody"])
        other.wait_for_selector(f'button:text("{said("study.begin_next")}")')
        other.close()
        page.wait_for_selector("#withdrawal")
        assert violations(page, dark=False) == []
        page.click("#leave-button")
        page.click("#leave-now")
        page.wait_for_selector(f'h2:text("{said("study.left")}")')


@pytest.mark.long
@pytest.mark.slow
def test_three_people_in_three_browsers_share_one_robot(chromium: Any, tmp_path: Path) -> None:
    """In German, as the pages of those who wait are seen in English above."""
    said = catalogue("de")
    text = spoken("de").replace("seed = 3", "seed = 3\ntick = 0.5")
    faults: list[str] = []
    with served("--study", written(tmp_path / "study.toml", text), "--data", tmp_path / "data", instance=None) as study:
        contexts = [chromium.new_context(viewport={"width": 360, "height": 740}) for _ in range(3)]
        pages = [context.new_page() for context in contexts]
        for number, page in enumerate(pages, start=1):
            page.set_default_timeout(60_000)
            page.on("pageerror", lambda error: faults.append(str(error)))
            page.goto(study.links["everybody"])
            begins(page, said)
            if number < 3:
                page.wait_for_selector(f'h2:text("{said("study.waiting")}")')
                page.wait_for_selector(f'#progress-word:text("{said("study.here", here=str(number), all="3")}")')
        pages[0].wait_for_selector(f'h1:text("{said("task.title")}")')
        told = set()
        for round_ in range(30):
            for number, page in enumerate(pages):
                page.wait_for_selector("#actions button:not([disabled])")
                if page.is_visible("#offer"):
                    told.add(number)
                steps = int(page.inner_text("#steps"))
                wrong = "fetch", "return"  # in turn, which leads nowhere
                page.click(f'#actions button[data-action^="({wrong[round_ % 2]}"]:not([disabled]) >> nth=0')
                page.wait_for_function(f"() => document.getElementById('steps').textContent === '{steps + 1}'")
            if len(told) == 3:
                break
        assert told == {0, 1, 2}
        pages[1].click('#leave:not([hidden]) a[href*="?leave"]')
        pages[1].click("#leave-now")
        pages[1].wait_for_selector(f'h2:text("{said("study.left")}")')
        steps = int(pages[2].inner_text("#steps"))
        pages[2].locator("#actions button:not([disabled])").nth(0).click()
        pages[2].wait_for_function(f"() => document.getElementById('steps').textContent === '{steps + 1}'")
        pages[0].goto(study.operator)
        pages[0].wait_for_selector('#people td:text("(G1)")')
        assert pages[0].locator('#people td:text("(G1)")').count() == 3
        late = contexts[1].new_page()
        late.goto(study.links["everybody"])
        late.click(f'button:text("{said("study.begin_next")}")')
        begins(late, said)
        late.wait_for_selector(f'#progress-word:text("{said("study.here", here="1", all="3")}")')
        assert violations(late) == []
        late.screenshot(path=str(tmp_path / "waiting.png"))
    assert faults == []
