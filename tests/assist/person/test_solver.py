"""One person's POMDP between two bounds, compared with the whole belief tree, other policies and simulation."""

from __future__ import annotations

import itertools
import json
import time
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import graph_task, thinned
from hypothesis import given
from scipy.optimize import linprog
from solved import NAMES, by_hand, few, problem, seeds, solution_of, some_beliefs
from test_qmdp import GRID, PlainBackup, make

from assist.people import Choices, Grid, Human, HumanModel, Population, perceived_cost_to_go
from assist.person import (
    AssistPOMDP,
    OfRobots,
    PersonProblem,
    Setting,
    Solution,
    SolverOptions,
    belief_hulls,
    convex_bound,
    evaluate,
    qmdp,
    solve,
)
from assist.person.problem_arrays import read_only
from assist.person.search import relative_gap
from assist.person.upper_hull import new_program
from planner import LimitError, sweep


def detour() -> Choices:
    """Return the choices of a task with a start, a state with a loop, the state before the goal, and the goal."""
    return by_hand([[2, 1], [0, 1], [3, 1, 0], []], [2, 3, 1, 0], [[1, 1], [1, 0.5], [1, 1, 0.7], []])


def whole_tree(pomdp: AssistPOMDP, cut: float) -> tuple[float, float]:
    """Bound the optimal value by the tree of all beliefs, level by level; equal beliefs (to 12 digits) are merged.

    The tree ends where the discounted probability of getting there is below `cut` for all robot actions. From there on
    the return is between the worst possible value and 0.
    """
    choices = pomdp.model.choices
    worst = -(pomdp.robot_costs.max() + choices.costs.max()) / (1 - pomdp.gamma)
    levels = []
    x, belief, reach = np.array([choices.initial]), pomdp.prior[None], np.ones(1)
    while len(x):
        actions = np.where(reach > cut, pomdp.robot_actions[x], 0)
        node = np.repeat(np.arange(len(x)), actions)
        action = np.arange(len(node)) - np.repeat(np.cumsum(actions) - actions, actions)
        place = pomdp.afterstate[x[node], action]
        acts = np.where(choices.goal[place], 0, choices.applicable[place].sum(axis=1))
        row = np.repeat(np.arange(len(node)), acts)
        slot = np.arange(len(row)) - np.repeat(np.cumsum(acts) - acts, acts)
        at = x[node[row]], action[row], slot
        chance = (pomdp.likelihood(*at) * belief[node[row]]).sum(axis=(1, 2))
        row, slot, at, chance = row[chance > 0], slot[chance > 0], tuple(a[chance > 0] for a in at), chance[chance > 0]
        after, y = pomdp.update(belief[node[row]], *at), choices.targets[place[row], slot]
        going, child = np.flatnonzero(~choices.goal[y]), np.full(len(row), -1)
        keys = np.ascontiguousarray(
            np.column_stack([y[going], (after[going] * 1e12).round().reshape(len(going), pomdp.prior.size)])
        )
        _, some, inverse = np.unique(keys.view(f"V{keys.shape[1] * 8}"), return_index=True, return_inverse=True)
        child[going] = inverse.reshape(-1)
        levels.append(
            (actions, node, pomdp.robot_costs[x[node], action], row, chance, choices.costs[place[row], slot], child)
        )
        reaching = np.zeros(len(some))
        np.maximum.at(reaching, child[going], pomdp.gamma * (reach[node[row]] * chance)[going])
        x, belief, reach = y[going][some], after[going][some], reaching
    low = high = np.zeros(1)
    for actions, node, charge, row, chance, cost, child in reversed(levels):
        found = []
        for bound, end in ((low, worst), (high, 0.0)):
            ahead = np.append(bound, 0.0)  # a finished child is number -1
            q = -charge + np.bincount(row, chance * (pomdp.gamma * ahead[child] - cost), len(node))
            value = np.where(actions > 0, -np.inf, end)
            np.maximum.at(value, node, q)
            found.append(value)
        low, high = found
    return float(low[0]), float(high[0])


def detour_problem(eta: float, gamma: float, **options: object) -> AssistPOMDP:
    choices = detour()
    h = perceived_cost_to_go(choices, 0.6, np.random.default_rng(2))
    model = HumanModel.own(choices, Human(1.0, 0.5, 0.6, h), eta=eta)
    population = Population(beta=(0.2, 2.5), theta=(0.3, 0.95))
    return AssistPOMDP.of(
        model, **{"grid": GRID, "population": population, "gamma": gamma, "robot": OfRobots(c_suggest=0.05), **options}
    )  # type: ignore[arg-type]


