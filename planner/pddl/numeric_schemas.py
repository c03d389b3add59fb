"""The actions of an instance in a form of which numbers can be compiled away, one schema at a time, and their costs.

Functions that nothing reads are left out, and those that only the metric reads become costs. Changes within
`(forall ...)` are written out for the objects. Where two terms of one function may be the same, and both are changed,
there is one schema in which they are, and one in which they are not; likewise for the condition of a growth.

Without a metric, the cost is the sum of durations in a domain with durative actions, where an action without a duration
costs 1; elsewhere each action costs 1. A metric is a linear expression of `(total-time)`, `(total-cost)` and functions
that only grow, with weights of 0 or more. The values with which these begin are constants, and no part of the cost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from math import lcm
from pathlib import Path
from typing import NoReturn, TypeVar

from ..system.errors import UnsuitedError
from .declarations import refuse, shown
from .durative import END, START, Change, Schema, TimedSchema, bound_in, growth, merged, renamed, total, unified
from .expressions import (
    FALSE,
    TRUE,
    Number,
    applied,
    compared_terms,
    conjunction,
    conjuncts,
    exclude,
    free_variables,
    key,
    listed,
    number,
    terms_of,
    unsatisfied,
    word,
    word_of,
)
from .instances import Expression
from .reader import DurativeAction, Reading
from .static_facts import Statics, literal_number

TIME = "total-time"
COST = "total-cost"


@dataclass(frozen=True)
class Metric:
    """What is minimized.

    `plain` is the cost of an action without a duration, apart from what it changes; `time` is the weight of durations;
    `weights` are those of functions with their arguments. `notes` say what was assumed.
    """

    plain: Number
    time: Number
    weights: Mapping[tuple[str, ...], Number]
    notes: tuple[str, ...] = ()

    @property
    def functions(self) -> frozenset[str]:
        """The functions that matter."""
        return frozenset(name for name, *_ in self.weights)


def metric_of(reading: Reading, changing: frozenset[str]) -> Metric:
    """Return what a reading's problem minimizes; `changing` are the functions that an action changes."""
    durative = any(isinstance(each, DurativeAction) for each in reading.domain.entries)
    ignored = COST in changing
    if reading.problem.metric is None:
        costs = "; the declared costs of actions are ignored, since there is no metric" if ignored else ""
        if durative:
            return Metric(1, 1, {}, (f"no metric: the cost is the sum of durations{costs}",))
        return Metric(1, 0, {}, (f"no metric: each action costs 1{costs}",) if ignored else ())
    expression = reading.problem.minimized
    if expression is None:
        return Metric(0, 0, {(COST,): 1})
    time: Number = 0
    weights: dict[tuple[str, ...], Number] = {}
    for term, weight in _linear(reading, expression, changing).items():
        if term == ("",):
            continue
        if weight < 0:
            refuse(reading.instance.problem, expression, f"the metric subtracts '({' '.join(term)})'; expected weights "
                   "of 0 or more, since costs are minimized")  # fmt: skip
        if term == (TIME,) and TIME not in changing:
            time = weight
        elif term[0] in changing and weight:
            weights[term] = weight
    if time and not durative:
        notes = ("no durative actions: each action takes a time of 1",)
        return Metric(time, 0, weights, notes)
    return Metric(0, time, weights)


def _linear(reading: Reading, expression: Expression, changing: frozenset[str]) -> dict[tuple[str, ...], Number]:
    """Return the weights of the changing terms of an expression; that of the key `("",)` is its constant."""
    if (literal := number(expression.word)) is not None:
        return {("",): literal}
    head, parts = expression.head, expression.parts[1:]
    if head not in ("+", "-", "*", "/"):
        term = tuple(part.word for part in expression.parts)
        if head in changing or term in ((TIME,), (COST,)):
            return {term: 1}
        if term not in reading.problem.values:
            refuse(reading.instance.problem, expression, f"the metric reads '{expression}', which has no value and "
                   "which no action changes; expected a value in (:init ...)")  # fmt: skip
        return {("",): reading.problem.values[term]}
    sides = [_linear(reading, part, changing) for part in parts]
    if head == "+":
        return _sum(sides)
    if head == "-":
        minus = [{term: -weight for term, weight in side.items()} for side in sides]
        return _sum(minus if len(sides) == 1 else [sides[0], *minus[1:]])
    factors = [side for side in sides if set(side) <= {("",)}]
    varying = [side for side in sides if not set(side) <= {("",)}]
    if len(varying) > 1 or (head == "/" and sides[0] not in varying and varying):
        refuse(reading.instance.problem, expression, f"the metric is not linear: {shown(expression)}; expected a sum "
               "of functions with constant weights")  # fmt: skip
    if head == "/" and not factors[-1].get(("",), 0):
        refuse(reading.instance.problem, expression, f"the metric divides by zero: {shown(expression)}")
    base = varying[0] if varying else factors.pop(0)
    factor = applied(head, [1, *(side.get(("",), 0) for side in factors)])
    return {term: applied("*", [weight, factor]) for term, weight in base.items()}


