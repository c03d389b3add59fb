"""unified-planning finds the planner as an engine of its own."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from conftest import KITTING
from unified_planning.engines import OptimalityGuarantee, PlanGenerationResultStatus
from unified_planning.environment import Environment, get_environment
from unified_planning.exceptions import UPUsageError
from unified_planning.model import Fluent, InstantaneousAction, Object, Problem
from unified_planning.model.metrics import MinimizeActionCosts
from unified_planning.shortcuts import BoolType, OneshotPlanner, PlanValidator, RealType, UserType
from unified_planning.test.examples import get_example_problems

from planner.engine import Engine

EXAMPLES = get_example_problems()
OURS = sorted(name for name, example in EXAMPLES.items() if Engine.supports(example.problem.kind))


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    """Register the engine as the documentation says, and forget it afterwards."""
    environment = get_environment()
    environment.credits_stream = None
    environment.factory.add_engine("kitassist", "planner.engine", "Engine")
    yield
    environment.factory._engines.pop("kitassist")


def length_or_cost(problem: Problem, plan: Any) -> float:
    """What an optimal plan has least of."""
    metric = next(iter(problem.quality_metrics), None)
    if not isinstance(metric, MinimizeActionCosts):
        return len(plan.actions)
    costs = [metric.get_action_cost(step.action) for step in plan.actions]
    return sum(cost.constant_value() for cost in costs if cost is not None)


@pytest.mark.parametrize("name", OURS)
def test_the_library_s_own_examples(name: str) -> None:
    example = EXAMPLES[name]
    problem = example.problem
    with OneshotPlanner(name="kitassist", optimality_guarantee=OptimalityGuarantee.SOLVED_OPTIMALLY) as planner:
        result = planner._solve(problem)  # `solve` refuses problems without a metric where plans have to be optimal
    if not example.solvable:
        assert result.status is PlanGenerationResultStatus.UNSOLVABLE_PROVEN
        return
    assert result.status is PlanGenerationResultStatus.SOLVED_OPTIMALLY
    with PlanValidator(problem_kind=problem.kind) as validator:
        assert validator.validate(problem, result.plan)
    for plan in example.valid_plans:
        assert length_or_cost(problem, result.plan) <= length_or_cost(problem, plan)


def test_the_examples_are_there() -> None:
    assert len(OURS) >= 20
    assert {"basic", "hierarchical_blocks_world", "basic_with_costs", "robot_loader"} <= set(OURS)


def ways(names: tuple[str, str] = ("quick", "slow")) -> Problem:
    """One step that costs 5, or two that cost 1 each."""
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
    problem.add_fluent(Fluent("fuel", RealType()), default_initial_value=1)
    problem.add_action(InstantaneousAction("fill"))
    problem.action("fill").add_increase_effect(problem.fluent("fuel"), 1)
    assert not Engine.supports(problem.kind)
    with OneshotPlanner(name="kitassist") as planner:
        planner.error_on_failed_checks = True
        with pytest.raises(UPUsageError, match="kitassist"):
            planner.solve(problem)


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


def test_a_failure_of_fast_downward_is_a_result(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planner.fast_downward.ASTAR", "astar(of_no_kind())")
    with OneshotPlanner(name="kitassist") as planner:
        result = planner.solve(ways())
    assert (result.status, result.plan) == (PlanGenerationResultStatus.INTERNAL_ERROR, None)
    assert "of_no_kind" in result.log_messages[0].message


def test_it_can_be_registered_in_a_file(tmp_path: Any) -> None:
    file = tmp_path / "up.ini"
    file.write_text("[engine kitassist]\nmodule_name: planner.engine\nclass_name: Engine\n")
    environment = Environment()
    environment.factory.configure_from_file(str(file))
    assert environment.factory.engine("kitassist") is Engine
