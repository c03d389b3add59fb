"""Problems that were built in Python: a unified-planning `Problem` is written as the files that all other code reads.

unified-planning allows names that PDDL does not (capitals, dots), and writes others in their place. `write` returns
these renamings, and `restore_names` undoes them in the grounded task. Fast Downward does not read costs that are sums
or products. Their values are therefore computed beforehand for all objects.
"""

from __future__ import annotations

import itertools
import math
import re
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from .instances import Instance, PDDLError
from .validation import clear_walkers

if TYPE_CHECKING:
    from unified_planning.model import Action, Fluent, FNode, Problem, Variable


def named(problem: Problem) -> Instance:
    """Return an instance without files, named after its problem."""
    name = problem.name or "problem"
    return Instance(Path(name), Path(f"{name} (domain)"))


def write(problem: Problem, folder: Path) -> tuple[Instance, dict[str, str]]:
    """Write a problem as PDDL into a folder. Return the instance, and the problem's own names.

    These are keyed by the PDDL names from which they differ. Names with spaces, commas or parentheses are left out,
    since they cannot stand in a ground action. A problem that is not classical planning with action costs raises a
    `PDDLError`.
    """
    from unified_planning.exceptions import UPException
    from unified_planning.io import PDDLWriter

    _require_no_bounds(problem)
    instance = Instance(folder / "problem.pddl", folder / "domain.pddl")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            writer = PDDLWriter(plain(problem))
            writer.write_domain(str(instance.domain))
            writer.write_problem(str(instance.problem))
    except PDDLError:
        raise
    except Exception as error:  # noqa: BLE001  it raises any exception, internal errors included
        clear_walkers()
        reason = " ".join(str(error).split()) if isinstance(error, UPException) else "unified-planning fails at it"
        raise PDDLError(named(problem).problem, None, f"cannot be written as classical PDDL: {reason}") from None
    renamed = {name: item.name for name, item in writer.nto_renamings.items() if name != item.name}
    return instance, {name: own for name, own in renamed.items() if own and not re.search(r"[\s(),]", own)}


def plain(problem: Problem) -> Problem:
    """Return a problem with the same plans, in the constructs that PDDL has and Fast Downward reads."""
    return with_plain_costs(with_plain_formulas(problem))