# eta, gamma, options, and where the tree is cut
TREES = {
    "trust moves": (0.2, 0.4, {}, 1e-7),
    "trust moves, all": (0.2, 0.3, {"suggestions": "all"}, 1e-6),
    "execute": (0.2, 0.3, {"robot": OfRobots(c_suggest=0.05, execute=True, c_execute=0.4)}, 1e-7),
    "trust stays": (0.0, 0.4, {}, 1e-7),
    "trust jumps": (5.0, 0.7, {}, 1e-7),
    "far sight": (5.0, 0.95, {}, 1e-6),
}


@pytest.mark.parametrize("name", thinned(TREES))
def test_bounds_meet_the_value_of_the_whole_tree(name: str) -> None:
    eta, gamma, options, cut = TREES[name]
    pomdp = detour_problem(eta, gamma, **options)
    low, high = whole_tree(pomdp, cut)
    assert high - low < 1e-4
    coarse, fine = solve(pomdp, gap=0.02), solve(pomdp, gap=1e-6)
    assert coarse.value_qmdp > high + 1e-3  # so that a search is needed
    for solution in (coarse, fine):
        assert solution.lower <= high + 1e-9
        assert solution.upper >= low - 1e-9
    assert fine.lower >= low - 1e-5
    assert fine.upper <= high + 1e-5


@pytest.mark.parametrize("name", NAMES)
@few
@given(seed=seeds)
def test_bounds_are_ordered_everywhere(name: str, seed: int) -> None:
    solution = solution_of(name)
    x, belief = some_beliefs(solution, seed)
    lower, upper = solution.value(x, belief), solution.upper_bound(x, belief)
    ahead = solution.q_values(x, belief).max(axis=1)
    highest = np.einsum("nbt,nbt->n", solution.corner[x], belief)
    size = 1e-9 * np.abs(lower)
    assert (lower <= ahead + size).all()  # after one step, the policy is at least as good as its vectors
    assert (ahead <= upper + size).all()
    assert (upper <= highest + size).all()


@pytest.mark.parametrize("name", thinned(NAMES))
@few
@given(seed=seeds)
def test_no_policy_exceeds_the_upper_bound(name: str, seed: int) -> None:
    """The exact value of a policy that looks only at x is linear in the belief, and so below the bound everywhere."""
    solution = solution_of(name)
    pomdp = solution.pomdp
    x, belief = some_beliefs(solution, seed)
    helpful = solution.choose(np.arange(len(pomdp.robot_actions)), np.broadcast_to(belief[0], solution.corner.shape))
    upper = solution.upper_bound(x, belief)
    for action in (np.random.default_rng(seed).integers(0, pomdp.robot_actions), helpful):
        value = evaluate(pomdp, action.astype(np.int64))
        assert (np.einsum("nbt,nbt->n", value[x], belief) <= upper + 1e-9 * np.abs(upper)).all()


@pytest.mark.parametrize(
    ("eta", "theta", "c_suggest", "gamma", "sigma"),
    [
        (0.0, (0.05, 0.5), 0.2, 0.99, 0.0), (0.0, (0.0, 0.0), 1.0, 0.99, 0.0), (0.2, (0.5, 0.95), 0.0, 0.95, 0.0),
        (0.0, (0.05, 0.3), 0.2, 0.99, 2.0), (0.1, (0.0, 0.2), 0.5, 0.999, 1.0),
    ],
)  # fmt: skip
def test_never_and_always_are_what_linear_equations_say(
    tiny_choices: Choices, eta: float, theta: tuple[float, float], c_suggest: float, gamma: float, sigma: float
) -> None:
    """This includes people who do the opposite of what is suggested, and who go in circles for long."""
    h = perceived_cost_to_go(tiny_choices, sigma, np.random.default_rng(0))
    model = HumanModel.own(tiny_choices, Human(1.0, 0.5, sigma, h), eta=eta)
    people = Population(theta=theta)
    pomdp = AssistPOMDP.of(model, grid=GRID, population=people, robot=OfRobots(c_suggest=c_suggest), gamma=gamma)
    solution, best = solve(pomdp, gap=0.9), qmdp(pomdp)
    values = np.einsum("nrbt,bt->nr", np.maximum(best.q_mdp, -1e9), pomdp.prior)
    q = np.where(pomdp.suggests_optimal[:, :, 0], values, -np.inf)
    for found, action in (
        (solution.value_never, np.zeros(len(q), dtype=int)),
        (solution.value_always, q.argmax(axis=1)),
    ):
        policy = np.broadcast_to(action[:, None, None], best.value_mdp.shape)
        value = PlainBackup(pomdp).of(np.zeros(policy.shape), policy)
        expected = (value[tiny_choices.initial] * pomdp.prior).sum()
        assert expected - 1e-3 <= found <= expected + 1e-9 * abs(expected)


