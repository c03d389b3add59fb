"""The frontier of a truncated task: its bounds compared with values from other methods, and its suggestions."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import DOMAINS, costly, graph_task, table_of
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from test_qmdp import PlainBackup

from assist.people import Choices, EquationSeven, HumanModel, Population, TrustRule, constant, outcome
from assist.person import AssistPOMDP, Assumptions, OfRobots, TruncatedTask, frontier_bounds, solve
from assist.person.closed_problem import closed_problem
from planner import Instance, OnDemand, Table, sweep

Floats = NDArray[np.float64]
ROUND_TRIP = Instance(DOMAINS / "delivery" / "round-trip.pddl", DOMAINS / "delivery" / "domain.pddl")

# Graphs with free actions, costs and dead ends; node 0 is the goal and node 1 the start.
edges = st.tuples(st.integers(1, 7), st.integers(0, 7), st.sampled_from([0, 0, 1, 2, 3]))
graphs = st.lists(edges, min_size=4, max_size=18)
numbers = st.fixed_dictionaries(
    {
        "gamma": st.sampled_from([0.8, 0.95]),
        "robot": st.builds(OfRobots, c_suggest=st.sampled_from([0.0, 0.3])),
        "eta": st.sampled_from([0.0, 0.2]),
        "lapse": st.sampled_from([0.0, 1e-3, 0.1]),
    }
)
examples = costly(5, 30)


def solvable(drawn: list[tuple[int, int, int]]) -> Table | None:
    table = sweep(graph_task(drawn))
    return table if np.isfinite(table[table.initial]) and not table.is_goal([table.initial])[0] else None


def values(problem: AssistPOMDP, *, worst: bool = False) -> Floats:
    """Return values of the best policy with beta and theta observed, shape (n, B, T), by plain value iteration.

    Or those of the worst optimal suggestion in every state, and of nothing in dead ends.
    """
    plain, value = PlainBackup(problem), np.zeros((len(problem.ends), *problem.grid.shape))
    optimal = problem.suggests_optimal[:, :, 0, None, None]
    for _ in range(int(np.log(1e-9) / np.log(problem.gamma))):
        q = plain.values(value)
        least = np.where(optimal.any(axis=1), np.where(optimal, q, np.inf).min(axis=1), q[:, 0])
        value = np.where(problem.ends[:, None, None], 0.0, least if worst else q.max(axis=1))
    return value


@examples
@given(graphs, numbers, st.integers(1, 6))
def test_bounds_on_the_frontier_hold(drawn: list[tuple[int, int, int]], given: dict[str, float], states: int) -> None:
    table = solvable(drawn)
    if table is None:
        return
    human = {name: given[name] for name in ("eta", "lapse")}
    cost = {name: given[name] for name in ("gamma", "robot")}
    whole = AssistPOMDP.of(HumanModel.exact(Choices.of(table), **human), **cost)  # type: ignore[arg-type]
    part = TruncatedTask.of(table, states=states)
    problem = closed_problem(part, Assumptions(**given))  # type: ignore[arg-type]
    at = part.states[part.frontier]
    left = 1e-8 * (3 + cost["robot"].c_suggest) / (1 - cost["gamma"])  # of the value iteration
    assert (values(whole)[at] <= problem.frontier.upper + left).all()
    assert (values(whole, worst=True)[at] >= problem.frontier.lower - left).all()


@examples
@given(graphs, numbers, st.integers(1, 6))
def test_a_parts_interval_and_the_wholes_overlap(
    drawn: list[tuple[int, int, int]], given: dict[str, float], states: int
) -> None:
    table = solvable(drawn)
    if table is None:
        return
    everything = closed_problem(TruncatedTask.of(table, states=len(table)), Assumptions(**given))  # type: ignore[arg-type]
    human = {name: given[name] for name in ("eta", "lapse")}
    whole = AssistPOMDP.of(
        HumanModel.exact(Choices.of(table), **human),  # type: ignore[arg-type]
        gamma=given["gamma"], robot=given["robot"],
    )  # fmt: skip
    part = closed_problem(TruncatedTask.of(table, states=states), Assumptions(**given))  # type: ignore[arg-type]
    # Bounds hold whenever a solution ends; one in a thousand of these takes minutes.
    exact, same, bounds = (solve(problem, gap=0.05, time_limit=5) for problem in (whole, everything, part))
    assert len(everything.frontier.states) == 0  # type: ignore[union-attr]
    for one, other in ((exact, same), (exact, bounds)):
        assert one.lower <= other.upper
        assert other.lower <= one.upper


def suggestions(choices: Choices, x: int) -> set[str]:
    return {choices.name(x, int(slot)) for slot in np.flatnonzero(choices.optimal[x])}


def test_what_is_suggested_on_demand_is_what_the_table_has() -> None:
    """Loading and unloading are free, so that without an order among them an optimal plan could contain a cycle."""
    table = table_of(ROUND_TRIP)
    asked = OnDemand(table.task)
    full, part = Choices.of(table), TruncatedTask.of(asked, states=30)
    inside = np.setdiff1d(np.arange(len(part.states)), part.frontier)
    same = table.numbers(asked.values(part.states))
    np.testing.assert_array_equal(part.choices.h, table.lookup(same))
    np.testing.assert_array_equal(asked.plan_lengths(part.states), table.plan_lengths(same))
    for x in inside:
        assert suggestions(part.choices, int(x)) == suggestions(full, int(same[x]))
    assert (part.choices.costs[part.choices.optimal] == 0).any()
    plan = asked.optimal_plan()
    assert plan is not None
    assert len(plan) == table.plan_lengths([table.initial])[0] == 8


CORRIDOR, DEAD_END = -(1 - 0.9**5) / 0.1, [(1, 0, 2), (1, 2, 2), (2, 3, 5), (3, 2, 1)]
BY_HAND: list[tuple[list[tuple[int, int, int]], int, float, float, float, float]] = [
    # Roads and the start, states, the cost of a suggestion, and the bounds at the frontier.
    # In a corridor free suggestions change nothing. For the upper bound, each of five steps may cost as little as 1.
    ([(node, node - 1, 1) for node in range(1, 9)], 8, 3, 0.0, CORRIDOR, CORRIDOR),
    ([(node, node - 1, 3) for node in range(1, 9)], 8, 3, 0.0, 3 * CORRIDOR, CORRIDOR),
    # A goal that is a free step away: who follows for nothing pays nothing, as far as the bound's sweeps go.
    ([(3, 2, 1), (2, 1, 0), (1, 0, 0)], 3, 1, 0.0, 0.0, 0.0),
    # Standing still costs 1 where all else is free.
    ([(1, 0, 0), (1, 2, 0), (2, 3, 0)], 1, 1, 1.0, -1 / 0.1, 0.0),
    # In a dead end nothing is suggested, and every step is paid for.
    (DEAD_END, 1, 1, 7.0, -5 / 0.1, -1 / 0.1),
]


@pytest.mark.parametrize(("roads", "start", "states", "c_suggest", "lower", "upper"), BY_HAND)
def test_bounds_by_hand(
    roads: list[tuple[int, int, int]], start: int, states: int, c_suggest: float, lower: float, upper: float
) -> None:
    part = TruncatedTask.of(sweep(graph_task(roads, start=start)), states=states)
    assumed = Assumptions(gamma=0.9, robot=OfRobots(c_suggest=c_suggest), lapse=0.0)
    frontier = closed_problem(part, assumed).frontier
    rtol, atol = (1e-12, 0.0) if c_suggest else (1e-6, 0.0 if lower else 1e-4)  # free suggestions: as far as sweeps go
    np.testing.assert_allclose(frontier.lower, np.full((1, 1, 10), lower), rtol=rtol, atol=atol)
    np.testing.assert_allclose(frontier.upper, upper, rtol=1e-12)
    assert (frontier.lower <= 0).all()
    if np.isinf(part.choices.h[part.frontier]).all():
        anybody = part.bounds_of_anybody(assumed)
        np.testing.assert_allclose(anybody.lower, frontier.lower, rtol=1e-12)
        np.testing.assert_array_equal(anybody.upper.shape, (1, 1, 1))
        assert (anybody.floor, frontier.floor) == pytest.approx((lower,) * 2, rel=1e-12)


@pytest.mark.parametrize("eta", [0.0, 0.2])
@pytest.mark.parametrize(("top", "wrong"), [(12, 1), (2, 3)])
def test_the_lower_bound_is_exact_on_a_ladder_for_people_who_choose_blindly(top: int, wrong: int, eta: float) -> None:
    """Half of the choices are wrong and lead up by one, at another cost; the bound is exact."""
    right_steps = [(node, node - 1, 1) for node in range(1, top + 1)]
    wrong_steps = [(node, min(node + 1, top), wrong) for node in range(1, top + 1)]
    table = sweep(graph_task(right_steps + wrong_steps, start=top))
    blind = Population(beta=(0.0, 0.0))
    setting = {"gamma": 0.9, "robot": OfRobots(c_suggest=0.25), "population": blind}
    whole = AssistPOMDP.of(HumanModel.exact(Choices.of(table), eta=eta, lapse=0.0), **setting)  # type: ignore[arg-type]
    expected = values(whole, worst=True)[:, 0]
    for states in range(1, top):
        part = TruncatedTask.of(table, states=states, population=blind)
        frontier = closed_problem(part, Assumptions(eta=eta, lapse=0.0, **setting)).frontier  # type: ignore[arg-type]
        np.testing.assert_allclose(frontier.lower[:, 0], expected[part.states[frontier.states]], rtol=1e-5)


@pytest.mark.parametrize("more", [[], [(2, 8, 1), (8, 9, 1), (9, 8, 1)]], ids=["a way from everywhere", "dead ends"])
def test_what_is_too_much_to_look_through_is_bounded_with_care(
    monkeypatch: pytest.MonkeyPatch, more: list[tuple[int, int, int]]
) -> None:
    ladder = [(node, to, 1) for node in range(1, 7) for to in (node - 1, min(node + 1, 6))]
    part = TruncatedTask.of(sweep(graph_task(ladder + more, start=3)), states=2)
    known = closed_problem(part, Assumptions(gamma=0.9)).frontier
    monkeypatch.setattr(frontier_bounds, "SURVEYED", 1)
    careful = closed_problem(part, Assumptions(gamma=0.9)).frontier
    assert (careful.lower <= known.lower + 1e-9).all()
    assert more or (careful.lower > careful.floor + 0.1).any()


def test_what_holds_everywhere_in_a_task(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ladder of 6 with a way back at each rung, a corridor of 8, and the ladder with a way into dead ends."""
    ladder = [(node, to, 1) for node in range(1, 7) for to in (node - 1, min(node + 1, 6))]
    drawn = {"ladder": ladder, "corridor": [(node, node - 1, 3) for node in range(1, 9)]}
    drawn["dead ends"] = [*ladder, (2, 8, 1), (8, 9, 1), (9, 8, 1)]
    tables = {name: sweep(graph_task(edges, start=6)) for name, edges in drawn.items()}
    tables["corridor"] = sweep(graph_task(drawn["corridor"], start=8))

    def found(name: str, **options: int) -> tuple[int, int, float]:
        survey = frontier_bounds.Survey.of(tables[name], tables[name].h, **options)
        return survey.highest, survey.actions, survey.rise

    for block in (1, 2, 5, 1_000_000):
        assert found("ladder", rows_at_a_time=block) == (6, 2, 1.0)
        assert found("corridor", rows_at_a_time=block) == (8, 1, 0.0)  # levels of cost 3
        assert found("dead ends", rows_at_a_time=block) == (6, 3, np.inf)
    monkeypatch.setattr(frontier_bounds, "SURVEYED", 7)
    assert found("ladder") == (6, 2, 1.0)  # the ladder has as many states
    monkeypatch.setattr(frontier_bounds, "SURVEYED", 6)
    assert found("ladder") == (6, 12, 6.0)
    assert found("dead ends") == (6, 15, np.inf)
    asked = OnDemand(tables["corridor"].task)
    part = frontier_bounds.Survey.of(asked, TruncatedTask.of(tables["corridor"], start=4, states=2).choices.h)
    assert (part.highest, part.actions, part.rise) == (4, 8, np.inf)


