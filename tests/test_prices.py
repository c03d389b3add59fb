"""The policy whose price of attention follows the team: which price it takes, its bound, and what it then does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from teams import state

from assist.simulation.pool import Pool
from assist.simulation.simulate import simulate
from assist.team.prices import PriceMenu, Repriced
from assist.team.priority import Priority
from assist.team.settings import Setting
from assist.team.state import TeamAction, TeamState
from planner import Table


@pytest.fixture(scope="module")
def strangers(tiny: Table) -> Pool:
    return Pool.sample(tiny, 6, seed=0, setting=Setting(c_suggest=0.1, c_move=0.1, knowledge="exact"))


@pytest.fixture(scope="module")
def priced(strangers: Pool) -> Repriced:
    return Repriced.of(strangers.policies, strangers.setting.travel(2), PriceMenu((0.1, 0.2, 0.4)))


def test_attention_is_free_for_as_many_people_as_robots(strangers: Pool) -> None:
    pool = replace(strangers, setting=replace(strangers.setting, robots=2))
    free = Priority.of(pool.policies, pool.setting.travel(2), 0.0)
    found = [
        simulate(pool, policy, humans=2, episodes=100, seed=1).discounted_return
        for policy in (pool.policy("prices"), free)
    ]
    np.testing.assert_array_equal(*found)


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), robots=st.integers(1, 3))
def test_the_price_falls_with_robots_and_rises_with_people_who_need_no_more_than_others(
    strangers: Pool, priced: Repriced, seed: int, robots: int
) -> None:
    team = state(strangers, np.random.default_rng(seed).integers(len(strangers.choices(0)), size=6))
    crowd = replace(team, x=np.full_like(team.x, team.x[0, 0]))
    prices = []
    for present in range(7):
        some = replace(crowd, active=crowd.active & (np.arange(6) < present))
        prices.append(int(priced.chosen(of_robots(some, robots))[0]))
    assert prices == sorted(prices)
    assert not any(prices[: robots + 1])
    assert priced.chosen(of_robots(crowd, robots + 1))[0] <= prices[-1]


def of_robots(team: TeamState, robots: int) -> TeamState:
    return team if robots == 1 else replace(team, location=np.full((1, robots), -1))


def test_a_crowd_pays(strangers: Pool, priced: Repriced) -> None:
    crowd = state(strangers, [strangers.choices(0).initial] * 6)
    assert priced.chosen(crowd)[0] > 0


def test_teams_do_not_depend_on_each_other(strangers: Pool, priced: Repriced) -> None:
    def checked(team: TeamState) -> TeamAction:
        together = priced(team)
        for n in range(len(team.x)):
            row = slice(n, n + 1)
            assert team.belief is not None
            own = replace(
                team, x=team.x[row], active=team.active[row], erred=team.erred[row], location=team.location[row],
                model=team.model[row], belief=team.belief[row],
            )  # fmt: skip
            alone = priced(own)
            assert (alone.person[0], alone.robot[0]) == (together.person[n], together.robot[n])
        return together

    simulate(strangers, checked, humans=5, episodes=6, seed=2)


@pytest.mark.parametrize("levels", [(), (0.0,), (0.1, -0.1)])
def test_a_menu_without_prices_is_refused(levels: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="expected one or more multiples above 0"):
        PriceMenu(levels)
