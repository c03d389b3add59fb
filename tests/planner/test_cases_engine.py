"""Problems with everything that the engine of unified-planning supports cost what a brute-force search finds."""

from __future__ import annotations

import heapq
import itertools
import math
import random
from collections.abc import Callable
from typing import Any

import pytest
import unified_planning as up
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.environment import get_environment
from unified_planning.model import Fluent, InstantaneousAction, Object, Problem, Variable
from unified_planning.model.metrics import MinimizeActionCosts, MinimizeSequentialPlanLength

from planner import load, sweep
from planner.engine import Engine

pytestmark = pytest.mark.cases


pytestmark = pytest.mark.usefixtures("one_name_for_two")


def kit() -> Problem:
    """Return a problem of two parts that are carried from a shelf to a kit, one at a time, in 7 actions."""
    env = get_environment()
    types, make = env.type_manager, env.expression_manager
    bins, parts = types.UserType("Bin"), types.UserType("Part")
    problem = Problem("kit", env)
    here, lies, held, free = (
        Fluent("here", types.BoolType(), environment=env, b=bins),
        Fluent("lies", types.BoolType(), environment=env, x=parts, b=bins),
        Fluent("held", types.BoolType(), environment=env, x=parts),
        Fluent("free", types.BoolType(), environment=env),
    )
    for fluent in (here, lies, held, free):
        problem.add_fluent(fluent, default_initial_value=False)
    bolt, nut, shelf, tray = (
        problem.add_object(Object(name, kind, env))
        for name, kind in (("bolt", parts), ("nut", parts), ("shelf", bins), ("tray", bins))
    )
    go = InstantaneousAction("go", _env=env, a=bins, b=bins)
    go.add_precondition(here(go.parameter("a")))
    go.add_precondition(make.Not(make.Equals(go.parameter("a"), go.parameter("b"))))
    go.add_effect(here(go.parameter("a")), False)
    go.add_effect(here(go.parameter("b")), True)
    pick = InstantaneousAction("pick", _env=env, x=parts, b=bins)
    place = here(pick.parameter("b"))
    pick.add_precondition(make.And(place, lies(pick.parameter("x"), pick.parameter("b")), free()))
    pick.add_effect(held(pick.parameter("x")), True)
    pick.add_effect(lies(pick.parameter("x"), pick.parameter("b")), False)
    pick.add_effect(free, False)
    put = InstantaneousAction("put", _env=env, x=parts, b=bins)
    put.add_precondition(make.And(here(put.parameter("b")), held(put.parameter("x"))))
    put.add_effect(lies(put.parameter("x"), put.parameter("b")), True)
    put.add_effect(held(put.parameter("x")), False)
    put.add_effect(free, True)
    problem.add_actions([go, pick, put])
    for fact in (here(shelf), lies(bolt, shelf), lies(nut, shelf), free()):
        problem.set_initial_value(fact, True)
    problem.add_goal(make.And(lies(bolt, tray), lies(nut, tray)))
    return problem


def with_idle_action(problem: Problem) -> None:
    problem.add_action(InstantaneousAction("wait", _env=problem.environment))


def with_tautology(problem: Problem) -> None:
    make, part = problem.environment.expression_manager, Variable("v", problem.user_type("Part"), problem.environment)
    problem.add_goal(make.Forall(make.Or(make.Equals(part, part), problem.fluent("held")(part)), part))


def with_constants(problem: Problem) -> None:
    make = problem.environment.expression_manager
    problem.action("go").add_precondition(make.Implies(problem.fluent("free")(), make.Or(make.TRUE(), make.FALSE())))
    problem.action("put").add_precondition(make.Not(make.And(make.FALSE(), problem.fluent("free")())))


def with_twin_names(problem: Problem) -> None:
    for name in ("pick", "go", "free"):
        problem.add_object(Object(name, problem.user_type("Part"), problem.environment))


