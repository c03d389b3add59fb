"""The classical instance that Fast Downward's translator grounds: compiled from the files, and as text.

What the translator does not read is finite for one person who acts in sequence, and is compiled away: numbers and time
by `numeric_compiler`, recursion through conditions for all objects here. A `Compilation` says how the compiled names
and numbers are shown, so that users only meet those of their files.

A derived predicate may depend on itself within a condition for all objects, which the translator refuses. It writes
such a condition as "there is no object without it", a negation, through which nothing may depend on itself.
But there are finitely many objects: what holds for all of them is a conjunction, which only grows as facts are derived,
so that the least fixed point of the rules exists as without it. Here the condition gets a derived predicate of its own,
with a further argument for each quantified variable, and the conjunction of its atoms stands in its place. No negation
is taken out: what depends on its own negation still does, and is refused.

The text is in a form on which all PDDL readers agree. Sections are in the order of the grammar. Requirements, of which
the readers know different ones, are left out. Each type is listed with its supertype, and `object` is not listed unless
asked for.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import groupby, product
from math import prod

from .declarations import OBJECT, Symbol, Typed, refuse
from .expressions import TRUE, as_shown, free_variables, listed, substituted, variables_of, word
from .instances import Expression
from .reader import TOTAL_COST, Action, DurativeAction, Reading, Rule

MOST_VALUES = 1_000
"""Largest number of values of one number, unless stated otherwise."""

NO_SEQUENTIAL_PLAN = "no plan for one person who acts in sequence"
"""Note where files with durations have no plan here: they may need two actions at once."""


@dataclass(frozen=True)
class Compilation:
    """An instance as a classical one, and what its names and numbers mean in the file.

    Attributes
    ----------
    reading : Reading
        A classical instance; its costs are whole numbers.
    unit : Fraction
        Cost in the file's unit of one unit of whole-number cost.
    actions : mapping of str to (str, int)
        By compiled action: its name in the file, and how many of its first parameters are those of the file. Actions
        that are not listed are unchanged.
    numbers : mapping of str to (str, mapping of str to str)
        By compiled predicate of a function: the function's name, and the number that each value object stands for, as
        it is shown: "3", "2.5", "more than 3", "undefined". The value is the predicate's last argument.
    compiled : mapping of str to int
        What was compiled away: "durations" counts durative actions, "numbers" functions that change.
    notes : tuple of str
        What the user should know, such as the cost that was assumed.
    """

    reading: Reading
    unit: Fraction = Fraction(1)
    actions: Mapping[str, tuple[str, int]] = field(default_factory=dict)
    numbers: Mapping[str, tuple[str, Mapping[str, str]]] = field(default_factory=dict)
    compiled: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def with_open_goal(self) -> Compilation:
        """Return an instance with the same states, each with and without a further fact, which is the goal.

        A free action makes it true, so that the translator grounds all actions whatever the goal of the file is.
        """
        domain, problem = self.reading.domain, self.reading.problem
        name = "open-goal"
        while name in domain.predicates or name in domain.actions:
            name += "x"
        fact, place = listed(word(name)), problem.init
        action = Action(name, (), TRUE, fact, None, place)
        predicates = {**domain.predicates, name: Symbol(name, (), place)}
        wider = replace(domain, predicates=predicates, entries=(*domain.entries, action))
        return replace(self, reading=replace(self.reading, domain=wider, problem=replace(problem, goal=fact)))


def with_derived_goal(reading: Reading) -> Reading:
    """Return a reading whose goal is a derived predicate, so that it changes nothing else in the grounded task."""
    domain, place = reading.domain, reading.problem.init
    head = Symbol("new-axiom@goal", (), place)  # its facts are not shown, as those of the translator
    goal = Rule(head, reading.problem.goal)
    return replace(
        reading,
        domain=replace(
            domain,
            constants=reading.objects,  # which the rule names
            predicates={**domain.predicates, head.name: head},
            entries=(*domain.entries, goal),
        ),
        problem=replace(reading.problem, objects={}, goal=listed(word(head.name))),
    )


MOST_OBJECTS = 10_000
"""Largest number of combinations of objects for which a condition is written out."""


def without_recursive_quantifiers(reading: Reading) -> Reading:
    """Return a reading in which no derived predicate depends on itself within a condition for all objects."""
    domain = reading.domain
    rules = _Rules(reading)
    entries = [
        replace(each, condition=rules.formula(each, each.condition, {}, holds=True)) if isinstance(each, Rule) else each
        for each in domain.entries
    ]
    if not rules.added:
        return reading
    added = {
        rule.head.name: replace(
            rule.head, parameters=tuple(replace(each, kinds=(OBJECT,)) for each in rule.head.parameters)
        )
        for rule in rules.added
    }
    return replace(
        reading,
        domain=replace(
            domain,
            constants=reading.objects,  # which the rules name
            predicates={**domain.predicates, **added},
            entries=(*entries, *rules.added),
        ),
        problem=replace(reading.problem, objects={}),
    )


class _Rules:
    """The rules of a reading, and those that are `added` for conditions that are written out."""

    def __init__(self, reading: Reading) -> None:
        self.reading = reading
        self.added: list[Rule] = []
        reads: dict[str, set[str]] = {}
        for rule in reading.domain.rules:
            reads.setdefault(rule.head.name, set()).update(each.head for each in rule.condition.walk())
        self.below = {name: reads.keys() & names for name, names in reads.items()}
        """By derived predicate: those that its rules read, directly or not."""
        for middle in reads:
            for name, names in self.below.items():
                if middle in names:
                    self.below[name] = names | self.below[middle]

    def formula(self, rule: Rule, formula: Expression, kinds: Mapping[str, str], *, holds: bool) -> Expression:
        """Return a part of a rule's condition that has to hold, or not to hold, in which nothing is to be refused.

        `kinds` are the types of the quantified variables around it.
        """
        head, parts = formula.head, formula.parts[1:]
        if head in ("and", "or", "not", "imply"):
            turned = [head == "not" or (head == "imply" and place == 0) for place in range(len(parts))]
            inner = (
                self.formula(rule, part, kinds, holds=holds != turn) for part, turn in zip(parts, turned, strict=True)
            )
            return listed(formula.parts[0], *inner)
        if head not in ("forall", "exists"):
            return formula
        own = variables_of(parts[0])
        body = self.formula(rule, parts[1], {**kinds, **own}, holds=holds)
        recursive = any(rule.head.name in self.below.get(each.head, ()) for each in parts[1].walk())
        if (head == "forall") is not holds or not recursive:
            return listed(*formula.parts[:2], body)
        found = self._written_out(rule, formula, body if holds else listed(word("not"), body), {**kinds, **own})
        return found if holds else listed(word("not"), found)

    def _written_out(self, rule: Rule, formula: Expression, body: Expression, kinds: Mapping[str, str]) -> Expression:
        """Return the conjunction of a new predicate's atoms, whose rule has the body as condition."""
        own, place = variables_of(formula.parts[1]), rule.head.place
        objects = [self.reading.of_kind(kind) for kind in own.values()]
        if prod(map(len, objects)) > MOST_OBJECTS:
            refuse(self.reading.instance.domain, place, f"'{rule.head.name}' depends on itself within (forall ...), "
                   f"for more than {MOST_OBJECTS} combinations of objects; expected fewer")  # fmt: skip
        outer = [name for name in free_variables(body) if name not in own]
        of_rule = {each.name: each for each in rule.head.parameters}
        typed = [of_rule.get(name) or Typed(name, (kinds[name],), place) for name in (*outer, *own)]
        name = (
            f"new-axiom@for-all-{len(self.added) + 1}"  # facts of such names are not shown, as those of the translator
        )
        self.added.append(Rule(Symbol(name, tuple(typed), place), body))
        atom = listed(word(name), *map(word, outer), *map(word, own))
        return listed(word("and"), *(substituted(atom, dict(zip(own, row, strict=True))) for row in product(*objects)))