def _sum(sides: Iterable[Mapping[tuple[str, ...], Number]]) -> dict[tuple[str, ...], Number]:
    found: dict[tuple[str, ...], Number] = {}
    for side in sides:
        for term, weight in side.items():
            found[term] = found.get(term, 0) + weight
    return found


def unit_of(costs: Iterable[Number]) -> Fraction:
    """Return the unit in which all costs are whole numbers: one by their least common denominator."""
    return Fraction(1, lcm(*{cost.denominator for cost in costs}))


T = TypeVar("T")

MOST_VARIANTS = 128
"""Largest number of schemas into which one action is divided."""
MOST_WRITTEN_OUT = 2_000
"""Largest number of objects for which one change is written out."""


@dataclass(frozen=True)
class Roles:
    """What the functions that change are for.

    Attributes
    ----------
    kept, costs, dead : frozenset of str
        Functions that a condition, an effect or a duration reads; those that only the metric reads; and those that
        nothing reads.
    """

    kept: frozenset[str]
    costs: frozenset[str]
    dead: frozenset[str]


def changing(timed: Iterable[TimedSchema]) -> frozenset[str]:
    """Return the functions that an action changes."""
    return frozenset(change.term.head for schema in timed for _, _, change in schema.changes)


def roles(
    timed: Iterable[TimedSchema], goal: Expression, rules: Iterable[Expression], metric: Metric
) -> Roles:  # fmt: skip
    """Return the roles of the functions that change."""
    every = changing(timed)
    read: set[str] = set()

    def add(condition: Expression) -> None:
        read.update(term.head for term in compared_terms(condition))

    for condition in (goal, *rules):
        add(condition)
    for schema in timed:
        for _, condition in schema.conditions:
            add(condition)
        for _, before, literal in schema.literals:
            add(before)
            add(literal.condition)
        for _, _, amount in schema.durations or ():
            read.update(term.head for term in terms_of(amount))
    before_size = -1
    while before_size != len(read):
        before_size = len(read)
        for schema in timed:
            for _, before, change in schema.changes:
                name = change.term.head
                if name in read or name in metric.functions:
                    add(before)
                    add(change.condition)
                    amount = (None if change.grows else growth(change.term, change.amount)) or change.amount
                    read.update(t.head for t in terms_of(amount) if t.head != name or name in metric.functions)
    kept = every & read
    return Roles(kept, (every & metric.functions) - kept, every - kept - metric.functions)


@dataclass(frozen=True)
class Costed:
    """A schema with its cost in the unit of the file."""

    schema: Schema
    cost: Expression


