"""Numbers as facts: the encoding of schemas with finite value sets for Fast Downward's translator.

A function that changes becomes a predicate with one more argument, an object that stands for the value. An action that
reads a value has it as a further parameter; sums and comparisons are static relations over values. The translator then
grounds what is reachable only, and finds that each fluent is one variable:

- growth: parameters for the old and the new value, a static relation between them; the old is deleted, the new added;
- assignment of a static value: `(forall (?o) (when (is-f ?o) (and (not (is-f ?o)) (is-f NEW))))`, without parameters;
- a comparison among other conditions: `(exists (?v) (and (is-f ?v) (RELATION ?v)))`;
- a fluent without a value: an object of its own, which is in no relation.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, prod

from .declarations import Typed, refuse
from .durative import Change, Literal, Schema
from .expressions import (
    COMPLEMENT,
    FALSE,
    OPERATIONS,
    TRUE,
    ZERO,
    Number,
    as_shown,
    compared_terms,
    comparisons,
    conjunction,
    conjuncts,
    free_variables,
    is_numeric,
    joined,
    key,
    listed,
    listing_of,
    variables_of,
    word,
)  # fmt: skip
from .instances import Expression, Place
from .numeric_schemas import Costed
from .static_facts import literal_number
from .value_scope import Encoder, Scope, Sum
from .value_sets import possible


@dataclass(frozen=True)
class EncodedAction:
    """A compiled schema; `costs` maps the objects for `cost_variables` to its cost in the unit of the file."""

    schema: Schema
    parameters: tuple[Typed, ...]
    precondition: Expression
    effect: tuple[Expression, ...]
    cost_variables: tuple[str, ...]
    costs: Mapping[tuple[str, ...], Number]


def encoded(encoder: Encoder, costed: Costed, kinds: Mapping[str, str]) -> EncodedAction | None:
    """Return a schema without numbers; None if it can never be applied. `kinds` are its parameters' types."""
    schema = costed.schema
    top = conjuncts(schema.precondition)
    scope = Scope(encoder, kinds, top, schema.name, schema.place)
    effects: list[Expression] = []
    growing = [change for change in schema.changes if change.grows]
    for change in growing:
        old = scope.value_of(change.term)
        effects += _growth(scope, change, old)
    assigned = [
        (change, _assigned(scope, change)) for change in schema.changes
        if not change.grows and not change.variables and not encoder.statics.is_static(change.amount)
    ]  # fmt: skip
    precondition = []
    for condition in top:
        if condition.head in COMPLEMENT:
            scope.compare(condition)
        elif condition.head == "failed" and len(inner := scope.failure(condition.parts[1])) == 1:
            scope.compare(inner[0])
        elif not is_numeric(condition):
            precondition.append(condition)
    nested = [
        each for each in top
        if is_numeric(each) and each.head not in COMPLEMENT
        and not (each.head == "failed" and len(scope.failure(each.parts[1])) == 1)
    ]  # fmt: skip
    for term in _shared(scope, nested):
        scope.value_of(term)
    precondition += map(scope.formula, nested)
    columns, costs = _costs(scope, costed)
    for change, new in assigned:
        effects += _replacement(scope, change, new)
    for change in schema.changes:
        if not change.grows and (change.variables or encoder.statics.is_static(change.amount)):
            effects += _static_assignment(scope, change)
    effects += [_literal(scope, each) for each in schema.literals]
    whole = conjunction([*precondition, *scope.atoms])
    if whole == FALSE or not costs:
        return None
    values = [Typed(name, (encoder.value_type,), schema.place) for name in scope.variables]
    return EncodedAction(schema, (*schema.parameters, *values), whole, tuple(effects), columns, costs)


def _shared(scope: Scope, conditions: Iterable[Expression]) -> list[Expression]:
    """Return the terms that several comparisons within conditions read, where they have a value for all parameters.

    With one variable for all of them, the translator does not combine values that exclude each other.
    """
    of_each = [dict.fromkeys(compared_terms(each)) for condition in conditions for each in comparisons(condition)]
    times = Counter(term for terms in of_each for term in terms)
    return [
        term for term, several in times.items()
        if several > 1 and term.head in scope.encoder.names and free_variables(term).keys() <= scope.kinds.keys()
        and not scope.missing(term)
    ]  # fmt: skip


