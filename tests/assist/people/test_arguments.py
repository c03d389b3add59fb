"""Checks of numeric arguments: valid values, invalid values, and values that are too large."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import pytest
from conftest import kit

from assist.certify.team_bound import upper_bound
from assist.people import Choices, Grid, Human, HumanModel, Population, boltzmann, perceived_cost
from assist.people.arguments import MOST, number
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

ONE = {"goals": (0.0, 1.0)}
"""The range of the weight of a term."""


def grid(beta: Any, theta: Any = (0, 1)) -> Grid:
    return Grid(np.array(beta), np.array(theta, dtype=float))


def person(beta: Any = 1.0, theta: Any = 0.5, sigma: Any = 0.0, h: Any = (0.0,)) -> Human:
    return Human(beta, theta, sigma, np.asarray(h))


def mixed(*shares: float, count: int = 2) -> Population:
    return Population.mixed((Population(),) * count, shares)


def model(**rates: float) -> HumanModel:
    return HumanModel.exact(Choices.of(kit("tiny")), **rates)


REFUSED: list[tuple[Callable[[], Any], str]] = [
    (lambda: mixed(0.5, NAN), "shares[2] nan: expected a number"),
    (lambda: mixed(True, count=1), "shares[1] True: expected a number"),
    (lambda: mixed(count=0), "0 parts: expected one or more"),
    (lambda: mixed(1.0), "2 parts, 1 shares: expected one share for each part"),
    (lambda: mixed(1.5, -0.5), "the shares add up to 1; expected numbers of 0 or more"),
    (lambda: mixed(0.5, 0.6), "the shares add up to 1.1; expected numbers of 0 or more that add up to 1"),
    (lambda: mixed(0.9, count=1), "the shares add up to 0.9;"),
    (lambda: Population(theta=(0.5, 1.2)), "theta (0.5, 1.2): expected two numbers, 0 <= low <= high <= 1"),
    (lambda: Population(beta=(1.0, INF)), "beta (1.0, inf): expected two numbers, 0 <= low <= high <= 1e+15"),
    (lambda: Population(beta=(NAN, 1.0)), "beta (nan, 1.0): expected"),
    (lambda: Population(sigma=(-0.1, 1.0)), "sigma (-0.1, 1.0): expected two numbers, 0 <= low <= high <= 1e+15"),
    (lambda: Population(sigma=(0.2, 0.1)), "sigma (0.2, 0.1): expected two numbers, 0 <= low <= high <= 1e+15"),
    (lambda: Population(noise="both"), "noise 'both': expected \"state\" or \"action\""),  # type: ignore[arg-type]
    (lambda: Population(weights={"goals": ("a", 1)}), "weights.goals ('a', 1): expected two numbers"),  # type: ignore[dict-item]
    (lambda: Population(weights={"goals": (1.0, 0.5)}), "weights.goals (1.0, 0.5): expected two numbers, -1e+15"),
    (lambda: Population(weights={"goals": (0.0, 2e15)}), "weights.goals (0.0, 2000000000000000.0): expected two"),
    (lambda: Population(weights=ONE, chooses=boltzmann), "weights of goals, and a choice model: expected one"),
    (lambda: person(beta=True), "beta True: expected a number"),
    (lambda: person(theta=np.zeros(1)), "theta array([0.]): expected a number"),
    (lambda: person(theta="high"), "theta 'high': expected a number"),
    (lambda: person(beta=2 * MOST), "beta 2e+15, theta 0.5, sigma 0: expected beta and sigma from 0 to 1e+15"),
    (lambda: person(beta=-0.1), "beta -0.1, theta"),
    (lambda: person(sigma=2 * MOST), "beta 1, theta 0.5, sigma 2e+15: expected"),
    (lambda: person(theta=1.5), "beta 1, theta 1.5, sigma"),
    (lambda: person(h=[0, NAN]), "h, shape (2,): expected a number for each"),
    (lambda: person(h=3), "h, shape (): expected a number for each state"),
    (lambda: person(h=np.zeros((1, 1, 1))), "h, shape (1, 1, 1): expected a number"),
    *((partial(model, lapse=lapse), f"lapse {lapse:g}: expected 0 <= lapse < 1") for lapse in (1.0, -0.1, NAN)),
    *((partial(model, eta=eta, utility_scale=scale), f"eta {eta:g}, utility_scale {scale:g}: expected eta from 0 to ")
      for eta, scale in ((-0.1, 1.0), (INF, 1.0), (NAN, 1.0), (0.2, 0.0), (0.2, -1.0), (0.2, INF))),
    *((partial(grid, beta), "beta: expected one or more ascending values from 0 upwards")
      for beta in ([NAN], [1.0, 0.5], [1.0, 1.0], [], [[1.0]], [-1.0])),
    (lambda: grid([0, INF]), "beta: expected finite values"),
    *((partial(grid, [1.0], theta), "theta: expected two or more ascending values")
      for theta in ([0.5], [[0, 1]], [0, 0.5, 0.5, 1])),
    *((partial(grid, [1.0], theta), "theta: expected a grid from 0 to 1, because") for theta in ([0.1, 1], [0, 0.9])),
    (lambda: Schedule.of(1, [2**63]), "joins [9223372036854775808]: expected whole numbers"),
    (lambda: Travel.of(1, distance=[[0, 1e300], [1, 0]]), "distance: expected 0 from each place"),
]  # fmt: skip


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


@pytest.mark.parametrize(("make", "text"), REFUSED, ids=[str(n) for n in range(len(REFUSED))])
def test_what_cannot_be_is_refused_in_one_sentence(make: Callable[[], Any], text: str) -> None:
    with pytest.raises(ValueError) as error:
        make()
    assert str(error.value).startswith(text)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("name", "value"), [("beta", MOST), ("sigma", MOST), ("theta", 0), ("theta", 1)])
def test_parameters_reach_the_ends_of_their_ranges(name: str, value: float) -> None:
    found = getattr(person(**{name: value}), name)
    assert (found, type(found)) == (value, float)
    for eta, scale in ((MOST, 1 / MOST), (0, MOST)):
        one = model(eta=eta, utility_scale=scale)
        assert (one.eta, one.utility_scale, type(one.eta)) == (eta, scale, float)
    assert grid([0.0]).shape == (1, 2)


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
    """They stay writable, and later changes to them do not affect the objects made from them."""
    choices = pool.choices(0)
    own = np.array([0.0, 1.0]), np.array([0.0, 1.0]), pool.model.copy(), choices.h.copy(), np.ones((3, 3)) - np.eye(3)
    beta, theta, models, h, distance = own
    q = perceived_cost(choices, h)[:, :, None]
    grid, human, travel = Grid(beta, theta), Human(1.0, 0.5, 0.0, h), Travel(distance, np.array([0.5]), np.zeros(1))
    other = Pool(pool.setting, pool.people, pool.policies, models)
    kept = [grid.beta, grid.theta, other.model, human.h, travel.distance, HumanModel(choices, q).q, travel.c_move]
    before = [array.copy() for array in kept]
    for array in (*own, q):
        array += 1
    for array, as_it_was in zip(kept, before, strict=True):
        np.testing.assert_array_equal(array, as_it_was)
        assert not array.flags.writeable
