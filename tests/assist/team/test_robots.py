"""Teams of robots, alike or different: joint assignment, costs and speeds, simulation, policies and the bound."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from conftest import graph_task, invoke, thinned
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field
from scipy.sparse import csr_array
from teams import state

from assist.certify import BoundOptions, upper_bound
from assist.certify.action_prices import paid, supply
from assist.certify.relaxed_value import relaxed_value
from assist.cli.options.config import read_config
from assist.cli.serve import serve
from assist.declare.declared import Number, Text, Whole, declared, plain
from assist.people import NOTHING, Choices, Population, UserCodeError
from assist.person import OfRobots, Robot, Setting, Travel, qmdp
from assist.person.fleet import Fleet
from assist.person.known_states import KnownStates
from assist.person.robots import Best
from assist.studies.protocol import read
from assist.team import BASE, NOBODY, POLICIES, Episodes, Pool, TeamAction, TeamState, assigned, simulate
from assist.team.action_check import check
from assist.team.trace import Trace
from planner import InputFileError, sweep

TASK = graph_task([(3, 2, 1), (2, 1, 1), (1, 0, 1), (2, 3, 4), (1, 2, 1)], start=3)
"""A chain from 3 to the goal 0, on which a step back from 2 costs 4."""
FAR = [[0, 1, 2.1, 3.3], [1, 0, 1.7, 1.2], [2.1, 1.7, 0, 2.4], [3.3, 1.2, 2.4, 0]]


@pytest.fixture(scope="module")
def strangers() -> Pool:
    """Four people on a chain from 3 to the goal 0, on which a step back from 2 costs 4; one policy for all."""
    setting = Setting(knowledge="exact", gamma=0.9, c_suggest=0.05, c_move=0.05)
    return Pool.sample(Choices.of(sweep(TASK)), 4, seed=1, setting=setting, population=Population(beta=(0.1, 0.5)))


def of(pool: Pool, robots: int, **setting: Any) -> Pool:
    return replace(pool, setting=replace(pool.setting, robots=robots, **setting))


def run(pool: Pool, policy: str, humans: int = 3, episodes: int = 50, **options: Any) -> Episodes:
    return simulate(pool, policy, humans=humans, episodes=episodes, seed=3, **options)


def policies(*quick: str) -> list[Any]:
    """Return all policies as parameters of a test, of which these are quick."""
    return [pytest.param(name, marks=[pytest.mark.slow] * (name not in quick)) for name in POLICIES]


def test_with_a_robot_each_everybody_is_always_attended_to(pool: Pool) -> None:
    """If moves are free, as many robots as people serve each person like a robot of their own."""
    each = of(pool, 3, c_move=0.0)
    policy = each.policy("attention")

    def everybody(team: TeamState) -> TeamAction:
        q = team.q_values()
        said = np.where(team.active, q.argmax(axis=2), 0)
        person = np.where(said > 0, np.arange(3), NOBODY)
        return TeamAction(person, said)

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
    under_way = replace(team, ready=np.array([[True, False]]))
    with pytest.raises(UserCodeError, match="sends a robot that is under way"):
        check(under_way, TeamAction(np.array([[NOBODY, 2]]), np.zeros((1, 2), dtype=np.int64)))


@pytest.mark.parametrize("window", thinned([3, 0]))
@pytest.mark.parametrize("robots", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_samples_are_not_below_the_joint_optimum(robots: int, window: int) -> None:
    """Alike people, one more than robots, whose beta and theta are known, so that joint states can be enumerated."""
    setting = Setting(
        knowledge="exact", gamma=0.9, c_suggest=0.05, c_move=0.05, trust="constant", lapse=0.0, robots=robots
    )
    pool = known_people(setting, robots + 1)
    best = joint_optimum(pool, setting.fleet.robots, robots + 1)
    found = upper_bound(pool, window=window, gap=1e-6, paths=40, options=BoundOptions(10, 200))
    assert found.sampled.mean + 3 * found.sampled.stderr >= best
    assert found.proven >= best
    assert found.sampled.mean < found.proven - 0.3 * (found.proven - best)  # of what prices lose
    certificate = found.certify(found.policy(), episodes=2000)
    assert certificate.value - 3 * certificate.value_stderr <= best


def test_nothing_is_sampled_where_no_robot_has_to_choose(strangers: Pool) -> None:
    found = upper_bound(of(strangers, 3), (0, 1, 2), paths=30, gap=1e-2)
    assert found.sampled is None
    assert found.upper == found.proven


def people(robots: int | tuple[Robot, ...], size: int = 3, **setting: Any) -> Pool:
    """Return people whom the robots do not know beforehand."""
    options: dict[str, Any] = {"knowledge": "exact", "gamma": 0.9, "c_suggest": 0.05, "c_move": 0.05} | setting
    chosen = Setting(robots=robots, **options)
    return Pool.sample(Choices.of(sweep(TASK)), size, seed=1, setting=chosen, population=Population(beta=(0.1, 0.5)))


@declared
class Waits(Robot):
    """A robot that pays for each step in which it is with a person and does nothing."""

    c_wait: Annotated[Number, Best(min), Field(ge=0, description="Cost of a step of waiting, in cost units.")] = 0.1

    @property
    def costs(self) -> tuple[float, float, float]:
        """What each class of robot actions costs."""
        return self.c_wait, self.c_suggest, self.c_execute


@declared(partial=True)
class Carries(OfRobots):
    """A robot that carries up to a number of kits; more is better."""

    kits: Annotated[Whole, Best(max), Field(ge=1, description="Kits that it carries.")] = 1
    name: Annotated[Text | None, Best(itemgetter(0)), Field(description="A name, or none.")] = None


@declared
class Cheaper(Carries):
    """A robot whose suggestions cost more the more kits it carries."""

    @property
    def costs(self) -> tuple[float, float, float]:
        """What each class of robot actions costs."""
        return 0.0, 0.1 * self.kits, 1.0


@declared
class Unmarked(Robot):
    """A robot with a field that does not say what the best of several robots has."""

    kits: Whole = 1


def test_a_field_says_what_the_best_robot_has() -> None:
    assert vars(Carries()) == dict.fromkeys(vars(OfRobots())) | {"kits": 1, "name": None}
    fleet = Fleet.of((Carries(kits=2), Carries(c_move=0.1)))  # type: ignore[arg-type]
    assert (fleet.best.kits, fleet.best.c_move, fleet.best.c_suggest) == (2, 0.1, 1.0)  # type: ignore[attr-defined]
    assert not fleet.alike
    assert not Fleet.of((Carries(kits=2), Carries())).alike  # type: ignore[arg-type]
    assert Fleet.of((Robot(c_execute=0.1), Robot())).alike  # which has no effect without execution
    assert Fleet.of((Robot(execute=True, c_execute=0.4), Robot(c_execute=0.1))).best.c_execute == 0.4
    with pytest.raises(ValueError, match=r"a suggestion costs robot 2 less than the best robot .* Cheaper\.costs"):
        _ = Fleet.of((Cheaper(kits=2), Cheaper())).extra  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"Unmarked\.kits: expected a mark in its annotation"):
        _ = Fleet.of((Unmarked(), Unmarked())).best


@declared
class Glad(Robot):
    """A robot that is paid for waiting, or whose cost of it is no number."""

    which: Annotated[Whole, Best(max), Field(ge=0, description="Which cost of a step of waiting.")] = 0

    @property
    def costs(self) -> tuple[float, float, float]:
        """What each class of robot actions costs."""
        return WAITING[self.which], self.c_suggest, self.c_execute


WAITING = (0.5, -1.0, math.nan, math.inf)


@pytest.mark.cases
@pytest.mark.parametrize("which", [1, 2, 3])
def test_costs_of_robots_are_numbers_of_0_or_more(which: int) -> None:
    """All bounds assume that: no problem has others, and no robot acts at others."""
    words = rf"Glad\.costs \({WAITING[which]}, 1\.0, 1\.0\): expected three numbers of 0 or more"
    with pytest.raises(ValueError, match=words):
        people((Glad(which=which),), c_suggest=1.0)
    with pytest.raises(ValueError, match=words):
        _ = Setting(robots=(Glad(), Glad(which=which))).fleet.extra


costs = st.sampled_from([None, 0.0, 0.02, 0.3])
kinds_of_robots = st.builds(
    Robot, execute=st.sampled_from([None, True, False]), c_suggest=costs, c_execute=costs, c_move=costs,
    travel_time=st.sampled_from([None, 0.0, 0.5, 2.0]),
)  # fmt: skip


@settings(max_examples=30, deadline=None)
@given(robot=kinds_of_robots, count=st.integers(1, 4), execute=st.booleans())
def test_robots_that_are_alike_are_a_number_of_robots(robot: Robot, count: int, execute: bool) -> None:
    setting = Setting(execute=execute, robots=(robot,) * count)
    assert setting.fleet == replace(Setting(execute=execute), robots=count, **plain(robot)).fleet
    assert set(setting.fleet.robots) == {replace(setting.fleet.best, c_execute=setting.fleet.robots[0].c_execute)}
    assert not setting.fleet.extra.any()


@settings(max_examples=30, deadline=None)
@given(robots=st.lists(kinds_of_robots, min_size=2, max_size=4).map(tuple))
def test_the_best_robot_is_nowhere_worse(robots: tuple[Robot, ...]) -> None:
    setting = Setting(robots=robots)
    assert Setting(**json.loads(json.dumps(plain(setting)))) == setting
    best, travel = vars(setting.fleet.best), setting.travel(3, FAR)
    place = np.arange(4)
    ways = travel.steps_between(np.arange(len(robots))[:, None, None], place[:, None], place)
    nearest = ways.min(axis=0, initial=9)[:, :3].min(axis=0, where=place[:, None] != place[:3], initial=9)
    assert (travel.entry_steps == nearest).all()
    for one, way in zip(setting.fleet.robots, ways, strict=True):
        each = vars(one)
        assert best["execute"] or not each["execute"]
        assert all(best[name] <= each[name] for name in ("c_suggest", "c_move", "travel_time"))
        assert not each["execute"] or best["c_execute"] <= each["c_execute"]
        alone = replace(setting, robots=(one,)).travel(3, FAR)
        np.testing.assert_array_equal(way[:, :3], alone.steps_from(place[:, None])[:, 0])


@pytest.mark.parametrize("name", policies("none", "reactive", "attention", "priority"))
@pytest.mark.parametrize("travel_time", thinned([0.7, 0.0]))
def test_robots_without_a_difference_act_like_alike_ones(pool: Pool, name: str, travel_time: float) -> None:
    """An execution has another cost for one of them, and none executes actions."""
    two = replace(pool, setting=replace(pool.setting, travel_time=travel_time, robots=2))
    same = replace(two, setting=replace(two.setting, robots=(Robot(c_execute=9.0), Robot())))
    episodes = 3 if name == "rollout" else 12
    found = [
        simulate(one, name, humans=3, episodes=episodes, seed=3, travel=one.setting.travel(3, FAR))
        for one in (two, same)
    ]
    for column in ("discounted_return", "moves", "helped", "actions"):
        np.testing.assert_array_equal(getattr(found[0], column), getattr(found[1], column))


@st.composite
def situations(draw: st.DrawFn) -> tuple[Travel, np.ndarray, np.ndarray, np.ndarray]:
    """Travel at equal or different costs, where robots are, which may choose, and what each is worth to each person."""
    count, alike, distance = draw(st.integers(1, 4)), draw(st.booleans()), None
    if not alike or draw(st.booleans()):
        between = np.array(draw(st.lists(st.integers(1, 9), min_size=16, max_size=16)), dtype=float).reshape(4, 4)
        distance = np.triu(between, 1) + np.triu(between, 1).T
        for via in range(4):  # a way is never longer than by another place
            distance = np.minimum(distance, distance[:, via, None] + distance[None, via])
    moves = [draw(st.sampled_from([0.0, 0.25, 0.5])) for _ in range(count)]
    worth = [[draw(st.integers(-8, 24)) / 8 for _ in range(3)] for _ in range(count)]
    if alike:
        moves, worth = moves[:1] * count, worth[:1] * count
    places = draw(st.permutations([0, 1, 2]))
    at = [place if draw(st.booleans()) else BASE for place in (*places, BASE)[:count]]
    ready = [draw(st.booleans()) or place == BASE for place in at]
    return Travel.of(3, c_move=moves, distance=distance), np.array([at]), np.array([ready]), np.array([worth])


@settings(max_examples=50, deadline=None)
@given(situations())
def test_the_assignment_is_the_best_of_all(found: tuple[Travel, np.ndarray, np.ndarray, np.ndarray]) -> None:
    travel, location, ready, worth = found
    nobody = np.zeros((1, 3), dtype=np.int64)
    known = KnownStates(nobody[0], np.empty((0, 1, 1)), nobody[0] > 0)
    team = TeamState(
        np.zeros(1, np.int64),
        nobody == 0,
        location,
        nobody,
        known,
        [],
        travel,
        ready=ready,
        fleet=Fleet.of((Robot(),) * worth.shape[1]),
    )
    net = worth - team.to()
    person = assigned(team, net)
    check(team, TeamAction(person, np.zeros_like(person)))
    rounded = net + np.random.default_rng(0).uniform(-1e-14, 1e-14, net.shape)
    assert (assigned(team, rounded) == person).all()  # also where several assignments are the best
    assert (person[~ready] == NOBODY).all()
    taken = set(location[~ready])
    options = [[NOBODY, *sorted({0, 1, 2} - taken)] if one else [NOBODY] for one in ready[0]]
    best = max(
        sum(net[0, m, k] for m, k in enumerate(each) if k != NOBODY)
        for each in itertools.product(*options)
        if len({k for k in each if k != NOBODY}) == sum(k != NOBODY for k in each)
    )
    assert sum(net[0, m, k] for m, k in enumerate(person[0]) if k != NOBODY) == pytest.approx(best)


@pytest.mark.parametrize("name", policies("reactive", "attention", "priority")[1:])
@pytest.mark.parametrize("travel_time", thinned([0.0, 1.0]))
def test_a_robot_that_may_not_execute_never_does(name: str, travel_time: float) -> None:
    robots = (Robot(c_suggest=0.3), Robot(execute=True, c_execute=0.1), Robot(c_move=0.0))
    pool = people(robots, travel_time=travel_time)
    policy, seen = pool.policy(name, pool.setting.travel(3)), [0, 0, 0]

    def watched(team: TeamState) -> TeamAction:
        action = policy(team)
        for n, m in np.argwhere(action.action > 0).tolist():
            k, r = action.person[n, m], action.action[n, m]
            seen[m] += team.policies[team.model[n, k]].pomdp.executes(int(team.x[n, k]), int(r)) is not None
        return action

    trace: Trace = []
    found = simulate(pool, watched, humans=3, episodes=4 if name == "rollout" else 15, seed=2, trace=trace)
    assert seen[0] == seen[2] == 0
    assert seen[1] == found.executed.sum() == sum(row["executed"] is not None for row in trace)
    assert (seen[1] > 0) == (name != "reactive")  # which only makes suggestions


def test_each_robot_pays_its_own_costs() -> None:
    """One person and one decision, with certain actions: the return is minus what the robot's actions cost."""
    robots = (Robot(c_suggest=0.5, c_move=2.0), Robot(execute=True, c_execute=0.25, c_move=1.0, c_suggest=0.125))
    pool = people(robots, size=2, max_steps=1)
    pomdp = pool.policies[0].pomdp
    start = pool.choices(0).initial
    suggests, executes = pomdp.first_optimal[start, 0], pomdp.robot_actions[start] - 1
    assert pomdp.executes(start, executes) is not None

    def paid(person: list[int], said: list[int]) -> float:
        def act(team: TeamState) -> TeamAction:
            each = np.array([person]).repeat(len(team.x), axis=0)
            return TeamAction(each, np.array([said]).repeat(len(team.x), axis=0))

        found = simulate(pool, act, humans=2, episodes=1, seed=1)
        return float(-found.discounted_return[0] - found.costs[0].sum())

    assert paid([NOBODY, NOBODY], [0, 0]) == pytest.approx(0)
    assert paid([0, NOBODY], [suggests, 0]) == pytest.approx(2.5)
    assert paid([NOBODY, 0], [0, suggests]) == pytest.approx(1.125)
    assert paid([NOBODY, 1], [0, executes]) == pytest.approx(1.25)
    assert paid([1, 0], [suggests, executes]) == pytest.approx(3.75)
    with pytest.raises(UserCodeError, match="lets robot 1 execute an action, which it cannot"):
        paid([0, NOBODY], [executes, 0])