def ways(encoder: Encoder, condition: Expression, values: Collection[str] = ()) -> int:
    """Return in about how many ways the translator may satisfy a condition by alternatives and by its `values`.

    It grounds an action for each of them, also where values of one number exclude each other, and for each instance of
    the other parameters. A relation of values that nothing else connects leaves the share of them that its rows are.
    """
    head, parts = condition.head, condition.parts[1:]
    if head == "or":
        return sum(ways(encoder, part) for part in parts)
    if head == "exists":
        return ways(encoder, parts[1], variables_of(parts[0]))
    several = 1
    limits: dict[str, int] = {}
    functions = {predicate: name for name, predicate in encoder.names.items()}
    for part in conjuncts(condition):
        if part.head in functions and part.parts[-1].word in values:
            numbers = len(encoder.numbers[functions[part.head]]) + (functions[part.head] in encoder.undefined)
            limits[part.parts[-1].word] = min(numbers, limits.get(part.parts[-1].word, numbers))
        elif part.head in ("or", "exists"):
            several *= ways(encoder, part)
    relations = []
    for part in conjuncts(condition):
        if part.head in encoder.rows:
            places = {each.word: place for place, each in enumerate(part.parts[1:]) if each.word in limits}
            rows = encoder.rows[part.head]
            for name, place in places.items():
                limits[name] = min(limits[name], len({row[place] for row in rows}))
            relations.append((list(places), len({tuple(row[place] for place in places.values()) for row in rows})))
    connected = {name: {name} for name in limits}
    share = Fraction(1)
    for names, rows_of_values in relations:
        groups = [connected[name] for name in names]
        together = set().union(*groups)
        if len(together) == sum(map(len, groups)):
            share *= min(Fraction(1), Fraction(rows_of_values, prod(limits[name] for name in names)))
            connected.update(dict.fromkeys(together, together))
    return several * ceil(share * prod(limits.values()))


def _growth(scope: Scope, change: Change, old: str) -> list[Expression]:
    """Return the effects of a growth, and require the relation of the old and the new value."""
    encoder, name = scope.encoder, change.term.head
    fluent = change.term if name in encoder.special else None
    before = Sum(old, encoder.numbers[name], name)
    if encoder.statics.is_static(change.amount):
        new = scope.result(
            change.amount, [before], lambda amount, number, of: encoder.stored(number + amount, of, name), name, fluent
        )  # fmt: skip
    else:
        new = scope.result(
            ZERO, [before, scope.computed(change.amount)],
            lambda _, number, amount, of: encoder.stored(number + amount, of, name), name, fluent,
        )  # fmt: skip
    return [listed(word("not"), scope.fact(change.term, old)), scope.fact(change.term, new.variable)]


def _assigned(scope: Scope, change: Change) -> str:
    """Return the variable for the new value of an assignment that reads changing numbers."""
    encoder, name = scope.encoder, change.term.head
    value = scope.computed(change.amount)
    special = name in encoder.special
    common = {encoder.saturations.get(fluent) for fluent in encoder.fluents[name]}
    plain = change.amount.head not in OPERATIONS and change.amount.head not in encoder.undefined
    if plain and not special and common == {None} and value.numbers <= encoder.numbers[name]:
        return value.variable
    if special and value.function == name:
        value = replace(value, function=None)  # its number may be one of another fluent of the function
    return scope.result(
        ZERO, [value], lambda _, number, of: encoder.stored(number, of, name), name, change.term if special else None
    ).variable  # fmt: skip


def _replacement(scope: Scope, change: Change, new: str) -> list[Expression]:
    """Return the effects of an assignment: the old value is deleted, the new one added."""
    old = scope.known.get(key(change.term))
    after = scope.fact(change.term, new)
    if old is not None and change.condition == TRUE:
        return [listed(word("not"), scope.fact(change.term, old)), after]
    return [_any_old(scope, change, {}, change.condition, after)]


def _any_old(
    scope: Scope, change: Change, variables: Mapping[str, str], condition: Expression, after: Expression
) -> Expression:
    """Return the effect that replaces whatever value a term has."""
    scope.root.count += 1
    old = f"?old{scope.root.count}"
    before = scope.fact(change.term, old)
    every = {**variables, old: scope.encoder.value_type}
    both = listed(word("and"), listed(word("not"), before), after)
    return listed(
        word("forall"), listing_of(every), listed(word("when"), conjunction((condition, before)), both)
    )  # fmt: skip


