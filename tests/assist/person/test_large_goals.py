"""People who pursue one of several goals on a task that is too large to enumerate."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from conftest import thinned
from teams import equal
from test_unknown_goals import three_goals

from assist.certify import upper_bound
from assist.live import Assistant
from assist.people import Choices, Goals, Human, HumanModel
from assist.people.misconception import Misconception
from assist.people.ranges import Population
from assist.person import AssistPOMDP, OfRobots, PersonProblem, Setting, TruncatedTask, person_problem
from assist.person.assumptions import Assumptions
from assist.person.closed_problem import closed_problem
from assist.person.each_goal import given_goals
from assist.person.mdp_values import evaluate
from assist.person.memory_needed import depth_within, first_bounds_bytes, states_within
from assist.person.qmdp import QMDP, qmdp
from assist.person.shared_task import default_size
from assist.person.solver import solve
from assist.person.truncated_policy import TruncatedPolicy
from assist.team import Pool, simulate
from planner import LimitError

EVERYTHING = 10_000  # states, more than these tasks have
SETTING = Setting(c_suggest=0.2, c_move=0.1, max_steps=60)
OPTIONS: dict[str, Any] = {"humans": 2, "episodes": 24, "seed": 3}
OTHERS = ("none", "priority", "whittle")


def pools(goals: Goals, setting: Setting, region: int = EVERYTHING) -> tuple[Pool, Pool]:
    """The same people, on the whole task and on a truncated one."""
    return (
        Pool.sample(goals, 3, seed=1, setting=setting),
        Pool.sample(goals, 3, seed=1, setting=setting, states=1, region=region),
    )


@pytest.mark.parametrize("policy", ["attention", *(pytest.param(name, marks=pytest.mark.slow) for name in OTHERS)])
@pytest.mark.parametrize("world", thinned(["people", "model"]))
def test_with_all_states_episodes_are_those_of_the_whole_task(policy: str, world: Any) -> None:
    whole, part = pools(three_goals("tiny"), SETTING)
    assert isinstance(part.policies[0], TruncatedPolicy)
    found = [simulate(pool, policy, world=world, **OPTIONS) for pool in (whole, part)]
    assert equal(*found)
    assert (policy == "none") == (not found[0].interventions.any())


@pytest.mark.parametrize("knows", thinned(["likeliest", "inferred", "known"]))
def test_of_whom_only_the_task_is_known(knows: Any) -> None:
    setting = Setting(c_suggest=0.05, c_move=0.1, max_steps=60, knowledge="exact")
    found = [simulate(pool, "attention", goals=knows, **OPTIONS) for pool in pools(three_goals("tiny"), setting)]
    assert equal(*found)
    assert found[0].interventions.any()


@pytest.mark.parametrize("suggestions", ["optimal", "all"])
@pytest.mark.parametrize("knowledge", thinned(["own", "exact"]))
def test_values_with_all_states_are_those_of_the_whole_task(knowledge: Any, suggestions: Any) -> None:
    """For beliefs in all goals; the robot may suggest what is optimal for any of them."""
    goals, rng = three_goals("tiny"), np.random.default_rng(4)
    setting = Setting(c_suggest=0.05, knowledge=knowledge, suggestions=suggestions)
    whole, part = (pool.policies[0] for pool in pools(goals, setting))
    x = np.arange(len(goals.tables["a"]))
    belief = rng.dirichlet(np.ones(whole.pomdp.prior.size), len(x)).reshape(-1, *whole.pomdp.prior.shape)
    expected, found = (policy.q_values(policy.rows(x), belief) for policy in (whole, part))
    assert np.isfinite(expected[:, : found.shape[1]]).sum() == np.isfinite(expected).sum()
    np.testing.assert_allclose(found, expected[:, : found.shape[1]], rtol=0, atol=1e-9)


def test_each_goals_problem_is_that_of_people_with_that_goal() -> None:
    goals = three_goals("tiny")
    more: dict[str, Any] = {"suggestions": "all", "robot": OfRobots(c_suggest=0.2)}
    every = given_goals(AssistPOMDP.of(HumanModel.exact(goals.choices()), **more))
    assert [share for share, _ in every] == list(goals.prior.values())
    for (_, problem), table in zip(every, goals.tables.values(), strict=True):
        alone = AssistPOMDP.of(HumanModel.exact(Choices.of(table)), **more)
        np.testing.assert_allclose(problem.prior, alone.prior, rtol=1e-12)
        np.testing.assert_allclose(qmdp(problem).value_mdp, qmdp(alone).value_mdp, atol=1e-5)


def test_a_solver_of_ones_own_acts_for_people_with_several_goals(monkeypatch: pytest.MonkeyPatch) -> None:
    """On all states its policy is that on the whole task; a user's solver sees the problem with all goals."""
    seen = list[AssistPOMDP]()

    def by_halves(pomdp: AssistPOMDP) -> QMDP:
        seen.append(pomdp)
        solved = qmdp(pomdp)
        return QMDP(pomdp, solved.value_mdp / 2, solved.q_mdp / 2)  # no other policy gives these

    goals, rng = three_goals("tiny"), np.random.default_rng(4)
    sample = partial(Pool.sample, goals, 2, seed=1, setting=Setting(c_suggest=0.05), solver=by_halves)
    whole = sample().policies[0]
    monkeypatch.setattr("assist.team.solving.MAX_ENUMERATED", 1)
    part = sample(region=EVERYTHING).policies[0]
    x = np.arange(len(goals.tables["a"]))
    belief = rng.dirichlet(np.ones(whole.pomdp.prior.size), len(x)).reshape(-1, *whole.pomdp.prior.shape)
    expected, found = (policy.q_values(policy.rows(x), belief) for policy in (whole, part))
    np.testing.assert_allclose(found, expected[:, : found.shape[1]], rtol=0, atol=1e-9)
    assert [len(pomdp.hidden.goals) for pomdp in seen] == [3, 3]
    assert simulate(sample(region=5), "attention", **OPTIONS).finished.any()


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["attention", "priority"])
def test_so_it_is_where_goals_have_dead_ends(policy: str) -> None:
    assert equal(*(simulate(pool, policy, **OPTIONS) for pool in pools(three_goals("sealed"), SETTING)))


