"""Problems of unified-planning, drawn at random, with everything that its engine supports but numbers and durations."""

from __future__ import annotations

import random
from typing import Any

from unified_planning.environment import get_environment
from unified_planning.model import Fluent, InstantaneousAction, Object, Problem, Variable
from unified_planning.model.metrics import MinimizeActionCosts, MinimizeSequentialPlanLength


def random_problem(seed: int) -> Problem:
    """Return a problem of a few objects with formulas, effects, quantifiers, types and costs of all supported kinds."""
    rng, env = random.Random(seed), get_environment()
    types, make = env.type_manager, env.expression_manager
    problem = Problem("random", env)
    thing = types.UserType("Thing")
    box, nothing = types.UserType("Box", thing), types.UserType("Nothing", thing)
    for name, kind in (("a", thing), ("q0", box), ("act0", box)):  # named like a fluent and an action
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
