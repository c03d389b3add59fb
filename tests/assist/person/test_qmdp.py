"""QMDP compared with an independent solver, and its properties."""

from __future__ import annotations

import pickle

import numba
import numpy as np
import pytest
from conftest import graph_task

from assist.people import Choices, Grid, Human, HumanModel, Population, constant, perceived_cost_to_go
from assist.person import AssistPOMDP, Behaviour, OfRobots, VectorPolicy, qmdp
from assist.person.problem_arrays import ProblemArrays
from assist.person.solution_cache import SolutionCache
from planner import sweep

GRID = Grid(np.array([0.3, 2.0]), np.array([0.0, 0.4, 1.0]))


def make(choices: Choices, h: np.ndarray | None = None, **options: object) -> AssistPOMDP:
    h = perceived_cost_to_go(choices, 0.9, np.random.default_rng(11)) if h is None else h
    model = HumanModel.own(choices, Human(1.0, 0.6, 0.9, h))
    return AssistPOMDP.of(model, grid=GRID, **{"gamma": 0.95, "robot": OfRobots(c_suggest=0.3), **options})  # type: ignore[arg-type]


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
