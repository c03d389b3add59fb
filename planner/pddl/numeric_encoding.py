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

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from .conditions import (
    COMPLEMENT,
    FALSE,
    TRUE,
    comparisons,
    conjunction,
    conjuncts,
    disjunction,
    free_variables,
    is_numeric,
    variables_of,
)  # fmt: skip
from .declarations import OBJECT, Symbol, Typed, refuse, shown
from .durative import Schema, key
from .formulas import listed, word
from .numeric_expressions import OPERATIONS, NoValueError, Number, applied, as_shown, compared, linear, terms_of
from .numeric_schemas import Costed
from .s_expressions import Expression, Place
from .schemas import Change, Literal
from .static_facts import Statics, literal_number
from .value_sets import Beyond, Fluent, Saturation, Value, ValueSets

MOST_ROWS = 300_000
"""Largest number of tuples of one static relation."""
MOST_TRIED = 5_000_000
"""Largest number of combinations of values that are tried for all relations of an instance, about ten seconds."""
DIRECT_ROWS = 3_000
"""A relation with more tuples reads the value of a static expression as an object of its own."""


@dataclass(frozen=True)
class Sum:
    """A value that an action or a formula knows: its variable, and the numbers that it may be."""

    variable: str
    numbers: frozenset[Number]


@dataclass(frozen=True)
class EncodedAction:
    """A compiled schema; `costs` maps the objects for `cost_variables` to its cost in the unit of the file."""

    schema: Schema
    parameters: tuple[Typed, ...]
    precondition: Expression
    effect: tuple[Expression, ...]
    cost_variables: tuple[str, ...]
    costs: Mapping[tuple[str, ...], Number]


class Encoder:
    """The relations, value objects and predicates of one compilation."""

    def __init__(
        self,
        file: Path,
        statics: Statics,
        sets: ValueSets,
        saturations: Mapping[Fluent, Saturation],
        kept: frozenset[str],
        taken: Iterable[str],
        kinds: Mapping[str, tuple[str, ...]],
    ) -> None:
        self.file = file
        self.statics = statics
        self.sets = sets
        self.saturations = saturations
        self.kinds = kinds
        self.taken = set(taken)
        self.value_type = self.fresh("value-of-number")
        self.objects: dict[object, str] = {}
        self.shown: dict[str, str] = {}
        self.names = {name: self.fresh(f"is-{name}") for name in sorted(kept)}
        self.facts: dict[tuple[str, ...], None] = {}
        self.relations: dict[frozenset[tuple[str, ...]], str] = {}
        self.arities: dict[str, int] = {}
        self.numbers: dict[str, frozenset[Number]] = {}
        self.undefined: set[str] = set()
        self.special: set[str] = set()
        self.tried = 0
        by_name: dict[str, list[Fluent]] = {name: [] for name in kept}
        for fluent in sets.values:
            by_name[fluent[0]].append(fluent)
        self.fluents = by_name
        for name, fluents in by_name.items():
            numbers: set[Number] = set()
            for fluent in fluents:
                numbers |= {value for value in sets.values[fluent] if value is not None}
                if None in sets.values[fluent]:
                    self.undefined.add(name)
            self.numbers[name] = frozenset(numbers)
            normal = {(saturations.get(fluent), fluent in sets.exceeded) for fluent in fluents}
            if len(normal) > 1 or any(fluent in sets.limited for fluent in fluents):
                self.special.add(name)

    def fresh(self, name: str) -> str:
        """Return a name that the files do not use."""
        while name in self.taken:
            name += "x"
        self.taken.add(name)
        return name

    def object_of(self, value: Value, fluent: Fluent | None = None) -> str:
        """Return the object for a value, of a fluent if that has values that stand for several."""
        saturation = None if fluent is None else self.saturations.get(fluent)
        label: object = value
        text = "undefined" if value is None else as_shown(value)
        if saturation is not None and fluent in self.sets.exceeded and saturation.is_beyond(value):
            words = ("or more", "more than") if saturation.above else ("or less", "less than")
            limit = as_shown(saturation.threshold)
            text = f"{limit} {words[0]}" if saturation.closed else f"{words[1]} {limit}"
            label = text
        return self._object(label, text)

    def beyond(self) -> str:
        """Return the object for the value of a fluent that has left its set of values."""
        return self._object(Beyond.BEYOND, Beyond.BEYOND.value)

    def _object(self, label: object, text: str) -> str:
        if label not in self.objects:
            plain = text.replace(" ", "-").replace("/", "of")
            self.objects[label] = self.fresh(f"value-{plain}")
            self.shown[self.objects[label]] = text
        return self.objects[label]

    def stored(self, value: Number, fluent: Fluent | None, name: str) -> Sequence[Number | Beyond]:
        """Return what a fluent has after it got a value, if any: the value that stands for it, or that it is beyond.

        Without a fluent, all those of the function are alike. Nothing means that the value is not reachable.
        """
        of = fluent or next(iter(self.fluents[name]), (name,))
        saturation = self.saturations.get(of)
        after = value if saturation is None else saturation.normal(value)
        if after in (self.sets.values.get(of, set()) if fluent is not None else self.numbers[name]):
            return [after]
        return [Beyond.BEYOND] if of in self.sets.open else []

    def fluent_object(self, name: str, value: Value) -> str:
        """Return the object for a value of a function all of whose fluents show it alike."""
        fluents = self.fluents[name]
        return self.object_of(value, fluents[0] if fluents else None)

    def relation(self, rows: Iterable[tuple[str, ...]]) -> str:
        """Return the predicate of a static relation with the given rows, each of one or more objects."""
        found = frozenset(rows)
        if found not in self.relations:
            name = self.fresh(f"relation-{len(self.relations) + 1}")
            self.relations[found] = name
            self.arities[name] = len(next(iter(found), ()))
            self.facts.update(dict.fromkeys((name, *row) for row in sorted(found)))
        return self.relations[found]

    def symbol_facts(self) -> list[tuple[str, ...]]:
        """Return the facts of the initial state that the encoding adds."""
        begin = [
            (self.names[fluent[0]], *fluent[1:], self.object_of(value, fluent))
            for fluent, value in self.sets.initial.items()
        ]  # fmt: skip
        return [*begin, *self.facts]

    def too_many(self, place: Place, what: str) -> None:
        """Refuse a relation with more than `MOST_ROWS` rows."""
        refuse(self.file, place, f"{what} compares or changes numbers in too many combinations of values; expected "
               "fewer comparisons, fewer terms in one expression, or fewer values")  # fmt: skip


