"""Problems that were built in Python: a unified-planning `Problem` is written as the files that all other code reads.

unified-planning allows names that PDDL does not (capitals, dots), and writes others in their place. `written` returns
what these name, and `restore_names` undoes the renaming in the grounded task.

An action without a duration has no times; None stands for each of them. Bounds of types, such as `IntType(0, 9)`,
become conditions of actions, since PDDL has none: an action that would leave them is not applicable. unified-planning's
own compiler of bounded types asks for the bounds of all fluents before each action instead, so that states beyond the
bounds are reached, and then are dead ends.
"""

from __future__ import annotations

import itertools
import re
import tempfile
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from .instances import Instance, PDDLError
from .validation import clear_walkers

if TYPE_CHECKING:
    from unified_planning.model import Action, Effect, Fluent, FNode, Problem, TimeInterval, Timing, Variable

Condition: TypeAlias = "tuple[TimeInterval | None, FNode]"
"""A condition, and when it has to hold."""
Change: TypeAlias = "tuple[Timing | None, Effect]"
"""An effect, and when it is made."""


def lasts(action: Action) -> bool:
    """Return whether an action has a duration."""
    from unified_planning.model import DurativeAction

    return isinstance(action, DurativeAction)


def is_temporal(problem: Problem) -> bool:
    """Return whether an action of a problem has a duration."""
    return any(map(lasts, problem.actions))


def conditions(action: Action) -> list[Condition]:
    """Return the conditions of an action."""
    if lasts(action):
        return [(interval, each) for interval, several in action.conditions.items() for each in several]
    return [(None, each) for each in action.preconditions]


def effects(action: Action) -> list[Change]:
    """Return the effects of an action."""
    if lasts(action):
        return [(timing, each) for timing, several in action.effects.items() for each in several]
    return [(None, each) for each in action.effects]


def rebuild(action: Action, read: Iterable[Condition], changed: Iterable[Change]) -> None:
    """Give an action other conditions and effects."""
    changed = list(changed)
    if lasts(action):
        action.clear_conditions()
        action.clear_effects()
        for interval, condition in read:
            action.add_condition(interval, condition)
        for timing, effect in changed:
            action._add_effect_instance(timing, effect)
        return
    action.clear_preconditions()
    action.clear_effects()
    for _, condition in read:
        action.add_precondition(condition)
    for _, effect in changed:
        action._add_effect_instance(effect)


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
        read = [(when, simple(one)) for when, one in conditions(action)]
        changed = [(when, part) for when, effect in effects(action) for part in parts(effect)]
        if not changed or any(one.is_false() for _, one in read):
            continue
        rebuild(action, read, changed)
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


MOST_TOGETHER = 6
"""Largest number of other effects of an action that may be on the same number; each doubles the conditions."""


def bounds(fluent: Fluent) -> tuple[Any, Any]:
    """Return the least and the largest value of a fluent by its type; None for what is not bounded."""
    kind = fluent.type
    return (kind.lower_bound, kind.upper_bound) if kind.is_int_type() or kind.is_real_type() else (None, None)


def add_bounds(problem: Problem, named: Path) -> None:
    """Add conditions to the actions of a problem that keep each number within the bounds of its type.

    A `PDDLError` about the file `named` refuses an action with too many effects that may be on the same number.
    """
    static = problem.get_static_fluents()
    bounded = {each for each in problem.fluents if each not in static and bounds(each) != (None, None)}
    for action in problem.actions:
        changes = effects(action)
        if any(effect.fluent.fluent() in bounded for _, effect in changes):
            _bound(problem, action, changes, bounded, named)


def _bound(problem: Problem, action: Action, changes: list[Change], bounded: set[Fluent], named: Path) -> None:
    """Add the bounds of the numbers that an action changes to its conditions."""
    from unified_planning.model import TimePointInterval

    read = conditions(action)
    for timing, effect in changes:
        if effect.fluent.fluent() not in bounded:
            continue
        together = [
            part for time, other in changes if time == timing and other.fluent.fluent() == effect.fluent.fluent()
            for part in other.expand_effect(problem)
        ]  # fmt: skip
        for part in effect.expand_effect(problem):
            others = list(together)
            others.remove(part)
            sure, perhaps = _same(problem, part, others)
            if len(perhaps) > MOST_TOGETHER:
                message = f"action '{action.name}' has {len(perhaps) + 1} effects that may be on the same {part.fluent}"
                raise PDDLError(named, None, f"{message}; expected at most {MOST_TOGETHER + 1}, or an unbounded type")
            when = None if timing is None else TimePointInterval(timing)
            read += [(when, condition) for condition in _conditions(part, sure, perhaps)]
    rebuild(action, read, changes)


