"""The words of one encoding of numbers as facts, and the variables for values within one action or formula.

There are objects for values, predicates for functions, and static relations, which are required of variables.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path

from ..system.errors import UnsuitedError
from .declarations import OBJECT, Symbol, Typed, refuse, shown
from .expressions import (
    COMPLEMENT,
    FALSE,
    OPERATIONS,
    TRUE,
    ZERO,
    Number,
    applied,
    as_shown,
    compared,
    conjunction,
    disjunction,
    free_variables,
    is_numeric,
    joined,
    key,
    linear,
    listed,
    listing_of,
    terms_of,
    variables_of,
    word,
)
from .instances import Expression, Place
from .static_facts import LARGEST_JOIN, Statics, literal_number, relation
from .value_sets import Beyond, Fluent, Saturation, Value, ValueSets

MOST_ROWS = 300_000
"""Largest number of tuples of one static relation."""
MOST_TRIED = 5_000_000
"""Largest number of combinations of values that are tried for all relations of an instance, about ten seconds."""


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
    ) -> None:
        self.file = file
        self.statics = statics
        self.sets = sets
        self.saturations = saturations
        self.taken = set(taken)
        self.value_type = self.fresh("value-of-number")
        self.objects: dict[object, str] = {}
        self.shown: dict[str, str] = {}
        self.names = {name: self.fresh(f"is-{name}") for name in sorted(kept)}
        self.facts: dict[tuple[str, ...], None] = {}
        self.relations: dict[frozenset[tuple[str, ...]], str] = {}
        self.rows: dict[str, frozenset[tuple[str, ...]]] = {}
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
            self.rows[name] = found
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
        """Refuse what needs a relation of too many rows, or too many ways to satisfy conditions."""
        refuse(self.file, place, f"{what} compares or changes numbers in too many combinations of values; expected "
               "fewer comparisons, fewer terms in one expression, or fewer values")  # fmt: skip


def value_symbol(encoder: Encoder, symbol: Symbol) -> Symbol:
    """Return the predicate of a function: its parameters, and the value."""
    names = [f"?x{number}" for number in range(len(symbol.parameters))]
    given = tuple(Typed(name, each.kinds, each.place) for name, each in zip(names, symbol.parameters, strict=True))
    value = Typed("?value", (encoder.value_type,), symbol.place)
    return Symbol(encoder.names[symbol.name], (*given, value), symbol.place)


def relation_symbols(encoder: Encoder, place: Place) -> list[Symbol]:
    """Return the predicates of the static relations."""
    return [
        Symbol(name, tuple(Typed(f"?x{number}", (OBJECT,), place) for number in range(len(next(iter(rows))))), place)
        for name, rows in encoder.rows.items()
    ]  # fmt: skip


DIRECT_ROWS = 3_000
"""A relation with more tuples reads the value of a static expression as an object of its own."""


@dataclass(frozen=True)
class Sum:
    """A value that an action or a formula knows: its variable, the numbers that it may be, and whose number it is.

    The objects of the `function` stand for the numbers, if there is one.
    """

    variable: str
    numbers: frozenset[Number]
    function: str | None = None


Related = Callable[..., Sequence[Number | Beyond] | bool | None]
"""What numbers are related to: gets the value of a static expression, the numbers, and the fluent of a relation."""


class Scope:
    """The variables for values within one action, or within one formula of it."""

    def __init__(self, encoder: Encoder, kinds: Mapping[str, str], conditions: Sequence[Expression], name: str,
                 place: Place, outer: Scope | None = None) -> None:  # fmt: skip
        self.encoder = encoder
        self.statics = encoder.statics
        self.arguments = dict(kinds)
        self.kinds = dict(kinds)
        """Types of the arguments, and of variables that conditions quantify."""
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
        return self.statics.bindings(wanted, self.conditions, terms)

    def static_rows(
        self, expression: Expression, more: Iterable[str] = ()
    ) -> tuple[tuple[str, ...], list[tuple[tuple[str, ...], Number]]]:
        """Return the variables of a static expression, and its value for the objects for which it has one."""
        variables = tuple(dict.fromkeys([*free_variables(expression), *more]))
        found = []
        for bound in self.rows(variables, terms_of(expression)):
            try:
                value = self.statics.value(expression, bound)
            except ZeroDivisionError:
                self._zero(expression, bound)
                continue
            except ArithmeticError:
                continue
            found.append((tuple(bound[name] for name in variables), value))
        return variables, found

    def _zero(self, expression: Expression, bound: Mapping[str, str]) -> None:
        """Refuse a division by zero, if an instance of the action may be applied."""
        if (instance := self.instance(bound)) is not None:
            inner = [each for each in expression.walk() if each.head == "/" and self._fails(each, bound)][-1]
            for_them = f" for ({' '.join(instance)})" if instance else ""
            refuse(self.encoder.file, inner.place if inner.place.line else self.place,
                   f"action '{self.name}' divides by zero in '{shown(inner)}'{for_them}; expected a "
                   "divisor other than 0")  # fmt: skip

    def instance(self, bound: Mapping[str, str]) -> tuple[str, ...] | None:
        """Return the objects of an instance of the action with some objects, which its static conditions admit."""
        rows = self.statics.bindings(self.arguments, self.conditions)
        return next((tuple(row.values()) for row in rows if bound.items() <= row.items()), None)

    def _fails(self, expression: Expression, bound: Mapping[str, str]) -> bool:
        """Whether a static expression divides by zero."""
        try:
            self.statics.value(expression, bound)
        except ZeroDivisionError:
            return True
        except ArithmeticError:
            pass
        return False

    def measured(self, expression: Expression) -> Sum:
        """Return a variable for the value of a static expression."""
        variables, rows = self.static_rows(expression)
        variable = self.fresh()
        self.require(((*row, self.encoder.object_of(value)) for row, value in rows), (*variables, variable))
        return Sum(variable, frozenset(value for _, value in rows))

    def may_be(self, names: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> bool:
        """Whether variables may be some objects, as far as the single facts that are required tell."""
        if FALSE in self.atoms:
            return False
        found, waiting = set(rows), self._required(names)
        while waiting and found:
            columns, facts = nearest = min(waiting, key=lambda each: (-len(set(each[0]) & set(names)), len(each[1])))
            waiting.remove(nearest)
            shared = [name for name in columns if name in names]
            at, within = [names.index(name) for name in shared], [columns.index(name) for name in shared]
            index: dict[tuple[str, ...], list[tuple[str, ...]]] = defaultdict(list)
            for row in facts:
                index[tuple(row[n] for n in within)].append(row)
            needed = {name for each in waiting for name in each[0]}
            both = (*names, *columns)
            kept = [both.index(name) for name in dict.fromkeys(both) if name in needed]
            pairs = ((*old, *new) for old in found for new in index.get(tuple(old[n] for n in at), ()))
            found = {tuple(row[n] for n in kept) for row in pairs}
            names = tuple(both[n] for n in kept)
            if len(found) > LARGEST_JOIN:
                return True
        return bool(found)

    def _required(self, names: Iterable[str]) -> list[tuple[tuple[str, ...], set[tuple[str, ...]]]]:
        """Return the variables of each fact that is required, and the objects that they may be.

        The last ones are all parameters among these variables and the given ones.
        """
        encoder = self.encoder
        functions = {predicate: name for name, predicate in encoder.names.items()}
        found = []
        for atom in self.atoms:
            if atom.head in functions:
                fluents = encoder.fluents[functions[atom.head]]
                rows = [(*f[1:], encoder.object_of(value, f)) for f in fluents for value in encoder.sets.values[f]]
                found.append(relation(atom, rows, free_variables(atom)))
            elif atom.head in encoder.rows:
                found.append(relation(atom, encoder.rows[atom.head], free_variables(atom)))
        every = dict.fromkeys([*names, *(name for columns, _ in found for name in columns)])
        own = tuple(name for name in every if name in self.kinds)
        with suppress(UnsuitedError):
            found.append((own, {tuple(row.values()) for row in self.rows(own, ())}))
        return found

    def related(
        self, static: Expression, values: Sequence[Sum], holds: Related, fluent: Expression | None = None
    ) -> None:
        """Require that the value of a static expression and numbers are related.

        A `fluent` is the one for which the relation is made, where its numbers are different ones for different
        objects.
        """
        self._require_related(static, values, holds, None, fluent)

    def result(
        self, static: Expression, values: Sequence[Sum], holds: Related, function: str | None = None,
        fluent: Expression | None = None,
    ) -> Sum:  # fmt: skip
        """Return a variable for the number, of a function, to which a static expression and numbers are related."""
        result = Sum(self.fresh(), frozenset(), function)
        return replace(result, numbers=self._require_related(static, values, holds, result, fluent))

    def _require_related(
        self, static: Expression, values: Sequence[Sum], holds: Related, result: Sum | None, fluent: Expression | None
    ) -> frozenset[Number]:
        """Require a relation, and return the numbers of its result."""
        encoder = self.encoder
        columns, static_rows = self.static_rows(static, () if fluent is None else free_variables(fluent))
        size = prod(max(len(each.numbers), 1) for each in values)
        if columns and fluent is None and size <= MOST_ROWS and size * len(static_rows) > DIRECT_ROWS:
            measure = self.measured(static)
            columns = (measure.variable,)
            static_rows = [((encoder.object_of(value),), value) for value in sorted(measure.numbers)]
        encoder.tried += size * len(static_rows)
        if size > MOST_ROWS or size * len(static_rows) > MOST_ROWS or encoder.tried > MOST_TRIED:
            encoder.too_many(self.place, f"action '{self.name}'" if self.name else "a condition")
        rows: list[tuple[str, ...]] = []
        found: set[Number] = set()
        for row, value in static_rows:
            of = None if fluent is None else key(fluent, dict(zip(columns, row, strict=True)))
            pools: list[Iterable[Number]] = [each.numbers for each in values]
            if of is not None and values and values[0].function == of[0]:
                pools[0] = [number for number in pools[0] if number in encoder.sets.values.get(of, ())]
            for numbers in itertools.product(*pools):
                related = holds(value, *numbers, of)
                words = [
                    self._object(each.function, number, None if place else of)
                    for place, (each, number) in enumerate(zip(values, numbers, strict=True))
                ]
                if result is None:
                    rows += [(*row, *words)] if related else []
                    continue
                assert not isinstance(related, bool)
                for after in related or ():
                    if isinstance(after, Beyond):
                        rows.append((*row, *words, encoder.beyond()))
                    else:
                        found.add(after)
                        rows.append((*row, *words, self._object(result.function, after, of)))
        variables = [each.variable for each in (*values, *([] if result is None else [result]))]
        if columns or variables or not rows:
            self.require(rows, (*columns, *variables))
        return frozenset(found)

    def _object(self, name: str | None, value: Number, of: Fluent | None) -> str:
        if name is None or (of is not None and of[0] == name):
            return self.encoder.object_of(value, of if name is not None else None)
        return self.encoder.fluent_object(name, value)

    def computed(self, expression: Expression) -> Sum:
        """Return a variable for the value of an expression that reads changing numbers."""
        if expression.head not in OPERATIONS:
            return Sum(self.value_of(expression), self.encoder.numbers[expression.head], expression.head)
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
            return self.result(rest, [found], lambda value, number, _: [number + value])
        sides = expression.parts[1:]
        if expression.head == "-" and len(sides) == 1:
            return self.result(ZERO, [self.computed(sides[0])], lambda _, number, _of: [-number])
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
            return self.result(left, [self.computed(right)], lambda value, number, _: result(value, number))
        if self.statics.is_static(right):
            return self.result(right, [left], lambda value, number, _: result(number, value))
        return self.result(ZERO, [left, self.computed(right)], lambda _, one, other, _of: result(one, other))

    def _scaled(self, term: Expression, factor: Number) -> Sum:
        own = self.computed(term)
        return own if factor == 1 else self.result(ZERO, [own], lambda _, number, _of: [number * factor])

    def _accumulated(self, found: Sum, term: Expression, factor: Number) -> Sum:
        return self.result(ZERO, [found, self.computed(term)], lambda _, one, other, _of: [one + other * factor])

    def compare(self, comparison: Expression) -> None:
        """Require that a comparison is satisfied."""
        head, (left, right) = comparison.head, comparison.parts[1:]
        split = linear(listed(word("-"), left, right), self.statics.is_static)
        if split is None and self.statics.is_static(left):
            self.related(left, [self.computed(right)], lambda value, number, _: compared(head, value, number))
            return
        if split is None and self.statics.is_static(right):
            self.related(right, [self.computed(left)], lambda value, number, _: compared(head, number, value))
            return
        if split is None:
            both = [self.computed(left), self.computed(right)]
            self.related(ZERO, both, lambda _, one, other, _of: compared(head, one, other))
            return
        terms, rest = split
        if not terms:
            self._compare_static(comparison, rest)
            return
        listing = list(terms.values())
        term, factor = listing[-1]
        if len(listing) == 1:
            fluent = term if term.head in self.encoder.special else None
            self.related(rest, [self.computed(term)], lambda s, v, _: compared(head, factor * v + s, 0), fluent)
            return
        if self._share(head, listing, rest):
            return
        found = self._scaled(*listing[0])
        for each, by in listing[1:-1]:
            found = self._accumulated(found, each, by)
        if literal_number(rest) is None:
            found = self._accumulated(found, term, factor)
            self.related(rest, [found], lambda s, v, _: compared(head, v + s, 0))
        else:
            both = [found, self.computed(term)]
            self.related(rest, both, lambda s, one, other, _: compared(head, one + factor * other + s, 0))

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
            return joined(head, map(self.formula, parts))
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
            found += [
                listed(word("undefined"), term) for term in terms_of(side)
                if term.head in self.encoder.undefined or self.missing(term)
            ]  # fmt: skip
            for each in side.walk():
                if each.head == "/":
                    zero = (listed(word("=="), divisor, word("0")) for divisor in each.parts[2:])
                    found += [one for one in zero if not self.statics.is_static(one.parts[1])]
        return found

    def missing(self, term: Expression) -> list[tuple[str, ...]]:
        """Return the objects for the variables of a term for which it is no fluent, and has no static value."""
        encoder, static = self.encoder, self.statics.values.get(term.head)
        known = encoder.sets.values.keys() if static is None else {(term.head, *row) for row in static}
        rows = self.statics.bindings({name: self.kinds[name] for name in free_variables(term)}, ())
        return [tuple(row.values()) for row in rows if key(term, row) not in known]

    def has_no_value(self, term: Expression) -> None:
        """Require that a term has no value."""
        missing, variables, ways = self.missing(term), free_variables(term), list[Expression]()
        if missing and variables:
            ways.append(listed(word(self.encoder.relation(missing)), *map(word, variables)))
        elif missing:
            ways.append(TRUE)
        if term.head in self.encoder.undefined:
            ways.append(self.fact(term, self.encoder.object_of(None)))
        self.atoms.append(disjunction(ways))

    def _inner(self, fill: Callable[[Scope], None]) -> Expression:
        """Return the condition that `fill` collects in a scope of its own, for some values of its variables."""
        inner = Scope(self.encoder, self.kinds, self.conditions, self.name, self.place, self)
        fill(inner)
        body = conjunction(inner.atoms)
        if not inner.variables or body == FALSE:
            return body
        return listed(word("exists"), listing_of(dict.fromkeys(inner.variables, self.encoder.value_type)), body)