def test_each_robot_has_its_own_speed() -> None:
    """Two robots set out to people who only they can reach: the slow one arrives later."""
    pool = people((Robot(travel_time=3), Robot(travel_time=1)), size=2)
    away: list[list[bool]] = []

    def act(team: TeamState) -> TeamAction:
        away.append((~team.ready[0]).tolist())
        person = np.full(team.location.shape, NOBODY)
        if team.step == 0:
            person[:] = [0, 1]
        return TeamAction(person, np.zeros_like(person))

    simulate(pool, act, humans=2, episodes=1, seed=1)
    assert away[:3] == [[False, False], [True, False], [True, False]]
    assert not any(map(any, away[3:]))


def test_a_robot_without_a_task_makes_room_for_a_better_one() -> None:
    """The first robot is with the person and can only suggest, which is in vain; the second one executes."""
    pool = people((Robot(), Robot(execute=True, c_execute=0.01)), size=1)
    places: list[list[int]] = []

    def act(team: TeamState) -> TeamAction:
        places.append(team.location[0].tolist())
        last = int(team.policies[0].pomdp.robot_actions[team.x[0, 0]] - 1)
        second = team.step > 0
        return TeamAction(np.array([[NOBODY, 0] if second else [0, NOBODY]]), np.array([[0, last * second]]))

    found = simulate(pool, act, humans=1, episodes=1, seed=1)
    assert places[:3] == [[BASE, BASE], [0, BASE], [BASE, 0]][: len(places)]
    assert found.moves[0] == 2
    team = replace(
        state(pool, [pool.choices(0).initial], travel=pool.setting.travel(1)),
        location=np.array([[0, BASE]]),
    )  # fmt: skip
    assert pool.policy("priority")(team).person.tolist() == [[NOBODY, 0]]
    with pytest.raises(UserCodeError, match="lets two robots be with one person"):
        check(team, TeamAction(np.array([[0, 0]]), np.zeros((1, 2), dtype=np.int64)))
    with pytest.raises(UserCodeError, match="or on their way there"):
        check(
            replace(team, ready=np.array([[False, True]])),
            TeamAction(np.array([[NOBODY, 0]]), np.zeros((1, 2), dtype=np.int64)),
        )