def domain_text(reading: Reading, *, list_object: bool = False) -> str:
    """Return the domain of a reading; `list_object` lists `object` among the types, as unified-planning needs it."""
    read = reading.domain
    return _defined(
        _list("domain", read.name),
        *_section(":types", [*_types(reading), *[OBJECT] * list_object]),
        *_section(":constants", _objects(read.constants.values())),
        _list(":predicates", *(_symbol(each, reading) for each in read.predicates.values())),
        *_section(":functions", _functions(reading)),
        *(_entry(each, reading) for each in read.entries),
    )


def problem_text(reading: Reading) -> str:
    """Return the problem of a reading. Facts that do not hold initially are left out.

    The sum of costs begins with 0, also where the file does not say so.
    """
    read = reading.problem
    begin = {TOTAL_COST: 0} if reading.has_costs else {}
    return _defined(
        _list("problem", read.name),
        _list(":domain", reading.domain.name),
        *_section(":objects", _objects(read.objects.values())),
        _list(
            ":init",
            *(_list(*atom) for atom in read.facts),
            *(_list("=", _list(*of), as_shown(value)) for of, value in (begin | dict(read.values)).items()),
        ),
        _list(":goal", str(read.goal)),
        *_section(":metric", [] if read.metric is None else ["minimize", str(read.minimized or "(total-cost)")]),
    )


