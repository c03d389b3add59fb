"""Tasks whose actions have costs of very different size."""

from __future__ import annotations

import json
import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import graph_task, invoke, thinned
from test_cases import Case

from assist.certify.priced_steps import plan_length, window_of
from assist.people.choices import Choices
from assist.team.pool import Pool
from assist.team.simulate import simulate
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
    assert plan_length(choices, at) == 7
    cut = choices.optimal.copy()
    cut[np.argsort(choices.h)[5]] = False  # the choices end two steps later, after a third of the cost
    assert 5 < plan_length(replace(choices, optimal=cut), at) < 9
    free = Choices.of(sweep(graph_task([(1, 2, 0), (2, 1, 0), (2, 3, 4), (3, 0, 0), (1, 4, 1)])))
    assert plan_length(free, free.initial) == 3
    assert plan_length(free, int(np.flatnonzero(np.isinf(free.h))[0])) == np.inf


@pytest.fixture(scope="module")
def compiled_code(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Compilation, once after an installation, is in no limit of time."""
    problem = Case(go="3").write(tmp_path_factory.mktemp("usual"))
    invoke("bound", problem, "--humans", 2, "--time-limit", 1, "--value-episodes", 2)


@pytest.mark.usefixtures("compiled_code")
@pytest.mark.parametrize("case", thinned([Case((("(= (total-cost) 0)", ""),), go=f"{10**12}"), Case(go=f"{10**9}")]))
def test_costs_of_very_different_size_are_bounded_and_simulated(tmp_path: Path, case: Case) -> None:
    """Memory and time do not grow with the ratio of costs; a limit is kept in time of this process, as others work."""
    cost, problem = int(case.go), case.write(tmp_path)
    begun, limit, team = time.process_time(), 15, (problem, "--humans", 2, "--json")
    bound = json.loads(invoke("bound", *team, "--value-episodes", 16, "--time-limit", limit).stdout)
    run = json.loads(invoke("simulate", *team, "--episodes", 8, "--policy", "priority").stdout)["policies"][0]
    assert time.process_time() - begun < limit
    assert -9 * cost < bound["value"] - 3 * bound["value_stderr"] < bound["upper"] < -4 * cost
    assert -9 * cost < run["return"]["mean"] < -4 * cost
    assert math.isfinite(bound["slack_percent"])