def _same(problem: Problem, part: Effect, others: Iterable[Effect]) -> tuple[list[Effect], list[tuple[FNode, Effect]]]:
    """Return the additions that are surely on the same number as an effect, and others, each with its condition."""
    make = problem.environment.expression_manager
    sure: list[Effect] = []
    perhaps: list[tuple[FNode, Effect]] = []
    for other in others:
        if part.is_assignment() or other.is_assignment():
            continue
        pairs = zip(part.fluent.args, other.fluent.args, strict=True)
        same = make.And([make.Equals(*pair) for pair in pairs]).simplify()
        if same.is_true() and other.condition.is_true():
            sure.append(other)
        elif not same.is_false():
            perhaps.append((make.And(other.condition, same), other))
    return sure, perhaps


def _conditions(part: Effect, sure: list[Effect], perhaps: list[tuple[FNode, Effect]]) -> Iterable[FNode]:
    """Yield the conditions under which an effect, with others that are on the same number, stays within the bounds."""
    make = part.environment.expression_manager
    for chosen in itertools.product((True, False), repeat=len(perhaps)):
        made = [match if one else make.Not(match) for (match, _), one in zip(perhaps, chosen, strict=True)]
        also = [other for (_, other), one in zip(perhaps, chosen, strict=True) if one]
        within = _within(part.fluent, _value(part, [*sure, *also]))
        yield make.Implies(make.And(part.condition, *made), within)


def _value(part: Effect, others: Iterable[Effect]) -> FNode:
    """Return the value of a number after effects on it."""
    make = part.environment.expression_manager
    if part.is_assignment():
        return part.value
    amounts = [make.Times(-1, each.value) if each.is_decrease() else each.value for each in (part, *others)]
    return make.Plus(part.fluent, *amounts)


def _within(number: FNode, value: FNode) -> FNode:
    """Return the condition that a value is within the bounds of a number's type."""
    make = number.environment.expression_manager
    low, high = bounds(number.fluent())
    limits = [] if low is None else [make.GE(value, low)]
    return make.And(*limits, *([] if high is None else [make.LE(value, high)]))


SUPPORTED = {
    "problem_class": ("ACTION_BASED",),
    "problem_type": ("SIMPLE_NUMERIC_PLANNING", "GENERAL_NUMERIC_PLANNING"),
    "time": ("CONTINUOUS_TIME", "DURATION_INEQUALITIES", "SELF_OVERLAPPING"),
    "expression_duration": (
        "STATIC_FLUENTS_IN_DURATIONS", "FLUENTS_IN_DURATIONS", "INT_TYPE_DURATIONS", "REAL_TYPE_DURATIONS",
    ),
    "numbers": ("BOUNDED_TYPES",),
    "fluents_type": ("INT_FLUENTS", "REAL_FLUENTS"),
    "typing": ("FLAT_TYPING", "HIERARCHICAL_TYPING"),
    "conditions_kind": (
        "NEGATIVE_CONDITIONS", "DISJUNCTIVE_CONDITIONS", "EQUALITIES", "EXISTENTIAL_CONDITIONS", "UNIVERSAL_CONDITIONS",
    ),
    "effects_kind": (
        "CONDITIONAL_EFFECTS", "FORALL_EFFECTS", "INCREASE_EFFECTS", "DECREASE_EFFECTS",
        "STATIC_FLUENTS_IN_BOOLEAN_ASSIGNMENTS", "FLUENTS_IN_BOOLEAN_ASSIGNMENTS",
        "STATIC_FLUENTS_IN_NUMERIC_ASSIGNMENTS", "FLUENTS_IN_NUMERIC_ASSIGNMENTS",
    ),
    "quality_metrics": ("ACTIONS_COST", "PLAN_LENGTH", "MAKESPAN"),
    "actions_cost_kind": (
        "STATIC_FLUENTS_IN_ACTIONS_COST", "FLUENTS_IN_ACTIONS_COST", "INT_NUMBERS_IN_ACTIONS_COST",
        "REAL_NUMBERS_IN_ACTIONS_COST",
    ),
    "initial_state": ("UNDEFINED_INITIAL_NUMERIC",),
}  # fmt: skip
"""Features of unified-planning problems that are supported, by kind: planning for one person who acts in sequence."""

SOMETIMES = frozenset({"FINAL_VALUE"})
"""Features that are supported in part: the least final value of numbers that only grow."""


@dataclass(frozen=True)
class Written:
    """The files of a problem, and what of it the names in them stand for."""

    instance: Instance
    items: Mapping[str, Any]

    @property
    def own_names(self) -> dict[str, str]:
        """The problem's own names by those in the files from which they differ.

        Names with spaces, commas or parentheses are left out, since they cannot stand in a ground action.
        """
        renamed = {name: item.name for name, item in self.items.items() if name != item.name}
        return {name: own for name, own in renamed.items() if own and not re.search(r"[\s(),]", own)}


def named(problem: Problem) -> Instance:
    """Return an instance without files, named after its problem."""
    name = problem.name or "problem"
    return Instance(Path(name), Path(f"{name} (domain)"))