class Scope:
    """The variables for values within one action, or within one formula of it."""

    def __init__(self, encoder: Encoder, kinds: Mapping[str, str], conditions: Sequence[Expression], name: str,
                 place: Place, outer: Scope | None = None) -> None:  # fmt: skip
        self.encoder = encoder
        self.statics = encoder.statics
        self.kinds = dict(kinds)
        self.conditions = conditions
        """Conditions under which rows of relations are needed."""
        self.name = name
        self.place = place
        self.outer = outer
        self.variables: list[str] = []
        self.atoms: list[Expression] = []
        self.known: dict[tuple[str, ...], str] = dict(outer.known) if outer is not None else {}
        self.root: Scope = self if outer is None else outer.root
        self.count = 0

    def fresh(self) -> str:
        """Return a new variable for a value."""
        self.root.count += 1
        name = f"?value{self.root.count}"
        while name in self.kinds:
            self.root.count += 1
            name = f"?value{self.root.count}"
        self.variables.append(name)
        return name

    def value_of(self, term: Expression) -> str:
        """Return the variable for the value of a changing term."""
        words = key(term)
        if words not in self.known:
            variable = self.fresh()
            self.known[words] = variable
            self.atoms.append(self.fact(term, variable))
        return self.known[words]

    def fact(self, term: Expression, value: str) -> Expression:
        """Return the fact that a term has a value."""
        return listed(word(self.encoder.names[term.head]), *term.parts[1:], word(value))

    def require(self, rows: Iterable[tuple[str, ...]], words: Iterable[str]) -> None:
        """Require that words, variables or objects, are in a static relation with the given rows."""
        found = list(rows)
        if not found:
            self.atoms.append(FALSE)
        else:
            self.atoms.append(listed(word(self.encoder.relation(found)), *map(word, words)))

    def rows(self, variables: Iterable[str], terms: Iterable[Expression]) -> list[dict[str, str]]:
        """Return the objects for variables for which the conditions may hold and static terms have values."""
        wanted = {name: self.kinds[name] for name in variables}
        found = self.statics.bindings(wanted, self.conditions, terms)
        return [dict(zip(wanted, row, strict=True)) for row in found]

    def static_rows(
        self, expression: Expression, more: Iterable[str] = ()
    ) -> tuple[tuple[str, ...], list[tuple[tuple[str, ...], Number]]]:
        """Return the variables of a static expression, and its value for the objects for which it has one."""
        variables = tuple(dict.fromkeys([*free_variables(expression), *more]))
        found = []
        for bound in self.rows(variables, terms_of(expression)):
            try:
                value = self.statics.value(expression, bound)
            except NoValueError:
                continue
            except ZeroDivisionError:
                self._zero(expression, bound)
                continue
            found.append((tuple(bound[name] for name in variables), value))
        return variables, found

    def _zero(self, expression: Expression, bound: Mapping[str, str]) -> None:
        """Refuse a division by zero, if an instance of the action may be applied."""
        everything = {name: kind for name, kind in self.kinds.items() if not name.startswith("?value")}
        for row in self.statics.bindings(everything, self.conditions):
            whole = dict(zip(everything, row, strict=True))
            if all(whole[name] == bound[name] for name in bound):
                arguments = " ".join(whole.values())
                refuse(self.encoder.file, expression.place if expression.place.line else self.place,
                       f"action '{self.name}' divides by zero in '{shown(expression)}' for ({arguments}); expected a "
                       "divisor other than 0")  # fmt: skip

    def measured(self, expression: Expression) -> Sum:
        """Return a variable for the value of a static expression."""
        variables, rows = self.static_rows(expression)
        variable = self.fresh()
        self.require(((*row, self.encoder.object_of(value)) for row, value in rows), (*variables, variable))
        return Sum(variable, frozenset(value for _, value in rows))

    def related(self, static: Expression, variables: Sequence[Sum | str], numbers: Sequence[frozenset[Number]],
                names: Sequence[str | None], holds: Callable[..., Sequence[Number | Beyond] | bool | None],
                fluent: Expression | None = None) -> frozenset[Number]:  # fmt: skip
        """Require a static relation between the value of a static expression and values.

        `holds` gets the static value and one number for each variable. It returns whether they are related, or the
        further number that they are related to, for which a variable is the last of `variables`. `names` has the
        function whose objects stand for the numbers of a variable, or None. A `fluent` is the one for which the
        relation is made, where its values are different ones for different objects.
        """
        encoder = self.encoder
        names_of = [each if isinstance(each, str) else each.variable for each in variables]
        more = free_variables(fluent) if fluent is not None else {}
        columns, static_rows = self.static_rows(static, more)
        size = 1
        for each in numbers:
            size *= max(len(each), 1)
        if size > MOST_ROWS:
            encoder.too_many(self.place, f"action '{self.name}'" if self.name else "a condition")
        if columns and fluent is None and size * len(static_rows) > DIRECT_ROWS:
            measure = self.measured(static)
            columns = (measure.variable,)
            static_rows = [((encoder.object_of(value),), value) for value in sorted(measure.numbers)]
        encoder.tried += size * len(static_rows)
        if size * len(static_rows) > MOST_ROWS or encoder.tried > MOST_TRIED:
            encoder.too_many(self.place, f"action '{self.name}'" if self.name else "a condition")
        rows: list[tuple[str, ...]] = []
        results: set[Number] = set()
        for row, value in static_rows:
            of: Fluent | None = None
            pools: Sequence[Iterable[Number]] = numbers
            if fluent is not None:
                bound = dict(zip(columns, row, strict=True))
                of = tuple(bound.get(each, each) for each in key(fluent))
                own = encoder.sets.values.get(of, set())
                pools = [
                    [each for each in pool if names[n] != fluent.head or n > 0 or each in own]
                    for n, pool in enumerate(numbers)
                ]
            for combination in itertools.product(*pools):
                result = holds(value, *combination, of) if fluent is not None else holds(value, *combination)
                if result is None or result is False:
                    continue
                words = [self._object(names[n], each, of if n == 0 else None) for n, each in enumerate(combination)]
                if not isinstance(result, bool):
                    for after in result:
                        if isinstance(after, Beyond):
                            rows.append((*row, *words, encoder.beyond()))
                            continue
                        results.add(after)
                        rows.append((*row, *words, self._object(names[-1], after, of)))
                else:
                    rows.append((*row, *words))
        if not rows and not columns and not names_of:
            self.atoms.append(FALSE)
            return frozenset()
        if not columns and not names_of:
            return frozenset()
        self.require(rows, (*columns, *names_of))
        return frozenset(results)

    def _object(self, name: str | None, value: Number, of: Fluent | None) -> str:
        if name is None:
            return self.encoder.object_of(value)
        if of is not None and of[0] == name:
            return self.encoder.object_of(value, of)
        return self.encoder.fluent_object(name, value)

    def computed(self, expression: Expression) -> Sum:
        """Return a variable for the value of an expression that reads changing numbers."""
        if expression.head not in OPERATIONS:
            return Sum(self.value_of(expression), self.encoder.numbers[expression.head])
        split = linear(expression, self.statics.is_static)
        if split is not None:
            terms, rest = split
            found: Sum | None = None
            for term, factor in terms.values():
                found = self._scaled(term, factor) if found is None else self._accumulated(found, term, factor)
            if found is None:
                return self.measured(rest)
            if literal_number(rest) == 0:
                return found
            return self._result(rest, [found], [None], lambda value, number: [number + value])
        sides = expression.parts[1:]
        if expression.head == "-" and len(sides) == 1:
            inner = self.computed(sides[0])
            return self._result(word("0"), [inner], [None], lambda _, number: [-number])
        left: Sum | Expression = sides[0] if self.statics.is_static(sides[0]) else self.computed(sides[0])
        for right in sides[1:]:
            left = self._operated(expression.head, left, right)
        assert isinstance(left, Sum)
        return left

    def _operated(self, operation: str, left: Sum | Expression, right: Expression) -> Sum | Expression:
        def result(*values: Number) -> Sequence[Number] | None:
            try:
                return [applied(operation, list(values))]
            except ZeroDivisionError:
                return None

        if isinstance(left, Expression):
            if self.statics.is_static(right):
                return listed(word(operation), left, right)
            return self._result(left, [self.computed(right)], [None], lambda value, number: result(value, number))
        if self.statics.is_static(right):
            return self._result(right, [left], [None], lambda value, number: result(number, value))
        both = [left, self.computed(right)]
        return self._result(word("0"), both, [None, None], lambda _, one, other: result(one, other))

    def _scaled(self, term: Expression, factor: Number) -> Sum:
        own = self.computed(term)
        if factor == 1:
            return own
        return self._result(word("0"), [own], [term.head], lambda _, number: [number * factor])

    def _accumulated(self, found: Sum, term: Expression, factor: Number) -> Sum:
        own = self.computed(term)
        return self._result(
            word("0"), [found, own], [None, term.head], lambda _, one, other: [one + other * factor]
        )  # fmt: skip

    def _result(self, static: Expression, values: list[Sum], names: list[str | None],
                holds: Callable[..., Sequence[Number] | bool | None]) -> Sum:  # fmt: skip
        variable = self.fresh()
        numbers = [each.numbers for each in values]
        found = self.related(static, [*values, variable], numbers, [*names, None], holds)
        return Sum(variable, found)

    def compare(self, comparison: Expression) -> None:
        """Require that a comparison is satisfied."""
        head, (left, right) = comparison.head, comparison.parts[1:]
        split = linear(listed(word("-"), left, right), self.statics.is_static)
        if split is None:
            both = [None if self.statics.is_static(side) else self.computed(side) for side in (left, right)]
            one, other = both
            if one is None or other is None:
                static, value = (left, other) if one is None else (right, one)
                assert value is not None
                self.related(
                    static, [value], [value.numbers], [None],
                    lambda s, v: compared(head, s, v) if one is None else compared(head, v, s),
                )  # fmt: skip
                return
            self.related(
                word("0"), [one, other], [one.numbers, other.numbers], [None, None],
                lambda _, a, b: compared(head, a, b),
            )  # fmt: skip
            return
        terms, rest = split
        if not terms:
            self._compare_static(comparison, rest)
            return
        listing = list(terms.values())
        if len(listing) == 1:
            ((term, factor),) = listing
            fluent = term if term.head in self.encoder.special else None
            self.related(
                rest, [self.value_of(term)], [self.encoder.numbers[term.head]], [term.head],
                lambda s, v, _=None: compared(head, factor * v + s, 0), fluent,
            )  # fmt: skip
            return
        if self._share(head, listing, rest):
            return
        found = self._scaled(*listing[0])
        for term, factor in listing[1:-1]:
            found = self._accumulated(found, term, factor)
        term, factor = listing[-1]
        if literal_number(rest) is None:
            found = self._accumulated(found, term, factor)
            self.related(rest, [found], [found.numbers], [None], lambda s, v: compared(head, v + s, 0))
            return
        last = self.computed(term)
        first = listing[0][0].head if len(listing) == 2 and listing[0][1] == 1 else None
        self.related(
            rest, [found, last], [found.numbers, last.numbers], [first, term.head],
            lambda s, a, b: compared(head, a + factor * b + s, 0),
        )  # fmt: skip

    def _share(self, head: str, listing: list[tuple[Expression, Number]], rest: Expression) -> bool:
        """Let two terms that must be equal have one variable, if both have values of their own kind only."""
        (one, first), (other, second) = listing[:2] if len(listing) == 2 else (listing[0], (listing[0][0], 0))
        names = self.encoder
        if (
            head != "==" or second == 0 or first + second != 0 or literal_number(rest) != 0
            or key(one) in self.known or key(other) in self.known or {one.head, other.head} & names.undefined
            or any(fluent in names.sets.exceeded for each in (one, other) for fluent in names.fluents[each.head])
        ):  # fmt: skip
            return False
        variable = self.value_of(one)
        self.known[key(other)] = variable
        self.atoms.append(self.fact(other, variable))
        return True

    def _compare_static(self, comparison: Expression, rest: Expression) -> None:
        """Require that a comparison of static numbers is satisfied."""
        head, (left, right) = comparison.head, comparison.parts[1:]
        difference = listed(word("-"), left, right)
        literal = literal_number(rest)
        if literal is not None and not terms_of(left) and not terms_of(right):
            if not compared(head, literal, 0):
                self.atoms.append(FALSE)
            return
        columns, rows = self.static_rows(difference)
        true = [row for row, value in rows if compared(head, value, 0)]
        if columns:
            self.require(true, columns)
        elif not true:
            self.atoms.append(FALSE)

    def formula(self, condition: Expression) -> Expression:
        """Return a condition in which comparisons are facts and relations, with variables of their own if needed."""
        head, parts = condition.head, condition.parts[1:]
        if head in ("and", "or"):
            inner = (self.formula(part) for part in parts)
            return conjunction(inner) if head == "and" else disjunction(inner)
        if head in ("forall", "exists") and is_numeric(condition):
            self.kinds.update(variables_of(parts[0]))
            return listed(condition.parts[0], parts[0], self.formula(parts[1]))
        if head in ("forall", "exists"):
            return condition
        if head == "failed":
            return disjunction(map(self.formula, self.failure(parts[0])))
        if head == "undefined":
            return self._inner(lambda scope: scope.has_no_value(parts[0]))
        if head in COMPLEMENT:
            return self._inner(lambda scope: scope.compare(condition))
        return condition

    def failure(self, comparison: Expression) -> list[Expression]:
        """Return conditions of which one holds where a comparison is not satisfied."""
        found = [comparison._replace(parts=(word(COMPLEMENT[comparison.head]), *comparison.parts[1:]))]
        for side in comparison.parts[1:]:
            for term in terms_of(side):
                if term.head in self.statics.values:
                    if self._is_partial(term):
                        found.append(listed(word("undefined"), term))
                elif term.head in self.encoder.undefined or self._lacks_fluents(term):
                    found.append(listed(word("undefined"), term))
        return found

    def _is_partial(self, term: Expression) -> bool:
        values = self.statics.values[term.head]
        variables = {name: self.kinds[name] for name in free_variables(term)}
        return any(
            tuple(dict(zip(variables, row, strict=True)).get(each, each) for each in key(term)[1:]) not in values
            for row in self.statics.bindings(variables, ())
        )

    def _lacks_fluents(self, term: Expression) -> bool:
        variables = {name: self.kinds[name] for name in free_variables(term)}
        return any(
            tuple(dict(zip(variables, row, strict=True)).get(each, each) for each in key(term))
            not in self.encoder.sets.values
            for row in self.statics.bindings(variables, ())
        )

    def has_no_value(self, term: Expression) -> None:
        """Require that a term has no value."""
        encoder = self.encoder
        variables = {name: self.kinds[name] for name in free_variables(term)}
        missing = []
        for row in self.statics.bindings(variables, ()):
            bound = dict(zip(variables, row, strict=True))
            words = tuple(bound.get(each, each) for each in key(term))
            static = self.statics.values.get(term.head)
            if (static is not None and words[1:] not in static) or (
                static is None and words not in encoder.sets.values
            ):
                missing.append(row)
        ways = []
        if missing and variables:
            ways.append(listed(word(encoder.relation(missing)), *map(word, variables)))
        elif missing:
            ways.append(TRUE)
        if term.head in encoder.undefined:
            ways.append(self.fact(term, encoder.object_of(None)))
        self.atoms.append(disjunction(ways))

    def _inner(self, fill: Callable[[Scope], None]) -> Expression:
        """Return the condition that `fill` collects in a scope of its own, for some values of its variables."""
        inner = Scope(self.encoder, self.kinds, self.conditions, self.name, self.place, self)
        fill(inner)
        body = conjunction(inner.atoms)
        if not inner.variables or body == FALSE:
            return body
        kind = self.encoder.value_type
        words = (word(text) for name in inner.variables for text in (name, "-", kind))
        return listed(word("exists"), listed(*words), body)


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
    precondition += [
        scope.formula(each) for each in top
        if is_numeric(each) and each.head not in COMPLEMENT
        and not (each.head == "failed" and len(scope.failure(each.parts[1])) == 1)
    ]  # fmt: skip
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