def test_suggestions_are_made_by_the_robot_for_which_they_cost_least() -> None:
    """Everybody is equally far, so that the cheap robot serves whoever needs one."""
    pool = people((Robot(c_suggest=0.5), Robot(c_suggest=0.01)), size=1)
    team = state(pool, [pool.choices(0).initial])
    for name in ("attention", "priority", "whittle"):
        action = pool.policy(name)(team)
        assert action.person.tolist() == [[NOBODY, 0]], name
        assert action.action[0, 1] > 0


@given(
    robots=st.lists(st.tuples(*[st.sampled_from([0.0, 0.125, 0.5])] * 2, st.booleans()), min_size=1, max_size=3),
    price=st.tuples(*[st.sampled_from([0.0, 0.0625, 0.125, 0.25, 0.5625, 0.875])] * 3),
)  # fmt: skip
def test_a_robot_pays_at_most_for_the_action_that_is_worth_most(
    robots: list[tuple[float, float, bool]], price: tuple[float, float, float]
) -> None:
    """One step: the sum over robots, and its slope in each price. All numbers are exact, so that ties are."""
    setting = Setting(
        c_suggest=0.0, c_execute=0.0,
        robots=(
            Robot(execute=True), *(Robot(c_suggest=say, c_execute=do, execute=able) for say, do, able in robots),
            Robot(c_move=0.1),
        ),
    )  # fmt: skip

    def total(price: list[float]) -> float:
        attention, suggestion, execution = price
        of_each = (
            attention + max(0.0, suggestion - one["c_suggest"], execution - one["c_execute"] if one["execute"] else 0.0)
            for one in map(vars, setting.fleet.robots)
        )
        return sum(of_each)

    assert paid(np.array(price)[:, None], setting) == pytest.approx(total(list(price)))
    found = supply(np.array(price)[:, None], setting.fleet.extra)[:, 0]
    for row in range(3):
        more = [one + 1e-4 * (number == row) for number, one in enumerate(price)]
        assert found[row] == pytest.approx((total(more) - total(list(price))) / 1e-4, abs=1e-6)


