"""The planner as an engine of unified-planning."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from types import SimpleNamespace
from typing import Any

import pytest
from conftest import KITTING, thinned
from unified_planning.engines import OptimalityGuarantee, PlanGenerationResultStatus
from unified_planning.environment import get_environment
from unified_planning.exceptions import UPUsageError
from unified_planning.model import DurativeAction, Fluent, InstantaneousAction, Object, Problem
from unified_planning.model.metrics import MinimizeActionCosts, MinimizeSequentialPlanLength
from unified_planning.shortcuts import (
    BoolType,
    Int,
    IntType,
    Minus,
    OneshotPlanner,
    PlanValidator,
    Plus,
    Times,
    UserType,
)

from planner import LimitError, Limits, load, sweep
from planner.engine import Engine

OVERLAPPING = {"matchcellar", "matchcellar_static_duration", "temporal_conditional"}
"""Examples that need two actions at once."""


@cache
def examples() -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the library's examples that the engine supports, and the others.

    They are no parameters of tests, since all processes that run tests would load them, which takes a second.
    """
    from unified_planning.test.examples import get_example_problems

    found = dict(sorted(get_example_problems().items()))
    ours = {name: example for name, example in found.items() if Engine.supports(example.problem.kind)}
    return ours, {name: example for name, example in found.items() if name not in ours}


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    """Register the engine as documented, and remove it afterwards."""
    environment = get_environment()
    environment.credits_stream = None
    environment.factory.add_engine("kitassist", "planner.engine", "Engine")
    yield
    environment.factory._engines.pop("kitassist")


def length_or_cost(problem: Problem, plan: Any) -> float:
    """The quantity that an optimal plan minimises."""
    metric = next(iter(problem.quality_metrics), None)
    if not isinstance(metric, MinimizeActionCosts):
        return len(plan.actions)
    with PlanValidator(problem_kind=problem.kind) as validator:
        return next(iter(validator.validate(problem, plan).metric_evaluations.values()))


@pytest.mark.parametrize("part", thinned(range(4), 4))
def test_the_library_s_own_examples(part: int) -> None:
    for name, example in list(examples()[0].items())[part::4]:
        problem = example.problem
        with OneshotPlanner(name="kitassist", optimality_guarantee=OptimalityGuarantee.SOLVED_OPTIMALLY) as planner:
            result = planner._solve(problem)  # `solve` refuses problems without a metric where plans have to be optimal
        timed = any(isinstance(action, DurativeAction) for action in problem.actions)
        if not example.solvable:
            assert result.status is PlanGenerationResultStatus.UNSOLVABLE_PROVEN, name
            continue
        if name in OVERLAPPING:
            assert result.status is PlanGenerationResultStatus.UNSOLVABLE_INCOMPLETELY, name
            continue
        solved = PlanGenerationResultStatus.SOLVED_SATISFICING if timed else PlanGenerationResultStatus.SOLVED_OPTIMALLY
        assert result.status is solved, name
        if "UNDEFINED_INITIAL_NUMERIC" not in problem.kind.features:  # which no validator of the library takes
            with PlanValidator(problem_kind=problem.kind, plan_kind=result.plan.kind) as validator:
                assert validator.validate(problem, result.plan), name
        for plan in [] if timed else example.valid_plans:
            assert length_or_cost(problem, result.plan) <= length_or_cost(problem, plan), name


def test_the_examples_are_there() -> None:
    ours, _ = examples()
    assert len(ours) >= 20
    assert {"basic", "hierarchical_blocks_world", "basic_with_costs", "robot_loader"} <= ours.keys()


def ways(names: tuple[str, str] = ("quick", "slow")) -> Problem:
    """Return a problem with one step of cost 5, or two steps of cost 1 each."""
    problem = Problem("ways")
    place = UserType("Place.Type")
    at = Fluent("At", BoolType(), p=place)
    home, middle, there = (Object(name, place) for name in ("Home", "middle one", "there"))
    problem.add_objects([home, middle, there])
    problem.add_fluent(at, default_initial_value=False)
    problem.set_initial_value(at(home), True)
    problem.add_goal(at(there))
    costs = {}
    for name, origin, to, cost in (
        (names[0], home, there, 5), (names[1], home, middle, 1), (f"{names[1]} again", middle, there, 1),
    ):  # fmt: skip
        action = InstantaneousAction(name)
        action.add_precondition(at(origin))
        action.add_effect(at(origin), False)
        action.add_effect(at(to), True)
        problem.add_action(action)
        costs[action] = cost
    problem.add_quality_metric(MinimizeActionCosts(costs))
    return problem


