"""The values that each number of an instance may have in a reachable state.

The sets are found by relaxed reachability: facts that actions change may hold or not, and a number keeps all values
that it ever had. The sets contain each value of a reachable state. A value outside of a proven range is not reachable,
and is left out. Where only thresholds of a number matter, values beyond the last of them are one.

Let a fluent f only grow (or be assigned), by amounts that do not read changing numbers, and let f be read only in
comparisons with static values. Let m be such that each of these comparisons has one truth value for all numbers of
[m, oo), or of (m, oo). Map each state to the one in which f is replaced by the class of its value, where all values of
that interval are one class. The map is a bisimulation: two states of one class satisfy the same conditions, since f
occurs only in comparisons, which agree within the interval; a growth by d >= 0 leads from the interval into itself, and
from equal values below it to equal values; an assignment does not read f. Costs do not read f. So the classes have the
same plans with the same costs as the states. Falling fluents are the mirror image.

Nothing is saturated that also moves the other way, or that another effect, a cost or a duration reads.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from enum import Enum
from fractions import Fraction
from typing import Any

from .durative import Schema
from .expressions import (
    COMPLEMENT,
    FALSE,
    OPERATIONS,
    Number,
    compared_terms,
    conjunction,
    conjuncts,
    disjunction,
    free_variables,
    is_numeric,
    isolated,
    key,
    number,
    terms_of,
    unsatisfied,
    variables_of,
    whole,
)
from .instances import Expression
from .numeric_schemas import Costed
from .static_facts import Statics, literal_number

Fluent = tuple[str, ...]
"""A function that changes, with its objects."""

Value = Number | None
"""A number, or None for a fluent that has no value."""


class Beyond(Enum):
    """The value of a fluent that has left its set of values."""

    BEYOND = "beyond"


MOST_STEPS = 2_000_000
"""Largest number of combinations of values that are computed; one with many conditions counts several times."""
LONGEST = 10**100
"""Values with a larger numerator or denominator are not kept: growth by factors makes thousands of digits."""
MOST_TOGETHER = 10_000
"""Largest number of combinations of values at which a condition on several numbers is used."""


@dataclass(frozen=True)
class Trial:
    """An attempt to do with few values of the functions for which no bound is proven.

    Attributes
    ----------
    values : int
        Largest number of values of a fluent of these functions: those that relaxed reachability finds first.
    known : mapping of Fluent to set of number, or None
        Numbers that fluents have in reachable states, once it is known that these states are all. Without it, another
        value is *beyond* the others, a value of its own with which nothing is known of the number.
    """

    values: int
    known: Mapping[Fluent, AbstractSet[Number]] | None = None

    def allows(self, fluent: Fluent, value: Value, before: int) -> bool:
        """Return whether a fluent has a value, apart from those with which it begins; it has so many already."""
        known = None if self.known is None else self.known.get(fluent)
        return before < self.values if known is None or value is None else value in known


@dataclass(frozen=True)
class GroundChange:
    """A change of one fluent with objects for its variables, under conditions that read numbers only."""

    schema: str
    fluent: Fluent
    amount: Expression
    grows: bool
    guard: Expression


@dataclass(frozen=True)
class Saturation:
    """The values of a fluent that are one: those above or below a threshold, and the threshold itself if `closed`."""

    above: bool
    threshold: Number
    closed: bool

    def normal(self, value: Number) -> Number:
        """Return the value that stands for a value."""
        beyond = value > self.threshold if self.above else value < self.threshold
        if not beyond:
            return value
        return self.threshold if self.closed else self.threshold + (1 if self.above else -1)

    def is_beyond(self, value: Value) -> bool:
        """Whether a normal value stands for several."""
        return value is not None and value == self.normal(self.threshold + (1 if self.above else -1))


@dataclass
class ValueSets:
    """The values of each fluent; `exceeded` are fluents of which different values have become one."""

    values: dict[Fluent, set[Value]]
    initial: dict[Fluent, Value] = field(default_factory=dict)
    """The values with which the fluents begin; like `values`, it has the values that stand for the others."""
    exceeded: set[Fluent] = field(default_factory=set)
    limited: set[Fluent] = field(default_factory=set)
    """Fluents of which a value outside of the proven range has been left out."""
    open: set[Fluent] = field(default_factory=set)
    """Fluents of which a value has been left out that may be reachable."""
    unbounded: Fluent | None = None
    """A fluent with more values than allowed, at which the search ended; the sets are not complete then."""
    costly: bool = False
    """Whether the search ended after `MOST_STEPS` combinations; the sets are not complete then."""


def ground_changes(statics: Statics, schema: Schema, kinds: Mapping[str, str]) -> list[GroundChange]:
    """Return the changes of a schema for all objects, as far as its numbers depend on them."""
    found: dict[tuple[Fluent, str, bool, str], GroundChange] = {}
    top = conjuncts(schema.precondition)
    for change in schema.changes:
        conditions = [*top, *conjuncts(change.condition)]
        scope = {**kinds, **change.variables}
        heads = {change.term.head, *(term.head for term in terms_of(change.amount) if term.head not in statics.values)}
        variables = dict.fromkeys([*free_variables(change.term), *free_variables(change.amount)])
        numeric = []
        for condition in conditions:
            if not is_numeric(condition):
                continue
            own = free_variables(condition)
            read = {term.head for term in compared_terms(condition)}
            if read & heads or own.keys() <= variables.keys():
                variables.update(own)
                numeric.append(condition)
        terms = [term for term in terms_of(change.amount) if term.head in statics.values]
        plain = [each for each in conditions if not is_numeric(each) or each.head in COMPLEMENT]
        for bound in statics.bindings({name: scope[name] for name in variables}, plain, terms):
            known = {str(statics.simplified(each, bound)) for each in conditions if each.head != "or"}
            guard = conjunction(_resolved(statics.simplified(each, bound), known) for each in numeric)
            if guard == FALSE:
                continue
            fluent = key(change.term, bound)
            try:
                amount = statics.evaluated(change.amount, bound)
            except ArithmeticError:
                continue
            one = GroundChange(schema.name, fluent, amount, change.grows, guard)
            found.setdefault((fluent, str(amount), change.grows, str(guard)), one)
    return list(found.values())


def _resolved(condition: Expression, known: set[str]) -> Expression:
    """Return a condition without the ways in which it cannot hold, given the texts of conditions that do hold."""
    if condition.head != "or":
        return condition
    return disjunction(part for part in condition.parts[1:] if str(unsatisfied(part)) not in known)


def possible(condition: Expression, known: Mapping[str, Value]) -> bool:
    """Whether a ground condition may be true; the values of some fluents are known, by their texts."""
    source = _Source({text: number for number, text in enumerate(known)})
    return bool(source.function(source.condition(condition))(tuple(known.values())))


class _Source:
    """Python text for conditions and numbers of ground fluents, whose values are in a tuple `v`."""

    def __init__(self, positions: Mapping[str, int]) -> None:
        self.positions = positions
        self.names: dict[str, object] = {"divided": _divided}

    def function(self, text: str) -> Callable[[tuple[Value, ...]], Any]:
        """Return the function of a text that this object has written."""
        function: Callable[[tuple[Value, ...]], Any] = eval(f"lambda v: {text}", self.names)
        return function

    def number(self, expression: Expression) -> str:
        """Return the text of a numeric expression."""
        if expression.word:
            value = number(expression.word)
            name = f"n{len(self.names)}"
            self.names[name] = value
            return name
        if expression.head not in OPERATIONS:
            return f"v[{self.positions[str(expression)]}]"
        parts = [self.number(part) for part in expression.parts[1:]]
        if expression.head == "-" and len(parts) == 1:
            return f"(-{parts[0]})"
        if expression.head == "/":
            return f"divided({', '.join(parts)})"
        return f"({f' {expression.head} '.join(parts)})"

    def condition(self, condition: Expression) -> str:
        """Return the text of a condition; what is not known may be true."""
        head, parts = condition.head, condition.parts[1:]
        if head in ("and", "or"):
            inner = [self.condition(part) for part in parts]
            return f"({f' {head} '.join(inner)})" if inner else str(head == "and")
        comparison = parts[0] if head == "failed" else condition
        if comparison.head not in COMPLEMENT:
            return "True"
        sides = comparison.parts[1:]
        terms = dict.fromkeys(str(term) for side in sides for term in terms_of(side))
        if not terms.keys() <= self.positions.keys():
            return "True"
        left, right = map(self.number, sides)
        known = "".join(f"v[{self.positions[text]}] is not None and " for text in terms)
        found = f"({known}{left} {comparison.head} {right})"
        if "divided" in found:  # a division by zero satisfies no comparison
            name = f"c{len(self.names)}"
            self.names[name] = _without_zero(self.function(found))
            found = f"{name}(v)"
        return f"(not {found})" if head == "failed" else found


def _divided(dividend: Number, divisor: Number) -> Number:
    return whole(Fraction(dividend) / divisor)


def _without_zero(function: Callable[[tuple[Value, ...]], Any]) -> Callable[[tuple[Value, ...]], Any]:
    def checked(values: tuple[Value, ...]) -> Any:
        try:
            return function(values)
        except ZeroDivisionError:
            return False

    return checked


class _Rule:
    """A change as a function of the values of the fluents that it reads."""

    def __init__(self, change: GroundChange, sizes: Mapping[Fluent, int], together: int) -> None:
        self.fluent = change.fluent
        own = [change.fluent] if change.grows else []
        needed = dict.fromkeys([*own, *map(key, terms_of(change.amount))])
        reads = dict(needed)
        guards: list[Expression] = []
        for guard in conjuncts(change.guard):
            inner = list(map(key, compared_terms(guard)))
            if not inner:
                continue
            guards.append(guard)
            more = dict.fromkeys([*reads, *inner])
            product = 1
            for each in more:
                product *= max(sizes.get(each, 1), 1)
            if (set(inner) & set(reads) and product <= together) or len(more) == 1:
                reads = more
        self.reads: tuple[Fluent, ...] = tuple(reads)
        self.work = 1 + len(guards) // 5
        source = _Source({f"({' '.join(each)})": number for number, each in enumerate(self.reads)})
        conditions = [f"v[{number}] is not None" for number in range(len(needed))]
        conditions += [source.condition(guard) for guard in guards]
        after = source.number(change.amount)
        after = f"v[0] + {after}" if change.grows else after
        allowed = " and ".join(conditions)
        self._function = source.function(f"{after} if {allowed} else None" if allowed else after)

    def result(self, values: tuple[Value, ...]) -> Number | None:
        """Return the value after the change, given those of the fluents that are read; None if it is not made."""
        try:
            found: Number | None = self._function(values)
        except ZeroDivisionError:
            return None
        return found


def computed(
    changes: Iterable[GroundChange],
    initial: Mapping[Fluent, Value],
    *,
    limit: int,
    saturations: Mapping[Fluent, Saturation],
    ranges: Mapping[Fluent, tuple[Number | None, Number | None]],
    together: int = MOST_TOGETHER,
    tried: Collection[str] = (),
    trial: Trial | None = None,
) -> ValueSets:
    """Return the values of all fluents.

    The search ends at a fluent with more than `limit` values, and after `MOST_STEPS` combinations. A condition on
    several fluents is used up to `together` combinations of their values. Fluents of the functions that are `tried`
    have the values of the `trial`, and those that are assigned or with which they begin.
    """
    changes = list(changes)
    begin = dict(initial)
    for change in changes:
        begin.setdefault(change.fluent, None)
    found = ValueSets({fluent: set() for fluent in begin})
    sizes = {fluent: min(limit, 50) for fluent in begin}
    rules = [_Rule(change, sizes, together) for change in changes]
    readers: dict[Fluent, list[_Rule]] = defaultdict(list)
    for rule in rules:
        for fluent in rule.reads:
            readers[fluent].append(rule)
    waiting: list[tuple[Fluent, Value]] = []
    steps = position = 0

    def normal(fluent: Fluent, value: Value) -> Value:
        """Return the value that stands for one with which a fluent begins, or which it gets."""
        saturation = saturations.get(fluent)
        if value is None or saturation is None:
            return value
        after = saturation.normal(value)
        if after != value:
            found.exceeded.add(fluent)
        return after

    def reached(fluent: Fluent, value: Value) -> None:
        if value is not None:
            low, high = ranges.get(fluent, (None, None))
            if (low is not None and value < low) or (high is not None and value > high):
                found.limited.add(fluent)
                return
        value = normal(fluent, value)
        if value not in found.values[fluent]:
            own = trial if position and fluent[0] in tried else None
            long = value is not None and max(abs(value.numerator), value.denominator) > LONGEST
            if long and own is None:
                found.unbounded = fluent
                return
            if own is not None and (long or not own.allows(fluent, value, len(found.values[fluent]))):
                found.limited.add(fluent)
                if own.known is None:
                    found.open.add(fluent)
                return
            found.values[fluent].add(value)
            if len(found.values[fluent]) > limit:
                found.unbounded = fluent
                return
            waiting.append((fluent, value))

    for fluent, value in begin.items():
        found.initial[fluent] = normal(fluent, value)
        if found.unbounded is None:
            reached(fluent, value)
    for rule in rules:
        if found.unbounded is None and not rule.reads and (after := rule.result(())) is not None:
            reached(rule.fluent, after)
    active: dict[Fluent, list[Value]] = defaultdict(list)
    while position < len(waiting):
        fluent, value = waiting[position]
        position += 1
        active[fluent].append(value)
        for rule in readers[fluent]:
            pools = [[value] if each == fluent else active[each] for each in rule.reads]
            for values in itertools.product(*pools):
                steps += rule.work
                if (after := rule.result(values)) is not None:
                    reached(rule.fluent, after)
                if found.unbounded is not None:
                    return found
            if steps > MOST_STEPS:
                found.costly = True
                return found
    return found


def initial_values(
    kept: Iterable[str], values: Mapping[tuple[str, ...], Number], more: Iterable[Fluent]
) -> dict[Fluent, Value]:
    """Return the values with which the fluents of functions begin; those of `more` have none where it is not given."""
    names = set(kept)
    found: dict[Fluent, Value] = {each: value for each, value in values.items() if each[0] in names}
    for fluent in more:
        found.setdefault(fluent, 0 if fluent == ("total-cost",) else None)
    return found


@dataclass(frozen=True)
class Read:
    """A comparison with the types of all variables in scope, and the conditions under which it matters."""

    comparison: Expression
    kinds: Mapping[str, str]
    conditions: tuple[Expression, ...] = ()


def reads(condition: Expression, kinds: Mapping[str, str], conditions: tuple[Expression, ...] = ()) -> Iterator[Read]:
    """Yield the comparisons within a condition."""
    head, parts = condition.head, condition.parts[1:]
    if head in COMPLEMENT:
        yield Read(condition, kinds, conditions)
    elif head in ("and", "or", "failed"):
        for part in parts:
            yield from reads(part, kinds, conditions)
    elif head in ("forall", "exists"):
        yield from reads(parts[1], {**kinds, **variables_of(parts[0])}, conditions)


def saturations(
    statics: Statics,
    kept: Iterable[str],
    costed: Iterable[Costed],
    compared: Iterable[Read],
    changes: Iterable[GroundChange],
    initial: Mapping[Fluent, Value],
) -> dict[Fluent, Saturation]:
    """Return the fluents that saturate.

    `compared` are all comparisons of the instance, `changes` all changes with objects for their variables.
    """
    ways: dict[str, set[bool]] = {name: set() for name in kept}  # whether amounts are positive
    excluded: set[str] = set()
    fluents: dict[str, set[Fluent]] = {name: set() for name in kept}
    for fluent in initial:
        fluents[fluent[0]].add(fluent)
    for change in changes:
        fluents[change.fluent[0]].add(change.fluent)
        if not change.grows:
            continue
        amount = literal_number(change.amount)
        if amount is None:
            excluded.add(change.fluent[0])
        elif amount:
            ways[change.fluent[0]].add(amount > 0)
    for each in costed:
        expressions = [change.amount for change in each.schema.changes]
        expressions += [each.cost, *([each.schema.duration] if each.schema.duration is not None else [])]
        excluded.update(term.head for expression in expressions for term in terms_of(expression))
    cuts: dict[str, list[tuple[Read, Expression, str, Expression, Number]]] = {name: [] for name in kept}
    for read in compared:
        found_term = isolated(read.comparison, statics.is_static)
        if found_term is None:
            excluded.update(term.head for side in read.comparison.parts[1:] for term in terms_of(side))
        elif found_term[3]:
            cuts[found_term[0].head].append((read, *found_term))
    found: dict[Fluent, Saturation] = {}
    for name, found_ways in ways.items():
        if name not in excluded and len(found_ways) == 1:
            above = found_ways == {True}
            limits = _limits(statics, cuts[name], fluents[name], above)
            for fluent in fluents[name]:
                begin = initial.get(fluent)
                found[fluent] = limits.get(fluent) or Saturation(above, 0 if begin is None else begin, True)
    return found


def _limits(
    statics: Statics,
    cuts: Iterable[tuple[Read, Expression, str, Expression, Number]],
    fluents: Iterable[Fluent],
    above: bool,
) -> dict[Fluent, Saturation]:
    """Return the interval of each fluent on which all comparisons are constant."""
    best: dict[Fluent, tuple[Number, int]] = {}
    sign = 1 if above else -1
    for read, term, head, rest, factor in cuts:
        closed = head in ((">=", "<") if above else ("<=", ">"))
        variables = {
            name: read.kinds[name] for name in dict.fromkeys([*free_variables(term), *free_variables(rest)])
        }  # fmt: skip
        for bound in statics.bindings(variables, read.conditions, terms_of(rest)):
            fluent = key(term, bound)
            try:
                threshold = whole(Fraction(-statics.value(rest, bound)) / factor)
            except ArithmeticError:
                continue
            cut = (sign * threshold, 0 if closed else 1)
            best[fluent] = max(best.get(fluent, cut), cut)
    return {
        fluent: Saturation(above, sign * cut, not is_open) for fluent, (cut, is_open) in best.items()
        if fluent in set(fluents)
    }  # fmt: skip