def test_prices_of_actions_bring_the_bound_closer_to_the_joint_optimum() -> None:
    setting = Setting(
        knowledge="exact", gamma=0.8, c_suggest=0.05, c_move=0.05, trust="constant", lapse=0.0,
        robots=(Robot(execute=True, c_suggest=0.02, c_execute=0.02), Robot()),
    )  # fmt: skip
    pool = known_people(setting)
    options = BoundOptions(price_episodes=300)
    bound = upper_bound(pool, window=6, gap=1e-3, options=options)
    best_robots = replace(setting, robots=(setting.fleet.best,) * 2)
    without = upper_bound(replace(pool, setting=best_robots), window=6, gap=1e-3, options=options)
    best = joint_optimum(pool, setting.fleet.robots)
    assert best <= bound.proven < (best + without.proven) / 2
    mean, error = relaxed_value(bound, episodes=800)
    assert bound.proven == pytest.approx(mean, abs=4 * error + 0.01)


@pytest.mark.parametrize(
    ("robots", "message"),
    [
        ((), r"robots \(\): expected a number of robots, or a list"),
        *((wrong, "robots") for wrong in (0, -1, 1.5, "two")),
        (("two",), r"robots\[1\] 'two': expected a table"),
        (({"c_sugest": 1},), r"robots\[1\].c_sugest: unknown; .*c_suggest"),
        ((Robot(), {"c_suggest": -1.0}), r"robots\[2\].c_suggest -1: expected a number from 0"),
        (({"execute": "yes"},), r"robots\[1\].execute 'yes': expected true or false"),
    ],
)
def test_robots_that_cannot_be(robots: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Setting(robots=robots)
    assert plain(Setting())["robots"] == [{}]
    assert Setting(**plain(Setting(robots=3))).robots == (Robot(),) * 3


def test_in_joined_pools_robots_differ_by_the_same_costs() -> None:
    one, other = people((Robot(c_suggest=0.2), Robot())), people((Robot(c_suggest=0.2), Robot()), c_suggest=0.1)
    with pytest.raises(ValueError, match="joined: actions of each robot cost more"):
        Pool.joined([one, other])
    alike = Pool.joined([people((Robot(),) * 2), people((Robot(),) * 2, c_suggest=0.1)])
    assert {policy.pomdp.robot_costs.max() for policy in alike.policies} == {0.05, 0.1}


LIST = "[{execute = true, c_execute = 0.1}, {c_suggest = 0.2}]"


def test_commands_and_files_with_different_robots(tmp_path: Path) -> None:
    costs = ("--c-suggest", 0.3, "--c-move", 0.2, "--set", "knowledge=exact", "--robots", LIST, "--json")
    options = ("kitting/tiny", "--humans", 2, "--policy", "priority", *costs)
    record = json.loads(invoke("simulate", *options, "--episodes", 20, "--trace", tmp_path / "trace.jsonl").stdout)
    robots = [{"execute": True, "c_execute": 0.1}, {"c_suggest": 0.2}]
    assert record["setting"]["robots"] == robots
    assert record["policies"][0]["executions"]["mean"] > 0
    assert len(json.loads((tmp_path / "trace.jsonl").read_text().splitlines()[0])["robot_places"]) == 2
    record = json.loads(invoke("bound", *options, "--value-episodes", 500, "--gap", 0.05).stdout)
    assert record["value"] - 3 * record["value_stderr"] <= record["upper"]
    for command, wrong, said in (
        ("simulate", "[{c_sugest = 1}]", "robots[1].c_sugest: unknown; did you mean 'c_suggest'?"),
        ("simulate", "two", '--robots: "two"; expected a number of robots, or a list of one table or more'),
        ("serve", LIST, "execute: expected a robot that suggests"),
    ):
        refused = invoke(command, "kitting/tiny", "--humans", 2, "--robots", wrong)
        assert (refused.exit_code, said in refused.stderr) == (2, True), refused.stderr
    study, config = tmp_path / "study.toml", tmp_path / "serve.toml"
    for text, expected in (("2", [{}, {}]), (LIST, robots)):
        study.write_text(f'instances = ["kitting/tiny"]\n[setting]\nrobots = {text}\n')
        ((_, setting),) = read(study).conditions[0].settings
        assert plain(setting)["robots"] == expected
        config.write_text(f"[setting]\nrobots = {text}\n")
        assert read_config(config, serve.params)["setting"]["robots"] == (2 if text == "2" else robots)
    study.write_text('instances = ["kitting/tiny"]\n[setting]\nrobots = [{c_move = -1}]\n')
    with pytest.raises(InputFileError, match=r"robots\[1\].c_move"):
        read(study)


def known_people(setting: Setting, size: int = 2) -> Pool:
    """Return alike people whose beta and theta the robots know."""
    population = Population(beta=(0.3, 0.3), theta=(0.5, 0.5))
    pool = Pool.sample(Choices.of(sweep(TASK)), size, seed=1, setting=setting, population=population)
    pomdp = pool.policies[0].pomdp
    prior = np.zeros_like(pomdp.prior)
    prior[0, len(pomdp.grid.theta) // 2] = 1.0
    return replace(pool, policies=(qmdp(replace(pomdp, prior=prior)),))


def joint_optimum(pool: Pool, robots: tuple[Any, ...], people: int = 2) -> float:
    """Return the optimal value of robots that differ, by value iteration over all joint states of known people."""
    pomdp, choices = pool.policies[0].pomdp, pool.choices(0)
    (known,) = np.flatnonzero(pomdp.prior)

    @cache
    def after(x: int, r: int) -> list[tuple[float, float, int]]:
        """Return the probability, the cost and the state after each action of a person."""
        place = pomdp.afterstate[x, r]
        if pomdp.ends[place]:
            return [(1.0, 0.0, int(place))]
        slots = np.flatnonzero(choices.applicable[place])
        chance = [pomdp.likelihood(np.array([x]), np.array([r]), np.array([a])).reshape(-1)[known] for a in slots]
        return [
            (float(p), float(choices.costs[place, a]), int(choices.targets[place, a]))
            for p, a in zip(chance, slots, strict=True)
        ]

    def joint_actions(x: tuple[int, ...], at: tuple[int, ...]) -> Iterator[tuple[float, tuple[int, ...], list[int]]]:
        """Return the cost of each joint action, where robots are then, and the robot action on each person."""
        each = []
        for robot, here in zip(robots, at, strict=True):
            options = [(0.0, here, NOBODY, 0)]
            for k in (k for k in range(people) if not pomdp.ends[x[k]]):
                moving = robot.c_move * (here != k)
                for r in range(pomdp.robot_actions[x[k]]):
                    executes = r > 0 and pomdp.suggested[x[k], r] == NOTHING
                    cost = 0.0 if r == 0 else robot.c_execute if executes else robot.c_suggest
                    if robot.execute or not executes:
                        options.append((moving + cost, k, k, r))
            each.append(options)
        for joint in itertools.product(*each):
            sent = [to for _, _, to, _ in joint if to != NOBODY]
            if len(set(sent)) == len(sent):
                does = [sum(r for _, _, to, r in joint if to == k) for k in range(people)]
                there = tuple(BASE if to == NOBODY and place in sent else place for _, place, to, _ in joint)
                waiting = sum(
                    robot.costs[0] for robot, place, (*_, r) in zip(robots, there, joint, strict=True)
                    if place != BASE and not pomdp.ends[x[place]] and r == 0
                )  # fmt: skip
                yield sum(cost for cost, *_ in joint) + waiting, there, does

    everywhere = itertools.product(range(len(choices)), repeat=people)
    states = [(x, at) for x in everywhere for at in itertools.product((BASE, *range(people)), repeat=len(robots))]
    number = {one: n for n, one in enumerate(states)}
    rows, columns, weights, rewards, first = [], [], [], [], []
    for x, at in states:
        first.append(len(rewards))
        for cost, there, does in joint_actions(x, at):
            reward = -cost
            for outcome in itertools.product(*(after(x[k], does[k]) for k in range(people))):
                chance = float(np.prod([p for p, _, _ in outcome]))
                reward -= chance * sum(spent for _, spent, _ in outcome)
                rows.append(len(rewards))
                columns.append(number[tuple(to for _, _, to in outcome), there])
                weights.append(chance)
            rewards.append(reward)
    matrix, value = csr_array((weights, (rows, columns)), shape=(len(rewards), len(states))), np.zeros(len(states))
    gamma = pomdp.gamma
    for _ in range(int(np.ceil(np.log(1e-7) / np.log(gamma)))):
        value = np.maximum.reduceat(np.array(rewards) + gamma * (matrix @ value), first)
    return float(value[number[(choices.initial,) * people, (BASE,) * len(robots)]])


@pytest.mark.slow
@settings(max_examples=10, deadline=None, derandomize=True)
@given(robots=st.lists(kinds_of_robots, min_size=2, max_size=2).map(tuple), execute=st.booleans())
def test_the_bound_is_not_below_the_joint_optimum(robots: tuple[Robot, ...], execute: bool) -> None:
    robots = tuple(replace(robot, travel_time=None) for robot in robots)
    setting = Setting(
        knowledge="exact", gamma=0.8, c_suggest=0.05, c_move=0.05, trust="constant", lapse=0.0, robots=robots,
        execute=execute,
    )  # fmt: skip
    pool = known_people(setting)
    best = joint_optimum(pool, setting.fleet.robots)
    bound = upper_bound(pool, window=3, gap=1e-3, options=BoundOptions(price_episodes=50))
    assert bound.proven >= best - 1e-6
    for name in ("priority", "whittle"):
        value = bound.certify(name, episodes=400)
        assert value.value - 4 * value.value_stderr <= best + 1e-6


@pytest.mark.parametrize("c_wait", thinned([0.4, 0.0]))
def test_a_cost_of_waiting_is_charged_weighed_and_bounded(c_wait: float) -> None:
    setting = Setting(
        knowledge="exact", gamma=0.8, c_suggest=0.05, c_move=0.05, trust="constant", lapse=0.0,
        robots=(Waits(c_wait=0.1), Waits(c_wait=c_wait, c_suggest=0.02)),
    )  # fmt: skip
    pool = known_people(setting)
    best = joint_optimum(pool, setting.fleet.robots)
    assert best < joint_optimum(pool, tuple(replace(robot, c_wait=0.0) for robot in setting.fleet.robots)) - 1e-3
    bound = upper_bound(pool, window=4, gap=1e-3, options=BoundOptions(price_episodes=100))
    assert best - 1e-6 <= bound.proven
    for name in ("attention", "priority"):
        value = bound.certify(name, episodes=500)
        assert best - 0.2 < value.value <= best + 4 * value.value_stderr


def test_a_bound_holds_where_one_robot_leaves_while_another_is_on_its_way() -> None:
    """Two robots come to one person in turn, each with a suggestion where the ways differ; so neither ever waits."""
    ways = [(8 - k, 7 - k, 1) for k in range(8)] + [(8 - k, 7 - k, 10) for k in range(1, 8, 2)]
    robots = (Waits(c_wait=1.0), Waits(c_wait=1.0))
    setting = Setting(robots=robots, c_suggest=1.0, c_move=0.0, travel_time=1, gamma=0.95, trust="constant", lapse=0.0)
    known = Population(theta=(0.9, 0.9), beta=(0.01, 0.01))
    pool = Pool.sample(Choices.of(sweep(graph_task(ways, start=8))), 1, seed=0, setting=setting, population=known)

    def in_turn(team: TeamState) -> TeamAction:
        person, action = np.full(team.location.shape, NOBODY), np.zeros_like(team.first_optimal())
        if team.step % 2:
            action = team.first_optimal()
        person[team.active[:, 0], team.step // 2 % 2] = 0
        return team.act(person, action)

    bound = upper_bound(pool, gap=0.01)
    value = bound.certify(in_turn, episodes=500)
    assert value.value - 4 * value.value_stderr <= bound.proven
    assert value.value + 4 * value.value_stderr > -18.6, "who would be paid for waiting gets less than the bound"


def test_who_waits_with_whom_pays() -> None:
    """Two robots, one of which is away for two steps, and stays; the other one is with somebody from the first step."""
    pool = people((Waits(c_wait=0.5), Waits(c_wait=2.0, travel_time=2)), size=2, c_move=0.0, max_steps=5)
    charged: list[list[float]] = []
    for waits in (True, False):
        robots = pool.setting.robots if waits else (Robot(c_move=0.0), Robot(c_move=0.0, travel_time=2))
        own = people(robots, size=2, c_move=0.0, max_steps=5)

        def act(team: TeamState) -> TeamAction:
            person = np.full(team.location.shape, NOBODY)
            if team.step == 0:
                person[:] = [0, 1]
            return TeamAction(person, np.zeros_like(person))

        trace: list[Any] = []
        found = simulate(own, act, humans=2, episodes=1, seed=3, trace=trace)
        charged.append([float(found.discounted_return[0]), float(found.actions[0].max())])
    steps = [np.arange(int(n)) for n in found.actions[0]]
    discount = own.setting.gamma
    expected = 0.5 * (discount ** steps[0]).sum() + 2.0 * (discount ** steps[1][2:]).sum()
    assert charged[1][0] - charged[0][0] == pytest.approx(expected)


def test_a_robot_at_its_base_does_not_pay_for_waiting() -> None:
    """A suggestion is not worth its cost. Staying at the base costs nothing, and being with somebody does."""
    pool = people((Waits(c_wait=3.0),), size=2, c_suggest=2.5, c_move=0.0)
    at_base = state(pool, [pool.choices(0).initial] * 2)
    there = replace(at_base, location=np.array([[0]]))
    one_done = replace(there, active=np.array([[False, True]]))
    attention = pool.policy("attention")
    scores = [attention.scores(team)[1][0, 0] for team in (at_base, there, one_done)]
    assert attention(at_base).person[0, 0] == NOBODY
    assert (scores[0] < 0).all()
    np.testing.assert_allclose(scores[1], scores[0] + 3.0)
    assert scores[2][1] == pytest.approx(scores[0][1])


def test_who_would_wait_for_a_price_helps_at_once() -> None:
    """A suggestion is not worth its cost, but it costs less than to be there in vain."""
    said = {}
    for c_wait in (0.0, 3.0):
        pool = people((Waits(c_wait=c_wait),), size=1, c_suggest=2.5, c_move=0.0)
        team = replace(state(pool, [pool.choices(0).initial]), location=np.array([[0]]))
        said[c_wait] = [int(pool.policy(name)(team).person[0, 0]) for name in ("attention", "priority")]
        priority = pool.policy("priority")
        _, _, staying = priority.worth(team)
        assert (staying[0, 0] < 0) == (c_wait > 0)
    assert said[0.0][0] == NOBODY
    assert said[3.0][0] == 0