class Preparation:
    """The steps from an action of the file to schemas for compilation."""

    def __init__(
        self,
        reading: Reading,
        statics: Statics,
        found: Roles,
        metric: Metric,
        derived: Mapping[str, frozenset[str]],
    ) -> None:
        self.file: Path = reading.instance.domain
        self.statics = statics
        self.roles = found
        self.metric = metric
        self.derived = derived
        self.changing = found.kept | found.costs | found.dead

    def prepared(self, timed: TimedSchema) -> list[Costed]:
        """Return the schemas of an action with their costs. Together they are applicable where the action is."""
        timed = self._without_dead(timed)
        found = []
        try:
            timed = self._written_out(timed).mapped(self.statics.expanded)
            for started in self._divided(timed, timed, self._by_change_at_start):
                for variant in self._divided(timed, started, self._by_equality):
                    decided = self._divided(timed, merged(self.file, variant, self.derived), self._by_condition)
                    found += [self._costed(each) for each in decided if each.precondition != FALSE]
        except UnsuitedError:
            refuse(self.file, timed.place, f"action '{timed.name}' has too many combinations of objects in conditions "
                   "or changes of numbers; expected fewer objects, or fewer terms in one action")  # fmt: skip
        if len(found) > MOST_VARIANTS:
            self._too_many(timed)
        return found

    def _too_many(self, timed: TimedSchema) -> NoReturn:
        refuse(
            self.file, timed.place, f"action '{timed.name}' has more than {MOST_VARIANTS} forms, since its conditional "
            "changes of numbers, or its terms that may be the same, combine; expected fewer of them in one action",
        )  # fmt: skip

    def _divided(self, timed: TimedSchema, first: T, division: Callable[[T], tuple[T, T] | None]) -> list[T]:
        """Return the forms of an action, each of which is divided as long as `division` returns two of it."""
        waiting, found = [first], list[T]()
        while waiting:
            each = waiting.pop()
            both = division(each)
            waiting += both or ()
            found += [each] if both is None else []
            if len(found) > MOST_VARIANTS:
                self._too_many(timed)
        return found

    def _without_dead(self, timed: TimedSchema) -> TimedSchema:
        """Return the schema without changes of functions that nothing reads."""
        return replace(timed, changes=tuple(each for each in timed.changes if each[2].term.head not in self.roles.dead))

    def _written_out(self, timed: TimedSchema) -> TimedSchema:
        """Return the schema with changes for all objects written out, apart from plain assignments of static values."""
        changes: list[tuple[str, Expression, Change]] = []
        heads = [change.term.head for _, _, change in timed.changes]
        for time, before, change in timed.changes:
            if not change.variables:
                changes.append((time, before, change))
                continue
            simple = (
                not change.grows and literal_number(change.amount) is not None and heads.count(change.term.head) == 1
                and change.term.head not in self.metric.functions
            )  # fmt: skip
            if simple and (timed.durations is None or time == END):
                changes.append((time, before, change))
                continue
            rows = self.statics.bindings(change.variables, [*conjuncts(before), *conjuncts(change.condition)])
            if len(rows) > MOST_WRITTEN_OUT:
                raise UnsuitedError
            for bound in rows:
                each = renamed(change, bound)
                condition = self.statics.simplified(each.condition, {})
                changes.append((time, self.statics.simplified(before, bound), replace(each, condition=condition)))
        return replace(timed, changes=tuple(changes))

    def _by_equality(self, schema: TimedSchema) -> tuple[TimedSchema, TimedSchema] | None:
        """Return schemas in which two terms that matter are never the same, and alike in name."""
        pair = self._doubtful(schema)
        if pair is None:
            return None
        equal = schema.with_condition(pair)
        for equality in conjuncts(pair):
            one, other = equality.parts[1].word, equality.parts[2].word
            equal = bound_in(equal, {one: other} if one.startswith("?") else {other: one})
        return schema.with_condition(unsatisfied(pair)), equal

    def _doubtful(self, schema: TimedSchema) -> Expression | None:
        """Return the condition that two terms of a schema are the same, where that is not known and matters."""
        known = {str(each) for time, condition in schema.conditions if time == START for each in conjuncts(condition)}
        kinds = {each.name: each.kinds for each in schema.parameters}
        for place, (time, _, change) in enumerate(schema.changes):
            if change.variables:
                continue
            adds = change.term.head in self.roles.costs and change.grows  # which of them grows does not matter
            others = [other.term for _, _, other in schema.changes[place + 1 :] if not (adds and other.grows)]
            if time == START and schema.durations is not None:
                others += self._later_terms(schema)
            for other in others:
                if other.head != change.term.head or key(other) == key(change.term):
                    continue
                condition = unified(change, other)
                if condition is None or str(unsatisfied(condition)) in known:
                    continue
                if any(str(unsatisfied(each)) in known or self._apart(each, kinds) for each in conjuncts(condition)):
                    continue
                if free_variables(condition).keys() <= kinds.keys():
                    return condition
        return None

    def _apart(self, equality: Expression, kinds: dict[str, tuple[str, ...]]) -> bool:
        """Whether the two sides of an equality have types without common objects."""
        sets = []
        for part in equality.parts[1:]:
            if part.word in kinds:
                sets.append({name for kind in kinds[part.word] for name in self.statics.of_kind(kind)})
            else:
                sets.append({part.word})
        return sets[0].isdisjoint(sets[1])

    @staticmethod
    def _later_terms(schema: TimedSchema) -> list[Expression]:
        found = []
        for time, condition in schema.conditions:
            if time != START:
                found += compared_terms(condition)
        for time, _, literal in schema.literals:
            if time == END:
                found += compared_terms(literal.condition)
        for time, _, change in schema.changes:
            if time == END:
                found += [change.term, *terms_of(change.amount), *compared_terms(change.condition)]
        return [term for term in found if not any(part.word == "" for part in term.parts)]

    @staticmethod
    def _by_change_at_start(schema: TimedSchema) -> tuple[TimedSchema, TimedSchema] | None:
        """Return schemas of a durative action without and with a change at its start that has a condition."""
        conditions = [
            conjunction((before, change.condition)) if time == START and not change.variables else TRUE
            for time, before, change in schema.changes
        ]
        condition = next((each for each in conditions if each != TRUE), None)
        if condition is None or schema.durations is None:
            return None
        alike = [
            time == START and str(conjunction((before, change.condition))) == str(condition)
            for time, before, change in schema.changes
        ]
        both = list(zip(alike, schema.changes, strict=True))
        true = tuple(
            (time, TRUE, replace(change, condition=TRUE)) if same else (time, before, change)
            for same, (time, before, change) in both
        )
        return (
            replace(
                schema.with_condition(unsatisfied(condition)), changes=tuple(each for same, each in both if not same)
            ),
            replace(schema.with_condition(condition), changes=true),
        )

    def _by_condition(self, schema: Schema) -> tuple[Schema, Schema] | None:
        """Return schemas without and with a conditional change, apart from assignments of static values."""
        condition = next((change.condition for change in schema.changes if self._must_be_decided(change)), None)
        if condition is None:
            return None
        alike = [str(change.condition) == str(condition) for change in schema.changes]
        both = list(zip(alike, schema.changes, strict=True))
        with_it = tuple(
            replace(change, condition=TRUE) if same else change
            for same, change in both if not exclude(condition, change.condition)
        )  # fmt: skip
        without = tuple(change for same, change in both if not same)

        def under(one: Expression, changes: tuple[Change, ...]) -> Schema:
            return replace(schema, precondition=conjunction((schema.precondition, one)), changes=changes)

        return under(unsatisfied(condition), without), under(condition, with_it)

    def _must_be_decided(self, change: Change) -> bool:
        if change.condition == TRUE:
            return False
        return change.grows or change.term.head in self.metric.functions or not self.statics.is_static(change.amount)

    @staticmethod
    def _summed(changes: Iterable[Change]) -> Iterator[Change]:
        """Yield the changes, with one for all growths of a term."""
        groups: dict[tuple[object, ...], list[Change]] = {}
        for change in changes:
            kind = (key(change.term), tuple(change.variables), change.grows, str(change.condition))
            groups.setdefault(kind, []).append(change)
        for group in groups.values():
            if len(group) == 1 or not group[0].grows:
                yield from group
            else:
                yield replace(group[0], amount=total(each.amount for each in group))

    def _costed(self, schema: Schema) -> Costed:
        """Return a schema without changes that are only costs, with its cost."""
        schema = replace(schema, changes=tuple(map(_grown, self._summed(schema.changes))))
        parts: list[Expression] = []
        if schema.duration is not None:
            if self.metric.time:
                parts.append(_times(self.metric.time, schema.duration))
        elif self.metric.plain:
            parts.append(word_of(self.metric.plain))
        for change in schema.changes:
            if change.term.head not in self.metric.functions:
                continue
            if not change.grows:
                refuse(self.file, change.place, f"action '{schema.name}' assigns '{change.term}', which the metric "
                       "minimizes; expected that it only grows (increase)")  # fmt: skip
            literal = literal_number(change.amount)
            if literal is not None and literal < 0:
                refuse(self.file, change.place, f"action '{schema.name}' lets '{change.term}' fall, which the metric "
                       "minimizes; expected that it only grows (increase)")  # fmt: skip
            weights = {each[1:]: weight for each, weight in self.metric.weights.items() if each[0] == change.term.head}
            if () in weights:
                parts.append(_times(weights[()], change.amount))
            else:
                name = f"weight of {change.term.head}"
                self.statics.values.setdefault(name, dict(weights))
                table = self.statics.values[name]
                terms = change.term.parts[1:]
                if not any(part.word.startswith("?") for part in terms):
                    factor = table.get(tuple(part.word for part in terms), 0)
                    parts.append(_times(factor, change.amount))
                else:
                    parts.append(listed(word("*"), listed(word(name), *terms), change.amount))
        kept = tuple(change for change in schema.changes if change.term.head not in self.roles.costs)
        return Costed(replace(schema, changes=kept), total(parts))


def _grown(change: Change) -> Change:
    """Return a change, the only one of its term, as a growth if it is an assignment that is one."""
    more = None if change.grows else growth(change.term, change.amount)
    return change if more is None else replace(change, amount=more, grows=True)


def _times(weight: Number, amount: Expression) -> Expression:
    return amount if weight == 1 else listed(word("*"), word_of(weight), amount)