def _static_assignment(scope: Scope, change: Change) -> list[Expression]:
    """Return the effects of an assignment of a static value."""
    encoder, name = scope.encoder, change.term.head
    literal = literal_number(change.amount)
    special = name in encoder.special
    inner = Scope(encoder, {**scope.kinds, **change.variables}, scope.conditions, scope.name, scope.place, scope)
    condition = inner.formula(change.condition)
    if literal is not None and not special:
        common = encoder.saturations.get(next(iter(encoder.fluents[name]), ("",)))
        new = encoder.fluent_object(name, literal if common is None else common.normal(literal))
        if not change.variables:
            return _replacement(scope, replace(change, condition=condition), new)
        return [_any_old(scope, change, change.variables, condition, scope.fact(change.term, new))]
    where = inner if change.variables else scope
    new = where.result(
        change.amount, [], lambda number, of: encoder.stored(number, of, name), name, change.term if special else None
    ).variable  # fmt: skip
    if not change.variables:
        return _replacement(scope, replace(change, condition=condition), new)
    more = dict.fromkeys(inner.variables, encoder.value_type)
    whole = conjunction([condition, *inner.atoms])
    return [_any_old(scope, change, {**change.variables, **more}, whole, scope.fact(change.term, new))]


def _literal(scope: Scope, literal: Literal) -> Expression:
    """Return the effect on a fact."""
    effect = literal.atom if literal.holds else listed(word("not"), literal.atom)
    inner = Scope(
        scope.encoder, {**scope.kinds, **literal.variables}, scope.conditions, scope.name, scope.place, scope
    )  # fmt: skip
    condition = inner.formula(literal.condition)
    if condition != TRUE:
        effect = listed(word("when"), condition, effect)
    if literal.variables:
        effect = listed(word("forall"), listing_of(literal.variables), effect)
    return effect


def _costs(scope: Scope, costed: Costed) -> tuple[tuple[str, ...], dict[tuple[str, ...], Number]]:
    """Return the variables on which the cost of an action depends, and the costs for their objects."""
    cost, schema = costed.cost, costed.schema
    if schema.duration is not None and not scope.statics.is_static(schema.duration):
        scope.compare(listed(word(">="), schema.duration, ZERO))
    for what, expression in (("duration", schema.duration), ("cost", cost)):
        if expression is not None and scope.statics.is_static(expression):
            variables, rows = scope.static_rows(expression)
            for row, value in rows:
                if value < 0 and scope.may_be(variables, [row]):
                    _negative(scope, what, dict(zip(variables, row, strict=True)), value)
            rows = [each for each in rows if each[1] >= 0]
            if variables and scope.rows(variables, ()) and len(rows) < len(scope.rows(variables, ())):
                scope.require((row for row, _ in rows), variables)
            elif not rows:
                return (), {}
            if what == "cost":
                return variables, dict(rows)
    sums = scope.computed(cost)
    priced = {scope.encoder.object_of(number): number for number in sorted(sums.numbers)}
    for object_, number in priced.items():
        if number < 0 and scope.may_be((sums.variable,), [(object_,)]):
            refuse(scope.encoder.file, schema.place, f"action '{schema.name}' may cost {as_shown(number)}; expected a "
                   "comparison among its conditions, outside of 'or', that excludes costs below 0")  # fmt: skip
    return (sums.variable,), {(name,): number for name, number in priced.items() if number >= 0}


def _negative(scope: Scope, what: str, bound: Mapping[str, str], value: Number) -> None:
    """Refuse a negative duration or cost of an instance that may be applied."""
    if (instance := scope.instance(bound)) is not None:
        refuse(scope.encoder.file, scope.place, f"({' '.join((scope.name, *instance))}) has a {what} of "
               f"{as_shown(value)}; expected a {what} of 0 or more")  # fmt: skip


def goal(encoder: Encoder, condition: Expression, place: Place) -> tuple[Expression, list[tuple[str, Expression]]]:
    """Return the goal, with derived predicates for comparisons that several values satisfy, and their conditions."""
    rules: list[tuple[str, Expression]] = []
    scope = Scope(encoder, {}, (), "", place)

    def encode(each: Expression) -> Expression:
        head, parts = each.head, each.parts[1:]
        if head in ("and", "or"):
            return joined(head, map(encode, parts))
        if head not in COMPLEMENT and head != "failed":
            return each
        terms = {key(term): term for term in compared_terms(each)}
        if len(terms) == 1:
            ((fluent, term),) = terms.items()
            text = f"({' '.join(fluent)})"
            values = encoder.sets.values.get(fluent, {None})
            true = [value for value in values if possible(each, {text: value})]
            if len(true) == len(values):
                return TRUE
            if not true:
                return FALSE
            if len(true) == 1:
                return scope.fact(term, encoder.object_of(true[0], fluent))
        name = encoder.fresh(f"new-axiom@goal-{len(rules) + 1}")  # facts of such names are not shown
        rules.append((name, scope.formula(each)))
        return listed(word(name))

    return encode(condition), rules
