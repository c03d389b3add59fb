"""Components of a certificate, on a graph that is small enough to compute values by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import FEW, graph_task, kit, thinned
from hypothesis import given, settings
from hypothesis import strategies as st
from test_goal_bounds import ring
from test_robots import TASK

from assist.certify import (
    BoundOptions,
    Certificate,
    RelaxationOptions,
    TeamBound,
    certificate,
    comparison,
    prices,
    team_bound,
)
from assist.certify.certificate import horizon, returns
from assist.certify.prices import SubproblemGroup, groups_of, search
from assist.certify.relaxed_value import relaxed_value
from assist.cli.output.person_bounds import show_samples
from assist.people import Choices, HumanModel, Population
from assist.person import AssistPOMDP, AttentionSubproblem, OfRobots, Robot, Setting, solve
from assist.person.attention_subproblem import with_actions
from assist.person.memory_needed import policy_bytes
from assist.person.time_expansion import TimeExpansion
from assist.team import NoAssistance, Pool, TeamAction, TeamState
from planner import LimitError, sweep

SETTING = Setting(gamma=0.5, c_suggest=0.1, c_move=0.2)
certify = partial(comparison.certify, options=FEW)
upper_bound = partial(team_bound.upper_bound, options=FEW)


@pytest.fixture(scope="module")
def choices() -> Choices:
    """A chain from 3 to the goal 0, on which a step back from 2 costs 4."""
    return Choices.of(sweep(TASK))


@pytest.fixture(scope="module")
def pool(choices: Choices) -> Pool:
    return Pool.sample(choices, 2, seed=1, setting=SETTING)


@pytest.fixture(scope="module")
def strangers(choices: Choices) -> Pool:
    """A pool of three people whom the robot cannot distinguish."""
    setting = replace(SETTING, knowledge="exact", gamma=0.9, c_suggest=0.05, c_move=0.05)
    return Pool.sample(choices, 3, seed=1, setting=setting, population=Population(beta=(0.1, 0.5)))


@pytest.fixture(scope="module")
def bound(strangers: Pool) -> TeamBound:
    return upper_bound(strangers, window=4, gap=1e-6)


def test_where_episodes_are_cut_off() -> None:
    assert horizon(0.5) == 21  # 2^-21 is the first power below half a millionth
    for gamma in (0.9, 0.99):
        assert gamma ** horizon(gamma) <= 1e-6 * (1 - gamma) < gamma ** (horizon(gamma) - 1)


def test_what_an_episode_that_is_cut_off_could_still_cost(pool: Pool, monkeypatch: pytest.MonkeyPatch) -> None:
    """After two steps no person is at the goal. Each could still pay 4 for actions, .1 for a suggestion and .2 for
    travel from the neighbour, or three times as much from the base if that is the farthest station.
    """
    monkeypatch.setattr(certificate, "horizon", lambda _: 2)
    paid = {1.5 + 1.5, 1.5 + 3.0, 3.0 + 3.0}  # 1 in the first step, then 1 or, by who goes back, 4
    for distance, furthest in ((None, 1), ([[0, 1, 3], [1, 0, 3], [3, 3, 0]], 3)):
        travel = SETTING.travel(2, distance)
        found = returns(pool, NoAssistance(), (0, 1), travel, episodes=2000, seed=0)
        later = 2 * (4 + 0.1 + 0.2 * furthest) * 0.25 / 0.5
        assert {round(-value - later, 9) for value in found} == paid
    # With two tasks it is the larger cost that could still be paid.
    line = [(node, node - 1, 9) for node in range(1, 5)]
    far = Pool.sample(Choices.of(sweep(graph_task(line, start=4))), 1, seed=1, setting=SETTING)
    both = Pool(SETTING, (pool.people[0], far.people[0]), (pool.policies[0], far.policies[0]), np.arange(2))
    found = returns(both, NoAssistance(), (0, 1), SETTING.travel(2), episodes=50, seed=0)
    later = 2 * (9 + 0.1 + 0.2) * 0.25 / 0.5
    assert {round(-value - later, 9) for value in found} <= {13.5 + 1.5, 13.5 + 3.0}
    travel = SETTING.travel(2)
    done = Pool.sample(Choices.of(sweep(graph_task([(1, 0, 1)]))), 2, seed=1, setting=SETTING)
    np.testing.assert_allclose(returns(done, "none", (0, 1), travel, episodes=3, seed=0), -2.0)


@pytest.mark.parametrize(
    ("best", "other", "more"),
    [
        ({}, {"c_suggest": 0.4}, 0.3),
        ({"c_move": 0.2}, {"c_move": 0.7, "c_suggest": 0.4}, 0.3 + 0.5),
        ({"execute": True, "c_execute": 0.5}, {"execute": True, "c_execute": 1.2, "c_suggest": 0.3}, 0.7),
        ({"execute": True, "c_execute": 0.5}, {"c_suggest": 0.7}, 0.6),
    ],
)
def test_what_robots_that_differ_could_still_cost(
    choices: Choices, monkeypatch: pytest.MonkeyPatch, best: dict[str, Any], other: dict[str, Any], more: float
) -> None:
    """Each of two people could still pay what the worse robot's most expensive action costs more."""
    monkeypatch.setattr(certificate, "horizon", lambda _: 2)
    found = []
    for robots in ((Robot(**best), Robot(**best)), (Robot(**best), Robot(**other))):
        setting = replace(SETTING, robots=robots)
        team = Pool.sample(choices, 2, seed=1, setting=setting)
        found.append(returns(team, NoAssistance(), (0, 1), setting.travel(2), episodes=50, seed=0))
    np.testing.assert_allclose(found[0] - found[1], 2 * more * 0.25 / 0.5)