ROUNDING_CASES = {
    "lapses only": {"lapse": 0.9},
    "no lapses": {"lapse": 0.0},
    "almost certain": {"lapse": 0.0, "beta": (1.0, 40.0), "scale": 0.9},
    "certain to the last digit": {"beta": (0.0, 1000.0), "scale": 0.72},  # exp(-720) is a denormal number
    "certain": {"lapse": 0.0, "beta": (0.0, 1e6), "suggestions": "all"},
    "they refuse": {"population": Population((0.2, 2.5), (0.0, 0.0)), "suggestions": "all"},
    "they obey": {"population": Population((0.2, 2.5), (1.0, 1.0))},
    "help is free": {"robot": OfRobots(c_suggest=0.0)},
    "some actions are free": {"costs": [[0, 1], [0, 0], [0, 1, 0], []]},
    "all actions are free": {"costs": [[0, 0], [0, 0], [0, 0, 0], []]},
    "help only costs": {"costs": [[0, 0], [0, 0], [0, 0, 0], []], "robot": OfRobots(c_suggest=0.05, execute=True)},
    "no way out of the mess": {"targets": [[2, 1], [1], [3, 1, 0], []]},
    "stuck in the mess": {"targets": [[2, 1], [1], [3, 1, 0], []], "costs": [[1, 1], [1], [1, 1, 1], []]},
    "far": {"gamma": 0.9999},
    "begun at the goal": {"initial": 3},
}


@pytest.mark.parametrize("name", ROUNDING_CASES)
def test_bounds_stay_ordered_and_finite(name: str) -> None:
    options = dict(ROUNDING_CASES[name])
    targets = options.pop("targets", [[2, 1], [0, 1], [3, 1, 0], []])
    scale = options.pop("scale", 1.0)
    unit = [[1, 1], [1, 1][: len(targets[1])], [1, 1, 1], []]
    costs = [[scale * c for c in row] for row in options.pop("costs", unit)]
    h = np.full(4, np.inf)
    h[3] = 0
    for _ in h:
        h[:3] = [min(c + h[y] for c, y in zip(costs[x], targets[x], strict=True)) for x in range(3)]
    choices = by_hand(targets, list(h), costs, options.pop("initial", 0))
    model = HumanModel.exact(choices, lapse=options.pop("lapse", 1e-3))
    beta = options.pop("beta", (0.3, 2.0))
    given = {"gamma": 0.9, "robot": OfRobots(c_suggest=0.05), "population": Population(beta, (0.0, 1.0)), **options}
    pomdp = AssistPOMDP.of(model, grid=Grid(np.array(beta), np.array([0.0, 0.5, 1.0])), **given)
    solution = solve(pomdp, gap=1e-3)
    assert solution.stopped in {"gap", "stalled"}
    x = np.repeat(np.arange(4), 50)
    belief = np.random.default_rng(0).dirichlet(np.full(6, 0.2), len(x)).reshape(-1, 2, 3)
    belief[::50] = pomdp.prior
    lower, upper = solution.value(x, belief), solution.upper_bound(x, belief)
    assert np.isfinite(lower).all()
    assert (lower <= upper).all()
    assert (upper <= 0).all()
    assert (lower >= -(pomdp.robot_costs.max() + 1) / (1 - pomdp.gamma) * (1 + 1e-9)).all()
    assert max(solution.value_never, solution.value_always) <= solution.lower
    assert solution.lower <= solution.upper <= solution.value_qmdp


def test_nothing_is_left_to_do_at_the_goal() -> None:
    solution = solve(AssistPOMDP.of(HumanModel.exact(by_hand([[1], []], [1, 0], initial=1))), gap=0)
    assert (solution.lower, solution.upper, solution.gap, solution.stopped) == (0, 0, 0, "gap")
    assert relative_gap(0.0, 0.0) == 0
    assert relative_gap(-2.0, -1.0) == 0.5
    nobody = np.empty(0, dtype=np.int64), np.empty((0, *solution.pomdp.grid.shape))
    for answer in (solution.value, solution.upper_bound, solution.choose):
        assert answer(*nobody).shape == (0,)


@pytest.mark.slow
def test_search_ends_where_rounding_stops_it(tiny_choices: Choices) -> None:
    solution = solve(make(tiny_choices, gamma=0.6), gap=0, time_limit=300)
    assert solution.stopped == "stalled"
    assert 0 < solution.gap < 1e-9


def test_options_with_which_nothing_is_searched_are_refused() -> None:
    for wrong in ({"depth": 0}, {"backups_per_check": 0}, {"first_sweeps": 0}, {"finest": 0.0}):
        with pytest.raises(ValueError, match=f"{next(iter(wrong))} .*expected"):
            SolverOptions(**wrong)  # type: ignore[arg-type]


