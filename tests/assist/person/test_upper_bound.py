"""The upper bound on one person's POMDP: compared with linear programs, and in the form used by the search."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from scipy.optimize import linprog
from solved import NAMES, few, seeds, solution_of, some_beliefs

from assist.person import Solution, belief_hulls, convex_bound
from assist.person.problem_arrays import read_only
from assist.person.upper_hull import new_program


def hull_and_sawtooth(corner: np.ndarray, point: np.ndarray, drop: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """What points with known bounds prove at a belief: together, by a linear program, and each alone.

    The program is in units of the entries of b and of what each point can do alone: its tolerances are absolute.
    """
    base = float(corner @ b)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(point > 0, b / point, np.inf).min(axis=1, initial=np.inf)
    alone = share * drop
    some, rows = alone < 1e-13 * base, b > 0
    if not some.any():
        return base, base
    A = share[some] * point[some].T[rows] / b[rows, None]
    return base + linprog(alone[some], A_ub=A, b_ub=np.ones(len(A)), method="highs").fun, base + alone.min()


def of_state(solution: Solution, x: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the corner values, the points and their drops of a state."""
    rows = slice(solution.first[x], solution.first[x + 1])
    size = solution.pomdp.prior.size
    return solution.corner[x].reshape(-1), solution.point[rows].reshape(-1, size), solution.drop[rows]


@pytest.mark.parametrize("name", NAMES)
@few
@given(seed=seeds)
def test_upper_bound_is_the_convex_hull(name: str, seed: int) -> None:
    solution = solution_of(name)
    x, belief = some_beliefs(solution, seed, 10)
    least = [hull_and_sawtooth(*of_state(solution, y), b.reshape(-1))[0] for y, b in zip(x, belief, strict=True)]
    np.testing.assert_allclose(solution.upper_bound(x, belief), least, rtol=1e-7, atol=1e-12)


@few
@given(seed=seeds)
def test_upper_bound_holds_wherever_the_pivots_end(seed: int) -> None:
    """Even if pivots cycle, the result so far is a valid bound, and no worse than an earlier one."""
    rng = np.random.default_rng(seed)
    size, count, people = int(rng.choice([3, 10, 60])), int(rng.integers(1, 80)), 10
    point = rng.dirichlet(np.full(size, rng.choice([0.05, 1.0])), count)
    point[count // 2 :] = point[: count - count // 2]  # twice the same, with other bounds
    drop, corner = -rng.random(count), -5 - rng.random((1, size))
    belief = rng.dirichlet(np.full(count, 0.2), people) @ point
    belief[0] = point[0]
    x, first, before = np.zeros(people, dtype=np.int64), np.array([0, count]), np.full(people, np.inf)
    least = np.array([hull_and_sawtooth(corner[0], point, drop, b)[0] for b in belief])
    x, corner, point, drop, first = map(read_only, (x, corner, point, drop, first))
    for pivots in (0, 1, 2, 5, 20, convex_bound.PIVOTS):
        value = np.empty(people)
        convex_bound.uppers(value, x, belief, corner, point, drop, first, pivots)
        assert (value >= least - 1e-7).all()
        assert (value <= before + 1e-9).all()
        before = value
    np.testing.assert_allclose(before, least, rtol=1e-7)


@cache
def searched(name: str) -> belief_hulls.UpperHull:
    """The points of a solution in the form that the search works with."""
    solution = solution_of(name)
    size = solution.pomdp.prior.size
    hull = belief_hulls.empty_hull(solution.corner.reshape(-1, size).copy(), len(solution.drop) + 1)
    for x in range(len(solution.corner)):
        corner, point, drop = of_state(solution, x)
        for b, d in zip(point, drop, strict=True):
            belief_hulls.add_point(x, b.copy(), float(corner @ b + d), hull)
    return hull


@pytest.mark.parametrize("name", NAMES)
@few
@given(seed=seeds)
def test_search_works_with_a_bound_between_the_convex_hull_and_the_sawtooth(name: str, seed: int) -> None:
    """A few pivots of the linear program: never below its optimum, never above its first step."""
    solution, hull = solution_of(name), searched(name)
    x, belief = some_beliefs(solution, seed, 10)
    for y, b in zip(x, belief.reshape(len(x), -1), strict=True):
        least, most = hull_and_sawtooth(*of_state(solution, y), b)
        upper = belief_hulls.upper(int(y), b, hull, new_program(b.size))
        assert least - 1e-7 * abs(least) <= upper <= most + 1e-9 * abs(most)


def test_weights_of_the_search_are_checked() -> None:
    """A belief's entry of 1e-13 is too small for the pivots, and yet decides how much weight the second point has."""
    point, drop, corner = np.array([[0.9, 0.1, 0.0], [0.1, 0.9, 5e-13]]), np.array([-1.0, -1.0]), np.full(3, -5.0)
    belief = np.array([0.5, 0.5, 1e-13])
    hull = belief_hulls.empty_hull(corner[None], 3)
    for b, d in zip(point, drop, strict=True):
        belief_hulls.add_point(0, b, float(corner @ b + d), hull)
    least, most = hull_and_sawtooth(corner, point, drop, belief)
    assert least == pytest.approx(-5 - 0.2 - 0.48 / 0.9)  # the second point cannot have more than 0.2
    assert least - 1e-9 <= belief_hulls.upper(0, belief, hull, new_program(3)) <= most + 1e-9
