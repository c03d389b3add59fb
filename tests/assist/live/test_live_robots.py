"""Live teams of several robots: the assistant, its saved states, and the service."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from sessions import EASY, SETTING
from test_live_web import Web

from assist.declare import InapplicableError, Refusal
from assist.live import Acted, Arrived, Assistant, Joined, Session
from assist.people.ranges import Population
from assist.person import Robot, Setting
from planner import Table

WRONG = "(place hammer slot-2 box-a)"


def test_each_of_different_robots_counts_its_own_costs(tiny: Table) -> None:
    """The second robot's suggestions cost less, so that it goes although its way costs more."""
    robots = (Robot(c_suggest=0.4, c_move=0.01), Robot(c_suggest=0.1, c_move=0.03))
    desk = Assistant(tiny, ["ann"], setting=Setting(trust="paper"), population=Population(), robots=robots)
    desk.observe("ann", "(fetch box-a)")
    desk.observe("ann", WRONG)
    first, second = desk.recommend_all()
    assert first.person is None
    assert second.person == "ann"
    assert second.reason is not None
    assert second.reason.moving == 0.03
    person = second.explanation.now
    assert person is not None
    assert person.prospect.cost == pytest.approx(0.1)
    assert person.prospect.score == pytest.approx(second.reason.score)
    again = Assistant.from_json(desk.to_json(), tiny)
    assert again.setting == desk.setting
    assert again.recommend_all() == desk.recommend_all()
    dear = Assistant(tiny, ["ann"], setting=Setting(trust="paper"), population=Population(), robots=robots[::-1])
    for action in ("(fetch box-a)", WRONG):
        dear.observe("ann", action)
    assert [one.person for one in dear.recommend_all()] == ["ann", None]
    assert dear.recommend(1).reason == second.reason
    with pytest.raises(ValueError, match="execute: expected a robot that suggests"):
        Assistant(tiny, ["ann"], robots=(Robot(execute=True), Robot()))


def test_a_robot_makes_room_for_a_better_one_also_in_a_record(tiny: Table) -> None:
    teams = []
    for _ in range(2):
        robots = (Robot(c_suggest=9), Robot())
        desk = Assistant(tiny, ["ann"], population=EASY, setting=SETTING, robots=robots)
        for action in ("(fetch box-a)", WRONG):
            desk.observe("ann", action)
        desk.arrived("ann", robot=1)
        teams.append(desk)
    advice = teams[0].recommend_all()
    assert [one.person for one in advice] == [None, "ann"]
    teams[1].follow(advice, 1)
    for desk in teams:
        assert desk.robots == (None, "ann")


def two(tiny: Table) -> Assistant:
    """Return two robots, sent to ann and bob, who have erred, but not to cleo."""
    desk = Assistant(tiny, ["ann", "bob", "cleo"], policy="reactive", setting=Setting(travel_time=2), robots=2)
    for name in ("ann", "bob", "cleo"):
        desk.observe(name, "(fetch box-a)")
    for name in ("bob", "ann"):
        desk.observe(name, WRONG)
    return desk


def test_each_robot_has_its_own_way(tiny: Table) -> None:
    desk = two(tiny)
    assert [(one.person, one.arrived) for one in desk.recommend_all()] == [("ann", False), ("bob", False)]
    desk.observe("cleo", WRONG)
    assert [one.person for one in desk.recommend_all()] == ["ann", "bob"]  # they are under way
    desk.arrived("bob", robot=2)
    assert (desk.recommend(2).person, desk.recommend(2).suggestion) == ("bob", "(remove hammer slot-2 box-a)")
    assert desk.recommend(2).explanation.text().startswith("I suggest")
    assert not desk.recommend(1).arrived
    again = Assistant.from_json(desk.to_json(), tiny)
    assert again.recommend_all() == desk.recommend_all()
    assert again.robots == desk.robots == ("ann", "bob")
    for team in (desk, again):
        team.observe("bob", "(remove hammer slot-2 box-a)")
        assert [(one.person, one.arrived) for one in team.recommend_all()] == [("ann", False), ("cleo", False)]
        team.arrived("ann", robot=2)  # somebody else has moved it: both are with ann
        team.arrived("ann")
        assert [one.person for one in team.recommend_all()].count("ann") <= 1
    with pytest.raises(Refusal, match="robot 3: expected a number from 1 to 2"):
        desk.arrived("ann", robot=3)
    with pytest.raises(Refusal, match="robot 7: expected 1, as there is one robot"):
        Assistant(tiny, ["ann"]).arrived("ann", robot=7)