def test_the_lower_bound_follows_rules_of_trust_whose_steps_are_known() -> None:
    """Constant trust is equation 7 with an eta of 0; for other rules the worst case is assumed."""
    ladder = [(node, to, 1) for node in range(1, 7) for to in (node - 1, min(node + 1, 6))]
    part = TruncatedTask.of(sweep(graph_task(ladder, start=3)), states=2)

    def lower(eta: float, trust: TrustRule | None, utility_scale: float = 1.0) -> Floats:
        frontier = closed_problem(
            part, Assumptions(gamma=0.9, eta=eta, trust=trust, utility_scale=utility_scale)
        ).frontier
        return frontier.lower

    np.testing.assert_array_equal(lower(0.2, constant()), lower(0.0, None))
    np.testing.assert_array_equal(lower(0.2, EquationSeven(0.2)), lower(0.2, None))
    np.testing.assert_array_equal(lower(0.2, EquationSeven(0.0)), lower(0.0, None))
    np.testing.assert_array_equal(lower(0.2, EquationSeven(0.4, 2.0)), lower(0.4, None, utility_scale=2.0))
    assert (lower(0.2, None) > lower(0.0, None)).any()
    np.testing.assert_allclose(lower(0.4, None, utility_scale=2.0), lower(0.2, None), rtol=1e-12)
    np.testing.assert_allclose(lower(0.2, outcome()), -2 / 0.1, rtol=1e-12)