def test_an_episode_that_is_cut_off_counts_at_most_what_the_whole_one_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """People in a dead end act for ever. Their episodes end after `LONGEST` steps, and the rest is subtracted."""
    table = sweep(graph_task([(0, 1, 1), (1, 3, 1), (0, 2, 1), (2, 2, 1)], goal=3, start=0))
    pool = Pool.sample(table, 1, seed=0, setting=Setting(gamma=0.99, lapse=0.5))
    travel = pool.setting.travel(1)
    whole = returns(pool, "none", (0,), travel, episodes=40, seed=4)
    monkeypatch.setattr("assist.certify.certificate.LONGEST", 20)
    cut_off = returns(pool, "none", (0,), travel, episodes=40, seed=4)
    stuck = whole < -50
    assert 0 < stuck.sum() < 40
    assert (cut_off[stuck] < whole[stuck]).all()
    np.testing.assert_array_equal(cut_off[~stuck], whole[~stuck])


def test_no_episodes_begin_after_the_time_limit(pool: Pool) -> None:
    travel, count = SETTING.travel(2), 1024 + 100
    whole = returns(pool, "none", (0, 1), travel, episodes=count, seed=4)
    assert whole.shape == (count,)
    np.testing.assert_array_equal(returns(pool, "none", (0, 1), travel, episodes=count, seed=4, time_limit=1e9), whole)
    short = returns(pool, "none", (0, 1), travel, episodes=count, seed=4, time_limit=1e-9)
    np.testing.assert_array_equal(short, whole[:1024])


def test_a_mean_above_the_bound_by_chance_is_within_its_error() -> None:
    returns_, options = np.array([-10.0, -12.0, -14.0]), {"humans": 2, "slack": 0.0}
    for upper, within in ((-11.0, False), (-12.0, False), (-12.5, True), (-15.4, True), (-15.5, False)):
        found = Certificate.of("mine", returns_, upper=upper, **options)
        assert (found.within_error, found.gap_percent < 0) == (within, upper < -12), upper
    assert found.above
    assert "the mean is above the bound" in repr(found)


