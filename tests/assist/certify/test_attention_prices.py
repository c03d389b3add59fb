"""Prices of attention: people whose behaviour is certain, truncated tasks, and the number of steps with prices."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from conftest import graph_task, kit
from test_goal_bounds import ring
from test_qmdp import PlainBackup

from assist.certify.priced_steps import window_of
from assist.certify.prices import SubproblemGroup, groups_of
from assist.people import Choices, Population
from assist.person import AttentionSubproblem, Setting, qmdp
from assist.person.attention_subproblem import with_actions
from assist.person.truncated_bound import likely
from assist.team import Pool, simulate
from planner import sweep

SETTING = Setting(knowledge="exact", gamma=0.9, c_suggest=0.01, c_move=0.02, eta=0.0, lapse=0.0, robots=2)


def pool_of(ways: list[tuple[int, int, int]], start: int, size: int = 2, **people: Any) -> Pool:
    choices = Choices.of(sweep(graph_task(ways, start=start)))
    return Pool.sample(choices, size, seed=1, setting=SETTING, **people)


def only_group(pool: Pool, window: int, time: float = 0.0, **options: Any) -> SubproblemGroup:
    team, pool = tuple(range(len(pool.people))), replace(pool, setting=replace(pool.setting, travel_time=time))
    (group,) = groups_of(pool, team, pool.setting.travel(len(team)), window, **options)
    return group


def test_attention_to_people_who_do_what_they_are_told() -> None:
    """In the robot's model, people follow each suggestion; alone they would walk at random, on the last two steps.

    The pool's own people never follow: the simulation is of the model.
    """
    ways = [(5, 4, 1), (4, 3, 1), (3, 2, 1), (2, 1, 1), (1, 0, 1), (2, 3, 1), (1, 2, 1)]
    follow, never = (Population(beta=(0.0, 0.0), theta=(theta, theta)) for theta in (1.0, 0.0))
    pool = pool_of(ways, 5, population=never, prior=follow)
    cost, gamma = np.ones(5), 0.9 ** np.arange(8)
    for time, attended in ((0.0, [0, 0, 0, 1, 1, 0, 0]), (2.0, [0, 1, 1, 1, 1, 0, 0])):
        group = only_group(pool, 7, time)
        assert (group.places, group.count, group.problem.outer, group.problem.between) == ((0, 1), 2, None, None)
        assert group.visits.price.tolist() == [0] * 7
        number, found = group.simulated(with_actions(np.zeros(7)), 8, 5, 0)
        assert number[0].tolist() == attended
        paid = 0.02 * gamma[attended.index(1)] + 0.01 * (gamma[3] + gamma[4])
        np.testing.assert_allclose(found, [-(cost @ gamma[:5]) - paid] * 5)
        shorter = group.at(with_actions(np.array([0.25, 0.5])))
        assert shorter.price.tolist() == [0.25, 0.5]
        assert shorter.layout.step.max() == 2
        # A price is paid at its step: here the suggestions are worth it, and the way is not the cheaper for it.
        price = np.array([0.0, 0.0, 0.0, 0.25, 0.5, 0.0, 0.0])
        number, dearer = group.simulated(with_actions(price), 8, 5, 0)
        assert number[0].tolist() == attended
        np.testing.assert_allclose(found - dearer, 0.25 * gamma[3] + 0.5 * gamma[4])
        assert group.simulated(with_actions(price), 4, 5, 0)[1] == pytest.approx(
            -gamma[:4].sum() - paid + 0.01 * gamma[4] - 0.25 * gamma[3]
        )
        free = qmdp(AttentionSubproblem.of(pool.policies[0].pomdp, 0.02, int(time)).pomdp, tolerance=1e-12).value_mdp
        np.testing.assert_allclose(group.tail, free, atol=1e-5)
        assert (group.tail >= free - 1e-9).all()
        left = group.simulated(with_actions(np.array([0.0, 0.0, 0.0, 0.0, 9.0, 0.0, 0.0])), 8, 5, 0)[0]
        assert left[0].tolist()[:5] == [*attended[:4], 0]  # the robot leaves before the price
    assert group.simulated(with_actions(np.full(7, 9.0)), 3, 5, 0)[0][0].tolist() == [0] * 7


def test_episodes_differ_by_their_seed() -> None:
    group = only_group(pool_of([(2, 1, 1), (1, 0, 1), (1, 2, 1)], 2, population=Population(beta=(0.1, 0.5))), 3)
    one, same, other = (group.simulated(with_actions(np.full(3, 0.1)), 9, 20, seed)[1].tolist() for seed in (1, 1, 2))
    assert one == same != other
    assert len(one) == 20


def test_people_with_several_goals_count_by_the_chance_of_each() -> None:
    pool = Pool.sample(ring(), 3, seed=1, setting=SETTING)
    groups = groups_of(pool, (0, 1, 2), pool.setting.travel(3), 0)
    assert [group.count for group in groups] == pytest.approx([1.5, 0.9, 0.6])
    assert all(group.places == (0, 1, 2) for group in groups)


@pytest.fixture(scope="module")
def truncated() -> SubproblemGroup:
    """The kind of people on a task of which six states are enumerated, within the whole one."""
    pool = Pool.sample(kit("tiny"), 2, seed=1, states=1, region=6, setting=replace(SETTING, c_suggest=0.1))
    return only_group(pool, 3, with_outer=True)


def test_prices_on_a_truncated_task(truncated: SubproblemGroup) -> None:
    group, price = truncated, np.array([1.0, 0.5, 0.2])
    assert (group.count, len(group.visits.price)) == (2, 0)
    group = replace(group, problem=replace(group.problem, pairs=3))
    visits = group.at(with_actions(price))
    kept = likely(group.visits.alone, 3, 3)
    plain = AttentionSubproblem.of(group.visits.alone, group.visits.entry, group.visits.entry_steps, price, kept=kept)
    for found, same in ((visits, plain), (group.at(with_actions(np.zeros(0))), group.visits)):
        np.testing.assert_array_equal(found.layout.x, same.layout.x)
        np.testing.assert_array_equal(found.pomdp.robot_costs, same.pomdp.robot_costs)
    free = group.at(with_actions(np.zeros(0))).pomdp.frontier
    np.testing.assert_array_equal(free.upper, group.visits.pomdp.frontier.upper)
    expected = group.problem.outer.beyond(plain, group.tail).pomdp.frontier
    np.testing.assert_array_equal(visits.pomdp.frontier.upper, expected.upper)


def test_a_policy_on_a_truncated_task_looks_a_step_ahead(truncated: SubproblemGroup) -> None:
    """It does so at the price of its step, to values with the prices of all later steps."""
    group, price = truncated, np.array([1.0, 0.5, 0.2])
    visits, policy = group._with_policy(with_actions(price))
    assert visits is group.problem.between.visits
    after, pomdp = [group.problem.between.value], visits.pomdp
    for step in (2, 1, 0):
        backed_up = PlainBackup(visits.at_price(price[step])).backup(after[0])
        after.insert(0, np.minimum(backed_up, group.problem.between.value))
    x = np.flatnonzero(~pomdp.ends)
    belief = np.broadcast_to(pomdp.prior, (len(x), *pomdp.prior.shape))
    for step in range(6):
        action = policy(step, x).choose(x, belief)
        own = visits.at_price([*price, 0.0, 0.0, 0.0][step])
        q = PlainBackup(own).values(after[min(step + 1, 3)])[x]
        q = np.where(np.isfinite(q[..., 0, 0]), (np.nan_to_num(q) * pomdp.prior).sum(axis=(2, 3)), -np.inf)
        best = q[np.arange(len(x)), action]
        np.testing.assert_allclose(best, q.max(axis=1), atol=1e-9)
        found = policy(step, x).q_values(x, belief)
        np.testing.assert_allclose(found[np.isfinite(q)], q[np.isfinite(q)], atol=1e-9)
    number, _ = group.simulated(with_actions(np.array([9.0, 9.0, 0.0])), 8, 50, 0)
    assert number[0, :2].tolist() == [0, 0]
    assert 0 < number[0, 2] <= 1


@pytest.mark.parametrize(
    ("ways", "options", "expected"),
    [
        ([(1, 0, 1)], {}, 6),  # a plan costs one unit, and has twelve actions
        ([(1, 0, 1)], {"at_work": 1}, 2),  # no more than one person for each of the two robots
        ([(1, 0, 1)], {"at_work": 0.9, "plans": 20}, 12),
        ([(2, 1, 3), (1, 0, 4)], {"at_work": 0, "plans": 2.5}, 6),  # 7 / 3 units: twice that are 5 steps, rounded up
        ([(2, 1, 3), (1, 0, 4)], {"at_work": 1, "plans": 2.5}, 5),
        ([(2, 1, 3), (1, 0, 4)], {"at_work": 0}, 12),
    ],
)
def test_steps_with_prices(ways: list[tuple[int, int, int]], options: dict[str, Any], expected: int) -> None:
    """Two people walk along a line; its first actions cost nothing."""
    start = max(way[0] for way in ways)
    free = [(a, b, 0) for a, b in pairwise(range(12, start - 1, -1))]
    pool = pool_of([*ways, *free], 12)
    assert window_of(pool, (0, 1), 0, **{"at_work": 0, **options}) == expected
    # Of three people, only those of the team count.
    assert window_of(pool_of([*ways, *free], 12, 3), (0, 1), 0, **{"at_work": 0, **options}) == expected


def test_steps_with_prices_for_people_who_stray() -> None:
    """If the robot's model is of people who do not stray, two of them are at work for two steps."""
    ways = [(2, 1, 1), (1, 0, 1), (1, 2, 1)]
    strays, sure = (Population(beta=(beta, beta)) for beta in (0.0, 40.0))
    assert window_of(pool_of(ways, 2, population=strays, prior=sure), (0, 1), 0, at_work=0) == 4  # type: ignore[arg-type]
    pool = pool_of(ways, 2, 3, population=Population(beta=(0.0, 0.1)))
    alone = simulate(pool, "none", humans=[0, 1, 2], episodes=64, seed=4, world="model").actions
    busy = [np.mean([sum(actions > step for actions in one) for one in alone]) for step in range(24)]
    for at_work in (0.1, 0.2, 0.4, 0.6):
        count = sum(number > 2 * at_work for number in busy)
        assert window_of(pool, (0, 1, 2), 4, at_work=at_work, plans=12) == max(4, count)  # type: ignore[arg-type]
    short = pool_of([(1, 0, 1)], 1, 2)
    mixed = Pool(SETTING, (short.people[0], pool.people[0]), (short.policies[0], pool.policies[0]), np.arange(2))
    assert window_of(mixed, (0, 1), 0) == 4  # the longer of two plans
    assert window_of(Pool.sample(ring(), 1, seed=1, setting=SETTING), (0,), 0) == 4  # the furthest goal: two steps
