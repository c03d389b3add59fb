"""The actions of an instance in a form of which numbers can be compiled away, one schema at a time.

Functions that nothing reads are left out, and those that only the metric reads become costs. Changes within
`(forall ...)` are written out for the objects. Where two terms of one function may be the same, and both are changed,
there is one schema in which they are, and one in which they are not; likewise for the condition of a growth.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ..system.errors import UnsuitedError
from . import timed_schemas
from .conditions import (
    FALSE,
    TRUE,
    compared_terms,
    conjunction,
    conjuncts,
    exclude,
    free_variables,
    unsatisfied,
)  # fmt: skip
from .declarations import refuse
from .durative import Schema, bound_in, key, merged, total, unified
from .formulas import listed, word
from .instances import Expression
from .metric import Metric
from .numeric_expressions import Number, terms_of, word_of
from .reader import Reading
from .static_facts import Statics, literal_number
from .timed_schemas import END, START, Change, TimedSchema, growth

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
            for started in self._started(timed):
                for variant in self._distinct(started):
                    decided = self._decided(merged(self.file, variant, self.derived))
                    found += [self._costed(each) for each in decided if each.precondition != FALSE]
        except UnsuitedError:
            refuse(self.file, timed.place, f"action '{timed.name}' has too many combinations of objects in conditions "
                   "or changes of numbers; expected fewer objects, or fewer terms in one action")  # fmt: skip
        if len(found) > MOST_VARIANTS:
            self._too_many(timed)
        return found

    def _too_many(self, timed: TimedSchema) -> None:
        refuse(
            self.file, timed.place, f"action '{timed.name}' has more than {MOST_VARIANTS} forms, since its conditional "
            "changes of numbers, or its terms that may be the same, combine; expected fewer of them in one action",
        )  # fmt: skip

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
            for row in rows:
                bound = dict(zip(change.variables, row, strict=True))
                each = timed_schemas.renamed(change, bound)
                condition = self.statics.simplified(each.condition, {})
                changes.append((time, self.statics.simplified(before, bound), replace(each, condition=condition)))
        return replace(timed, changes=tuple(changes))

    def _distinct(self, timed: TimedSchema) -> Iterator[TimedSchema]:
        """Yield schemas in which two terms that matter are alike in name, or never the same."""
        waiting, made = [timed], 0
        while waiting:
            schema = waiting.pop()
            pair = self._doubtful(schema)
            if pair is None:
                made += 1
                if made > MOST_VARIANTS:
                    self._too_many(timed)
                yield schema
                continue
            waiting.append(schema.with_condition(unsatisfied(pair)))
            equal = schema.with_condition(pair)
            for equality in conjuncts(pair):
                one, other = equality.parts[1].word, equality.parts[2].word
                bound = {one: other} if one.startswith("?") else {other: one}
                equal = bound_in(equal, bound)
            waiting.append(equal)

    def _doubtful(self, schema: TimedSchema) -> Expression | None:
        """Return the condition that two terms of a schema are the same, where that is not known and matters."""
        known = {str(each) for time, condition in schema.conditions if time == START for each in conjuncts(condition)}
        kinds = {each.name: each.kinds for each in schema.parameters}
        for number, (time, _, change) in enumerate(schema.changes):
            if change.variables:
                continue
            adds = change.term.head in self.roles.costs and change.grows  # which of them grows does not matter
            others = [other.term for _, _, other in schema.changes[number + 1 :] if not (adds and other.grows)]
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
    def _started(timed: TimedSchema) -> Iterator[TimedSchema]:
        """Yield schemas in which the changes at the start of a durative action have no conditions."""
        waiting = [timed]
        while waiting:
            schema = waiting.pop()
            conditions = [
                conjunction((before, change.condition)) for time, before, change in schema.changes
                if schema.durations is not None and time == START and not change.variables
            ]  # fmt: skip
            condition = next((each for each in conditions if each != TRUE), None)
            if condition is None:
                yield schema
                continue
            alike = [
                time == START and str(conjunction((before, change.condition))) == str(condition)
                for time, before, change in schema.changes
            ]  # fmt: skip
            both = list(zip(alike, schema.changes, strict=True))
            true = tuple(
                (time, TRUE, replace(change, condition=TRUE)) if same else (time, before, change)
                for same, (time, before, change) in both
            )
            false = tuple(each for same, each in both if not same)
            if len(waiting) > MOST_VARIANTS:
                raise UnsuitedError
            waiting.append(replace(schema.with_condition(unsatisfied(condition)), changes=false))
            waiting.append(replace(schema.with_condition(condition), changes=true))

    def _decided(self, schema: Schema) -> Iterator[Schema]:
        """Yield schemas without conditional changes, apart from assignments of static values."""
        waiting, made = [schema], 0
        while waiting:
            each = waiting.pop()
            doubtful = next((change for change in each.changes if self._must_be_decided(change)), None)
            if doubtful is None:
                made += 1
                if made > MOST_VARIANTS:
                    raise UnsuitedError
                yield replace(each, changes=tuple(map(_grown, self._summed(each.changes))))
                continue
            condition = doubtful.condition
            alike = [str(change.condition) == str(condition) for change in each.changes]
            with_it = tuple(
                replace(change, condition=TRUE) if same else change
                for same, change in zip(alike, each.changes, strict=True)
                if not exclude(condition, change.condition)
            )
            without = tuple(change for same, change in zip(alike, each.changes, strict=True) if not same)
            waiting.append(self._under(each, unsatisfied(condition), without))
            waiting.append(self._under(each, condition, with_it))

    def _under(self, schema: Schema, condition: Expression, changes: tuple[Change, ...]) -> Schema:
        """Return a schema with one more condition, and other changes."""
        return replace(schema, precondition=conjunction((schema.precondition, condition)), changes=changes)

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
