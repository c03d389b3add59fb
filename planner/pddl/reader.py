"""Reading a domain and a problem into frozen types; all other readings are compared with this one.

`read` checks names, numbers of arguments and types everywhere, without a planner or another library.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from . import declarations, instances
from .declarations import Names, Symbol, Typed, Types, meant, refuse, shown
from .expressions import COMPARISONS, DURATION, Number, listed, number, word
from .formulas import Cost, Formulas, whole_number
from .instances import Expression, Instance, Place

TOTAL_COST = ("total-cost",)
"""The function that sums up the costs of actions, without arguments."""


@dataclass(frozen=True)
class Action:
    """An action. Its formulas are normalised for all PDDL readers (see `formulas`); the effect includes the cost."""

    name: str
    parameters: tuple[Typed, ...]
    precondition: Expression
    effect: Expression
    cost: Cost | None
    place: Place


@dataclass(frozen=True)
class DurativeAction:
    """A durative action. `duration` is a conjunction of constraints on `?duration`.

    The parts of the condition and the effect stand in `(at start ...)`, `(over all ...)` or `(at end ...)`.
    """

    name: str
    parameters: tuple[Typed, ...]
    duration: Expression
    condition: Expression
    effect: Expression
    place: Place


@dataclass(frozen=True)
class Rule:
    """A rule that defines a derived predicate; `head` is the predicate with the rule's variables."""

    head: Symbol
    condition: Expression


@dataclass(frozen=True)
class Domain:
    """A domain; `entries` are its actions and rules in the order of the file."""

    name: str
    types: Types
    constants: Mapping[str, Typed]
    predicates: Mapping[str, Symbol]
    functions: Mapping[str, Symbol]
    entries: tuple[Action | DurativeAction | Rule, ...]

    @property
    def actions(self) -> dict[str, Action]:
        """The actions without durations by name."""
        return {each.name: each for each in self.entries if isinstance(each, Action)}

    @property
    def rules(self) -> list[Rule]:
        """The rules of the derived predicates."""
        return [each for each in self.entries if isinstance(each, Rule)]


@dataclass(frozen=True)
class Problem:
    """A problem. `metric` and `init` are the places of the metric and of the initial state."""

    name: str
    objects: Mapping[str, Typed]
    """Objects, without the domain's constants."""
    facts: Mapping[tuple[str, ...], Place]
    """Facts that hold in the initial state (predicate and arguments), with their places."""
    values: Mapping[tuple[str, ...], Number]
    """Values of the functions, by name and arguments."""
    goal: Expression
    metric: Place | None
    init: Place
    minimized: Expression | None = None
    """What the metric minimizes; None stands for `(total-cost)` where there is a metric."""


