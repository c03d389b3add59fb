"""The live assistant: it acts as the simulated robot does, step by step, and a saved state restores it exactly."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from conftest import costly, thinned
from hypothesis import given
from hypothesis import strategies as st
from silence import ThreeInARow

from assist.declare import AbsentError, InapplicableError
from assist.live.assistant import Assistant
from assist.people import TERMS, Choices, HumanModel, Population, Weighted, boltzmann, remembered
from assist.person import AssistPOMDP, Assumptions, Robot, Setting, person_problem, shared_task
from assist.person.pomdp import Behaviour
from assist.person.qmdp import qmdp
from assist.team.belief_trace import Watched
from assist.team.pool import Pool
from assist.team.simulate import simulate
from planner import CostToGo, OnDemand, Table

WRONG, RIGHT = "(place hammer slot-2 box-a)", "(place hammer slot-1 box-a)"


def trace_of(pool: Pool, policy: str, team: list[int], **more: Any) -> tuple[list[dict[str, Any]], Watched]:
    """Simulate one episode of a team; return its actions, and the robot's beliefs at each decision."""
    watched, trace = Watched(pool.policy(policy)), []
    simulate(pool, watched, humans=team, episodes=1, seed=3, trace=trace, **more)
    return trace, watched


TWO = (Robot(c_suggest=0.3, c_move=0.2), Robot(travel_time=2, c_move=0.1))


@pytest.mark.parametrize(
    ("policy", "setting"),
    [
        ("none", Setting()),
        ("reactive", Setting(c_suggest=0.1, robots=2)),
        pytest.param("attention-never", Setting(c_suggest=0.2), marks=pytest.mark.slow),
        ("rollout", Setting(c_suggest=0.2)),
        ("attention", Setting(c_suggest=0.1, travel_time=2, c_move=0.1)),
        ("attention", Setting(c_suggest=0.2, knowledge="exact", suggestions="all")),
        ("attention", Setting(c_suggest=0.1, trust=ThreeInARow(0.3, 0.1))),
        pytest.param("attention", Setting(c_suggest=0.1, robots=2), marks=pytest.mark.slow),
        pytest.param("priority", Setting(c_suggest=0.1, robots=2, travel_time=2, c_move=0.1), marks=pytest.mark.slow),
        ("priority", Setting(c_suggest=0.1, robots=TWO)),
    ],
)
def test_step_by_step_it_is_what_is_simulated(tiny: Table, policy: str, setting: Setting) -> None:
    """With the same policy, people and random numbers, places, suggestions and beliefs are equal to the last bit."""
    pool = Pool.sample(tiny, 4, seed=2, setting=setting, population=Population(beta=(0.1, 0.6)))
    team = [2, 0, 3]
    trace, watched = trace_of(pool, policy, team)
    people = {str(place): pool.policies[pool.model[number]] for place, number in enumerate(team)}
    desk = Assistant(people=people, policy=policy, setting=setting)
    travel, home, arrivals, spoken = setting.travel(3), 3, [0] * len(setting.fleet), 0
    for step in range(trace[-1]["step"] + 1):
        for number, where in enumerate(desk.robots):
            if where is not None and step == arrivals[number]:
                desk.arrived(where, robot=number + 1)
        before = desk.robots
        advice = desk.recommend_all()
        for number, (here, there) in enumerate(zip(before, desk.robots, strict=True)):
            if here != there:
                way = np.array([[number], [home if here is None else int(here)], [int(there or 0)]])
                arrivals[number] = step + int(travel.steps_between(*way)[0])
        for row in (row for row in trace if row["step"] == step):
            name = str(row["place"])
            known = desk.person(name)
            if step in watched.seen:
                assert (known.belief == watched.seen[step][row["place"]]).all()
            assert known.cost_to_go == row["cost_to_go"]
            assert known.suggestion == row["suggestion"]
            assert (
                row["suggestion"] in [one.suggestion for one in advice if one.person == name] or not row["suggestion"]
            )
            assert row["robot_places"] == [
                int(where) if where and arrivals[number] <= step else None for number, where in enumerate(desk.robots)
            ]
            spoken += row["suggestion"] is not None
            desk.observe(name, row["action"])
    assert desk.finished
    assert (spoken > 0) == (policy != "none")
    assert [(r["person"], r["action"], r["suggestion"]) for r in desk.log()] == sorted(
        ((str(r["place"]), r["action"], r["suggestion"]) for r in trace), key=lambda r: r[0]
    )