def test_a_certificate_by_hand() -> None:
    found = Certificate.of("mine", np.array([-10.0, -12.0, -14.0]), humans=2, upper=-10.5, slack=0.6)
    assert found == Certificate(2, "mine", -12.0, 2 / math.sqrt(3), -10.5, 12.5, 5.0, 3)
    loose = Certificate.of("mine", np.array([-10.0, -12.0, -14.0]), humans=2, upper=-10.5, slack=6.0)
    assert loose.slack_percent == loose.gap_percent  # no solution lowers a bound below the policy's value
    nothing = Certificate.of("mine", np.zeros(2), humans=1, upper=0.5, slack=0.1)
    assert (nothing.gap_percent, nothing.slack_percent) == (0, 0)


class Attended:
    """A group of people, of whom this share is attended to at each step, at every price."""

    def __init__(self, count: int, *share: float) -> None:
        self.count, self.share, self.asked = count, np.array(share), 0

    def simulated(self, *_: object) -> tuple[np.ndarray, None]:
        self.asked += 1
        return self.share, None


def looked_for(
    *groups: Attended, rounds: float = math.inf, most: int = 40, told: list[int] | None = None
) -> np.ndarray:
    """Return prices of two steps, with a clock that advances by a round whenever the first kind is simulated.

    Append the rounds that are reported to `told`.
    """
    tell = [] if told is None else told
    clock = SimpleNamespace(perf_counter=lambda: groups[0].asked)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prices, "time", clock)
        found = search(
            list(groups), 2, BoundOptions(most, 100), seed=3, deadline=rounds - 0.5,  # type: ignore[arg-type]
            tell=lambda _, done, __: tell.append(done), extra=np.zeros((1, 3)),
        )  # fmt: skip
    assert not found[1:].any()  # actions have no prices where robots are alike
    return found[0]


# With two robots busy where one is there, the slope is (2 - 1) / 2 in every round, and the step after n of them is
# 1/2 * 1/2 / sqrt(n / 4); at the second step no robot is busy, and the price stays at 0.
PRICE = np.cumsum(0.5 / np.sqrt(np.arange(1, 41)))


@pytest.mark.parametrize(
    ("rounds", "expected"),
    [(math.inf, PRICE[20:].mean()), (30, PRICE[20:30].mean()), (21, PRICE[20]), (20, PRICE[19]), (5, PRICE[4])],
)
def test_prices_are_the_mean_of_the_last_half_of_the_rounds_that_there_were(rounds: float, expected: float) -> None:
    np.testing.assert_allclose(looked_for(Attended(4, 0.5, 0.0), rounds=rounds), [expected], rtol=1e-9)


def test_what_is_left_of_a_round_says_nothing() -> None:
    one, other = Attended(2, 0.5, 0.0), Attended(1, 1.0, 0.0)
    np.testing.assert_allclose(looked_for(one, other), [PRICE[20:].mean()], rtol=1e-9)
    one, other = Attended(2, 0.5, 0.0), Attended(1, 1.0, 0.0)
    told: list[int] = []
    np.testing.assert_allclose(looked_for(one, other, rounds=30, told=told), [PRICE[20:29].mean()], rtol=1e-9)
    assert told == list(range(30))  # and nothing is begun after it
    assert (one.asked, other.asked) == (30, 29)
    assert looked_for(Attended(4, 0.5, 0.5), rounds=0).tolist() == []  # no time at all: no prices


def test_where_one_robot_is_enough_nothing_has_a_price() -> None:
    assert looked_for(Attended(2, 0.5, 0.4)).tolist() == []
    assert len(looked_for(Attended(4, 0.1, 0.5))) == 2  # a step without a price before one with a price
    # A step in which exactly as many are busy as there are robots.
    np.testing.assert_allclose(looked_for(Attended(4, 0.25, 0.5)), [0.0, PRICE[20:].mean()], rtol=1e-9)


def test_steps_are_relative_to_the_number_of_busy_robots_and_to_past_ones() -> None:
    """Two robots are busy in the first round and four in the second, where one is there: by 1/2 and by 3/4 too many."""

    class Busier(Attended):
        def simulated(self, *given: Any) -> tuple[np.ndarray, None]:
            return super().simulated(*given)[0] * self.asked, None

    second = 0.5 + 0.5 * 0.75 / math.sqrt(0.5**2 + 0.75**2)
    np.testing.assert_allclose(looked_for(Busier(2, 1.0, 0.0), most=2), [second], rtol=1e-9)