def _growth(scope: Scope, change: Change, old: str) -> list[Expression]:
    """Return the effects of a growth, and require the relation of the old and the new value."""
    encoder, name = scope.encoder, change.term.head
    numbers = encoder.numbers[name]
    special = name in encoder.special

    def grown(number: Number, amount: Number, of: Fluent | None = None) -> Sequence[Number | Beyond]:
        return encoder.stored(number + amount, of, name)

    new = scope.fresh()
    if encoder.statics.is_static(change.amount):
        scope.related(
            change.amount, [old, new], [numbers], [name, name],
            lambda amount, number, of=None: grown(number, amount, of), change.term if special else None,
        )  # fmt: skip
    else:
        amount = scope.computed(change.amount)
        scope.related(
            word("0"), [old, amount, new], [numbers, amount.numbers], [name, None, name],
            lambda _, number, more, of=None: grown(number, more, of), change.term if special else None,
        )  # fmt: skip
    return [listed(word("not"), scope.fact(change.term, old)), scope.fact(change.term, new)]


def _assigned(scope: Scope, change: Change) -> str:
    """Return the variable for the new value of an assignment that reads changing numbers."""
    encoder, name = scope.encoder, change.term.head
    value = scope.computed(change.amount)
    special = name in encoder.special
    common = {encoder.saturations.get(fluent) for fluent in encoder.fluents[name]}

    def stored(number: Number, of: Fluent | None = None) -> Sequence[Number | Beyond]:
        return encoder.stored(number, of, name)

    plain = change.amount.head not in OPERATIONS and change.amount.head not in encoder.undefined
    if plain and not special and common == {None} and value.numbers <= encoder.numbers[name]:
        return value.variable
    new = scope.fresh()
    source = change.amount.head if change.amount.head in encoder.names else None
    if special:
        scope.related(
            word("0"), [value, new], [value.numbers], [None if source == name else source, name],
            lambda _, number, of: stored(number, of), change.term,
        )  # fmt: skip
    else:
        scope.related(
            word("0"), [value, new], [value.numbers], [source, name], lambda _, number: stored(number)
        )  # fmt: skip
    return new


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
    words = (word(text) for name, kind in every.items() for text in (name, "-", kind))
    both = listed(word("and"), listed(word("not"), before), after)
    return listed(
        word("forall"), listed(*words), listed(word("when"), conjunction((condition, before)), both)
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
            return _replacement(scope, _under(change, condition), new)
        return [_any_old(scope, change, change.variables, condition, scope.fact(change.term, new))]
    where = inner if change.variables else scope
    variable = where.fresh()

    where.related(
        change.amount, [variable], [], [name], lambda number, of=None: encoder.stored(number, of, name),
        change.term if special else None,
    )  # fmt: skip
    if not change.variables:
        return _replacement(scope, _under(change, condition), variable)
    more = dict.fromkeys(inner.variables, encoder.value_type)
    whole = conjunction([condition, *inner.atoms])
    return [_any_old(scope, change, {**change.variables, **more}, whole, scope.fact(change.term, variable))]


def _under(change: Change, condition: Expression) -> Change:
    return Change(change.variables, condition, change.term, change.amount, change.grows, change.place)


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
        words = (word(text) for name, kind in literal.variables.items() for text in (name, "-", kind))
        effect = listed(word("forall"), listed(*words), effect)
    return effect


def _costs(scope: Scope, costed: Costed) -> tuple[tuple[str, ...], dict[tuple[str, ...], Number]]:
    """Return the variables on which the cost of an action depends, and the costs for their objects."""
    cost, schema = costed.cost, costed.schema
    for what, expression in (("duration", schema.duration), ("cost", cost)):
        if expression is not None and scope.statics.is_static(expression):
            variables, rows = scope.static_rows(expression)
            for row, value in rows:
                if value < 0:
                    _negative(scope, what, dict(zip(variables, row, strict=True)), value)
            if variables and scope.rows(variables, ()) and len(rows) < len(scope.rows(variables, ())):
                scope.require((row for row, _ in rows), variables)
            elif not rows:
                return (), {}
            if what == "cost":
                return variables, dict(rows)
    sums = scope.computed(cost)
    if schema.duration is not None and not scope.statics.is_static(schema.duration):
        scope.compare(listed(word(">="), schema.duration, word("0")))
    numbers = {scope.encoder.object_of(number): number for number in sums.numbers}
    for number in sums.numbers:
        if number < 0:
            refuse(scope.encoder.file, schema.place, f"action '{schema.name}' may cost {as_shown(number)}; expected "
                   "costs of 0 or more for all values of its numbers")  # fmt: skip
    return (sums.variable,), {(name,): number for name, number in numbers.items()}


def _negative(scope: Scope, what: str, bound: Mapping[str, str], value: Number) -> None:
    """Refuse a negative duration or cost of an instance that may be applied."""
    everything = {name: kind for name, kind in scope.kinds.items() if not name.startswith("?value")}
    for row in scope.statics.bindings(everything, scope.conditions):
        whole = dict(zip(everything, row, strict=True))
        if all(whole[name] == bound[name] for name in bound):
            arguments = " ".join((scope.name, *whole.values()))
            refuse(scope.encoder.file, scope.place, f"({arguments}) has a {what} of {as_shown(value)}; expected "
                   f"a {what} of 0 or more")  # fmt: skip


def goal(encoder: Encoder, condition: Expression, place: Place) -> tuple[Expression, list[tuple[str, Expression]]]:
    """Return the goal, with derived predicates for comparisons that several values satisfy, and their conditions."""
    rules: list[tuple[str, Expression]] = []
    scope = Scope(encoder, {}, (), "", place)

    def encode(each: Expression) -> Expression:
        head, parts = each.head, each.parts[1:]
        if head in ("and", "or"):
            inner = map(encode, parts)
            return conjunction(inner) if head == "and" else disjunction(inner)
        if head not in COMPLEMENT and head != "failed":
            return each
        terms = {key(t): t for c in comparisons(each) for side in c.parts[1:] for t in terms_of(side)}
        if len(terms) == 1:
            from .value_sets import possible

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
        name = encoder.fresh(f"goal-{len(rules) + 1}")
        rules.append((name, scope.formula(each)))
        return listed(word(name))

    return encode(condition), rules


def value_symbol(encoder: Encoder, symbol: Symbol) -> Symbol:
    """Return the predicate of a function: its parameters, and the value."""
    names = [f"?x{number}" for number in range(len(symbol.parameters))]
    given = tuple(Typed(name, each.kinds, each.place) for name, each in zip(names, symbol.parameters, strict=True))
    value = Typed("?value", (encoder.value_type,), symbol.place)
    return Symbol(encoder.names[symbol.name], (*given, value), symbol.place)


def relation_symbols(encoder: Encoder, place: Place) -> list[Symbol]:
    """Return the predicates of the static relations."""
    return [
        Symbol(name, tuple(Typed(f"?x{number}", (OBJECT,), place) for number in range(size)), place)
        for name, size in encoder.arities.items()
    ]  # fmt: skip


__all__ = ["Encoder", "encoded", "free_variables", "goal"]