@dataclass(frozen=True)
class Reading:
    """The content of the two files of an instance; `unions` names the type that replaces each `(either ...)`.

    `numeric` is true if there is more than classical planning with whole costs: durations, or numbers that matter.
    """

    instance: Instance
    domain: Domain
    problem: Problem
    unions: Mapping[tuple[str, ...], str] = field(default_factory=dict)
    numeric: bool = False

    @cached_property
    def objects(self) -> Mapping[str, Typed]:
        """All objects, with the constants of the domain."""
        return {**self.domain.constants, **self.problem.objects}

    def of_kind(self, kind: str) -> tuple[str, ...]:
        """Return the objects of a type, or of a union of types."""
        kinds: Iterable[str] = next((kinds for kinds, union in self.unions.items() if union == kind), (kind,))
        fits = self.domain.types.fits
        return tuple(name for name, each in self.objects.items() if fits(each.kinds[0], kinds))

    @property
    def has_costs(self) -> bool:
        """Whether the files mention the sum of costs."""
        costs = any(each.cost is not None for each in self.domain.actions.values())
        declared = TOTAL_COST[0] in self.domain.functions or TOTAL_COST in self.problem.values
        return costs or declared or self.problem.metric is not None

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know about the costs. It names no file, since the task may be cached for a copy."""
        costs = [each.cost for each in self.domain.actions.values() if each.cost is not None]
        if self.problem.metric is None:
            if not costs:
                return ()
            missing = "the problem has no (:metric minimize (total-cost)), so that each action costs 1"
            return (f"line {costs[0].place.line} of the domain has an action cost, but {missing}",)
        if not costs and not self.domain.actions:
            return ()  # as where no action can ever happen
        if not costs:
            return ("the problem minimizes (total-cost), but no action increases it, so that each action costs 0",)
        if TOTAL_COST not in self.problem.values:
            return ("the initial state has no (= (total-cost) 0), which is assumed",)
        return ()


def read(instance: Instance) -> Reading:
    """Read and check the files of an instance.

    A `PDDLError` says if they are not valid PDDL, do not match, or go beyond classical planning with action costs.
    """
    if (fault := instances.missing(instance)) is not None:
        raise fault
    domain, problem = (
        instances.nested(file, instances.text(file, kind))
        for file, kind in ((instance.domain, "domain"), (instance.problem, "problem"))
    )
    declarations.check_supported(instance, domain, problem)
    unions: dict[tuple[str, ...], str] = {}
    known, derived, numeric = _domain(instance.domain, domain, unions)
    asked, numbers = _problem(instance, problem, known, derived, unions)
    reading = _without_empty_types(Reading(instance, known, asked, unions, numeric or numbers))
    if not reading.numeric:
        for action in known.actions.values():
            _check_repeated(reading, action)
    return reading


def _without_empty_types(reading: Reading) -> Reading:
    """Return a reading in which no quantifier is over a type without objects, which readers treat differently.

    What is for all of no objects holds, as an effect it is none; what is for some of them does not hold.
    """
    domain, problem = reading.domain, reading.problem

    def decided(formula: Expression) -> Expression:
        kinds = formula.parts[1].parts[2::3] if formula.head in ("forall", "exists") else ()
        if not all(reading.of_kind(kind.word) for kind in kinds):
            return listed(word("and" if formula.head == "forall" else "or"))
        return formula._replace(parts=tuple(map(decided, formula.parts))) if formula.parts else formula

    def entry(each: Action | DurativeAction | Rule) -> Action | DurativeAction | Rule:
        if isinstance(each, Rule):
            return replace(each, condition=decided(each.condition))
        effect = decided(each.effect)
        if isinstance(each, Action):
            return replace(each, precondition=decided(each.precondition), effect=effect)
        return replace(each, condition=decided(each.condition), effect=effect)

    entries = tuple(map(entry, domain.entries))
    return replace(
        reading, domain=replace(domain, entries=entries), problem=replace(problem, goal=decided(problem.goal))
    )


def _check_repeated(reading: Reading, action: Action) -> None:
    """Refuse a cost that has a repeated parameter and lacks a value: the translator grounds such actions wrongly."""
    function = () if action.cost is None or action.cost.number is not None else action.cost.function
    variables = [word for word in function[1:] if word.startswith("?")]
    if action.cost is None or len(variables) == len(set(variables)):
        return
    kinds = {each.name: each.kinds for each in action.parameters if each.name in variables}
    fits = reading.domain.types.fits
    ranges = [[name for name, each in reading.objects.items() if fits(each.kinds[0], k)] for k in kinds.values()]
    for chosen in itertools.product(*ranges):
        bound = dict(zip(kinds, chosen, strict=True))
        if action.cost.of(bound, reading.problem.values) is None:
            missing = " ".join(bound.get(word, word) for word in function)
            refuse(
                reading.instance.domain,
                action.cost.place,
                f"action '{action.name}' costs '({' '.join(function)})', which names a parameter twice; ({missing}) "
                "has no value in the initial state; expected a value for every object",
            )


def _parts(whole: Expression, head: str) -> tuple[Expression, ...]:
    section = whole.section(head)
    return () if section is None else section.parts[1:]


def _domain(file: Path, whole: Expression, unions: dict[tuple[str, ...], str]) -> tuple[Domain, dict[str, Place], bool]:
    """Read the domain. Return it, its derived predicates, and whether it is more than classical."""
    types = declarations.types(file, whole.section(":types"))
    constants = declarations.objects(file, whole.section(":constants"), types, {}, "")
    predicates = declarations.predicates(file, whole.section(":predicates"), types)
    functions = declarations.functions(file, whole.section(":functions"), types)
    derived: dict[str, Place] = {}
    for part in whole.parts:
        if part.head == ":derived" and len(part.parts) > 1:
            derived.setdefault(part.parts[1].head, part.place)
    formulas = Formulas(file, Names(types, predicates, functions, constants), derived, unions)
    entries: list[Action | DurativeAction | Rule] = []
    places: dict[str, Place] = {}
    for part in whole.parts:
        if part.head in (":action", ":durative-action"):
            read = _action if part.head == ":action" else _durative_action
            action = read(file, part, formulas)
            if (other := places.get(action.name)) is not None:
                refuse(file, part.parts[1], f"'{action.name}' is defined twice, on line {other.line} as well")
            places[action.name] = action.place
            entries.append(action)
        elif part.head == ":derived":
            entries.append(_rule(file, part, formulas))
    name = _parts(whole, "domain")[0].word
    domain = Domain(name, types, constants, predicates, functions, tuple(entries))
    return domain, derived, formulas.numeric


def _sections(
    file: Path, part: Expression, sections: tuple[str, ...], formulas: Formulas
) -> tuple[dict[str, Expression], tuple[Typed, ...]]:
    """Read the sections of an action by their heads, and its parameters."""
    if len(part.parts) < 2 or not part.parts[1].word or part.parts[1].word.startswith((":", "?")):
        layout = " ".join(f"{section} ..." for section in sections[1:])
        refuse(file, part, f"expected ({part.head} NAME :parameters (...) {layout})")
    title = part.parts[1]
    found: dict[str, Expression] = {}
    words = iter(part.parts[2:])
    for key in words:
        if key.word == ":observe":
            refuse(file, key, f"action '{title}' observes (:observe): sensing actions are not supported")
        if key.word not in sections:
            expected = meant(key.word, sections) or f"; expected {', '.join(sections)}"
            refuse(file, key, f"'{shown(key)}' is not expected in action '{title}'{expected}")
        if key.word in found:
            refuse(file, key, f"action '{title}' has a second {key}")
        value = next(words, None)
        if value is None or value.word.startswith(":"):
            refuse(file, key, f"action '{title}': nothing follows {key}")
        found[key.word] = value
    if ":effect" not in found:
        refuse(file, part, f"action '{title}' has no :effect")
    listing = found.get(":parameters")
    if listing is not None and listing.word:
        refuse(file, listing, f"parameters of action '{title}': expected (?VARIABLE - TYPE ...), not '{listing}'")
    parameters = declarations.parameters(file, () if listing is None else listing.parts, formulas.names.types)
    return found, parameters


def _action(file: Path, part: Expression, formulas: Formulas) -> Action:
    found, parameters = _sections(file, part, (":parameters", ":precondition", ":effect"), formulas)
    title = part.parts[1]
    scope = formulas.scope(parameters)
    formulas.variables(parameters)  # for their types
    empty = listed(word("and"))
    precondition = formulas.condition(found.get(":precondition", empty), scope)
    costs: list[Cost] = []
    effect = formulas.effect(found[":effect"], scope, title.word, costs)
    return Action(title.word, parameters, precondition, effect, costs[0] if costs else None, title.place)


def _durative_action(file: Path, part: Expression, formulas: Formulas) -> DurativeAction:
    sections = (":parameters", ":duration", ":condition", ":effect")
    found, parameters = _sections(file, part, sections, formulas)
    title = part.parts[1]
    if ":duration" not in found:
        refuse(file, part, f"durative action '{title}' has no :duration; expected :duration (= {DURATION} NUMBER)")
    if (own := next((each for each in parameters if each.name == DURATION), None)) is not None:
        refuse(file, own.place, f"{DURATION} is the duration of action '{title}', and cannot be a parameter")
    scope = formulas.scope(parameters)
    formulas.variables(parameters)  # for their types
    formulas.numeric = True
    duration = formulas.duration(found[":duration"], scope, title.word)
    formulas.in_time = True
    condition = formulas.timed_condition(found.get(":condition", listed(word("and"))), scope, title.word)
    effect = formulas.timed_effect(found[":effect"], scope, title.word)
    formulas.in_time = False
    return DurativeAction(title.word, parameters, duration, condition, effect, title.place)


def _rule(file: Path, part: Expression, formulas: Formulas) -> Rule:
    if len(part.parts) != 3 or not part.parts[1].head:
        refuse(file, part, "expected (:derived (PREDICATE ?VARIABLE - TYPE ...) CONDITION)")
    head = part.parts[1]
    parameters = declarations.parameters(file, head.parts[1:], formulas.names.types)
    scope = formulas.scope(parameters)
    formulas.variables(parameters)  # for their types
    arguments = (Expression(each.name, (), each.place) for each in parameters)
    formulas.atom(head._replace(parts=(head.parts[0], *arguments)), scope)
    return Rule(Symbol(head.head, parameters, part.place), formulas.condition(part.parts[2], scope))


def _problem(
    instance: Instance,
    whole: Expression,
    domain: Domain,
    derived: Mapping[str, Place],
    unions: dict[tuple[str, ...], str],
) -> tuple[Problem, bool]:
    """Read the problem. Return it, and whether it is more than classical."""
    file = instance.problem
    objects = declarations.objects(
        file, whole.section(":objects"), domain.types, domain.constants, str(instance.domain)
    )
    names = Names(domain.types, domain.predicates, domain.functions, {**domain.constants, **objects})
    formulas = Formulas(file, names, derived, unions)
    init, goal, metric = (whole.section(head) for head in (":init", ":goal", ":metric"))
    if goal is None:
        refuse(file, None, "the problem has no (:goal ...)")
    if init is None:
        refuse(file, None, "the problem has no (:init ...)")
    facts, values = _init(file, init, formulas)
    if len(goal.parts) != 2 or not goal.parts[1].parts:
        refuse(file, goal, "expected (:goal CONDITION), and one condition")
    minimized = None if metric is None else _minimized(file, metric, formulas)
    asked = Problem(
        name=_parts(whole, "problem")[0].word,
        objects=objects,
        facts=facts,
        values=values,
        goal=formulas.condition(goal.parts[1], formulas.scope(())),
        metric=None if metric is None else metric.place,
        init=init.place,
        minimized=minimized,
    )
    return asked, formulas.numeric or minimized is not None


def _minimized(file: Path, metric: Expression, formulas: Formulas) -> Expression | None:
    """Read what is minimized; None stands for the sum of costs, `(total-cost)`."""
    expected = "expected (:metric minimize EXPRESSION), such as (total-cost) or (total-time)"
    if len(metric.parts) != 3:
        refuse(file, metric, expected)
    way, what = metric.parts[1:]
    if way.word == "maximize":
        refuse(file, way, "metric maximize is not supported: costs are minimized; write what it costs to go without")
    if way.word != "minimize":
        refuse(file, way, f"'{shown(way)}' is no direction of a metric{meant(way.word, ('minimize',))}; {expected}")
    if any(each.word == "is-violated" for each in what.walk()):
        refuse(file, what, "preferences are not supported; write what must hold as a plain goal")
    if str(what) in ("(total-cost)", "total-cost"):
        return None

    def named(part: Expression) -> Expression:
        if part.word in ("total-time", "total-cost") or (part.word and part.word in formulas.names.functions):
            return Expression("", (part,), part.place)
        if part.head == "total-time" and len(part.parts) == 1 and "total-time" not in formulas.names.functions:
            return part
        if part.head in ("+", "-", "*", "/"):
            return Expression("", (part.parts[0], *map(named, part.parts[1:])), part.place)
        return formulas.expression(part, {})

    return named(what)


def _init(
    file: Path, init: Expression, formulas: Formulas
) -> tuple[dict[tuple[str, ...], Place], dict[tuple[str, ...], Number]]:
    """Read the initial state: the facts that hold, with their places, and the values of functions."""
    facts: dict[tuple[str, ...], Place] = {}
    absent: dict[tuple[str, ...], Place] = {}
    values: dict[tuple[str, ...], Number] = {}
    places: dict[tuple[str, ...], Place] = {}
    for fact in init.parts[1:]:
        if fact.word or not fact.parts:
            refuse(file, fact, f"'{fact}' is not expected in (:init ...): a fact stands in parentheses")
        if fact.head in ("and", "or", "forall", "exists", "when", "imply"):
            refuse(file, fact, f"({fact.head} ...) is not expected in (:init ...): list the facts one by one")
        if fact.head == "at" and len(fact.parts) == 3 and fact.parts[2].parts:
            refuse(file, fact, f"timed initial literals are not supported: {fact}; state what holds from the start")
        if fact.head in COMPARISONS:
            refuse(
                file, fact, f"'{fact}' is a condition; expected the number itself, (= (FUNCTION ARGUMENT ...) NUMBER)"
            )
        if fact.head == "=":
            of, value = _value(file, fact, formulas)
            if values.setdefault(of, value) != value:
                refuse(file, fact, f"'({' '.join(of)})' has another value on line {places[of].line}")
            places.setdefault(of, fact.place)
            continue
        positive = fact
        if fact.head == "not":
            if len(fact.parts) != 2 or not fact.parts[1].parts:
                refuse(file, fact, "'not' expects exactly one argument; expected (not (PREDICATE ARGUMENT ...))")
            positive = fact.parts[1]
        atom = tuple(formulas.atom(positive, {}).words)
        if (rule := formulas.derived.get(atom[0])) is not None:
            refuse(file, fact, f"'{atom[0]}' is derived (line {rule.line} of the domain), and not stated")
        (facts if positive is fact else absent).setdefault(atom, fact.place)
    for atom in facts.keys() & absent.keys():
        refuse(file, absent[atom], f"'({' '.join(atom)})' holds on line {facts[atom].line}, and does not hold here")
    return facts, values


def _value(file: Path, fact: Expression, formulas: Formulas) -> tuple[tuple[str, ...], Number]:
    """Read `(= (FUNCTION OBJECT ...) NUMBER)`."""
    parts = fact.parts[1:]
    if len(parts) != 2 or not parts[0].parts:
        refuse(file, fact, f"'{shown(fact)}': expected (= (FUNCTION OBJECT ...) NUMBER)")
    of, written = parts
    function = formulas.names.functions.get(of.head)
    if function is None and of.head != "total-cost":
        refuse(file, of, f"no such function '{of.head}' in (:functions ...){meant(of.head, formulas.names.functions)}")
    arguments: Iterable[Expression] = formulas.arguments(of, function, {}) if function is not None else of.parts[1:]
    value: Number | None = whole_number(written)
    if value is None:
        value = number(written.word)
        formulas.numeric = True
    else:
        formulas.limited(written, int(value))
    if value is None:
        refuse(file, written, f"'{shown(written)}' is no number; expected a number such as 3, 2.5 or -1")
    if of.head == "total-cost" and (value or len(of.parts) > 1):
        refuse(file, fact, "the sum of costs begins with 0: expected (= (total-cost) 0)")
    return (of.head, *(part.word for part in arguments)), value