def test_the_cheapest_plan_under_the_problem_s_own_names() -> None:
    with OneshotPlanner(name="kitassist") as planner:
        result = planner.solve(ways(("Quick one", "Slow one")))
    assert [step.action.name for step in result.plan.actions] == ["Slow one", "Slow one again"]


def test_what_it_does_not_support_it_says() -> None:
    problem = ways()
    problem.add_fluent(Fluent("holder", problem.user_type("Place.Type")), default_initial_value=problem.object("Home"))
    assert not Engine.supports(problem.kind)
    with OneshotPlanner(name="kitassist") as planner:
        planner.error_on_failed_checks = True
        with pytest.raises(UPUsageError, match="kitassist"):
            planner.solve(problem)


@pytest.mark.parametrize(
    ("cost", "steps"),
    [
        (lambda t: Plus(t.there, t.toll), ["far", "near"]),
        (lambda t: Plus(t.there, t.toll, 1), ["far", "near"]),
        (lambda t: Times(t.there, 2), ["far", "near"]),
        (lambda t: Minus(t.there, 3), ["far", "near"]),
        (lambda t: Plus(t.toll, 100), ["near"]),
        (lambda t: Times(t.toll, t.toll), ["near"]),
        (lambda t: Plus(Minus(100, t.back), 20), ["near"]),
        (lambda t: Plus(Times(t.there, 10**9), 1), ["far", "near"]),  # too much for Fast Downward
    ],
)  # fmt: skip
def test_costs_that_are_sums_and_products(cost: Any, steps: list[str]) -> None:
    problem, move = trip()
    problem.add_quality_metric(MinimizeActionCosts({move: cost(terms(problem))}))
    assert Engine.supports(problem.kind)
    before = str(problem)
    with OneshotPlanner(name="kitassist") as planner:
        result = planner.solve(problem)
    assert result.status is PlanGenerationResultStatus.SOLVED_OPTIMALLY
    assert [str(step.actual_parameters[1]) for step in result.plan.actions] == steps
    assert str(problem) == before
    with PlanValidator(problem_kind=problem.kind) as validator:
        assert validator.validate(problem, result.plan)
        costs = validator.validate(problem, result.plan).metric_evaluations
    table = sweep(load(problem))
    assert table[table.initial] == next(iter(costs.values()))


def terms(problem: Problem) -> SimpleNamespace:
    """Return the terms that costs of the trip may contain."""
    _, length, toll = problem.fluents
    move = problem.action("move")
    return SimpleNamespace(there=length(move.a, move.b), back=length(move.b, move.a), toll=toll())


def trip() -> tuple[Problem, InstantaneousAction]:
    """From home to a place nearby: 30 at once, or 10 and 12 by a place far away."""
    place = UserType("place")
    at, length = Fluent("at", BoolType(), p=place), Fluent("length", IntType(), a=place, b=place)
    problem = Problem("trip")
    home, near, far = (problem.add_object(name, place) for name in ("home", "near", "far"))
    problem.add_fluent(at, default_initial_value=False)
    problem.add_fluent(length, default_initial_value=30)
    problem.add_fluent(Fluent("toll", IntType()), default_initial_value=2)
    problem.set_initial_value(length(home, far), 10)
    problem.set_initial_value(length(far, near), 12)
    problem.set_initial_value(at(home), True)
    problem.add_goal(at(near))
    move = InstantaneousAction("move", a=place, b=place)
    move.add_precondition(at(move.a))
    move.add_effect(at(move.a), False)
    move.add_effect(at(move.b), True)
    problem.add_action(move)
    return problem, move


@pytest.mark.parametrize(
    ("cost", "said"),
    [
        (lambda t: Minus(t.there, 29), "has a cost of -17; expected"),
        (lambda t: Minus(t.toll, 3), "has a cost of -1; expected"),
        (lambda _: Int(-1), "may not be negative"),
    ],
)  # fmt: skip
def test_costs_that_no_plan_can_have(cost: Any, said: str) -> None:
    """`supports` cannot check the values of costs; the result contains the reason."""
    problem, move = trip()
    problem.add_quality_metric(MinimizeActionCosts({move: cost(terms(problem))}))
    with OneshotPlanner(name="kitassist") as planner:
        result = planner.solve(problem)
    assert (result.status, result.plan) == (PlanGenerationResultStatus.UNSUPPORTED_PROBLEM, None)
    assert re.search(said, result.log_messages[0].message)