def with_plain_formulas(problem: Problem) -> Problem:
    """Return the problem without constants in formulas, and without quantifiers over types that have no objects.

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

    found = problem.clone()
    actions = list(found.actions)
    found.clear_actions()
    for action in actions:
        conditions = [simple(one) for one in action.preconditions]
        effects = [part for effect in action.effects for part in parts(effect)]
        if not effects or any(one.is_false() for one in conditions):
            continue
        action.clear_preconditions()
        action.clear_effects()
        for one in conditions:
            action.add_precondition(one)
        for part in effects:
            action._add_effect_instance(part)
        found.add_action(action)
    goals = [simple(one) for one in found.goals]
    found.clear_goals()
    for one in goals:
        found.add_goal(one)
    if any(one.is_false() for one in goals):
        found.clear_goals()
        found.add_goal(_never(found)())
    if len(found.quality_metrics) == 1 and found.quality_metrics[0].is_minimize_action_costs():
        (metric,) = problem.quality_metrics
        found.clear_quality_metrics()
        costs = {action: metric.get_action_cost(problem.action(action.name)) for action in found.actions}
        found.add_quality_metric(type(metric)({action: cost for action, cost in costs.items() if cost is not None}))
    return found


def _never(problem: Problem) -> Fluent:
    """Add a fluent that never holds, and return it."""
    from unified_planning.model import Fluent

    name = next(f"never{n}" for n in itertools.count() if not problem.has_name(f"never{n}"))
    never = Fluent(name, problem.environment.type_manager.BoolType(), environment=problem.environment)
    problem.add_fluent(never, default_initial_value=False)
    return never


def _require_no_bounds(problem: Problem) -> None:
    """Refuse a fluent that changes and has a bounded type: PDDL has no bounds, so that they would be lost."""
    static = problem.get_static_fluents()
    for fluent in problem.fluents:
        kind = fluent.type
        if fluent in static or not (kind.is_int_type() or kind.is_real_type()):
            continue
        if kind.lower_bound is not None or kind.upper_bound is not None:
            message = f"fluent '{fluent.name}' changes and has the type {kind}, whose bounds PDDL lacks; expected an "
            raise PDDLError(named(problem).problem, None, f"{message}unbounded type, and the bounds as preconditions")


def with_plain_costs(problem: Problem) -> Problem:
    """Return the problem with costs that Fast Downward can read: numbers, or functions of arguments.

    An action without a cost gets the cost 0. A problem whose metric is not the sum of action costs is returned
    unchanged. A `PDDLError` says if a cost is negative, not a whole number or unknown for some objects, or has more
    than 100,000 values.
    """
    metric = problem.quality_metrics[0] if len(problem.quality_metrics) == 1 else None
    if metric is None or not metric.is_minimize_action_costs():
        return problem
    plain = problem.clone()
    plain.clear_quality_metrics()
    costs = {action: metric.get_action_cost(problem.action(action.name)) for action in plain.actions}
    for action, cost in costs.items():
        if cost is None:
            costs[action] = problem.environment.expression_manager.Int(0)
        elif not cost.is_constant() and not (cost.is_fluent_exp() and cost.type.is_int_type()):
            costs[action] = _tabulated(plain, action, cost)
    plain.add_quality_metric(type(metric)(costs))
    return plain


def _tabulated(problem: Problem, action: Action, cost: FNode) -> FNode:
    """Return an action's cost as a function of its arguments; its values are added to the problem's initial state."""
    from unified_planning.model import Fluent
    from unified_planning.model.walkers import Simplifier

    def refuse(message: str) -> PDDLError:
        return PDDLError(named(problem).problem, None, f"action '{action.name}' costs {cost}: {message}")

    variables = problem.environment.expression_manager
    used = [one for one in action.parameters if variables.ParameterExp(one) in _parts(cost)]
    objects = [list(problem.objects(one.type)) for one in used]
    most = 100_000  # values in the table; it bounds the time of writing and the size of the files
    if (many := math.prod(map(len, objects))) > most:
        raise refuse(f"it has {many} values; expected at most {most}, or a fluent of its own")
    name = next(f"costs{n}" for n in itertools.count() if not problem.has_name(f"costs{n}"))
    table = Fluent(name, problem.environment.type_manager.IntType(), used, problem.environment)
    problem.add_fluent(table)
    simplifier = Simplifier(problem.environment, problem)
    for arguments in itertools.product(*objects):
        given = dict(zip(map(variables.ParameterExp, used), map(variables.ObjectExp, arguments), strict=True))
        value = simplifier.simplify(cost.substitute(given))
        if not value.is_int_constant() or value.int_constant_value() < 0:
            at = f" for ({', '.join(one.name for one in arguments)})" if arguments else ""
            raise refuse(f"that is {value}{at}; expected a whole number of 0 or more")
        problem.set_initial_value(table(*arguments), value)
    return table(*used)


def _parts(expression: FNode) -> set[FNode]:
    """Return all subexpressions of an expression, itself included."""
    found, waiting = set(), [expression]
    while waiting:
        found.add(one := waiting.pop())
        waiting += one.args
    return found


def restore_names(sas: str, names: Mapping[str, str]) -> str:
    """Return the SAS text with the problem's own names in its facts and operators."""
    if not names:
        return sas

    def restored(match: re.Match[str]) -> str:
        return re.sub(r"[^\s(),]+", lambda word: names.get(word[0], word[0]), match[0])

    sas = re.sub(r"(?<=^Atom ).*", restored, sas, flags=re.M)
    sas = re.sub(r"(?<=^NegatedAtom ).*", restored, sas, flags=re.M)
    return re.sub(r"(?<=^begin_operator\n).*", restored, sas, flags=re.M)