def test_a_live_robot_infers_goals_of_a_large_task(monkeypatch: pytest.MonkeyPatch) -> None:
    goals, said, parts = three_goals("tiny"), list[list[Any]](), list[bool]()
    setting = Setting(c_suggest=0.05, c_move=0.0)
    for whole in (True, False):
        if not whole:
            monkeypatch.setattr(person_problem, "is_whole", lambda _: False)
        desk = Assistant(goals, ["ann"], setting=setting)
        found: list[Any] = []
        for action in ("(fetch box-a)", "(place hammer slot-2 box-a)", "(return box-a)"):
            advice = desk.recommend().as_dict()
            seen = desk.person("ann")
            text = desk.explain().text()
            found.append((advice["suggestion"], text, seen.applicable, seen.cost_to_go, dict(seen.goals)))
            found.append(seen.belief.tobytes())
            desk.observe("ann", action)
        said.append(found)
        parts.append(isinstance(desk.person("ann") and desk.roster.records[0].problem.policy, TruncatedPolicy))
    assert parts == [False, True]
    assert said[0] == said[1]


@pytest.mark.parametrize("states", [4, 60])
def test_a_truncated_task_of_all_goals_has_bounds_for_each(states: int) -> None:
    """Compared with the values on the whole task: of a robot that is told the goal, and of one that does nothing."""
    goals = three_goals("sealed")
    part = TruncatedTask.of(goals, states=states)
    full, rows = goals.choices(), part.states
    np.testing.assert_array_equal(part.choices.goals.h, full.goals.h[:, rows])
    np.testing.assert_array_equal(part.choices.goals.goal, full.goals.goal[:, rows])
    inside = np.setdiff1d(np.flatnonzero(part.choices.applicable.any(axis=1)), part.frontier)
    for x in inside[:: max(1, len(inside) // 200)].tolist():
        count = part.choices.applicable[x].sum()
        theirs = rows[x]
        assert count == full.applicable[theirs].sum()
        for own, whole in zip(part.choices.of_each_goal, full.of_each_goal, strict=True):
            assert set(own.actions[x][own.optimal[x]]) == set(whole.actions[theirs][whole.optimal[theirs]])
        assert sorted(rows[part.choices.targets[x, :count]]) == sorted(full.targets[theirs, :count])
    setting = {"gamma": 0.97, "robot": OfRobots(c_suggest=0.3)}
    problem = AssistPOMDP.of(HumanModel.exact(full), **setting)  # type: ignore[arg-type]
    frontier = closed_problem(part, Assumptions(**setting)).frontier  # type: ignore[arg-type]
    assert frontier is not None
    assert len(frontier.states) == len(part.frontier) > 0
    leaves = rows[part.frontier]
    assert (qmdp(problem).value_mdp[leaves] <= frontier.upper + 1e-9).all()
    never = evaluate(problem, np.zeros(len(full), dtype=np.int64))
    assert (never[leaves] >= frontier.lower - 1e-8).all()  # `evaluate` is lowered by its rounding errors
    assert frontier.floor is not None
    assert (frontier.lower > frontier.floor).any()


def test_bounds_on_a_truncated_task_contain_the_value_on_the_whole() -> None:
    """The value is bounded independently, on all states; with all of them, the problem is the same."""
    goals, setting = three_goals("tiny"), Setting(gamma=0.9, c_suggest=0.05)
    size = len(goals.tables["a"])
    problems = [PersonProblem.of(goals, states=states, setting=setting) for states in (size, 4, 12)]
    exact, *found = (solve(one.pomdp, gap=1e-2) for one in problems)
    for one, truncated in zip(found, problems[1:], strict=True):
        assert one.lower <= exact.upper
        assert exact.lower <= one.upper
        assert one.value_never <= exact.upper
        assert len(truncated.states) == len(truncated.pomdp.robot_actions)
    assert found[0].upper - found[0].lower > found[1].upper - found[1].lower > 0
    part = TruncatedTask.of(goals, states=size)
    assert (len(part.frontier), sorted(part.states)) == (0, [*range(size)])
    same = solve(closed_problem(part, Assumptions.of(setting, None, Population())), gap=1e-2)
    assert same.lower <= exact.upper
    assert exact.lower <= same.upper
    assert same.value_qmdp == pytest.approx(exact.value_qmdp, abs=1e-5)
    assert same.value_never == pytest.approx(exact.value_never, abs=1e-3)


def test_a_truncated_task_holds_the_likeliest_states_of_all_goals() -> None:
    """With the whole prior on one goal it is that goal's, and misconceptions are the same for every goal."""
    goals = three_goals("sealed")
    for number, (name, table) in enumerate(goals.tables.items()):
        certain = Goals(goals.tables, {other: float(other == name) for other in goals.tables})
        own, joint = (TruncatedTask.of(task, states=20) for task in (table, certain))
        expanded = [np.delete(part.states, part.frontier) for part in (own, joint)]
        assert set(expanded[0][table.h[expanded[0]] > 0]) <= set(expanded[1])
        human = Human(1.0, 0.5, 1.0, Misconception(1.0, 5))
        one = TruncatedTask.of(table, states=20, among=goals)
        assert one.choices.offered is not None
        assert (one.choices.offered >= one.choices.optimal)[~one.choices.goal].all()
        perceived = human.expects(joint.choices.of_goal(number))
        place = joint.local(one.states)
        np.testing.assert_array_equal(perceived[place[place >= 0]], human.expects(one.choices)[place >= 0])


def test_the_size_of_a_part_counts_goals_and_memory() -> None:
    goals = three_goals("sealed")
    assert default_size(goals.tables["a"]) == 20_000
    assert default_size(goals) == 20_000 // 3
    assert states_within(4000, range(50), 12) > 1_000 > states_within(4000, range(50), 100)
    values = 4 * len(goals) * 60 * 8 / 1e6  # of enumerated policies for three people, and of a copy
    found = Pool.sample(goals, 3, seed=1, memory_limit_mb=values / 2)
    assert isinstance(found.policies[0], TruncatedPolicy)
    with pytest.raises(
        LimitError, match="policies for 3 people with 3 goals, on as few as 20 states, take about 1 MB of memory"
    ):
        Pool.sample(goals, 3, seed=1, memory_limit_mb=0.5)


def test_the_size_of_a_part_counts_memory_where_the_goal_is_known() -> None:
    table = three_goals("sealed").tables["a"]
    policies = Pool.sample(table, 3, seed=1, states=1, memory_limit_mb=1.0).policies
    assert {policy.ground.size for policy in policies} == {states_within(1.0, [table], 3)} == {41}  # type: ignore[attr-defined]
    with pytest.raises(LimitError, match="policies for 3 people, on as few as 20 states, take about 0 MB of memory"):
        Pool.sample(table, 3, seed=1, states=1, memory_limit_mb=0.4)


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["attention", "attention-never"])
def test_a_robot_asks_as_on_the_whole_task(policy: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Questions about goals are worth as much, and so is help against none."""
    goals, setting = three_goals("sealed"), Setting(c_suggest=0.2, c_move=0.1, c_ask=0.05, ask_error=0.1, max_steps=60)
    whole = Pool.sample(goals, 2, seed=1, setting=setting)
    monkeypatch.setattr("assist.team.solving.MAX_ENUMERATED", 5)
    parts = [Pool.sample(goals, 2, seed=1, setting=setting, states=1, region=region) for region in (EVERYTHING, 20)]
    assert all(isinstance(part.policies[0], TruncatedPolicy) for part in parts)
    found = [simulate(pool, policy, **OPTIONS | {"episodes": 12}) for pool in (whole, *parts)]
    assert equal(*found[:2])
    assert all(one.questions is not None and one.questions.sum() > 4 for one in found)


def test_a_live_robot_asks_about_goals_of_a_large_task(monkeypatch: pytest.MonkeyPatch) -> None:
    goals, said = three_goals("tiny"), list[list[Any]]()
    for whole in (True, False):
        monkeypatch.setattr(person_problem, "is_whole", lambda _, whole=whole: whole)
        desk = Assistant(goals, ["ann", "bob"], setting=Setting(c_suggest=0.2, c_move=0.0, c_ask=0.02))
        said.append([])
        for _ in range(8):
            advice = desk.recommend()
            asked = advice.question
            said[-1].append((advice.suggestion, None if asked is None else (asked.person, asked.goal)))
            if asked is not None:
                desk.answer(asked.person, asked.goal == "b")
            for person in desk.people:
                desk.observe(person, desk.person(person).applicable[0])
    assert said[0] == said[1]
    assert any(question for _, question in said[0])


@pytest.mark.slow
@pytest.mark.parametrize("knowledge", ["exact", "own"])
@pytest.mark.parametrize("region", [2, EVERYTHING])
def test_a_bound_on_a_truncated_task_is_one_on_the_whole(knowledge: Any, region: int) -> None:
    """It is at least that on all states, whose robot is told the goals as well, and above what policies reach."""
    setting = Setting(c_suggest=0.1, c_move=0.1, knowledge=knowledge, gamma=0.9)
    goals = three_goals("tiny")
    whole = Pool.sample(goals, 2, seed=1, setting=setting)
    exact = upper_bound(whole, gap=0.05)
    least = exact.upper - exact.slack
    found = upper_bound(Pool.sample(goals, 2, seed=1, setting=setting, states=1, region=region), gap=0.05)
    assert found.upper >= least - 1e-6
    value = found.certify("priority", episodes=200, seed=2)
    assert value.value - 4 * value.value_stderr <= found.upper
    assert region == 2 or found.upper <= exact.upper + 0.5


def test_a_problem_has_as_many_states_as_a_solver_can_keep() -> None:
    goals = three_goals("sealed")
    sizes = []
    for limit in (np.inf, 17.0, 1.0):
        found = PersonProblem.of(goals, states=100, memory_limit_mb=limit)
        assert found.pomdp.frontier is not None
        sizes.append(len(found.states))
        if limit > 1:
            depth = depth_within(found.pomdp, limit)
            assert first_bounds_bytes(found.pomdp, depth) <= 0.8e6 * limit
            assert depth == (500 if limit == np.inf else 125)
    assert sizes[0] > sizes[1] > sizes[2] > 20
    bounds = solve(found.pomdp, gap=1.0, memory_limit_mb=20.0)
    assert bounds.lower < bounds.upper