def test_more_robots_than_people_leave_the_others_where_they_are(tiny: Table) -> None:
    desk = Assistant(tiny, ["ann", "bob"], policy="reactive", robots=5)
    for name in ("ann", "bob"):
        desk.observe(name, "(fetch box-a)")
        desk.observe(name, WRONG)
    assert [one.person for one in desk.recommend_all()] == ["ann", "bob", None, None, None]
    assert desk.robots == ("ann", "bob", None, None, None)
    for number in (0, -1, 6, 1.5, "1", True):
        for ask in (desk.recommend, lambda robot: desk.arrived("ann", robot=robot)):
            with pytest.raises(Refusal, match=r"robot .*expected (a number from 1 to 5|a whole)"):
                ask(number)  # type: ignore[arg-type]


def test_two_robots_that_report_the_same_arrival(tiny: Table, tmp_path: Path) -> None:
    """One of them makes the suggestion. The same id of another robot is another report."""
    setting = Setting(c_suggest=0.02, c_move=0.01, trust="paper", robots=2)
    session = Session({"tiny": tiny}, tmp_path / "one.sqlite", setting=setting, population=Population())
    session.report_all(
        [Joined(person="ann"), *(Acted(person="ann", action=action) for action in ("(fetch box-a)", WRONG))]
    )
    assert [one.person for one in session.outlook().robots] == ["ann", None]
    for order in ((1, 2), (2, 1)):
        session.report_all([Arrived(person="ann", robot=number) for number in order])
        assert [one.location for one in session.outlook().robots] == ["ann", "ann"]
        assert [one.suggestion is None for one in session.outlook().robots] == [False, True]
    session.report_all([Arrived(robot=1)])
    assert [one.person for one in session.outlook().robots] == [None, "ann"]  # who is still there
    first, again, other, own = session.report_all([
        Arrived(person="ann", robot=1, id="7"), Arrived(person="ann", robot=1, id="7"),
        Arrived(person="ann", robot=2, id="7"), Acted(person="ann", action="(fetch box-a)", id="7"),
    ])  # fmt: skip
    assert first == again
    assert isinstance(other, dict)
    assert isinstance(own, InapplicableError)
    assert "(fetch box-a) is not applicable" in str(own)
    assert [one.location for one in session.outlook().robots] == ["ann", "ann"]
    session.close()


def test_the_service_has_an_address_for_each_robot(tiny: Table, tmp_path: Path) -> None:
    web = Web(tiny, tmp_path, robots=2)
    ask = web.ask
    with web.client:
        for name in ("ann", "bob"):
            for action in ("(fetch box-a)", WRONG):
                assert ask("POST", f"/api/people/{name}/actions", json={"action": action}).status_code == 200
        team = ask("GET", "/api/team").json()
        each = [ask("GET", f"/api/robots/{number}").json() for number in (1, 2)]
        assert team["robots"] == each
        assert {one["location"] for one in each} == {"ann", "bob"}
        assert {one["suggestion"] for one in each} == {"(remove hammer slot-2 box-a)"}
        moved = ask("POST", "/api/robots/2/arrived", json={"person": None, "id": "1"})
        assert moved.json()["location"] is None
        assert ask("POST", "/api/robots/2/arrived", json={"person": None, "id": "1"}).json() == moved.json()
        for method, path in (("GET", "/api/robots/{}"), ("POST", "/api/robots/{}/arrived")):
            for number in (0, 3):
                refused = ask(method, path.format(number), **({"json": {"person": None}} if method == "POST" else {}))
                assert refused.status_code == 404, refused.text
                assert json.loads(refused.text)["detail"] == f"robot {number}: expected a number from 1 to 2"
