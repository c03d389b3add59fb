"""QMDP compared with an independent solver, and its properties."""

from __future__ import annotations

import pickle

import numba
import numpy as np
import pytest
from conftest import graph_task
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from assist.people import Choices, Grid, Human, HumanModel, Population, constant, perceived_cost_to_go
from assist.person import QMDP, AssistPOMDP, Behaviour, OfRobots, VectorPolicy, qmdp
from assist.person.problem_arrays import ProblemArrays
from assist.person.solution_cache import SolutionCache
from planner import Table, sweep

GRID = Grid(np.array([0.3, 2.0]), np.array([0.0, 0.4, 1.0]))


def make(choices: Choices, h: np.ndarray | None = None, **options: object) -> AssistPOMDP:
    h = perceived_cost_to_go(choices, 0.9, np.random.default_rng(11)) if h is None else h
    model = HumanModel.own(choices, Human(1.0, 0.6, 0.9, h))
    return AssistPOMDP.of(model, grid=GRID, **{"gamma": 0.95, "robot": OfRobots(c_suggest=0.3), **options})  # type: ignore[arg-type]


def test_in_dead_ends_costs_go_on(sealed: Table) -> None:
    """The return is that of never reaching the goal."""
    pomdp = AssistPOMDP.of(HumanModel.exact(Choices.of(sealed)), grid=GRID, gamma=0.9)
    policy = qmdp(pomdp, tolerance=1e-9)
    dead = sealed.dead_end
    np.testing.assert_allclose(policy.value_mdp[dead], -1 / (1 - 0.9), atol=1e-8)  # unit costs, nothing to suggest
    assert (policy.value_mdp[~dead] > -10).all()


@pytest.fixture(scope="module")
def policy(tiny_choices: Choices) -> QMDP:
    return qmdp(make(tiny_choices))


def test_values_are_the_best_of_the_action_values(policy: QMDP) -> None:
    np.testing.assert_allclose(policy.q_mdp.max(axis=1), policy.value_mdp, atol=1e-6)


def test_suggesting_pays_where_the_person_would_err(tiny_choices: Choices) -> None:
    """For a person without misconceptions who follows, free suggestions are always worthwhile, expensive ones never."""
    x = np.flatnonzero(~tiny_choices.goal)
    model = HumanModel.exact(tiny_choices)
    free, dear = (qmdp(AssistPOMDP.of(model, grid=GRID, gamma=0.95, robot=OfRobots(c_suggest=c))) for c in (0.0, 100.0))
    belief = np.zeros((len(x), *GRID.shape))
    belief[:, 0, 2] = 1  # a novice who always follows
    q = free.q_values(x, belief)
    gain = q[:, 1:].max(axis=1) - q[:, 0]
    assert (gain >= -1e-9).all()  # none where there is only one choice
    assert (gain > 0.01).mean() > 0.5
    assert (dear.choose(x, belief) == 0).all()
    np.testing.assert_allclose(
        dear.value_mdp[tiny_choices.initial, :, 0], dear.value_mdp[tiny_choices.initial, :, 2], atol=1e-9
    )


beliefs = arrays.arrays(float, (1, 2, 3), elements=st.floats(0.001, 1)).map(lambda b: b / b.sum())


@given(beliefs, st.integers(0, 20))
def test_qmdp_is_the_best_action_value_and_below_the_bound(policy: QMDP, belief: np.ndarray, x: int) -> None:
    at = np.array([x])
    q = policy.q_values(at, belief)[0]
    assert q.max() <= policy.value(at, belief)[0] + 1e-9
    assert q[policy.choose(at, belief)[0]] == q.max()


@pytest.mark.parametrize("options", [{"gamma": 1.0}, {"gamma": float("nan")}])
def test_parameters_are_checked(tiny_choices: Choices, options: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="expected"):
        make(tiny_choices, **options)


@pytest.mark.parametrize("sent", [False, True])
def test_one_compiled_form_serves_every_problem(tiny_choices: Choices, sent: bool) -> None:
    """Whether it was made here or sent by another process, which writes protection does not survive."""
    problem, other = make(tiny_choices), AssistPOMDP.of(HumanModel.exact(Choices.of(sweep(graph_task([(1, 0, 1)])))))
    vectors = VectorPolicy(other, np.zeros((2, *other.prior.shape)), np.zeros(2, np.int64), np.arange(3))
    assert vectors._arrays.gamma == other.gamma
    if sent:
        other, vectors = pickle.loads(pickle.dumps((other, vectors)))
        assert other.chosen.flags.writeable
    assert (
        numba.typeof(ProblemArrays.of(problem))
        == numba.typeof(ProblemArrays.of(other))
        == numba.typeof(vectors._arrays)
    )


def test_kept_solutions_are_those_of_the_solver_and_only_for_equal_problems(tiny_choices: Choices) -> None:
    solutions = SolutionCache()
    wide, high = Population(theta=(0.0, 1.0)), Population(theta=(0.7, 0.9))

    def values(**options: object) -> np.ndarray:
        problem = make(tiny_choices, **options)
        found = solutions.qmdp(problem)
        assert (found.q_mdp == qmdp(problem).q_mdp).all()
        return found.value_mdp

    first = values(population=wide)
    assert values(population=high) is first, "the prior does not matter to the values"
    for other in ({"robot": OfRobots(c_suggest=0.2)}, {"behaviour": Behaviour(trust=constant())}):
        assert values(population=wide, **other) is not first
    nothing = SolutionCache(limit_mb=0.0)
    assert (nothing.qmdp(make(tiny_choices)).value_mdp == first).all(), "what is not kept is solved again"


@pytest.mark.parametrize("dear", [10**6, 10**6 + 1, 10**6 + 3, 10**7 + 9])
def test_a_suggestion_against_a_dear_action_keeps_its_precision(dear: int) -> None:
    """Nobody follows; who is advised to take the dear action takes one of two that cost 1 for sure."""
    roads = [(1, 0, dear), (1, 2, 1), (2, 0, 0), (1, 3, 1), (3, 0, 0)]
    model = HumanModel.exact(Choices.of(sweep(graph_task(roads))), lapse=0.0)
    grid = Grid(np.array([0.0]), np.array([0.0, 1.0]))
    pomdp = AssistPOMDP.of(
        model,
        grid=grid,
        gamma=0.9,
        robot=OfRobots(c_suggest=0.1),
        suggestions="all",
        behaviour=Behaviour(trust=constant()),
    )
    found = qmdp(pomdp, tolerance=1e-13).value_mdp[model.choices.initial, 0, 0]
    assert found == pytest.approx(-1.1, rel=1e-14)
