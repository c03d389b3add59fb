"""Tasks whose actions have costs of very different size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import graph_task

from assist.certify.prices import window_of
from assist.people.choices import Choices
from assist.simulation.pool import Pool
from assist.simulation.simulate import simulate
from planner import Table, sweep

pytestmark = pytest.mark.cases


def there_and_back(dear: int) -> Table:
    """Return a task of two dear trips, each of which brings one of two parts; there are wrong ways."""
    roads = [(1, 2, 1), (2, 3, dear), (3, 4, 2), (4, 5, dear), (5, 6, 1), (6, 7, dear), (7, 0, 2)]
    back = [(2, 1, 2), (3, 2, dear), (4, 3, 1), (5, 4, dear), (6, 5, 2), (7, 6, dear)]
    return sweep(graph_task(roads + back))


@pytest.mark.parametrize("dear", [10, 10**4, 10**9, 10**12])
def test_prices_are_on_the_steps_of_a_plan_whatever_its_cost(dear: int) -> None:
    """The number of steps was the cost of the plan in units of its cheapest action: 134 GiB at a ratio of 1e9."""
    pool = Pool.sample(there_and_back(dear), 2, seed=1)
    assert 14 <= window_of(pool, (0, 1), 0) <= 42


@pytest.mark.parametrize("dear", [10**4, 10**9, 10**12])
def test_priority_is_simulated(dear: int) -> None:
    """Value iteration never converged: the tolerance was absolute, and rounding larger."""
    pool = Pool.sample(there_and_back(dear), 2, seed=1)
    run = simulate(pool, "priority", humans=[0, 1], episodes=4, seed=0)
    assert (run.discounted_return < -dear).all()
    assert np.isfinite(run.discounted_return).all()


def test_the_length_of_a_plan_is_its_smallest_number_of_actions() -> None:
    choices = Choices.of(there_and_back(50))
    at = int(np.argmax(choices.h))
    assert choices.plan_length(at) == 7
    cut = choices.optimal.copy()
    cut[np.argsort(choices.h)[5]] = False  # the choices end two steps later, after a third of the cost
    assert 5 < replace(choices, optimal=cut).plan_length(at) < 9
    free = Choices.of(sweep(graph_task([(1, 2, 0), (2, 1, 0), (2, 3, 4), (3, 0, 0), (1, 4, 1)])))
    assert free.plan_length(free.initial) == 3
    assert free.plan_length(int(np.flatnonzero(np.isinf(free.h))[0])) == np.inf