def with_formula_assigned(problem: Problem) -> None:
    lamp = Fluent("lamp", problem.environment.type_manager.BoolType(), environment=problem.environment)
    problem.add_fluent(lamp, default_initial_value=False)
    problem.action("go").add_effect(lamp, problem.fluent("free")())
    problem.add_goal(lamp())


def without_inhabitants(problem: Problem) -> None:
    env = problem.environment
    tray = env.type_manager.UserType("Tray")
    problem.add_fluent(
        Fluent("clean", env.type_manager.BoolType(), environment=env, t=tray), default_initial_value=False
    )
    problem.clear_goals()
    free = problem.fluent("free")()
    problem.add_goal(env.expression_manager.Not(env.expression_manager.Exists(free, Variable("v", tray, env))))


def with_impossible_action(problem: Problem) -> None:
    problem.action("go").add_precondition(problem.environment.expression_manager.FALSE())


CASES: dict[str, tuple[Callable[[Problem], None], int | None]] = {
    "as it is": (lambda _: None, 7),
    "an action without effects": (with_idle_action, 7),
    "a tautology in the goal": (with_tautology, 7),
    "constants within formulas": (with_constants, 7),
    "objects with the names of actions and fluents": (with_twin_names, 7),
    "a formula that is assigned": (with_formula_assigned, 8),
    "a quantifier over nothing": (without_inhabitants, 0),
    "an action that is never possible": (with_impossible_action, None),
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_supported_is_solved(case: str) -> None:
    change, length = CASES[case]
    problem = kit()
    change(problem)
    before = str(problem)
    assert Engine.supports(problem.kind)
    result = Engine()._solve(problem, timeout=math.inf)
    assert str(problem) == before
    if length is None:
        assert result.status is Status.UNSOLVABLE_PROVEN
        return
    assert result.status is Status.SOLVED_OPTIMALLY
    assert len(result.plan.actions) == length
    with problem.environment.factory.PlanValidator(problem_kind=problem.kind) as validator:
        assert validator.validate(problem, result.plan)


def random_problem(seed: int) -> Problem:
    """Return a problem of a few objects with formulas, effects, quantifiers, types and costs of all supported kinds."""
    rng, env = random.Random(seed), get_environment()
    types, make = env.type_manager, env.expression_manager
    problem = Problem("random", env)
    thing = types.UserType("Thing")
    box, nothing = types.UserType("Box", thing), types.UserType("Nothing", thing)
    for name, kind in (("a", thing), ("b", box), ("act0", box)):
        problem.add_object(Object(name, kind, env))
    fluents = [Fluent(f"p{n}", types.BoolType(), environment=env) for n in range(2)]
    fluents += [Fluent(f"q{n}", types.BoolType(), environment=env, x=thing) for n in range(2)]
    price = Fluent("price", types.IntType(), environment=env, x=thing)
    for fluent in fluents:
        problem.add_fluent(fluent, default_initial_value=False)
    if seed % 3 == 0:
        problem.add_fluent(price, default_initial_value=2)
    for one in problem.all_objects:
        if seed % 3 == 0:
            problem.set_initial_value(price(one), rng.randint(0, 5))
        for fluent in fluents[2:]:
            problem.set_initial_value(fluent(one), rng.random() < 0.4)

    def atom(terms: list[Any]) -> Any:
        fluent = rng.choice(fluents)
        return fluent(*(rng.choice(terms) for _ in fluent.signature))

    def formula(terms: list[Any], depth: int) -> Any:
        kind = rng.choice(
            ["atom", "atom", "not", "and", "or", "implies", "iff", "exists", "forall", "equals", "constant"]
        )
        if kind == "constant":
            return make.Bool(rng.random() < 0.5)
        if kind == "equals":
            return make.Equals(rng.choice(terms), rng.choice(terms))
        if kind == "atom" or not depth:
            return atom(terms)
        if kind == "not":
            return make.Not(formula(terms, depth - 1))
        if kind in ("exists", "forall"):
            variable = Variable(f"v{depth}", rng.choice([thing, box, nothing]), env)
            body = formula([*terms, make.VariableExp(variable)], depth - 1)
            return (make.Exists if kind == "exists" else make.Forall)(body, variable)
        two = formula(terms, depth - 1), formula(terms, depth - 1)
        return {"and": make.And, "or": make.Or, "implies": make.Implies, "iff": make.Iff}[kind](*two)

    objects = [make.ObjectExp(one) for one in problem.all_objects]
    costs: dict[Any, Any] = {}
    for number in range(4):
        action = InstantaneousAction(f"act{number}", _env=env, **{"x": rng.choice([thing, box])} if number % 2 else {})
        terms = objects + [make.ParameterExp(one) for one in action.parameters]
        action.add_precondition(formula(terms, 2))
        seen = set()
        for _ in range(rng.randint(0, 3)):
            target = atom(terms)
            if target.fluent() in seen:  # effects that contradict each other are another matter
                continue
            seen.add(target.fluent())
            value = rng.choice([make.TRUE(), make.TRUE(), make.FALSE(), formula(terms, 1)])
            action.add_effect(target, value, formula(terms, 1) if rng.random() < 0.4 else make.TRUE())
        free = [fluent for fluent in fluents[2:] if fluent not in seen]
        if free and rng.random() < 0.4:
            variable = Variable("w", rng.choice([thing, box, nothing]), env)
            bound = make.VariableExp(variable)
            action.add_effect(
                rng.choice(free)(bound), rng.random() < 0.7, formula([*terms, bound], 1), forall=[variable]
            )
        problem.add_action(action)
        costs[action] = price(action.parameters[0]) if action.parameters else make.Int(rng.randint(0, 3))
    problem.add_goal(formula(objects, 3))
    problem.add_goal(atom(objects))
    if seed % 3 == 0:
        problem.add_quality_metric(MinimizeActionCosts(costs, environment=env))
    elif seed % 3 == 1:
        problem.add_quality_metric(MinimizeSequentialPlanLength(environment=env))
    return problem


def cheapest(problem: Problem) -> float:
    """Return the cost of a cheapest plan, by a search through the library's own simulator."""
    metric = next((m for m in problem.quality_metrics if isinstance(m, MinimizeActionCosts)), None)
    with problem.environment.factory.SequentialSimulator(problem) as simulator:
        names = [fluent for fluent in problem.initial_values if fluent.type.is_bool_type()]

        def key(state: Any) -> tuple[bool, ...]:
            return tuple(state.get_value(name).is_true() for name in names)

        first, count = simulator.get_initial_state(), itertools.count()
        queue, done = [(0, next(count), first)], set()
        while queue:
            cost, _, state = heapq.heappop(queue)
            if key(state) in done:
                continue
            done.add(key(state))
            if simulator.is_goal(state):
                return cost
            for action, parameters in simulator.get_applicable_actions(state):
                price = 1
                if metric is not None:
                    said = metric.get_action_cost(action).substitute(
                        dict(zip(map(action.environment.expression_manager.ParameterExp, action.parameters), parameters,
                                 strict=True))
                    )  # fmt: skip
                    price = (state.get_value(said) if said.is_fluent_exp() else said).int_constant_value()
                heapq.heappush(queue, (cost + price, next(count), simulator.apply(state, action, parameters)))
    return math.inf


@pytest.mark.parametrize("seed", range(30))
def test_random_problems_cost_what_a_search_finds(seed: int) -> None:
    problem = random_problem(seed)
    assert Engine.supports(problem.kind), problem.kind
    expected = cheapest(problem)
    result = Engine()._solve(problem)
    if expected == math.inf:
        assert result.status is Status.UNSOLVABLE_PROVEN
        return
    assert result.status is Status.SOLVED_OPTIMALLY, [message.message for message in result.log_messages or []]
    with problem.environment.factory.PlanValidator(problem_kind=problem.kind) as validator:
        assert validator.validate(problem, result.plan), f"{problem}{result.plan}"
    table = sweep(load(problem))
    assert table[table.initial] == expected
    assert isinstance(result.plan, up.plans.SequentialPlan)
