"""A domain and a problem, written in a form on which all PDDL readers agree.

Sections are in the order of the grammar. Requirements, of which the readers know different ones, are left out. Each
type is listed with its supertype, and `object` is not listed unless asked for.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby

from .declarations import OBJECT, Symbol, Typed
from .instances import Expression
from .numeric_expressions import as_shown
from .reader import TOTAL_COST, Action, DurativeAction, Reading, Rule


def domain(reading: Reading, *, list_object: bool = False) -> str:
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


def problem(reading: Reading) -> str:
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
