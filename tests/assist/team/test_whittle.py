"""The Whittle policy: its indices against bisection on plain arrays, and its place among the other policies."""

from __future__ import annotations

import numpy as np
import pytest
from graphs import graph_task
from scipy.optimize import brentq
from teams import state

from assist.person.pomdp import AssistPOMDP
from assist.person.settings import Setting
from assist.team.pool import Pool
from assist.team.simulate import simulate
from assist.team.state import NOBODY
from assist.team.whittle import Whittle
from planner import Table, sweep


def index_of(pomdp: AssistPOMDP, x: int, b: int, t: int) -> float:
    """Return the exact index of a person with known beta and theta, to whom the robot comes at no cost."""
    n, R = pomdp.suggested.shape
    choices = pomdp.model.choices
    states, P, cost = np.arange(n), np.zeros((R, n, n)), np.zeros((R, n))
    for robot in range(R):
        for slot in range(choices.targets.shape[1]):
            chance = (
                pomdp.likelihood(states, np.full(n, robot), np.full(n, slot))[:, b, t] * choices.applicable[:, slot]
            )
            np.add.at(P[robot], (states, choices.targets[:, slot]), chance)
            cost[robot] += chance * choices.costs[:, slot]
    padding = (np.arange(R)[:, None] >= pomdp.robot_actions) & (np.arange(R)[:, None] > 0)
    working = ~pomdp.ends

    def advantage(price: float) -> float:
        """Return what presence brings, less the price of this step; staying silently is presence as well."""
        value = np.zeros(n)
        while True:
            q = -cost - pomdp.robot_costs.T + pomdp.gamma * P @ value
            silent = q[0]
            present = np.where(padding, -np.inf, q).max(axis=0) - price
            new = np.where(working, np.maximum(silent, present), 0.0)
            if np.abs(new - value).max() < 1e-11:
                return float(present[x] - silent[x])
            value = new

    return float(brentq(advantage, 0, 50, xtol=1e-9))


def test_indices_equal_those_by_bisection(tiny: Table) -> None:
    setting = Setting(gamma=0.9, c_move=0, c_suggest=0.02, knowledge="exact", trust="constant", lapse=0)
    pool = Pool.sample(tiny, 2, seed=0, setting=setting)
    pomdp, rng = pool.policies[0].pomdp, np.random.default_rng(0)
    policy = Whittle.of(pool.policies, setting.travel(2), np.linspace(0, 1, 51).tolist())
    B, T = pomdp.prior.shape
    compared = 0
    for x in np.flatnonzero(~pomdp.ends).tolist():
        b, t = int(rng.integers(B // 2)), int(rng.integers(T // 2, T))
        belief = np.zeros((2, B, T))
        belief[:, b, t] = 1
        _, going, _ = policy.worth(state(pool, [x, x], belief=belief))
        if (going[0] > 0).all():  # people who do not need the robot have a negative index, which is not exact
            assert going[0] == pytest.approx(index_of(pomdp, x, b, t), abs=2e-3)
            compared += 1
    assert compared >= 8


def test_the_robot_goes_to_the_largest_index_and_not_for_less_than_the_way(tiny: Table) -> None:
    pool = Pool.sample(tiny, 3, seed=2, setting=Setting(c_suggest=0.02, c_move=0.01, knowledge="exact"))
    one = state(pool, [pool.choices(0).initial] * 3)
    policy = pool.policy("whittle")
    _, going, staying = policy.worth(one)
    assert policy(one).person[0] == going[0].argmax()
    assert staying[0] == 0
    far = state(pool, [pool.choices(0).initial] * 3, travel=Setting(c_move=50).travel(3))
    assert Whittle.of(pool.policies, far.travel)(far).person[0] == NOBODY


def test_it_helps_as_much_as_priority_does(tiny: Table) -> None:
    pool = Pool.sample(tiny, 4, seed=0, setting=Setting(c_suggest=0.1, c_move=0.1))
    returns = {
        name: simulate(pool, name, humans=4, episodes=300, seed=1).discounted_return
        for name in ("none", "priority", "whittle")
    }
    difference = returns["whittle"] - returns["priority"]
    assert returns["whittle"].mean() > returns["none"].mean() + 1
    assert abs(difference.mean()) < 0.02 * abs(returns["priority"].mean())


@pytest.mark.parametrize("prices", [[], [0.2, 0.1], [-1.0, 0.0]])
def test_prices_that_are_no_grid_are_refused(tiny: Table, prices: list[float]) -> None:
    pool = Pool.sample(tiny, 2, seed=0)
    with pytest.raises(ValueError, match="expected at least one, none below 0, in ascending order"):
        Whittle.of(pool.policies, pool.setting.travel(2), prices)


def test_prices_are_in_units_of_the_cheapest_action_that_is_not_free() -> None:
    roads = [(0, 1, 1), (1, 0, 1), (1, 2, 0), (2, 1, 0), (2, 3, 2), (1, 3, 5)]
    pool = Pool.sample(sweep(graph_task(roads, goal=3, start=0)), 2, seed=1, setting=Setting(knowledge="exact"))
    assert pool.policies[0].problem.cheapest == 1
    returns = {
        name: simulate(pool, name, humans=2, episodes=20, seed=1).discounted_return.mean()
        for name in ("none", "whittle", "priority", "rollout")
    }
    assert min(returns, key=lambda name: returns[name]) == "none"
    free = Pool.sample(sweep(graph_task([(0, 1, 0), (1, 2, 0)], goal=2)), 2, seed=1)
    assert simulate(free, "whittle", humans=2, episodes=5, seed=1).discounted_return.tolist() == [0.0] * 5