def test_bounds_tighten_until_the_gap_is_reached() -> None:
    steps: list[tuple[float, float, float]] = []
    pomdp = problem("paper-fixed", 0.95, 0.5, 0.5)
    solution = solve(pomdp, gap=5e-3, bounds=lambda *step: steps.append(step))
    seconds, lower, upper = np.array(steps).T
    assert len(steps) > 3
    assert (np.diff(seconds) > 0).all()
    assert (np.diff(lower) >= 0).all()
    assert (np.diff(upper) <= 0).all()
    assert lower[-1] > lower[0]
    assert upper[-1] < upper[0]
    assert (solution.lower, solution.upper) == (lower[-1], upper[-1])
    assert solution.stopped == "gap"
    assert solution.gap <= 5e-3
    # The result is the same where the search was.
    x, prior = np.array([pomdp.model.choices.initial]), pomdp.prior[None]
    assert solution.value(x, prior)[0] == pytest.approx(solution.lower, rel=1e-9)
    assert solution.upper_bound(x, prior)[0] == pytest.approx(solution.upper, rel=1e-3)
    assert solution.upper_bound(x, prior)[0] <= solution.upper + 1e-9  # more pivots than in the search
    again = solve(pomdp, gap=5e-3)
    assert (again.lower, again.upper, again.backups) == (solution.lower, solution.upper, solution.backups)
    np.testing.assert_array_equal(again.policy.vectors, solution.policy.vectors)
    np.testing.assert_array_equal(again.drop, solution.drop)


def test_people_who_err_for_long_do_not_keep_the_search() -> None:
    """Sample paths that follow the largest gap only would go back and forth with such people.

    After 80,000 backups a gap of 1.5 % remained.
    """

    def few(_: str, done: int, total: int | None) -> None:  # noqa: ARG001
        assert done < 40_000

    assert solve(problem("paper", 0.99, 1.0, 0.5), gap=1e-2, progress=few).stopped == "gap"


def test_limits_stop_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    pomdp = problem("paper-fixed", 0.95, 1.0, 1.0)
    stopped = {"memory": solve(pomdp, gap=1e-6, memory_limit_mb=15)}
    begun, asked = time.perf_counter() + 3600, itertools.count()  # a tenth of a second at each check
    clock = SimpleNamespace(perf_counter=lambda: begun + 0.1 * next(asked))
    monkeypatch.setattr("assist.person.solver.time", clock)
    stopped["time"] = solve(pomdp, gap=1e-6, time_limit=2.0)
    for reason, solution in stopped.items():
        assert solution.stopped == reason
        assert solution.value_always < solution.lower < solution.upper < solution.value_qmdp
        assert solution.backups > 0
    assert 2.0 <= stopped["time"].seconds < 2.5
    with pytest.raises(LimitError, match=r"first bounds on 128 states take about \d+ MB.*1 MB are allowed"):
        solve(pomdp, memory_limit_mb=1)


def test_bounds_hold_where_there_is_no_time_for_the_first_ones(tiny_choices: Choices) -> None:
    pomdp = make(tiny_choices)
    hasty, whole = solve(pomdp, time_limit=0), solve(pomdp, gap=1e-3)
    assert hasty.stopped == "time"
    assert hasty.value_qmdp == 0 > whole.value_qmdp  # not a sweep was begun
    assert hasty.lower <= whole.lower <= whole.upper < hasty.upper
    assert hasty.value_never == pytest.approx(whole.value_never)


@pytest.mark.parametrize(
    ("name", "value"), [("gap", -1e-3), *((name, float("nan")) for name in ("gap", "time_limit", "memory_limit_mb"))]
)
def test_limits_are_numbers(tiny_choices: Choices, name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name} {value}: expected 0 or more"):
        solve(make(tiny_choices), **{name: value})


@pytest.mark.parametrize("theta", [(0.3, 0.7), (0.5, 0.95)])
def test_a_problem_whose_value_is_0_has_bounds(theta: tuple[float, float]) -> None:
    """The upper bound is above 0 by a margin for rounding, and there is no relative gap."""
    table = sweep(graph_task([(0, 1, 1), (0, 2, 1), (2, 0, 1)], goal=1, start=0))
    setting = Setting(execute=True, c_execute=0.0, c_suggest=0.0, gamma=0.4, knowledge="exact")
    free = PersonProblem.of(table, setting=setting, population=Population(beta=(0.0, 0.5), theta=theta)).pomdp
    found = solve(free, gap=1e-6)
    assert found.stopped == "gap"
    assert found.lower <= 0.0 <= found.upper == pytest.approx(0.0, abs=1e-9)
    json.dumps(found.as_dict(), allow_nan=False)


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
