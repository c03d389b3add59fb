"""Formulas of problems that were built in Python, in the constructs that PDDL has and Fast Downward reads."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import TYPE_CHECKING

from . import built_actions

if TYPE_CHECKING:
    from unified_planning.model import Effect, Fluent, FNode, Problem, Variable


def simplify(problem: Problem) -> None:
    """Rewrite a problem without constants in formulas, and without quantifiers over types that have no objects.

    The assignment of a formula to a fluent becomes two conditional effects. Actions that can never be done, or change
    nothing, are left out, since no shortest or cheapest plan needs them.
    """
    from unified_planning.model import Effect
    from unified_planning.model.walkers.identitydag import IdentityDagWalker

    make = problem.environment.expression_manager

    def is_empty(variables: Iterable[Variable]) -> bool:
        return any(not any(True for _ in problem.objects(one.type)) for one in variables)

    class Inhabited(IdentityDagWalker):  # type: ignore[misc]  # the library has no types
        """Decides quantifiers over types without objects; `simplify` takes any quantifier over nothing for its body."""

        def walk_exists(self, expression: FNode, args: list[FNode], **_: object) -> FNode:
            return make.FALSE() if is_empty(expression.variables()) else make.Exists(args[0], *expression.variables())

        def walk_forall(self, expression: FNode, args: list[FNode], **_: object) -> FNode:
            return make.TRUE() if is_empty(expression.variables()) else make.Forall(args[0], *expression.variables())

    walker = Inhabited(problem.environment)

    def simple(formula: FNode) -> FNode:
        return walker.walk(formula).simplify()

    def parts(effect: Effect) -> list[Effect]:
        """Return effects that assign constants, under conditions that may hold."""
        if is_empty(effect.forall):
            return []
        condition, value = simple(effect.condition), simple(effect.value)
        found = [(condition, value)]
        if value.type.is_bool_type() and not value.is_bool_constant():
            found = [(simple(make.And(condition, value)), make.TRUE())]
            found.append((simple(make.And(condition, make.Not(value))), make.FALSE()))
        return [
            Effect(effect.fluent, to, when, effect.kind, effect.forall) for when, to in found if not when.is_false()
        ]

    actions = list(problem.actions)
    problem.clear_actions()
    for action in actions:
        conditions = [(when, simple(one)) for when, one in built_actions.conditions(action)]
        effects = [(when, part) for when, effect in built_actions.effects(action) for part in parts(effect)]
        if not effects or any(one.is_false() for _, one in conditions):
            continue
        built_actions.rebuild(action, conditions, effects)
        problem.add_action(action)
    goals = [simple(one) for one in problem.goals]
    problem.clear_goals()
    for one in goals:
        problem.add_goal(one)
    if any(one.is_false() for one in goals):
        problem.clear_goals()
        problem.add_goal(_never(problem)())


def _never(problem: Problem) -> Fluent:
    """Add a fluent that never holds, and return it."""
    from unified_planning.model import Fluent

    name = next(f"never{n}" for n in itertools.count() if not problem.has_name(f"never{n}"))
    never = Fluent(name, problem.environment.type_manager.BoolType(), environment=problem.environment)
    problem.add_fluent(never, default_initial_value=False)
    return never
