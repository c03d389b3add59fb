"""Estimates from few actions, whose likelihoods have ridges and flat parts, compared with grids of all parameters."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import kit
from recorded import lines, observed, people_at_work

from assist.learning.likelihood import Method, largest_beta
from assist.learning.likelihood_table import log_likelihood
from assist.learning.maximum_likelihood import maximum_likelihood
from assist.learning.observations import Observations
from assist.people.choices import Choices

DROP = 1.9207


def ten_actions(instance: str, people: int, suggest: float, seed: int) -> list[Observations]:
    """Return observations of ten actions of each person, with suggestions in a share of the steps."""
    table = kit(instance)
    choices, rng = Choices.of(table), np.random.default_rng(seed)
    rows = []
    for k in range(people):
        own = people_at_work(choices, [rng.uniform(0.1, 5)], rng, suggest=suggest, theta=rng.uniform(0.3, 0.95))
        rows += [{**row, "person": f"p{k:03}"} for row in own[:10]]
    return observed(table, rows)


@pytest.mark.parametrize(
    ("instance", "suggest", "seed", "eta"),
    [("tiny", 1.0, 0, None), ("tiny", 0.5, 5, None), ("paper", 0.5, 0, None), ("paper", 1.0, 3, 0.2)],
)
def test_nothing_on_a_grid_is_likelier_or_left_out(instance: str, suggest: float, seed: int, eta: float | None) -> None:
    team, method = ten_actions(instance, 3, suggest, seed), Method(eta=eta)
    largest = largest_beta(team, method)
    beta = 1e-3 * largest * np.expm1(np.linspace(0, np.log1p(1e3), 49))
    shares = np.unique([*np.linspace(0, 1, 51), 0.002, 0.998, *np.linspace(0, 1, 31), *np.linspace(0, 1, 17)])
    for o, found in zip(team, maximum_likelihood(team, method), strict=True):
        rates = np.array([0.0 if eta is None else eta]) if "eta" not in found.estimates else shares
        values = log_likelihood(o, beta, np.array([0.5]) if "theta" not in found.estimates else shares, rates)
        assert found.log_likelihood >= values.max() - 1e-6
        for axis, (name, estimate) in enumerate(found.estimates.items()):
            grid = beta if name == "beta" else shares
            kept = values.max(axis=tuple({0, 1, 2} - {axis})) > found.log_likelihood - DROP + 1e-3
            assert not kept.any() or estimate.interval[0] - 1e-3 * grid[-1] <= grid[kept].min()
            assert not kept.any() or grid[kept].max() <= estimate.interval[1] + 1e-3 * grid[-1]
            assert estimate.open_below or not kept[0]
            assert estimate.open_above or not kept[-1]


def test_an_interval_is_open_where_the_profile_is_flat_up_to_the_bound() -> None:
    """One fetch gives no information; a good choice after it bounds beta from below only, for all theta and eta."""
    plan = ["(fetch box-a)", "(place hammer slot-1 box-a)"]
    for told in ({}, {1: plan[1]}):
        for actions in (plan[:1], plan):
            (o,) = observed(kit("tiny"), lines(*actions, told=told))
            (found,) = maximum_likelihood([o])
            assert found.estimates["beta"].open_above
            assert found.beta_interval[1] == pytest.approx(largest_beta([o], Method()))
            for estimate in list(found.estimates.values())[1:]:
                assert (estimate.open_above, estimate.interval[1]) == (True, 1.0)


def test_theta_may_have_to_lie_in_a_narrow_range() -> None:
    """With a rate near 1 trust survives a bad suggestion only if it was about as large: theta is eta or more."""
    bad, good = "(return box-a)", "(place hammer slot-1 box-a)"
    told = {1: bad, 2: "(fetch box-a)", 3: good}
    (o,) = observed(kit("tiny"), lines("(fetch box-a)", "(return box-a)", "(fetch box-a)", good, told=told))
    (found,) = maximum_likelihood([o])
    theta = np.linspace(0, 1, 2001)
    for eta in (0.47, 0.49, 0.9, 0.99):
        profile = log_likelihood(o, np.geomspace(0.01, 5, 60), theta, np.array([eta])).max()
        if profile > found.log_likelihood - DROP + 1e-3:
            assert found.estimates["eta"].interval[0] <= eta <= found.estimates["eta"].interval[1]
