"""A domain and a problem, written in a form on which all PDDL readers agree.

Sections are in the order of the grammar. Each type is listed with its supertype, and `object` is not listed unless
asked for. Each line corresponds to a line of the original file, so that positions of other readers can be translated.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby

from .declarations import OBJECT, Symbol, Typed
from .formulas import entry, listed, word
from .reader import Action, Reading, Rule
from .s_expressions import Expression, Place

START = Place(1, 1)


@dataclass(frozen=True)
class Rendered:
    """A file in normalised form."""

    whole: Expression
    """Its expression, with the positions of the original file."""
    text: str
    lines: tuple[int, ...]
    """Line of the original file for each line of the text."""

    def line(self, number: int | None) -> int | None:
        """Return the line of the original file for a line of the text; None if it is unknown."""
        return self.lines[number - 1] if number is not None and 0 < number <= len(self.lines) else None


def domain(reading: Reading, *, list_object: bool = False) -> Rendered:
    """Write the domain of a reading; `list_object` lists `object` among the types."""
    read = reading.domain
    parts = [_section(START, "domain", [word(START, read.name)])]
    if read.requirements:
        parts.append(_section(read.requirements[0], ":requirements", read.requirements))
    kinds = _types(reading) + [word(START, OBJECT)] * list_object
    if kinds:
        parts.append(_section(START, ":types", kinds))
    if read.constants:
        parts.append(_section(START, ":constants", _objects(read.constants.values())))
    parts.append(_section(START, ":predicates", [_symbol(each, reading) for each in read.predicates.values()]))
    if functions := _functions(reading):
        parts.append(_section(START, ":functions", functions))
    parts += [_action(each, reading) if isinstance(each, Action) else _rule(each, reading) for each in read.entries]
    return _rendered(parts)


def problem(reading: Reading) -> Rendered:
    """Write the problem of a reading. Facts that do not hold initially are left out."""
    read = reading.problem
    parts = [
        _section(START, "problem", [word(START, read.name)]),
        _section(START, ":domain", [word(START, reading.domain.name)]),
    ]
    if read.requirements:
        parts.append(_section(read.requirements[0], ":requirements", read.requirements))
    if read.objects:
        parts.append(_section(START, ":objects", _objects(read.objects.values())))
    init = [_words(place, atom) for atom, place in read.facts.items()]
    init += [
        listed(place, word(place, "="), _words(place, of), word(place, str(read.values[of])))
        for of, place in read.value_places.items()
    ]
    parts.append(_section(read.init, ":init", init))
    parts.append(_section(read.goal, ":goal", [read.goal]))
    if (at := read.metric) is not None:
        parts.append(_section(at, ":metric", [word(at, "minimize"), _words(at, ("total-cost",))]))
    return _rendered(parts)


def _section(at: Expression | Place, head: str, parts: Iterable[Expression]) -> Expression:
    found = list(parts)
    begin = found[0] if found else at
    return listed(begin, word(begin, head), *found)


def _words(at: Place, words: Iterable[str]) -> Expression:
    return listed(at, *(word(at, each) for each in words))


def _types(reading: Reading) -> list[Expression]:
    """Return the typed list of types, each after its supertypes."""
    types, found = reading.domain.types, list[Expression]()
    for kinds, union in reading.unions.items():
        found += entry(types.places.get(kinds[0], START), union, types.common(kinds))
    for name in types.ordered:
        if name == OBJECT:
            continue
        unions = [union for kinds, union in reading.unions.items() if name in kinds]
        implied = {types.common(kinds) for kinds in reading.unions if name in kinds}
        for parent in [*unions, *(parent for parent in types.parents[name] if parent not in implied)]:
            found += entry(types.places[name], name, parent)
    return found


def _objects(objects: Iterable[Typed]) -> list[Expression]:
    """Return the typed list of objects; neighbours of the same type share it."""
    found: list[Expression] = []
    for _, alike in groupby(objects, key=lambda each: each.kinds):
        *others, last = alike
        found += [word(each.place, each.name) for each in others]
        found += entry(last.place, last.name, last.kinds[0])
    return found


def _symbol(symbol: Symbol, reading: Reading) -> Expression:
    """Return a declaration. A parameter of several types gets their common supertype."""
    found = [word(symbol.place, symbol.name)]
    differ = len({each.name for each in symbol.parameters}) == len(symbol.parameters)
    for number, each in enumerate(symbol.parameters):
        name = each.name if differ else f"?x{number}"
        found += entry(each.place, name, reading.domain.types.common(each.kinds))
    return listed(symbol.place, *found)


def _functions(reading: Reading) -> list[Expression]:
    functions = dict(reading.domain.functions)
    costs = any(isinstance(each, Action) and each.cost is not None for each in reading.domain.entries)
    if costs or reading.problem.metric is not None or ("total-cost",) in reading.problem.values:
        functions.setdefault("total-cost", Symbol("total-cost", (), START))
    found = []
    for each in functions.values():
        found += [_symbol(each, reading), word(each.place, "-"), word(each.place, "number")]
    return found


def _variables(found: Iterable[Typed], reading: Reading) -> list[Expression]:
    written = []
    for each in found:
        kinds = reading.domain.types.reduced(each.kinds)
        kind = reading.unions.get(kinds, kinds[0])
        written += entry(each.place, each.name, kind)
    return written


def _action(action: Action, reading: Reading) -> Expression:
    at = action.place
    return listed(
        at, word(at, ":action"), word(at, action.name),
        word(at, ":parameters"), listed(at, *_variables(action.parameters, reading)),
        word(action.precondition, ":precondition"), action.precondition,
        word(action.effect, ":effect"), action.effect,
    )  # fmt: skip


def _rule(rule: Rule, reading: Reading) -> Expression:
    at = rule.head.place
    head = listed(at, word(at, rule.head.name), *_variables(rule.head.parameters, reading))
    return listed(at, word(at, ":derived"), head, rule.condition)


def _rendered(parts: Iterable[Expression]) -> Rendered:
    """Write a file; a line ends where the next word is on another line of the original."""
    whole = listed(START, word(START, "define"), *parts)
    pieces: list[str] = []
    lines = [1]
    waiting: list[Expression | None] = [whole]
    while waiting:
        part = waiting.pop()
        if part is None:
            pieces.append(")")
            continue
        if part.line != lines[-1]:
            pieces.append("\n")
            lines.append(part.line)
        pieces.append(" " if pieces and pieces[-1] not in "(\n" else "")
        if part.word:
            pieces.append(part.word)
        else:
            pieces.append("(")
            waiting.append(None)
            waiting.extend(reversed(part.parts))
    return Rendered(whole, "".join(pieces) + "\n", tuple(lines))