def test_problems_that_do_not_fit_are_refused_beforehand(pool: Pool, choices: Choices) -> None:
    """One problem is rebuilt in every round while those of both people exist, so that three have to fit into memory."""
    travel, alone = SETTING.travel(2), pool.policies[0].pomdp
    states = len(TimeExpansion.of(alone, 2, 3))
    one = policy_bytes(states, slots=choices.applicable.shape[1], actions=1 + alone.suggested.shape[1]) / 1e6
    with pytest.raises(LimitError, match=rf"^2 problems of people, each of up to {states} states with 3 steps"):
        groups_of(pool, (0, 1), travel, 3, memory_limit_mb=0.999 * 3 * one)
    with pytest.raises(LimitError, match=r"^1 problem of people"):  # what its first bounds take, which is more
        groups_of(pool, (0, 1), travel, 3, memory_limit_mb=1.001 * 3 * one)
    assert len(groups_of(pool, (0, 1), travel, 3, memory_limit_mb=100.0)) == 2
    with pytest.raises(LimitError, match=r"^2 problems of people"):
        upper_bound(pool, window=3, memory_limit_mb=0.01)


edges = st.tuples(st.integers(1, 5), st.integers(0, 5), st.sampled_from([0, 1, 1, 2]))


@settings(max_examples=25, deadline=None)
@given(st.lists(edges, min_size=2, max_size=12), st.integers(1, 6), st.booleans())
def test_states_at_a_step_are_those_that_can_be_reached_in_so_many(
    drawn: list[tuple[int, int, int]], steps: int, execute: bool
) -> None:
    """States are reachable along choices and, if the robot executes actions, along those that may precede choices."""
    choices = Choices.of(sweep(graph_task(drawn)))
    alone = AssistPOMDP.of(HumanModel.exact(choices), robot=OfRobots(execute=execute))

    def executed(states: set[int]) -> set[int]:
        return states | {int(y) for x in states for y in alone.afterstate[x, : alone.robot_actions[x]]}

    def after(states: set[int]) -> set[int]:
        going = [x for x in states if not choices.goal[x]]
        return {int(y) for x in going for y in choices.targets[x, choices.applicable[x]]}

    there = executed({choices.initial})
    layers = TimeExpansion.of(alone, 2, steps).layers
    for layer in layers[:-1]:
        assert set(layer.tolist()) == there
        there = executed(after(there))
    everything, more = there, executed(after(there))
    while not more <= everything:
        everything, more = everything | more, executed(after(everything | more))
    assert set(layers[-1].tolist()) == everything


def test_a_bound_is_what_peoples_problems_are_worth_and_what_is_paid(strangers: Pool, bound: TeamBound) -> None:
    alone, travel, gamma = strangers.policies[0].pomdp, strangers.setting.travel(3), strangers.setting.gamma
    assert (bound.team, bound.pool) == ((0, 1, 2), strangers)
    assert len(bound.travel) == 3
    assert 0 < len(bound.price) <= 4
    one = solve(AttentionSubproblem.of(alone, travel.entry[0], 0, bound.price).pomdp, gap=1e-6)
    paid = sum(price * gamma**step for step, price in enumerate(bound.price))
    assert bound.upper == pytest.approx(3 * one.upper + paid, abs=1e-5)
    assert bound.upper_seen == pytest.approx(3 * one.value_qmdp + paid, abs=1e-4)
    assert bound.slack == pytest.approx(3 * (one.upper - one.lower), abs=1e-5)
    assert 0 <= bound.slack <= 3e-6 * abs(one.upper)
    assert bound.seconds > 0
    with pytest.raises(ValueError, match="read-only"):
        bound.price[0] = 0.0


