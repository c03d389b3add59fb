"""The words of one encoding of numbers as facts, and the variables for values within one action or formula.

There are objects for values, predicates for functions, and static relations, which are required of variables.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ..system.errors import UnsuitedError
from .declarations import OBJECT, Symbol, Typed, refuse, shown
from .durative import key
from .expressions import (
    COMPLEMENT,
    FALSE,
    OPERATIONS,
    TRUE,
    Number,
    applied,
    as_shown,
    compared,
    conjunction,
    disjunction,
    free_variables,
    is_numeric,
    linear,
    listed,
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
        """Refuse a relation with more than `MOST_ROWS` rows."""
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
    """A value that an action or a formula knows: its variable, and the numbers that it may be."""

    variable: str
    numbers: frozenset[Number]


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
            except ZeroDivisionError:
                self._zero(expression, bound)
                continue
            except ArithmeticError:
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
                inner = [each for each in expression.walk() if each.head == "/" and self._fails(each, bound)][-1]
                for_them = f" for ({arguments})" if arguments else ""
                refuse(self.encoder.file, inner.place if inner.place.line else self.place,
                       f"action '{self.name}' divides by zero in '{shown(inner)}'{for_them}; expected a "
                       "divisor other than 0")  # fmt: skip

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
                elif term.head in self.encoder.undefined or self.lacks_fluents(term):
                    found.append(listed(word("undefined"), term))
            for each in side.walk():
                if each.head == "/":
                    zero = (listed(word("=="), divisor, word("0")) for divisor in each.parts[2:])
                    found += [one for one in zero if not self.statics.is_static(one.parts[1])]
        return found

    def _is_partial(self, term: Expression) -> bool:
        values = self.statics.values[term.head]
        variables = {name: self.kinds[name] for name in free_variables(term)}
        return any(
            tuple(dict(zip(variables, row, strict=True)).get(each, each) for each in key(term)[1:]) not in values
            for row in self.statics.bindings(variables, ())
        )

    def lacks_fluents(self, term: Expression) -> bool:
        """Return whether a term is no fluent for some objects."""
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
