"""Checks of numeric arguments: valid values, invalid values, and values that are too large."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from assist.certify.team_bound import upper_bound
from assist.people import Grid, Human, Population
from assist.people.arguments import number
from assist.person import PersonProblem, Setting, Travel
from assist.team import Pool, Schedule
from assist.team.simulate import simulate
from planner import LimitError, Table

NAN, INF = float("nan"), float("inf")

NO_NUMBERS: list[Any] = [True, np.True_, "1", None, [1.0], np.array([0.5]), np.array(0.5), 1j, Decimal(1)]

SAMPLED: list[tuple[str, Any]] = [
    ("states", NAN), ("states", -1), ("states", True), ("region", 0), ("region", "x"), ("region", 2.5), ("size", True),
    ("seed", -1), ("memory_limit_mb", None), ("memory_limit_mb", "1"), ("memory_limit_mb", NAN),
]  # fmt: skip

PEOPLE: dict[str, tuple[Callable[[], Any], str]] = {
    "shares": (lambda: Population.mixed((Population(), Population()), (0.5, NAN)), "shares[2] nan: expected a number"),
    "share": (lambda: Population.mixed((Population(),), (True,)), "shares[1] True: expected a number"),
    "beta": (lambda: Human(True, 0.5, 0, np.zeros(1)), "beta True: expected a number"),
    "sigma": (lambda: Human(1, 0.5, 1e300, np.zeros(1)), "beta 1, theta 0.5, sigma 1e+300: expected beta and"),
    "theta": (lambda: Human(1, np.zeros(1), 0, np.zeros(1)), "theta array([0.]): expected a number"),  # type: ignore[arg-type]
    "h of no number": (lambda: Human(1, 0.5, 0, np.array([0, NAN])), "h, shape (2,): expected a number for each"),
    "h of one": (lambda: Human(1, 0.5, 0, np.array(3)), "h, shape (): expected a number for each state"),
    "h of three axes": (lambda: Human(1, 0.5, 0, np.zeros((1, 1, 1))), "h, shape (1, 1, 1): expected a number"),
    "weight": (lambda: Population(weights={"goals": ("a", 1)}), "weights.goals ('a', 1): expected two numbers"),  # type: ignore[dict-item]
    "grid": (lambda: Grid(np.array([NAN]), np.array([0, 1])), "beta: expected one or more ascending values"),
    "infinite grid": (lambda: Grid(np.array([0, INF]), np.array([0, 1])), "beta: expected finite values"),
    "joins": (lambda: Schedule.of(1, [2**63]), "joins [9223372036854775808]: expected whole numbers"),
    "distance": (lambda: Travel.of(1, distance=[[0, 1e300], [1, 0]]), "distance: expected 0 from each place"),
}  # fmt: skip


def said(error: pytest.ExceptionInfo[ValueError]) -> str:
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("value", NO_NUMBERS, ids=repr)
def test_what_is_no_number(value: Any) -> None:
    with pytest.raises(ValueError, match=r"^gamma .*: expected a number$"):
        number("gamma", value)


@pytest.mark.parametrize("value", [5, None, (1,), (1, 2, 3), "01", np.zeros((1, 2)), np.zeros((3, 1))], ids=repr)
@pytest.mark.parametrize("name", ["beta", "theta", "sigma"])
def test_what_is_no_range(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=rf"(?s)^{name} .*: expected two numbers"):
        Population(**{name: value})


def test_numbers_of_any_kind_become_pythons_own() -> None:
    given = Setting(gamma=np.float64(0.5), c_suggest=Fraction(1, 2), eta=np.float32(0.25), max_steps=np.int64(7))  # type: ignore[arg-type]
    assert given == Setting(gamma=0.5, c_suggest=0.5, eta=0.25, max_steps=7)
    assert [type(one) for one in (given.gamma, given.c_suggest, given.eta, given.max_steps)] == [float] * 3 + [int]
    people = Population(beta=np.array([0, 1]), theta=[0, 1])  # type: ignore[arg-type]
    assert hash(people) == hash(Population(beta=(0.0, 1.0), theta=(0.0, 1.0)))
    assert Human(np.float32(1), 0, 0, [1, 2]).h.dtype == float  # type: ignore[arg-type]


@pytest.mark.parametrize(("name", "value"), SAMPLED, ids=str)
def test_what_no_pool_is_drawn_with(tiny: Table, name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"^{name} {value!r}: expected"):
        Pool.sample(tiny, **{"size": 2, "seed": 0, name: value})


@pytest.mark.parametrize("name", PEOPLE)
def test_what_no_people_have(name: str) -> None:
    make, text = PEOPLE[name]
    with pytest.raises(ValueError) as error:
        make()
    assert said(error).startswith(text)


def test_a_problem_of_no_states(tiny: Table) -> None:
    with pytest.raises(ValueError, match=r"^states 0: expected a whole number"):
        PersonProblem.of(tiny, states=0)


def test_a_way_that_memory_does_not_hold(tiny: Table) -> None:
    pool = Pool.sample(tiny, 2, seed=0, setting=Setting(travel_time=1e8))
    with pytest.raises(LimitError, match="with ways of up to 100,000,000 steps, and takes about"):
        simulate(pool, "priority", humans=2, episodes=2, seed=0)
    with pytest.raises(LimitError, match="MB of memory"):
        upper_bound(pool, window=0)
    for given in ({"setting": Setting(knowledge="exact")}, {"states": 5}):
        with pytest.raises(LimitError, match=r"^1,000,000,000 people take about"):
            Pool.sample(tiny, 10**9, seed=0, **given)
    with pytest.raises(ValueError, match=r"^places 1,000,000,000: expected at most 1,000,000"):
        Travel.of(10**9)
    with pytest.raises(LimitError, match="with 10000000 steps of prices, take about"):  # before they are listed
        upper_bound(replace(pool, setting=Setting()), window=10**7)


def test_arrays_of_the_caller_stay_their_own(pool: Pool) -> None:
    beta, theta, model = np.array([0.0, 1.0]), np.array([0.0, 1.0]), pool.model.copy()
    grid, other = Grid(beta, theta), Pool(pool.setting, pool.people, pool.policies, model)
    beta += 1
    theta += 1
    model += 1
    np.testing.assert_array_equal(grid.beta, [0, 1])
    np.testing.assert_array_equal(grid.theta, [0, 1])
    np.testing.assert_array_equal(other.model, pool.model)
