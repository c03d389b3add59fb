"""Teams of several robots: their joint assignment, simulation with every policy, and the bound."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import graph_task, invoke, thinned
from teams import state

from assist.certify.coupled import Agents, joint_optimum
from assist.certify.options import BoundOptions
from assist.certify.prices import kinds_of
from assist.certify.team_bound import upper_bound
from assist.declare.declared import plain
from assist.people.choices import Choices
from assist.people.ranges import Population
from assist.people.user_code import UserCodeError
from assist.person.attention_subproblem import AttentionSubproblem
from assist.person.qmdp import qmdp
from assist.person.robots import Robot
from assist.person.settings import Setting
from assist.team.action_check import check
from assist.team.episodes import Episodes
from assist.team.policy_names import POLICIES
from assist.team.pool import Pool
from assist.team.simulate import simulate
from assist.team.state import BASE, NOBODY, TeamAction, TeamState
from assist.team.trace import Trace
from planner import sweep

FAR: list[list[float]] = [[0, 1, 2, 3], [1, 0, 1.5, 1], [2, 1.5, 0, 2], [3, 1, 2, 0]]


@pytest.fixture(scope="module")
def strangers() -> Pool:
    """Four people on a chain from 3 to the goal 0, on which a step back from 2 costs 4; one policy for all."""
    task = graph_task([(3, 2, 1), (2, 1, 1), (1, 0, 1), (2, 3, 4), (1, 2, 1)], start=3)
    setting = Setting(knowledge="exact", gamma=0.9, c_suggest=0.05, c_move=0.05)
    return Pool.sample(Choices.of(sweep(task)), 4, seed=1, setting=setting, population=Population(beta=(0.1, 0.5)))


def of(pool: Pool, robots: int, **setting: Any) -> Pool:
    return replace(pool, setting=replace(pool.setting, robots=robots, **setting))


def run(pool: Pool, policy: str, humans: int = 3, episodes: int = 50, **options: Any) -> Episodes:
    return simulate(pool, policy, humans=humans, episodes=episodes, seed=3, **options)


@pytest.mark.parametrize(
    ("name", "travel_time", "distance"),
    [
        pytest.param(name, time, distance, marks=[pytest.mark.slow] * (time == 1 or (time > 0 and name != "priority")))
        for name in POLICIES
        for time, distance in ((0, None), (1, None), (0.7, FAR))
    ],
)
def test_two_robots_never_attend_the_same_person(
    pool: Pool, name: str, travel_time: float, distance: list[list[float]] | None
) -> None:
    trace: Trace = []
    two = of(pool, 2, travel_time=travel_time)
    travel = two.setting.travel(3, distance)
    episodes = run(two, name, episodes=10 if name == "rollout" else 20, trace=trace, travel=travel)
    for episode in episodes:
        rows = [row for row in trace if row["episode"] == f"{name}-{episode.episode}"]
        assert sum(row["suggestion"] is not None for row in rows) == episode.interventions
        for row in rows:
            there = [place for place in row["robot_places"] if place is not None]
            assert len(set(there)) == len(there)
            assert row["suggestion"] is None or row["place"] in there
    assert (episodes.interventions > 0).any() == (name != "none")
    if travel_time:
        return
    both = {tuple(row["robot_places"]) for row in trace if None not in row["robot_places"]}
    assert bool(both) == (name != "none")  # two robots are with two people at a time


def test_with_a_robot_each_everybody_is_always_attended_to(pool: Pool) -> None:
    """If moves are free, as many robots as people serve each person like a robot of their own."""
    each = of(pool, 3, c_move=0.0)
    policy = each.policy("attention")

    def everybody(team: TeamState) -> TeamAction:
        q = team.q_values()
        robot = np.where(team.active, q.argmax(axis=2), 0)
        person = np.where(robot > 0, np.arange(3), NOBODY)
        return TeamAction(person, robot)

    def checked(team: TeamState) -> TeamAction:
        action = policy(team)
        said = np.zeros_like(team.x)
        n, m = np.nonzero(action.person != NOBODY)
        said[n, action.person[n, m]] = action.action[n, m]
        np.testing.assert_array_equal(said, everybody(team).action)
        return action

    found = simulate(each, checked, humans=3, episodes=50, seed=3)
    assert (found.discounted_return == simulate(each, everybody, humans=3, episodes=50, seed=3).discounted_return).all()
    more = run(of(pool, 4, c_move=0.0), "attention")
    assert (more.discounted_return == found.discounted_return).all()


def test_more_robots_are_worth_more(strangers: Pool) -> None:
    found = [run(of(strangers, robots), "priority", 4, 1000).discounted_return for robots in (1, 2, 3, 4)]
    for fewer, more in itertools.pairwise(found):
        difference = more - fewer
        assert difference.mean() > -2 * difference.std() / np.sqrt(len(difference))
    assert (found[1] - found[0]).mean() > 0.01


def test_what_a_policy_for_several_robots_may_not_do(pool: Pool) -> None:
    team = replace(state(of(pool, 2), [pool.choices(0).initial] * 3), location=np.array([[BASE, 1]]))
    for person, complaint in (
        ([0, 0], "lets two robots be with one person"),
        ([0, 3], "goes to person 3 in a team of 3"),
    ):
        with pytest.raises(UserCodeError, match=complaint):
            check(team, TeamAction(np.array([person]), np.zeros((1, 2), dtype=np.int64)))
    for person in ([1, 0], [1, NOBODY]):  # the second robot goes elsewhere, or makes room
        check(team, TeamAction(np.array([person]), np.zeros((1, 2), dtype=np.int64)))
    with pytest.raises(UserCodeError, match=r"shape \(1, 2\), an entry for each robot"):
        check(team, TeamAction(np.array([0]), np.array([0])))
    under_way = replace(team, free=np.array([[True, False]]))
    with pytest.raises(UserCodeError, match="sends a robot that is under way"):
        check(under_way, TeamAction(np.array([[NOBODY, 2]]), np.zeros((1, 2), dtype=np.int64)))


@pytest.mark.parametrize("robots", [0, -1, 1.5, "two"])
def test_a_team_has_a_whole_number_of_robots(robots: object) -> None:
    with pytest.raises(ValueError, match="robots"):
        Setting(robots=robots)  # type: ignore[arg-type]
    assert plain(Setting())["robots"] == [{}]
    assert Setting(**plain(Setting(robots=3))).robots == (Robot(),) * 3


def as_agents(visits: AttentionSubproblem, people: int) -> Agents:
    """Return people whose beta and theta the robots know, each with a robot that comes and goes."""
    pomdp, choices = visits.pomdp, visits.pomdp.model.choices
    (known,) = np.flatnonzero(pomdp.prior)
    shape = (pomdp.robot_costs.shape[1], len(pomdp.robot_actions))
    P, R = np.zeros((*shape, shape[1])), np.zeros(shape)
    for x, r in itertools.product(range(shape[1]), range(shape[0])):
        if pomdp.ends[x] or r >= pomdp.robot_actions[x]:
            P[r, x, x] = 1.0
            continue
        R[r, x], place = -pomdp.robot_costs[x, r], pomdp.afterstate[x, r]
        for a in np.flatnonzero(choices.applicable[place]):
            chance = pomdp.likelihood(np.array([x]), np.array([r]), np.array([a])).reshape(-1)[known]
            P[r, x, choices.targets[place, a]] += chance
            R[r, x] -= chance * choices.costs[place, a]
    allowed = np.arange(shape[0])[:, None] < pomdp.robot_actions
    start = np.full(people, choices.initial)
    return Agents([P], [R], visits.attended().T[None], start, pomdp.gamma, allowed[None], np.zeros(people, dtype=int))


@pytest.mark.parametrize("case", thinned([(2, 3), (1, 3), (2, 0)], 3))
def test_samples_are_not_below_the_joint_optimum(case: tuple[int, int]) -> None:
    """Three alike people whose beta and theta are known, so that all joint states can be enumerated."""
    robots, window = case
    task = graph_task([(3, 2, 1), (2, 1, 1), (1, 0, 1), (2, 3, 4), (1, 2, 1)], start=3)
    setting = Setting(
        knowledge="exact", gamma=0.9, c_suggest=0.05, c_move=0.05, robots=robots, trust="constant", lapse=0.0
    )
    population = Population(beta=(0.3, 0.3), theta=(0.5, 0.5))
    pool = Pool.sample(Choices.of(sweep(task)), 3, seed=1, setting=setting, population=population)
    pomdp = pool.policies[0].pomdp
    prior = np.zeros_like(pomdp.prior)
    prior[0, len(pomdp.grid.theta) // 2] = 1.0
    pool = replace(pool, policies=(qmdp(replace(pomdp, prior=prior)),))
    (kind,) = kinds_of(pool, (0, 1, 2), setting.travel(3), 0)
    best = joint_optimum(as_agents(kind.at(np.zeros(0)), 3), robots)
    found = upper_bound(pool, window=window, gap=1e-6, paths=40, options=BoundOptions(10, 200))
    assert found.sampled is not None
    assert found.sampled.mean + 3 * found.sampled.stderr >= best.value
    assert found.proven >= best.value
    assert found.sampled.mean < found.proven - 0.3 * (found.proven - best.value)  # of what prices lose
    attended = found.policy()
    certificate = found.certify(attended, episodes=2000)
    assert certificate.value - 3 * certificate.value_stderr <= best.value


def test_nothing_is_sampled_where_no_robot_has_to_choose(strangers: Pool) -> None:
    found = upper_bound(of(strangers, 3), (0, 1, 2), paths=30, gap=1e-2)
    assert found.sampled is None
    assert found.upper == found.proven


def test_commands_with_several_robots(tmp_path: Path) -> None:
    trace = tmp_path / "trace.jsonl"
    costs = ("--c-suggest", 0.1, "--c-move", 0.2, "--set", "knowledge=exact", "--json")
    found = invoke(
        "simulate", "kitting/tiny", "--humans", 3, "--robots", 2, "--policy", "priority", "--episodes", 20, *costs,
        "--trace", trace,
    )  # fmt: skip
    assert json.loads(found.stdout)["setting"]["robots"] == [{}, {}]
    assert len(json.loads(trace.read_text().splitlines()[0])["robot_places"]) == 2
    found = invoke(
        "bound", "kitting/tiny", "--humans", 2, "--robots", 2, "--policy", "priority", "--value-episodes", 500,
        "--gap", 0.05, *costs,
    )  # fmt: skip
    record = json.loads(found.stdout)
    assert record["value"] - 3 * record["value_stderr"] <= record["upper"]
    more = ("--samples", 30, "--value-episodes", 100, "--gap", 0.05)
    found = invoke("bound", "kitting/tiny", "--humans", 2, "--robots", 2, *more, *costs[:-1])
    assert "sample" not in found.stdout  # as no robot has to choose