def test_the_first_bound_is_moved_up_by_what_rounding_may_take(pool: Pool, strangers: Pool) -> None:
    for whose in (pool, strangers):
        travel, exact = whose.setting.travel(2), Fraction(0)
        for group in groups_of(whose, (0, 1), travel, 0):
            pomdp = group.visits.pomdp
            values = group.tail[pomdp.model.choices.initial].ravel().tolist()
            terms = zip(values, pomdp.prior.ravel().tolist(), strict=True)
            exact += Fraction(group.count) * sum(Fraction(value) * Fraction(chance) for value, chance in terms)
        found = Fraction(team_bound.free_attention_bound(whose, (0, 1), travel))
        assert abs(exact) / 10**12 < found - exact < abs(exact) / 10**9


def test_the_bound_is_not_above_the_one_that_was_announced() -> None:
    """One round of prices leaves this team a looser bound than free attention with all known, which is there first."""
    pool = Pool.sample("kitting/tiny", 3, seed=1, setting=Setting(c_suggest=0.5, c_move=0.5))
    loose: Any = {"gap": 0.99, "options": BoundOptions(1, 20)}
    first: list[Certificate] = []
    made = comparison.Comparison.of(
        pool, {"none": "none"}, episodes=100, seed=0, time_limit=None, progress=lambda *_: None, first=first.extend,
        **loose,
    )  # fmt: skip
    alone, announced = team_bound.upper_bound(pool, seed=0, **loose), first[0].upper
    assert made.bound.upper == made.bound.proven == announced < alone.upper
    assert made.bound.upper - made.bound.slack == pytest.approx(alone.upper - alone.slack)


def test_a_bound_does_not_depend_on_who_works_on_it(strangers: Pool, bound: TeamBound) -> None:
    told: list[tuple[str, int, int]] = []
    other = upper_bound(strangers, window=4, gap=1e-6, jobs=1, progress=lambda *what: told.append(what))
    assert (other.upper, other.slack, other.upper_seen) == (bound.upper, bound.slack, bound.upper_seen)
    assert other.price.tolist() == bound.price.tolist()
    assert told[0] == ("setting up people's problems", 0, 1)
    assert told[1:3] == [("optimising prices", done, FEW.price_rounds) for done in (0, 1)]
    assert told[-2:] == [("bounding people's problems", 0, 1), ("bounding people's problems", 1, 1)]


def test_a_bound_holds_however_little_time_there_was(strangers: Pool, bound: TeamBound) -> None:
    hasty = upper_bound(strangers, window=4, time_limit=1e-6)
    assert hasty.price.tolist() == []
    free = upper_bound(strangers, window=0, gap=1e-6)
    assert free.price.tolist() == []
    assert hasty.upper >= free.upper >= bound.upper
    assert hasty.upper - hasty.slack <= free.upper
    slow = upper_bound(strangers, window=4, gap=1e-6, time_limit=1e9)
    assert (slow.upper, slow.price.tolist()) == (bound.upper, bound.price.tolist())


