"""The rollout policy of teams: its estimates against simulated returns, and its place among the other policies."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from conftest import kit, thinned
from teams import state
from test_unknown_goals import three_goals

from assist.people import Choices, Goals, Neighbours, SeenFollowed
from assist.person import ObservationModel, Setting
from assist.team import Pool, Rollout, RolloutOptions, TeamAction, TeamState, simulate
from assist.team.rollout import _Paths
from planner import Table

TEAM = [0, 1, 2]


def of(table: Table | Choices | Goals, **setting: Any) -> Pool:
    return Pool.sample(table, 3, seed=0, setting=Setting(c_suggest=0.2, **setting))


def start(pool: Pool) -> TeamState:
    """Return the first state of the pool's people."""
    return state(pool, [pool.choices(k).initial for k in TEAM])


@pytest.mark.parametrize(
    "setting",
    [
        {"execute": True, "travel_time": 1.0},
        {"goals": True},
        {"neighbours": Neighbours(rule=SeenFollowed(0.3, 0.2), sees="next"), "robots": 2, "travel_time": 1.0},
        pytest.param({}, marks=pytest.mark.slow),
        pytest.param({"robots": 2, "travel_time": 2.0}, marks=pytest.mark.slow),
        pytest.param({"neighbours": Neighbours(rule="followed"), "trust": "constant"}, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_the_advantages_on_sample_paths_are_those_of_simulated_returns(tiny: Table, setting: dict[str, Any]) -> None:
    """V at the start and the mean sum of advantages are priority's return: the differences of V have mean 0."""
    pool = of(three_goals("tiny")) if "goals" in setting else of(tiny, **setting)
    policy, team = Rollout.of(pool.policies, pool.setting.travel(3), RolloutOptions(horizon=200)), start(pool)
    paths = _Paths(policy, team, np.array([0]), [policy.base(team)], np.ones((1, 1), dtype=bool), 150, 0)
    sums = paths.values()[0]
    for k, one in enumerate(pool.policies):
        solved = one.with_robot(policy.base)
        values = solved.policy.value_mdp[solved.states[0][0, team.x[0, k]]]
        sums += (values * team.belief[0, k]).sum()
    found = simulate(pool, "priority", humans=TEAM, episodes=300, seed=1, world="model").discounted_return
    error = np.hypot(sums.std() / np.sqrt(len(sums)), found.std() / np.sqrt(len(found)))
    assert abs(sums.mean() - found.mean()) < 4 * error
    if "neighbours" not in setting:  # what people see of each other is no part of their own problems, which V is of
        assert sums.std() < found.std() / 2


@pytest.mark.parametrize("options", thinned([{"errors": 1e9}, {"people": 0}, {"near": 0}], 3))
def test_without_a_better_alternative_it_is_priority(tiny: Table, options: dict[str, Any]) -> None:
    pool = of(tiny)
    policy = Rollout.of(pool.policies, pool.setting.travel(3), RolloutOptions(**options))
    own, base = (simulate(pool, one, humans=3, episodes=4, seed=2) for one in (policy, pool.policy("priority")))
    np.testing.assert_array_equal(own.discounted_return, base.discounted_return)


def test_the_same_state_has_the_same_action_whatever_is_simulated_beside_it(tiny: Table) -> None:
    pool = of(tiny, c_move=2.0)
    policy = Rollout.of(pool.policies, pool.setting.travel(3), RolloutOptions(samples=16, errors=0.0))
    whole = simulate(pool, policy, humans=TEAM, episodes=30, seed=4, jobs=2)
    part = simulate(pool, policy, humans=TEAM, episodes=[3, 20, 29], seed=4)
    np.testing.assert_array_equal(part.discounted_return, whole.discounted_return[[3, 20, 29]])
    base = simulate(pool, "priority", humans=TEAM, episodes=30, seed=4)
    assert (whole.discounted_return != base.discounted_return).any()


@pytest.mark.slow
def test_changed_actions_are_better_on_other_sample_paths() -> None:
    pool = Pool.sample(kit("paper"), 3, seed=0, setting=Setting(c_move=2.0))
    policy = Rollout.of(pool.policies, pool.setting.travel(3))
    gains = []

    def compared(team: TeamState) -> TeamAction:
        own, base = policy(team), policy.base(team)
        differs = (own.person != base.person) | (own.action != base.action)
        rows = np.flatnonzero(differs.reshape(len(team.x), -1).any(1))
        if len(rows):
            ahead = _Paths(policy, team, rows, [base, own], np.ones((len(rows), 2), dtype=bool), 200, 9).values()
            gains.extend((ahead[1::2] - ahead[::2]).mean(axis=1).tolist())
        return own

    simulate(pool, compared, humans=TEAM, episodes=50, seed=7, world="model")
    assert len(gains) >= 10
    assert np.mean(gains) > 2 * np.std(gains) / np.sqrt(len(gains))


def test_it_infers_goals() -> None:
    pool = of(three_goals("tiny"))
    found = simulate(pool, "rollout", humans=2, episodes=2, seed=0)
    assert found.finished.all()
    assert found.interventions.any()


def test_what_it_cannot_know_is_refused(tiny: Table) -> None:
    hidden = of(tiny, observation=ObservationModel(0.05, 0.1))
    with pytest.raises(ValueError, match="observation: expected none, as policy 'rollout' has actions"):
        hidden.policy("rollout")
    for wrong in ({"samples": 4}, {"near": -1.0}, {"people": -1}, {"errors": "many"}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            RolloutOptions(**wrong)