def _list(*words: str) -> str:
    return f"({' '.join(words)})"


def _defined(*sections: str) -> str:
    return "\n".join(["(define", *sections, ")\n"])


def _section(head: str, words: Iterable[str]) -> list[str]:
    """Return a section, or nothing if it is empty."""
    found = list(words)
    return [_list(head, *found)] if found else []


def _types(reading: Reading) -> list[str]:
    """Return the typed list of types: unions first, then each type after its supertypes."""
    types = reading.domain.types
    found = [f"{union} - {types.common(kinds)}" for kinds, union in reading.unions.items()]
    for name in types.ordered:
        if name == OBJECT:
            continue
        unions = [union for kinds, union in reading.unions.items() if name in kinds]
        implied = {types.common(kinds) for kinds in reading.unions if name in kinds}
        parents = [*unions, *(parent for parent in types.parents[name] if parent not in implied)]
        found += [f"{name} - {parent}" for parent in parents]
    return found


def _objects(objects: Iterable[Typed]) -> list[str]:
    """Return the typed list of objects; neighbours of the same type share it."""
    alike = groupby(objects, key=lambda each: each.kinds[0])
    return [f"{' '.join(each.name for each in group)} - {kind}" for kind, group in alike]


def _symbol(symbol: Symbol, reading: Reading) -> str:
    """Return a declaration. A parameter of several types gets their common supertype."""
    names = [each.name for each in symbol.parameters]
    if len(set(names)) < len(names):
        names = [f"?x{number}" for number in range(len(names))]
    kinds = (reading.domain.types.common(each.kinds) for each in symbol.parameters)
    return _list(symbol.name, *(f"{name} - {kind}" for name, kind in zip(names, kinds, strict=True)))


def _functions(reading: Reading) -> list[str]:
    functions = list(reading.domain.functions.values())
    if reading.has_costs and "total-cost" not in reading.domain.functions:
        functions.append(Symbol("total-cost", (), reading.problem.init))
    return [f"{_symbol(each, reading)} - number" for each in functions]


def _variables(variables: Iterable[Typed], reading: Reading) -> list[str]:
    found = []
    for each in variables:
        kinds = reading.domain.types.reduced(each.kinds)
        found.append(f"{each.name} - {reading.unions.get(kinds, kinds[0])}")
    return found


def _entry(entry: Action | DurativeAction | Rule, reading: Reading) -> str:
    if isinstance(entry, Rule):
        return _rule(entry, reading)
    return _action(entry, reading) if isinstance(entry, Action) else _durative_action(entry, reading)


def _durative_action(action: DurativeAction, reading: Reading) -> str:
    return _list(
        ":durative-action", action.name,
        ":parameters", _list(*_variables(action.parameters, reading)),
        ":duration", str(action.duration),
        ":condition", str(action.condition),
        ":effect", str(action.effect),
    )  # fmt: skip


def _action(action: Action, reading: Reading) -> str:
    return _list(
        ":action", action.name,
        ":parameters", _list(*_variables(action.parameters, reading)),
        ":precondition", str(action.precondition),
        ":effect", str(action.effect if reading.numeric or reading.problem.metric else _without_cost(action.effect)),
    )  # fmt: skip


def _without_cost(effect: Expression) -> Expression:
    """Return an effect without the cost, which may lack a value, and is no part of a problem without a metric."""
    if effect.head != "and":
        return effect
    kept = (part for part in effect.parts[1:] if part.head != "increase")
    return effect._replace(parts=(effect.parts[0], *map(_without_cost, kept)))


def _rule(rule: Rule, reading: Reading) -> str:
    return _list(":derived", _list(rule.head.name, *_variables(rule.head.parameters, reading)), str(rule.condition))