def answers(task: CostToGo, actions: list[str]) -> Assistant:
    """Return an assistant of a person who takes these actions, whatever is suggested."""
    desk = Assistant(task, ["ann"], setting=Setting(c_suggest=0.05))
    for action in actions:
        desk.recommend()
        desk.observe("ann", action)
    return desk


MANY_MISTAKES = ["(fetch box-a)", WRONG, "(return box-a)", "(fetch box-a)", "(remove hammer slot-2 box-a)", RIGHT]


def test_what_is_believed_does_not_depend_on_where_regions_end(tiny: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = answers(tiny, MANY_MISTAKES)
    monkeypatch.setattr(person_problem, "WHOLE", 3)
    monkeypatch.setattr(shared_task, "REGION", {"sweep": 3, "on-demand": 2})
    for task in (tiny, OnDemand(tiny.task)):
        parts = answers(task, MANY_MISTAKES)
        assert [row["action"] for row in parts.log()] == [row["action"] for row in whole.log()]
        silent = {step: row["suggestion"] for step, row in enumerate(parts.log())}
        told = Assistant.from_json(parts.to_json(), task)
        assert told.to_json() == parts.to_json()
        # The same suggestions, followed through the whole table.
        replayed = Assistant(tiny, ["ann"], setting=Setting(c_suggest=0.05))
        record = replayed.roster.by_name["ann"]
        for step, action in enumerate(MANY_MISTAKES):
            replayed.roster.suggest(record, silent[step])
            replayed.observe("ann", action)
        for desk in (parts, told):
            assert (desk.person("ann").belief == replayed.person("ann").belief).all()
            assert desk.person("ann").cost_to_go == replayed.person("ann").cost_to_go


@pytest.mark.parametrize("policy", thinned(["priority", "reactive", "attention"], every=3))
def test_a_large_task_is_looked_at_where_people_are(tiny: Table, monkeypatch: pytest.MonkeyPatch, policy: str) -> None:
    """With a region of all states the advice is the same; with a small region it is still valid."""
    setting = Setting(c_suggest=0.05, c_move=0.01, travel_time=1 if policy == "priority" else 0, trust="paper")
    names, choices = ["ann", "bob", "cem"], Choices.of(tiny)
    desks = [Assistant(tiny, names, policy=policy, setting=setting)]
    monkeypatch.setattr(person_problem, "WHOLE", 3)
    for states in (len(tiny), 6):
        monkeypatch.setattr(shared_task, "REGION", {"sweep": states})
        desks.append(Assistant(tiny, names, policy=policy, setting=setting))
    whole, every, few = desks
    rng, said = np.random.default_rng(1), dict.fromkeys(desks, 0)
    for _ in range(45):
        for desk in desks:
            if desk.robots[0] is not None:
                desk.arrived(desk.robots[0])
            advice = desk.recommend()
            if advice.person is not None and advice.suggestion is not None:
                said[desk] += 1
                they = desk.person(advice.person)
                assert choices.optimal[they.state, they.applicable.index(advice.suggestion)]
        first, second = whole.recommend(), every.recommend()
        assert (first.person, first.suggestion) == (second.person, second.suggestion)
        assert first.reason is None or first.reason.saving == pytest.approx(second.reason.saving, abs=2e-3)
        name = names[rng.integers(3)]
        for desk in desks:
            if desk.person(name).finished:
                desk.begin(name)
        applicable = whole.person(name).applicable
        action = applicable[rng.integers(len(applicable))]
        for desk in desks:
            assert desk.person(name).applicable == applicable
            desk.observe(name, action)
        assert (whole.person(name).belief == every.person(name).belief).all()
    assert min(said.values()) > 10
    assert every.log() == whole.log()
    again = Assistant.from_json(few.to_json(), tiny)
    assert again.to_json() == few.to_json()
    name = next(name for name in names if few.person(name).steps > 1)
    believed = few.person(name).belief
    assert (again.person(name).belief == believed).all()
    few.observe(name, few.undo(name))
    assert (few.person(name).belief == believed).all()


def test_a_suggestion_stands_until_it_is_answered(tiny: Table) -> None:
    desk = Assistant(tiny, ["ann", "bob"], setting=Setting(c_suggest=0.05, c_move=0.0))
    for name in desk.people:
        desk.observe(name, "(fetch box-a)")
        desk.observe(name, WRONG)
    first = desk.recommend()
    assert first == desk.recommend()
    assert first.person
    assert first.suggestion
    assert first.reason is not None
    assert first.reason.score == first.reason.saving - first.reason.moving > 0
    assert first.reason.beta_interval[0] <= first.reason.beta <= first.reason.beta_interval[1]
    other = "bob" if first.person == "ann" else "ann"
    desk.observe(other, "(return box-a)")
    second = desk.recommend()
    assert second.person == other
    assert desk.person(first.person).suggestion == first.suggestion
    before = desk.person(first.person)
    desk.observe(first.person, first.suggestion)
    assert desk.log()[2 if first.person == "ann" else 5]["suggestion"] == first.suggestion
    assert desk.person(first.person).theta.mean > before.theta.mean


def test_what_was_not_heard_tells_nothing_of_influence(tiny: Table) -> None:
    desk = Assistant(tiny, ["ann"], setting=Setting(c_suggest=0.05, c_move=0.0))
    for action in ("(fetch box-a)", WRONG):
        desk.observe("ann", action)
    advice, before = desk.recommend(), desk.person("ann").belief
    assert advice.suggestion == "(remove hammer slot-2 box-a)"
    desk.observe("ann", advice.suggestion, heard=False)
    np.testing.assert_allclose(desk.person("ann").belief.sum(axis=0), before.sum(axis=0))
    desk.undo("ann")
    desk.observe("ann", advice.suggestion)
    assert desk.log()[-1]["suggestion"] is None  # it was taken back unheard


EVENTS = st.lists(
    st.tuples(
        st.sampled_from(["act", "act", "act", "advise", "advise", "undo", "leave", "join", "begin", "arrive"]),
        st.integers(0, 2), st.integers(0, 9),
    ),
    max_size=25,
)  # fmt: skip


def happen(desk: Assistant, events: list[tuple[str, int, int]]) -> None:
    """Apply events to a team of a, b and c, as far as they are possible."""
    for what, who, luck in events:
        name = "abc"[who]
        there = name in desk.people
        if what == "advise":
            desk.recommend()
        elif what == "join" and not there:
            desk.join(name)
        elif not there:
            continue
        elif what == "act" and not desk.person(name).finished:
            applicable = desk.person(name).applicable
            desk.observe(name, applicable[luck % len(applicable)], heard=luck < 8)
        elif what == "undo" and desk.person(name).steps:
            desk.undo(name)
        elif what == "leave":
            desk.leave(name)
        elif what == "begin":
            desk.begin(name)
        elif what == "arrive":
            desk.arrived(name if luck else None)


@costly(12, 40)
@given(EVENTS, EVENTS)
def test_a_restored_team_is_the_same_and_goes_on_the_same(
    tiny: Table, events: list[tuple[str, int, int]], more: list[tuple[str, int, int]]
) -> None:
    mixed = Population.mixed((Population(), Population(theta=(0.6, 0.7))), (0.25, 0.75))
    setting = Setting(c_suggest=0.05, c_move=0.1, travel_time=0.5 * (len(events) % 2))
    desk = Assistant(tiny, list("abc"), setting=setting, population=mixed)
    happen(desk, events)
    again = Assistant.from_json(desk.to_json(), tiny)
    for _ in range(2):
        assert again.to_json() == desk.to_json()
        for name in desk.people:
            assert (again.person(name).belief == desk.person(name).belief).all()
        assert again.recommend() == desk.recommend()
        happen(desk, more)
        happen(again, more)


@costly(15, 50)
@given(EVENTS, st.integers(0, 9))
def test_undo_takes_back_what_was_observed(tiny: Table, events: list[tuple[str, int, int]], luck: int) -> None:
    desk = Assistant(tiny, list("abc"), setting=Setting(c_suggest=0.05))
    happen(desk, events)
    for name in desk.people:
        before = desk.person(name)
        if before.finished:
            continue
        desk.observe(name, before.applicable[luck % len(before.applicable)])
        assert desk.undo(name) == before.applicable[luck % len(before.applicable)]
        after = desk.person(name)
        assert (after.belief == before.belief).all()
        assert (after.state, after.steps, after.suggestion) == (before.state, before.steps, before.suggestion)


def test_what_is_kept_of_others_is_what_would_be_worked_out(tiny: Table) -> None:
    """Only the person who acted is updated; a policy sees the same values as after a complete update."""
    seen = []

    def policy(team: Any) -> Any:
        seen.append(np.array_equal(team.q_values(), super(type(team), team).q_values()))
        return team.act(np.array([-1]), team.first_optimal())

    desk = Assistant(tiny, list("abc"), policy=policy)
    happen(desk, [(what, who, 0) for who in (0, 2, 1, 0) for what in ("act", "advise")])
    assert seen == [True] * 4


def test_people_come_and_go(tiny: Table, fixed: Table) -> None:
    desk = Assistant(tiny, ["ann"])
    desk.join("bob", fixed)
    assert desk.people == ("ann", "bob")
    assert desk.person("bob").cost_to_go == fixed[fixed.initial]
    desk.observe("bob", desk.person("bob").applicable[0])
    desk.leave("bob")
    assert desk.people == ("ann",)
    with pytest.raises(AbsentError, match="'bob' is not in the team; present: ann"):
        desk.observe("bob", "(return box-a)")
    for action in tiny.optimal_plan() or []:
        assert not desk.finished
        desk.observe("ann", action)
    assert desk.finished
    with pytest.raises(InapplicableError, match="ann has reached the goal"):
        desk.observe("ann", "(fetch box-a)")
    believed = desk.person("ann").belief
    desk.join("bob")
    assert desk.person("bob").steps == 1
    assert not desk.finished
    desk.begin("ann", fixed)
    assert (desk.person("ann").belief == believed).all()
    assert [row["episode"] for row in desk.log()] == ["1"] * 7
    desk.observe("ann", desk.person("ann").applicable[0])
    assert [row["episode"] for row in desk.log() if row["person"] == "ann"] == ["1"] * 6 + ["2"]
    restored = Assistant.from_json(desk.to_json(), fixed, tiny)
    assert (restored.person("ann").belief == desk.person("ann").belief).all()
    with pytest.raises(ValueError, match="the task 'task 1' is not among the 1"):
        Assistant.from_json(desk.to_json(), fixed)


def test_a_team_is_not_restored_with_people_who_choose_otherwise(tiny: Table) -> None:
    """Each policy is for its own choice model, and a belief from the other would be wrong."""
    weights = {"ann": {"goals": 3.0}, "bob": {"goals": -3.0}}
    solved = {
        name: qmdp(
            AssistPOMDP.of(
                HumanModel.exact(remembered(tiny, {"goals": TERMS["goals"]})), behaviour=Behaviour(Weighted(one))
            )
        )
        for name, one in weights.items()
    }
    desk = Assistant(people=solved)
    for name in solved:
        desk.observe(name, "(fetch box-a)")
        desk.observe(name, WRONG)
    assert not np.allclose(desk.person("ann").belief, desk.person("bob").belief)
    restored = Assistant.from_json(desk.to_json(), *reversed(solved.values()))
    for name in solved:
        assert (restored.person(name).belief == desk.person(name).belief).all()
    with pytest.raises(ValueError, match="the task 'task 2' is not among the 1"):
        Assistant.from_json(desk.to_json(), solved["ann"])
    own = Assistant(tiny, ["ann"], population=Population(chooses=lambda *known: boltzmann(*known)))
    with pytest.raises(ValueError, match="a function that is not saved"):
        Assistant.from_json(own.to_json(), tiny)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda desk, _: desk.observe("anne", "(fetch box-a)"), "'anne' is not in the team; present: ann, bob"),
        (
            lambda desk, _: desk.observe("ann", "(plaec hammer slot-2)"),
            r"'plaec'; nearest in spelling of all actions: \(place hammer slot-2\); of the 2 applicable: \(fetch",
        ),
        (lambda desk, _: desk.observe("ann", "(fetch box-c)"), "box-c\\) is no action of the task; nearest in"),
        (
            lambda desk, _: desk.observe("ann", "(return box-a)"),
            r"not applicable here; nearest in spelling of the 2.*\(fetch box-a\)",
        ),
        (lambda desk, _: desk.observe("ann", "(fetch box-a)", id=""), "id '': expected 1 to 128 characters"),
        (lambda desk, _: desk.undo("ann"), "ann has done nothing yet"),
        (lambda desk, _: desk.undo("ann", of="left"), "of 'left': expected one of acted, answered"),
        (lambda desk, _: desk.undo("ann", of="answerd"), "of 'answerd': did you mean 'answered'?"),
        (lambda desk, _: desk.join("ann"), "ann is there already"),
        (lambda desk, _: desk.join(" "), "expected a name"),
        (lambda _, task: Assistant(task, "ann"), "expected a list of names"),
        (lambda _, task: Assistant(task, policy="atention"), "unknown policy 'atention'; did you mean 'attention'"),
        (lambda *_: Assistant(None, ["ann"]), "there is no task"),
        (lambda _, task: Assistant(task, ["ann"], setting=Setting(execute=True)), "expected a robot that suggests"),
        (lambda _, task: Assistant.from_json("{}", task), "no saved team"),
        (lambda desk, task: Assistant.from_json(desk.to_json()[:-9], task), "no saved team"),
        (lambda desk, task: Assistant.from_json(json.dumps({**json.loads(desk.to_json()), "population": []}), task),
         "no saved team"),
        (lambda _, task: Assistant(task, ["a", "b"], distance=np.zeros((2, 2))), "b: there is a place for 1 people"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_one_line_and_changes_nothing(tiny: Table, call: Any, says: str) -> None:
    desk = Assistant(tiny, ["ann", "bob"])
    before = desk.to_json()
    with pytest.raises((TypeError, ValueError), match=says) as error:
        call(desk, tiny)
    assert "\n" not in str(error.value)
    assert desk.to_json() == before
    assert json.loads(before)["records"][0]["event"]["person"] == "ann"


@pytest.mark.parametrize("reports", [False, True])
def test_a_robot_on_its_way_to_a_person_who_leaves_helps_others(tiny: Table, reports: bool) -> None:
    """This holds whether or not the robot reports its arrival at the station of the person who left."""
    desk = Assistant(tiny, ["ann", "bob"], policy="reactive", setting=Setting(travel_time=2, c_suggest=0, c_move=0))
    for name in ("ann", "bob"):
        desk.observe(name, "(fetch box-a)")
    desk.observe("ann", WRONG)
    going = desk.recommend()
    assert (going.person, going.arrived) == ("ann", False)
    desk.leave("ann")
    if reports:
        desk.arrived("ann")
    assert desk.recommend().person is None
    desk.observe("bob", WRONG)
    assert desk.recommend().person == "bob"
    again = Assistant.from_json(desk.to_json(), tiny)
    again.join("ann")
    assert again.recommend() == desk.recommend()
    desk.arrived("bob")
    assert desk.recommend().arrived
    with pytest.raises(AbsentError):
        desk.arrived("carl")


def test_a_reason_counts_answers_and_expects_the_next(tiny: Table) -> None:
    """Of three suggestions one was followed; the expectation is the likelihood of following under the belief."""
    desk = Assistant(tiny, ["ann"], setting=Setting(c_suggest=0.0, c_move=0.0, trust="paper"), population=Population())
    for follows in (True, False, False):
        advice = desk.recommend()
        assert advice.suggestion is not None
        others = [action for action in desk.person("ann").applicable if action != advice.suggestion]
        desk.observe("ann", advice.suggestion if follows or not others else others[0])
    advice = desk.recommend()
    assert advice.reason is not None
    answered = [row for row in desk.log() if row["suggestion"] is not None]
    assert advice.reason.suggestions == len(answered) == 3
    assert advice.reason.followed == sum(row["suggestion"] == row["action"] for row in answered)
    state, policy = desk.person("ann"), qmdp(Assumptions.of(desk.setting, None, Population()).problem(Choices.of(tiny)))
    x, robot = np.array([state.state]), np.array([int(policy.choose(np.array([state.state]), state.belief[None])[0])])
    chance = policy.pomdp.likelihood(x, robot, policy.pomdp.suggested[x, robot])[0]
    assert advice.reason.follow == pytest.approx(float((chance * state.belief).sum()))
    assert advice.reason.follow_interval[0] <= advice.reason.follow <= advice.reason.follow_interval[1]