def test_the_robot_of_one_person_has_no_price(pool: Pool) -> None:
    both = upper_bound(pool, window=0, gap=1e-6)
    apart = [upper_bound(pool, (person,), gap=1e-6, travel=SETTING.travel(1)) for person in (0, 1)]
    for found in apart:
        assert found.price.tolist() == []
    assert [found.team for found in apart] == [(0,), (1,)]
    as_usual = upper_bound(pool, window=0)
    assert as_usual.slack > both.slack
    assert as_usual.upper == upper_bound(pool, window=0, gap=1e-3).upper
    for name in ("upper", "slack", "upper_seen"):
        assert getattr(both, name) == pytest.approx(sum(getattr(found, name) for found in apart), abs=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"team": (0, 2)}, r"team \[0, 2\]: expected names of people, or their numbers from 0 to 1$"),
        ({"team": ()}, r"team \[\]: expected names of people, or their numbers"),
        ({"team": (0, -1)}, r"team \[0, -1\]: expected names of people, or their numbers from 0 to 1"),
        ({"travel": SETTING.travel(3)}, "travel for 3: expected 2 people"),
        ({"time_limit": 0.0}, "time_limit 0.0: expected more than 0"),
        ({"window": -1}, "window -1: expected a whole number of 0 or more"),
        ({"jobs": -1}, "jobs -1: expected a whole number of 1 or more"),
    ],
)
def test_bounds_that_cannot_be(pool: Pool, options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        upper_bound(pool, **options)  # type: ignore[arg-type]


def test_a_robot_for_each_person_of_a_kind(pool: Pool) -> None:
    """Means and variances add up, since people's random numbers are independent."""
    found = upper_bound(pool, (0, 0, 1), window=3, gap=1e-6)
    mean, error = relaxed_value(found, episodes=400, seed=5)
    groups: list[SubproblemGroup] = groups_of(pool, found.team, found.travel, len(found.price))
    assert [group.count for group in groups] == [2, 1]
    values = [
        group.simulated(with_actions(found.price), horizon(0.5), 400, 5 + number)[1]
        for number, group in enumerate(groups)
    ]
    paid = sum(price * 0.5**step for step, price in enumerate(found.price))
    assert mean == pytest.approx(2 * values[0].mean() + values[1].mean() + paid)
    assert error == pytest.approx(math.sqrt((4 * values[0].var(ddof=1) + values[1].var(ddof=1)) / 400))
    assert relaxed_value(found, episodes=400) == relaxed_value(found, episodes=400, seed=0)
    assert relaxed_value(found, episodes=2)[0] < 0
    with pytest.raises(ValueError, match=r"^episodes 1: expected a whole number of 2 or more"):
        relaxed_value(found, episodes=1)


def bound_at(pool: Pool, team: tuple[int, ...], price: list[float]) -> TeamBound:
    """A bound with these prices, whose other figures do not matter."""
    return TeamBound(
        pool, team, pool.setting.travel(len(team)), 0.0, 0.0, 0.0, np.array(price), 0.0, 0.0, np.zeros((2, len(price)))
    )


@pytest.mark.parametrize("robots", [1, 2])
def test_each_robot_of_the_relaxed_problem_is_paid_the_discounted_prices(pool: Pool, robots: int) -> None:
    price = np.array([0.3, 0.2, 0.1])
    several = replace(pool, setting=replace(pool.setting, robots=robots))
    mean, _ = relaxed_value(bound_at(several, (0, 1), [*price]), episodes=100, seed=5)
    groups = groups_of(several, (0, 1), SETTING.travel(2), 3)
    values = [
        group.simulated(with_actions(price), horizon(0.5), 100, 5 + number)[1].mean()
        for number, group in enumerate(groups)
    ]
    assert mean == pytest.approx(sum(values) + robots * (0.3 + 0.2 * 0.5 + 0.1 * 0.25))


def test_the_policy_of_a_bound_has_its_prices(pool: Pool, strangers: Pool) -> None:
    """Without any, attention is free if everybody has a robot, and else costs as much as usual."""
    assert bound_at(pool, (0, 1), [0.3, 0.2]).policy().price.tolist() == [0.3, 0.2, 0.0]
    for base, robots, team, expected in (
        (pool, 2, (0, 1), 0.0), (pool, 1, (0, 1), 0.15), (pool, 1, (0,), 0.0), (strangers, 2, (0, 1, 2), 0.15),
    ):  # fmt: skip
        several = replace(base, setting=replace(base.setting, robots=robots))
        assert bound_at(several, team, []).policy().price == pytest.approx([expected])


def test_what_a_bounds_policy_and_its_relaxed_problem_need(pool: Pool) -> None:
    """Prices hold with unknown goals, too, and the simulation needs the values of all states."""
    assert bound_at(pool, (1,), [0.3]).policy().price.tolist() == [0.3, 0.0]
    unknown = Pool.sample(ring(), 1, seed=1, setting=SETTING)
    assert bound_at(unknown, (0,), [0.3]).policy().price.tolist() == [0.3, 0.0]
    large = Pool.sample(kit("tiny"), 1, seed=1, states=1, region=6, setting=replace(SETTING, knowledge="exact"))
    with pytest.raises(ValueError, match="relaxed_value: expected an enumerated task"):
        relaxed_value(bound_at(large, (0,), []), episodes=2)


def test_a_bound_from_sample_paths_counts_if_there_are_enough(strangers: Pool, capsys: Any) -> None:
    """Of 30 paths it does, and it is the lower one here; fewer are only reported."""
    for paths in (4, 30):
        found = upper_bound(strangers, window=0, gap=1e-2, paths=paths, jobs=1)
        assert found.sampled.paths == paths
        assert found.sampled.upper < found.proven
        assert found.upper == (found.proven if paths < 30 else found.sampled.upper)
        show_samples(found)
        said = "4 sample paths are too few for a bound; 30 are needed"
        assert (said in capsys.readouterr().out) == (paths < 30)


def test_a_bound_on_a_truncated_task_holds_for_the_whole_and_has_the_rounds_that_are_asked_for(strangers: Pool) -> None:
    told: list[tuple[str, int, int]] = []
    given = {"setting": strangers.setting, "population": Population(beta=(0.1, 0.5)), "seed": 1}
    whole, large = (Pool.sample(kit("tiny"), 3, **more, **given) for more in ({}, {"states": 1, "region": 6}))  # type: ignore[arg-type]
    bound = partial(team_bound.upper_bound, window=2, gap=0.05, jobs=1, options=BoundOptions(2, 50))
    one, other = bound(whole), bound(large, paths=4, progress=lambda *what: told.append(what))
    assert other.proven >= one.upper - one.slack
    assert other.sampled is not None
    assert [what for what in told if what[0] == "optimising prices"] == [("optimising prices", n, 2) for n in (0, 1)]


def test_prices_on_truncated_tasks_are_optimised_where_there_is_memory_for_them(strangers: Pool) -> None:
    given = {"setting": strangers.setting, "population": Population(beta=(0.1, 0.5)), "seed": 1}
    large = Pool.sample(kit("tiny"), 3, states=1, region=6, **given)  # type: ignore[arg-type]
    priced, without = (
        upper_bound(large, gap=0.05, options=BoundOptions(2, 50, price_memory_mb=least)) for least in (1.0, 1e9)
    )
    assert len(priced.price) > len(without.price) == 0
    assert priced.upper < without.upper


def test_policies_are_certified_by_their_names(pool: Pool) -> None:
    def quiet(team: TeamState) -> TeamAction:
        return NoAssistance()(team)

    told: list[tuple[str, int, int]] = []
    policies = {"first": "none", "mine": quiet}
    found, certificates = certify(
        pool, policies, episodes=30, seed=3, window=0, progress=lambda *what: told.append(what)
    )  # fmt: skip
    assert [(c.policy, c.humans, c.episodes) for c in certificates] == [("first", 2, 30), ("mine", 2, 30)]
    assert certificates[0] == replace(certificates[1], policy="first")
    assert certificates[1] == found.certify(quiet, "mine", episodes=30, seed=3)
    assert certificates[1] != found.certify(quiet, "mine", episodes=30, seed=4)
    assert certificates[1].upper == found.upper
    assert certificates[1].slack_percent == pytest.approx(100 * found.slack / abs(certificates[1].value))
    assert told[-3:] == [("simulating policies", done, 60) for done in (0, 30, 60)]
    assert found.certify("none", episodes=30) == found.certify("none", episodes=30, seed=0)
    assert found.certify("none", episodes=1025, time_limit=1e-9).episodes == 1024
    names = [found.certify(policy, episodes=2).policy for policy in ("none", quiet, partial(quiet))]
    assert names == ["none", "quiet", "policy"]
    assert certify(pool, {"none": "none"}, episodes=30, seed=3, window=0, time_limit=1e9)[1][0] == replace(
        certificates[0], policy="none"
    )
    for run in (partial(certify, pool, policies), partial(found.certify, "none")):
        with pytest.raises(ValueError, match=r"^episodes 1: expected a whole number of 2 or more"):
            run(episodes=1)
    for gap, shown in ((5, "5"), ("5%", "'5%'"), (-0.1, "-0.1")):
        with pytest.raises(ValueError, match=rf"^gap {shown}: expected a fraction from 0 to 1, such as 0.05 for 5 %"):
            upper_bound(pool, gap=gap)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^time_limit -1: expected more than 0"):
        certify(pool, policies, time_limit=-1)


def test_a_bound_and_certificates_share_what_is_told_of_luck_and_progress(strangers: Pool) -> None:
    told: list[str] = []
    options = {"window": 4, "gap": 1e-3}
    found, _ = certify(strangers, {}, seed=7, progress=lambda what, *_: told.append(what), **options)
    assert found.price.tolist() == upper_bound(strangers, seed=7, **options).price.tolist()  # type: ignore[arg-type]
    other = upper_bound(strangers, **options)  # type: ignore[arg-type]
    assert other.price.tolist() == upper_bound(strangers, seed=0, **options).price.tolist()  # type: ignore[arg-type]
    assert found.price.tolist() != other.price.tolist()
    assert {"optimising prices", "bounding people's problems"} <= set(told)


@pytest.mark.parametrize(
    "ways", thinned([[(1, 0, 0), (1, 1, 0)], [(3, 2, 0), (2, 1, 1), (1, 0, 3), (2, 3, 4), (1, 2, 0)]])
)
@pytest.mark.parametrize("window", [pytest.param(None, marks=pytest.mark.slow), 3])
def test_tasks_with_free_actions_are_bounded(ways: list[tuple[int, int, int]], window: int | None) -> None:
    """Some actions cost nothing, or all of them: no scale is taken from a cost of 0."""
    task = Choices.of(sweep(graph_task(ways, start=max(way[0] for way in ways))))
    pool = Pool.sample(task, 2, seed=1, setting=SETTING)
    found = upper_bound(pool, window=window, gap=1e-3, paths=4, jobs=1)
    assert found.sampled.paths == 4
    for name in ("none", "priority"):
        certified = found.certify(name, episodes=2000)
        assert certified.value - 4 * certified.value_stderr <= min(found.proven, found.upper) + 1e-9


@pytest.mark.parametrize(
    "theta", [(0.5, 0.95), *(pytest.param((end, end), marks=pytest.mark.slow) for end in (0.0, 1.0))]
)
def test_choices_without_lapses_may_have_probability_0(choices: Choices, theta: tuple[float, float]) -> None:
    """Sampled bounds omit choices of probability 0; they equal the bounds for a lapse rate of 1e-12."""
    found = []
    for lapse in (0.0, 1e-12):
        pool = Pool.sample(
            choices,
            2,
            seed=1,
            setting=replace(SETTING, lapse=lapse),
            population=Population(beta=(0.0, 40.0), theta=theta),
        )
        sampled = upper_bound(pool, window=3, gap=1e-3, paths=4, jobs=1).sampled
        found.append(sampled.mean)
    assert found[0] == pytest.approx(found[1], abs=1e-3)


def test_people_whose_task_is_solved_at_the_start_have_a_bound_of_zero() -> None:
    pool = Pool.sample(sweep(graph_task([(0, 1, 1), (1, 0, 1)], start=0)), 2, seed=1)
    for paths in (0, 40):
        assert team_bound.upper_bound(pool, paths=paths, seed=0).upper == 0


def test_numbers_for_which_the_penalty_is_not_proven_are_refused() -> None:
    for alphas in ((), (0.5, 1.5), (-0.1, 0.5)):
        with pytest.raises(ValueError, match="expected numbers from 0 to 1"):
            RelaxationOptions(alphas=alphas)
    for wrong in ({"fading": 1.5}, {"fading": -0.1}, {"decay_steps": 0.0}, {"decay_steps": -5.0}, {"steps_ahead": -1}):
        with pytest.raises(ValueError, match="expected"):
            RelaxationOptions(**wrong)