def test_actions_without_a_cost_are_free() -> None:
    problem = ways()
    quick, slow, again = problem.actions
    problem.clear_quality_metrics()
    problem.add_quality_metric(MinimizeActionCosts({quick: Int(1), slow: Int(0)}))
    with OneshotPlanner(name="kitassist") as planner:
        assert [step.action for step in planner.solve(problem).plan.actions] == [slow, again]
        problem.clear_quality_metrics()
        problem.add_quality_metric(MinimizeActionCosts({}))
        assert planner.solve(problem).status is PlanGenerationResultStatus.SOLVED_OPTIMALLY


def test_one_metric_is_supported_and_not_two() -> None:
    problem = ways()
    problem.add_quality_metric(MinimizeSequentialPlanLength())
    assert not Engine.supports(problem.kind)
    with Engine() as engine:
        engine.skip_checks = True
        result = engine.solve(problem)
    assert result.status is PlanGenerationResultStatus.UNSUPPORTED_PROBLEM
    assert "one metric" in result.log_messages[0].message


def test_no_example_ends_in_an_exception() -> None:
    """Even if checks are left out, as unified-planning allows."""
    for name, example in examples()[1].items():
        with Engine() as engine:
            engine.skip_checks = True
            result = engine.solve(example.problem)
        assert result.status in (
            PlanGenerationResultStatus.UNSUPPORTED_PROBLEM,
            PlanGenerationResultStatus.SOLVED_OPTIMALLY,
        ), name


def test_what_cannot_be_solved_is_proven_so() -> None:
    from unified_planning.io import PDDLReader

    problem = PDDLReader().parse_problem(str(KITTING / "domain.pddl"), str(KITTING / "unsolvable.pddl"))
    with Engine() as engine, pytest.warns(UserWarning, match="kitassist does not use the heuristic that it was given"):
        result = engine.solve(problem, heuristic=lambda _: 0.0)
    assert (result.status, result.plan) == (PlanGenerationResultStatus.UNSOLVABLE_PROVEN, None)


def test_a_time_that_is_too_short_is_said() -> None:
    with OneshotPlanner(name="kitassist") as planner:
        result = planner.solve(ways(), timeout=1e-9)
    assert result.status is PlanGenerationResultStatus.TIMEOUT
    assert "out of time" in result.log_messages[0].message


def test_large_costs_at_which_a_search_does_not_end_are_swept(monkeypatch: pytest.MonkeyPatch) -> None:
    def not_ending(*_: Any, limits: Limits, **__: Any) -> None:
        assert limits.seconds is not None
        raise LimitError("Fast Downward ran out of time")

    problem, move = trip()
    problem.add_quality_metric(MinimizeActionCosts({move: Plus(Times(terms(problem).there, 10**6), 1)}))
    monkeypatch.setattr("planner.costtogo.astar.fast_downward.optimal_plan", not_ending)
    with OneshotPlanner(name="kitassist") as planner:
        result = planner.solve(problem)
        assert result.status is PlanGenerationResultStatus.SOLVED_OPTIMALLY
        assert [str(step.actual_parameters[1]) for step in result.plan.actions] == ["far", "near"]
        assert planner.solve(problem, timeout=60).status is PlanGenerationResultStatus.TIMEOUT


def test_a_failure_of_fast_downward_is_a_result(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planner.grounding.fast_downward.ASTAR", "astar(of_no_kind())")
    with OneshotPlanner(name="kitassist") as planner:
        result = planner.solve(ways())
    assert (result.status, result.plan) == (PlanGenerationResultStatus.INTERNAL_ERROR, None)
    assert "of_no_kind" in result.log_messages[0].message


def test_it_can_be_registered_in_a_file(tmp_path: Any) -> None:
    file = tmp_path / "up.ini"
    file.write_text("[engine kitassist]\nmodule_name: planner.engine\nclass_name: Engine\n")
    factory = get_environment().factory  # to make another environment takes seconds where many modules are loaded
    factory._engines.pop("kitassist")
    factory.configure_from_file(str(file))
    assert factory.engine("kitassist") is Engine
