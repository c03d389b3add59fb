"""Live people who see each other helped: what is believed of them, also after actions are taken back or erased."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import thinned

from assist.declare import Refusal
from assist.live import Assistant, Remark, Session, TraceReasons
from assist.live.simulated_person import SimulatedPerson
from assist.people import Neighbours, Population, SeenFollowed, SeenOutcome
from assist.person.settings import Setting
from assist.team import Pool, TeamAction, TeamState
from assist.team.simulate import simulate
from assist.team.trace import Trace
from planner import Table

SETTING = Setting(c_suggest=0.0, c_move=0.0, neighbours=Neighbours(rule="followed", sees="next"), trust="constant")
NAMES = ("ann", "ben", "cat")


class Pesters:
    """A policy that suggests something to everybody, one after the other."""

    def __call__(self, team: TeamState, /) -> TeamAction:
        able = team.active & (team.first_optimal() > 0)
        person = np.where(able.any(axis=1), able.argmax(axis=1), -1)
        return team.act(person, team.first_optimal())


def theta(team: Assistant) -> list[float]:
    return [team.person(name).theta.mean for name in NAMES]


def team_of(task: Table, **fields: Any) -> Assistant:
    return Assistant(task, list(NAMES), setting=Setting(**(vars(SETTING) | fields)))


def tell(team: Assistant, person: str, suggestion: str) -> None:
    """Let the robot make a suggestion, whatever its policy says."""
    team.roster.suggest(team.known(person), suggestion)


def test_those_who_see_it_are_believed_to_be_moved(tiny: Table) -> None:
    team = team_of(tiny)
    before, prior = theta(team), team.person("ann").belief
    first, other = team.person("ann").applicable[:2]
    tell(team, "ann", first)
    team.observe("ann", first)
    grid = team.person("ben").grid
    low, weight = grid.shares(np.clip(grid.theta + 0.05, 0, 1))
    moved = np.zeros_like(prior)
    for t in range(len(grid.theta)):
        moved[:, low[t]] += prior[:, t] * (1 - weight[t])
        moved[:, low[t] + 1] += prior[:, t] * weight[t]
    np.testing.assert_allclose(team.person("ben").belief, moved, atol=1e-12)
    assert theta(team)[2] == before[2]  # who is two places away sees nothing
    tell(team, "ben", first)
    team.observe("ben", other)
    after = theta(team)
    assert after[2] < before[2]
    team.observe("cat", first)  # without a suggestion nobody sees anything
    assert theta(team)[:2] == after[:2]


def test_what_is_taken_back_was_not_seen(tiny: Table) -> None:
    """Whoever takes back what, beliefs are those of a team in which it did not happen."""
    one, other = team_of(tiny), team_of(tiny)
    act = one.person("ann").applicable[0]
    for team in (one, other):
        tell(team, "cat", act)
        team.observe("cat", act)
        team.observe("ben", act)
    tell(one, "ann", act)
    one.observe("ann", act)
    assert theta(one)[1] != theta(other)[1]
    one.observe("ben", one.person("ben").applicable[0])
    other.observe("ben", other.person("ben").applicable[0])
    one.undo("ann")
    for name in NAMES:
        np.testing.assert_allclose(one.person(name).belief, other.person(name).belief, atol=1e-12)
    for team in (one, other):  # who takes back their own actions has still seen what they saw
        team.undo("ben")
        team.undo("ben")
    np.testing.assert_allclose(one.person("ben").belief, other.person("ben").belief, atol=1e-12)
    assert theta(one)[1] > team_of(tiny).person("ben").theta.mean


def test_a_simulated_person_hears_of_what_is_done_again_after_it_was_taken_back(tiny: Table, tmp_path: Path) -> None:
    session = Session(tiny, tmp_path / "a.sqlite", setting=SETTING, policy=Pesters())
    for name in NAMES:
        session.join(name)
    ben, first = SimulatedPerson(Population(theta=(0.3, 0.3)), trust=SETTING.rule_of_people()), list[float]()
    for _ in range(2):
        desk = session.history.desk  # type: ignore[attr-defined]
        act = session.person("ann")["applicable"][0]
        desk.roster.suggest(desk.known("ann"), act)
        session.observe("ann", act)
        for _ in range(2):  # what was heard before counts once
            ben.hear(session.history.news("ben"))
        first.append(ben.theta)
        session.undo("ann")
    assert first == pytest.approx([0.35, 0.4])
    session.close()


@pytest.mark.parametrize("who", ["ann", "ben"])
def test_what_was_seen_in_a_finished_task_stays(tiny: Table, who: str) -> None:
    """It does not matter who has finished a task since: who was seen, or who saw it."""
    team = team_of(tiny)
    act = team.person("ann").applicable[0]
    tell(team, "ann", act)
    team.observe("ann", act)
    seen = theta(team)[1]
    team.begin(who)
    if who == "ann":
        team.observe("ann", act)  # without a suggestion, so that nobody sees it
    team.undo("ann")
    assert theta(team)[1] == pytest.approx(seen, abs=1e-12)


@pytest.mark.parametrize("rule", [SeenFollowed(0.1, 0.2), SeenOutcome(0.1)])
def test_a_saved_team_is_the_same_again(tiny: Table, rule: Any) -> None:
    team = team_of(tiny, neighbours=Neighbours(rule=rule))
    for _ in range(4):
        advice = team.recommend()
        if advice.person is not None:
            team.observe(advice.person, advice.suggestion)
    again = Assistant.from_json(team.to_json(), tiny)
    assert again.setting == team.setting
    assert all(np.array_equal(again.person(name).belief, team.person(name).belief) for name in NAMES)


def test_uncertain_actions_are_refused(tiny: Table) -> None:
    team = team_of(tiny, suggestions="all")
    first, other = team.person("ann").applicable[:2]
    with pytest.raises(Refusal, match="neighbours: expected actions that are all seen as they are"):
        team.observe("ann", likelihoods={first: 0.6, other: 0.4})
    with pytest.raises(Refusal, match="neighbours: expected actions"):
        team.observe("ann", missed=0.3)
    team.observe("ann", first)
    with pytest.raises(Refusal, match="neighbours: expected actions"):
        team.answer("ann", other)
    assert team.person("ann").steps == 1


def test_a_person_without_a_station_is_refused(tiny: Table) -> None:
    team = team_of(tiny, neighbours=Neighbours(rule="followed", matrix=np.ones((3, 3)) - np.eye(3)))
    with pytest.raises(ValueError, match="3 stations for 4 people"):
        team.join("dan")


@pytest.mark.parametrize("taken_back", thinned([True, False]))
def test_an_erased_neighbour_changes_nothing_for_the_others(tiny: Table, tmp_path: Path, taken_back: bool) -> None:
    setting = Setting(c_suggest=0.0, c_move=0.0, neighbours=Neighbours(rule="followed"))

    def opened(name: str) -> Session:
        return Session(tiny, tmp_path / f"{name}.sqlite", setting=setting, policy=Pesters(), clock=lambda: 0.0)

    session = opened("left")
    for name in "abc":
        session.join(name)
    for number in range(5):
        for name in "abc":
            view = session.person(name)
            if view["suggestion"] is not None and (name == "b" or number % 2):
                session.observe(name, view["suggestion"])
            elif name != "b":
                session.observe(name, view["applicable"][0])
            if name == "b" and view["suggestion"] is not None and taken_back:
                session.undo("b")
    session.leave("b")
    session.close()
    shutil.copy(tmp_path / "left.sqlite", tmp_path / "erased.sqlite")
    left, erased = opened("left"), opened("erased")
    erased.erase("b", "as asked")
    assert left.beliefs() == erased.beliefs()
    erased.close()
    erased = opened("erased")
    assert left.beliefs() == erased.beliefs()
    left.close()
    erased.close()
    stored = (tmp_path / "erased.sqlite").read_bytes()
    assert b'"witnessed"' in stored
    assert (b'"unwitnessed"' in stored) == taken_back
    assert b'"person":"b"' not in stored


def test_what_others_saw_stands_in_the_record_of_the_event_alone(tiny: Table) -> None:
    """It is found once, when the event happens: a saved team reads it, and what a person does stays their own."""
    team = team_of(tiny)
    act = team.person("ann").applicable[0]
    tell(team, "ann", act)
    team.observe("ann", act)
    team.undo("ann")
    team.observe("cat", act)
    done, undone, silent = team.records[-3:]
    assert [(one.kind, one.who) for one in done.caused] == [("witnessed", "ann")]
    assert undone.caused[0].model_dump() == {"kind": "unwitnessed", "person": "ann", "number": done.n}
    assert (silent.caused, "caused" in silent.text()) == ((), False)
    document = json.loads(team.to_json())
    del document["records"][-2]["caused"]  # as if it had not been taken back for those who saw it
    again = Assistant.from_json(json.dumps(document), tiny)
    assert again.person("ben").theta.mean > team.person("ben").theta.mean


def test_an_explanation_says_what_was_seen_and_what_those_who_see_it_gain(tiny: Table) -> None:
    neighbours = Neighbours(rule=SeenOutcome(0.3), sees="next")
    team = Assistant(
        tiny, list(NAMES), policy="attention-outlook",
        setting=Setting(c_suggest=0.05, c_move=0.0, neighbours=neighbours),
    )  # fmt: skip
    advice = team.recommend()
    now = advice.explanation.now
    assert now is not None
    assert now.remark is None
    assert now.prospect.beside > 0  # nobody's own theta moves by it, so that the suggestion pays for those who see it
    assert now.prospect.worth - now.prospect.cost < now.prospect.score
    assert any("Those who see it should save" in one for one in advice.explanation.sentences())
    assert advice.person is not None
    team.observe(advice.person, advice.suggestion)
    other = "ann" if advice.person == "ben" else "ben"
    tell(team, other, team.person(other).applicable[0])
    told = team.explain(other)
    assert told.now is not None
    assert told.now.remark == Remark("saw_followed", advice.person)
    assert f"You saw {advice.person} follow a hint." in told.sentences()
    assert f"Sie haben gesehen, dass {advice.person} einem Hinweis folgte." in told.sentences("de")
    assert "You saw somebody follow a hint." in told.without_names().sentences()
    assert told.as_dict()["now"]["remark"] == {"what": "saw_followed", "other": advice.person}
    assert "remark" not in advice.explanation.as_dict()["now"]


def test_the_operators_view_says_who_sees_whom(tiny: Table, tmp_path: Path) -> None:
    setting = Setting(c_suggest=0.0, c_move=0.0, neighbours=Neighbours(rule="followed", pairs=[[1, 2], [2, 3, 0.25]]))
    session = Session(tiny, tmp_path / "a.sqlite", setting=setting, policy=Pesters())
    for name in "abc":
        session.join(name)
    assert [session.entry(name)["sees"] for name in "abc"] == [{"b": 1.0}, {"a": 1.0, "c": 0.25}, {"b": 0.25}]
    before = session.entry("b")
    session.observe("a", session.person("a")["suggestion"])
    after = session.entry("b")
    assert after["theta"][1] > before["theta"][1]
    assert after["seq"] > before["seq"]  # pages show that it has changed
    session.leave("c")
    assert session.entry("b")["sees"] == {"a": 1.0}
    session.close()
    alone = Session(tiny, tmp_path / "b.sqlite")
    alone.join("a")
    assert "sees" not in alone.entry("a")
    alone.close()


@pytest.mark.parametrize("policy", thinned(["attention-outlook", "priority", "whittle", "rollout"]))
def test_an_explanation_names_what_the_policy_counts_for_those_who_see_it(tiny: Table, policy: str) -> None:
    setting = Setting(c_suggest=0.05, c_move=0.0, trust="constant", neighbours=Neighbours(rule=SeenOutcome(0.3)))
    team = Assistant(tiny, list(NAMES), policy=policy, setting=setting)
    now = team.recommend().explanation.now
    assert now is not None
    assert now.prospect.beside > 0
    assert all(other.beside > 0 for other in now.others)
    if policy != "attention-outlook":  # a trace asks any policy alike
        return
    pool = Pool.sample(tiny, 3, seed=2, setting=setting)
    reasons, trace = TraceReasons(pool.policies, tiny), Trace()
    _ = simulate(pool, policy, humans=3, episodes=[0], seed=1, trace=trace, reasons=reasons)
    first = next(row for row in trace if "explanation" in row)
    assert "Those who see it should save" in first["explanation"]["text"]


def test_a_policy_that_does_not_consider_them_counts_nothing_for_those_who_see_it(tiny: Table) -> None:
    setting = Setting(c_suggest=0.0, c_move=0.0, neighbours=Neighbours(rule=SeenOutcome(0.3)))
    now = Assistant(tiny, list(NAMES), policy=Pesters(), setting=setting).recommend().explanation.now
    assert now is not None
    assert now.prospect.beside == 0
    nothing = Assistant(tiny, list(NAMES), policy="attention", setting=setting).recommend().explanation.nothing
    assert nothing is not None
    assert nothing.prospect is not None
    assert nothing.prospect.beside == 0


def test_pages_are_sent_those_who_changed(tiny: Table, tmp_path: Path) -> None:
    neighbours = Neighbours(rule="followed", pairs=[[1, 2], [3, 4]])
    setting = Setting(c_suggest=0.0, c_move=0.0, neighbours=neighbours)
    session, sent = Session(tiny, tmp_path / "a.sqlite", setting=setting, policy="none"), list[set[str]]()
    session.changed = lambda people, _: sent.append(people)
    for name in "abcd":
        session.join(name)
    assert sent == [{"a"}, {"a", "b"}, {"c"}, {"c", "d"}]
    sent.clear()
    for _ in range(2):
        desk = session.history.desk  # type: ignore[attr-defined]
        act = session.person("b")["applicable"][0]
        desk.roster.suggest(desk.known("b"), act)
        session.observe("b", act)
    session.undo("b")
    session.observe("c", session.person("c")["applicable"][0])
    session.leave("c")
    assert sent == [{"a", "b"}, {"a", "b"}, {"a", "b"}, {"c"}, {"c", "d"}]
    session.close()


def test_who_is_seen_by_nobody_may_be_seen_with_doubt_where_the_robots_know_of_no_graph(tiny: Table) -> None:
    team = team_of(tiny, suggestions="all", neighbours=Neighbours(rule="followed", known=False))
    first, other = team.person("ann").applicable[:2]
    team.observe("ann", likelihoods={first: 0.6, other: 0.4})
    assert team.person("ann").steps == 1