@contextmanager
def written(problem: Problem) -> Iterator[Written]:
    """Write a problem as PDDL, into files that last as long as the context.

    A problem that is not supported raises a `PDDLError`. One that is raised within the context is about the problem
    too, since its user does not know the files.
    """
    with tempfile.TemporaryDirectory(prefix="kitassist-") as folder:
        try:
            yield _write(problem, Path(folder))
        except PDDLError as error:
            raise PDDLError(named(problem).problem, None, error.message) from None


def _write(problem: Problem, folder: Path) -> Written:
    from unified_planning.exceptions import UPException
    from unified_planning.io import PDDLWriter

    name = named(problem).problem
    instance = Instance(folder / "problem.pddl", folder / "domain.pddl")
    try:
        _require_supported(problem)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", "The PDDL printer cannot exactly represent")
            writer = PDDLWriter(plain(problem))
            for file, text in ((instance.domain, writer.get_domain()), (instance.problem, writer.get_problem())):
                file.write_text(_without_powers(text), encoding="utf-8")
    except PDDLError:
        raise
    except UserWarning as warning:
        number = str(warning).split("'")[1]
        message = f"the number {number} has no decimal of at most ten digits, as PDDL needs; expected one, such as 0.5"
        raise PDDLError(name, None, message) from None
    except Exception as error:  # noqa: BLE001  it raises any exception, internal errors included
        clear_walkers()
        reason = " ".join(str(error).split()) if isinstance(error, UPException) else "unified-planning fails at it"
        raise PDDLError(name, None, f"cannot be written as PDDL: {reason}") from None
    return Written(instance, dict(writer.nto_renamings))


def _without_powers(text: str) -> str:
    """Return a text whose numbers have no exponents: 0.0000001 for 1e-07."""
    return re.sub(r"(?<=[\s(])-?\d[\d.]*e[-+]\d+(?=[\s)])", lambda found: format(Decimal(found[0]), "f"), text)


def _require_supported(problem: Problem) -> None:
    """Refuse what PDDL, or this project, does not have."""
    name = named(problem).problem
    known = SOMETIMES.union(*SUPPORTED.values())
    if more := sorted(problem.kind.features - known):
        said = ", ".join(each.lower().replace("_", " ") for each in more)
        raise PDDLError(name, None, f"{said}: not supported")
    for action in filter(lasts, problem.actions):
        times: list[tuple[Any, ...]] = [(timing,) for timing, _ in effects(action)]
        times += [(interval.lower, interval.upper) for interval in action.conditions]
        if any(each.is_global() for several in times for each in several) or any(
            each[0].is_from_end() and each[-1].is_from_start() for each in times
        ):
            raise PDDLError(name, None, f"action '{action.name}' has a time that is not within it; expected its start, "
                            "its end, or all between them")  # fmt: skip
        if action.duration.is_left_open():
            raise PDDLError(name, None, f"action '{action.name}' has no least duration, since its interval is open on "
                            "the left; expected a closed one")  # fmt: skip


def plain(problem: Problem) -> Problem:
    """Return a problem with the same plans, in the constructs that PDDL has and Fast Downward reads."""
    found = problem.clone()
    add_bounds(found, named(problem).problem)
    _close_durations(found)
    simplify(found)
    metric = problem.quality_metrics[0] if len(problem.quality_metrics) == 1 else None
    if metric is not None and metric.is_minimize_action_costs():
        zero = problem.environment.expression_manager.Int(0)
        costs = {action: metric.get_action_cost(problem.action(action.name)) for action in found.actions}
        found.clear_quality_metrics()
        found.add_quality_metric(type(metric)({one: zero if cost is None else cost for one, cost in costs.items()}))
    return found


def _close_durations(problem: Problem) -> None:
    """Close the intervals of durations: below an open end there has to be a duration."""
    from unified_planning.model import ClosedDurationInterval, StartTiming

    make = problem.environment.expression_manager
    for action in filter(lasts, problem.actions):
        if action.duration.is_right_open():
            low, high = action.duration.lower, action.duration.upper
            action.add_condition(StartTiming(), make.LT(low, high))
            action.set_duration_constraint(ClosedDurationInterval(low, high))


def restore_names(sas: str, names: Mapping[str, str]) -> str:
    """Return the SAS text with the problem's own names in its facts and operators."""
    if not names:
        return sas

    def restored(match: re.Match[str]) -> str:
        return re.sub(r"[^\s(),]+", lambda word: names.get(word[0], word[0]), match[0])

    sas = re.sub(r"(?<=^Atom ).*", restored, sas, flags=re.M)
    sas = re.sub(r"(?<=^NegatedAtom ).*", restored, sas, flags=re.M)
    return re.sub(r"(?<=^begin_operator\n).*", restored, sas, flags=re.M)
