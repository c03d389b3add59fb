"""Durative actions compiled away: each becomes one step of a person who does one action after the other.

Start effects turn the state s into s1 (deletions first, then additions); conditions `over all` and `at end` are those
of s1; end effects are made on s1. All of them are rewritten as conditions and effects in s (regression): a fact p holds
in s1 if the start adds it, or if it holds in s and the start does not delete it; variables of p and of the effect may
stand for the same object, which the new condition tests by equalities. A number read in s1 is the one after the start's
change of it; whether a term with a quantified variable is the changed one is tested by equalities, too.

In `(when (at start c) (at end e))`, c is read in s.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

from .conditions import (
    COMPLEMENT,
    FALSE,
    TRUE,
    changed,
    compared_terms,
    conjunction,
    disjunction,
    exclude,
    free_variables,
    quantified,
    same,
    substituted,
    unsatisfied,
)  # fmt: skip
from .declarations import Typed, refuse
from .formulas import listed, word
from .instances import Expression, Place
from .numeric_expressions import DURATION, OPERATIONS
from .timed_schemas import END, START, Change, Literal, TimedSchema, reads_duration

ZERO = word("0")


@dataclass(frozen=True)
class Schema:
    """An action in which nothing has a time. All conditions are in negation normal form (see `conditions`).

    `duration` is None for an action that takes no time.
    """

    name: str
    parameters: tuple[Typed, ...]
    precondition: Expression
    literals: tuple[Literal, ...]
    changes: tuple[Change, ...]
    duration: Expression | None
    place: Place


def key(term: Expression) -> tuple[str, ...]:
    """Return the words of a term or atom, by which it is compared with others."""
    return tuple(part.word for part in term.parts)


def total(parts: Iterable[Expression]) -> Expression:
    """Return the sum of expressions."""
    found = list(parts)
    return found[0] if len(found) == 1 else listed(word("+"), *found) if found else ZERO


def merged(file: Path, schema: TimedSchema, derived: Mapping[str, frozenset[str]]) -> Schema:
    """Return the schema without times. Terms of one function that the start changes are alike, or never the same.

    `derived` has the predicates and functions that each derived predicate depends on.
    """
    start = _Start(file, schema, derived)
    duration, bounds = _duration(file, schema)

    def timed(expression: Expression) -> Expression:
        return _with_duration(expression, duration)

    conditions = [
        timed(condition if time == START else start.condition(condition)) for time, condition in schema.conditions
    ]
    literals = [
        replace(each, condition=timed(conjunction((before, each.condition if time == START else
                start.condition(each.condition)))))
        for time, before, each in schema.literals
    ]  # fmt: skip
    times = [time for time, _, _ in schema.literals]
    changes = []
    for time, before, each in schema.changes:
        at_end = time == END
        condition = start.condition(each.condition) if at_end else each.condition
        amount = start.number(each.amount) if at_end else each.amount
        changes.append(
            replace(each, condition=timed(conjunction((before, condition))), amount=timed(amount))
        )  # fmt: skip
    return Schema(
        schema.name, schema.parameters, conjunction([*conditions, *bounds]), tuple(_overwritten(times, literals)),
        tuple(_composed(file, schema, [time for time, _, _ in schema.changes], changes)), duration, schema.place,
    )  # fmt: skip


def _overwritten(times: Sequence[str], literals: Sequence[Literal]) -> Iterable[Literal]:
    """Yield the effects on facts, without additions at the start that a deletion at the end takes back."""
    deletions = [each for time, each in zip(times, literals, strict=True) if time == END and not each.holds]
    for time, each in zip(times, literals, strict=True):
        if time == END or not each.holds:
            yield each
            continue
        kept = [each.condition]
        for other in deletions:
            if other.atom.head == each.atom.head:
                meets = conjunction((other.condition, same(other.atom, each.atom)))
                kept.append(unsatisfied(_exists(other.variables, meets)))
        if (condition := conjunction(kept)) != FALSE:
            yield replace(each, condition=condition)


def _exists(variables: Mapping[str, str], body: Expression) -> Expression:
    listing = listed(*(word(text) for name, kind in variables.items() for text in (name, "-", kind)))
    return quantified("exists", listing, body)


def _composed(file: Path, schema: TimedSchema, times: Sequence[str], changes: Sequence[Change]) -> Iterable[Change]:
    """Yield the changes of numbers, with one for each term whose number changes twice."""
    groups: dict[tuple[tuple[str, ...], tuple[str, ...]], list[tuple[str, Change]]] = {}
    for time, change in zip(times, changes, strict=True):
        groups.setdefault((key(change.term), tuple(change.variables)), []).append((time, change))
    for group in groups.values():
        last: list[Change] = []
        for time in (START, END):
            now = _alike([change for when, change in group if when == time])
            for one, other in combinations(now, 2):
                if not (one.grows and other.grows) and not exclude(one.condition, other.condition):
                    _twice(file, schema, one, other)
            if not last and not all(each.grows for each in now):
                last = now  # at most one of them is made, or growths
                continue
            for each in now:
                if each.grows or not last:
                    last = _added(file, schema, last, each)
                elif each.condition == TRUE:
                    last = [each]
                else:
                    _too_intricate(file, schema, each)
        yield from last


def _alike(changes: Sequence[Change]) -> list[Change]:
    """Return changes of one term at one time, in which assignments of one amount are one, under either condition."""
    found: list[Change] = []
    for change in changes:
        amount = str(change.amount)
        at = next((n for n, each in enumerate(found) if str(each.amount) == amount and not each.grows), None)
        if at is None or change.grows:
            found.append(change)
        else:
            found[at] = replace(found[at], condition=disjunction((found[at].condition, change.condition)))
    return found


def _twice(file: Path, schema: TimedSchema, one: Change, other: Change) -> None:
    sure = one.condition == other.condition == TRUE
    said = "" if sure else "perhaps "
    expected = "one change, " if sure else "one change, conditions of which one is the opposite of the other, "
    refuse(file, other.place, f"action '{schema.name}' {said}changes '{other.term}' twice at one time, on line "
           f"{one.place.line} as well; expected {expected}or (increase ...) only")  # fmt: skip


def _added(file: Path, schema: TimedSchema, before: list[Change], change: Change) -> list[Change]:
    """Return the changes of one term with one more growth."""
    if not before or all(each.grows for each in before):
        alike = next((n for n, each in enumerate(before) if str(each.condition) == str(change.condition)), None)
        if alike is None:
            return [*before, change]
        grown = replace(before[alike], amount=total((before[alike].amount, change.amount)))
        return [*before[:alike], grown, *before[alike + 1 :]]
    if change.condition != TRUE or len(before) > 1 or before[0].condition != TRUE:
        _too_intricate(file, schema, change)
    return [replace(before[0], amount=total((before[0].amount, change.amount)))]


def _too_intricate(file: Path, schema: TimedSchema, change: Change) -> None:
    refuse(file, change.place, f"action '{schema.name}' changes '{change.term}' at its start and at its end, and under "
           "a condition; expected both at its end")  # fmt: skip


def _with_duration(expression: Expression, duration: Expression | None) -> Expression:
    if expression.word == DURATION and duration is not None:
        return duration
    if expression.word or not reads_duration(expression):
        return expression
    return expression._replace(parts=tuple(_with_duration(part, duration) for part in expression.parts))


def _duration(file: Path, schema: TimedSchema) -> tuple[Expression | None, list[Expression]]:
    """Return the least duration, and the conditions under which it is allowed."""
    if schema.durations is None:
        return None, []
    exact: list[Expression] = []
    lower: list[Expression] = []
    upper: list[Expression] = []
    for _, comparison, amount in schema.durations:  # it is read in s, also where it is stated (at end ...)
        {"=": exact, ">=": lower, "<=": upper}[comparison].append(amount)
    if not exact and (reader := reader_of_duration(schema)) is not None:
        refuse(file, reader, f"durative action '{schema.name}': an effect or condition reads {DURATION}, and the "
               f"duration is free; expected (= {DURATION} NUMBER)")  # fmt: skip
    if len(lower) > 1 and not exact:
        refuse(file, schema.place, f"durative action '{schema.name}' has several least durations; expected one")
    least = (exact or lower or [ZERO])[0]
    conditions = [listed(word("=="), least, each) for each in exact[1:]]
    conditions += [listed(word(">="), least, each) for each in lower if exact]
    conditions += [listed(word("<="), least, each) for each in upper]
    return least, conditions


def reader_of_duration(schema: TimedSchema) -> Place | None:
    """Return the place of a change or condition that reads `?duration`; None if there is none."""
    for _, before, change in schema.changes:
        if any(map(reads_duration, (before, change.amount, change.condition))):
            return change.place
    effects = [condition for _, before, each in schema.literals for condition in (before, each.condition)]
    if any(map(reads_duration, (*effects, *(condition for _, condition in schema.conditions)))):
        return schema.place
    return None


class _Start:
    """The start effects of an action, through which conditions and numbers of s1 are rewritten as those of s."""

    def __init__(self, file: Path, schema: TimedSchema, derived: Mapping[str, frozenset[str]]) -> None:
        self.file = file
        self.schema = schema
        self.literals = [
            replace(each, condition=conjunction((before, each.condition)))
            for time, before, each in schema.literals if time == START
        ]  # fmt: skip
        self.changes = [(before, change) for time, before, change in schema.changes if time == START]
        self.derived = derived
        self.parameters = {each.name for each in schema.parameters}

    def condition(self, condition: Expression) -> Expression:
        """Return the condition in s that is equivalent to a condition in s1."""
        return changed(condition, self._leaf)

    def _leaf(self, leaf: Expression) -> Expression:
        if leaf.head in COMPLEMENT or leaf.head == "failed":
            return self._compared(leaf, frozenset())
        if leaf.head == "not":
            return leaf if leaf.parts[1].head == "=" else unsatisfied(self._atom(leaf.parts[1]))
        return leaf if leaf.head == "=" else self._atom(leaf)

    def _compared(self, leaf: Expression, apart: frozenset[tuple[Expression, Expression]]) -> Expression:
        """Return the condition in s for a comparison in s1, or one that is not satisfied.

        Whether a term with a quantified variable is one that the start changes is tested by equalities; those that are
        `apart` are not.
        """
        for term in compared_terms(leaf):
            for _, change in self.changes:
                alike = unified(change, term)
                if alike is None or (term, change.term) in apart or free_variables(alike).keys() <= self.parameters:
                    continue  # the same term, or never the same
                is_changed = self._compared(_exchanged(leaf, term, change.term), apart)
                is_not = self._compared(leaf, apart | {(term, change.term)})
                return disjunction((conjunction((alike, is_changed)), conjunction((unsatisfied(alike), is_not))))
        return self._numeric(leaf)

    def _numeric(self, leaf: Expression) -> Expression:
        if leaf.head == "failed":
            return listed(leaf.parts[0], self._numeric(leaf.parts[1]))
        return leaf._replace(parts=(leaf.parts[0], *map(self.number, leaf.parts[1:])))

    def _atom(self, atom: Expression) -> Expression:
        changed_at_start = {each.atom.head for each in self.literals} | {each.term.head for _, each in self.changes}
        if changed_at_start & self.derived.get(atom.head, frozenset()):
            refuse(self.file, self.schema.place, f"durative action '{self.schema.name}': '{atom}' is derived, and read "
                   "after effects at start on which it depends; expected it (at start ...)")  # fmt: skip
        added, deleted = ([each for each in self.literals if each.holds is way and each.atom.head == atom.head]
                          for way in (True, False))  # fmt: skip
        ways = [disjunction(self._meets(each, atom) for each in those) for those in (added, deleted)]
        return disjunction((ways[0], conjunction((atom, unsatisfied(ways[1])))))

    @staticmethod
    def _meets(effect: Literal, atom: Expression) -> Expression:
        """Return the condition under which an effect is on an atom."""
        return _exists(effect.variables, conjunction((effect.condition, same(effect.atom, atom))))

    def number(self, expression: Expression) -> Expression:
        """Return the expression in s that has the value of an expression in s1."""
        if expression.word:
            return expression
        if expression.head in OPERATIONS:
            return expression._replace(parts=(expression.parts[0], *map(self.number, expression.parts[1:])))
        found = expression
        for before, change in self.changes:
            if key(change.term) == key(expression):
                if (before, change.condition) != (TRUE, TRUE):
                    _too_intricate(self.file, self.schema, change)
                amount = change.amount
                if reads_duration(amount) and reads_duration(expression):
                    _too_intricate(self.file, self.schema, change)
                found = total((found, amount)) if change.grows else amount
        return found


def _exchanged(expression: Expression, term: Expression, other: Expression) -> Expression:
    """Return an expression with one term in place of another."""
    if key(expression) == key(term):
        return other
    return expression._replace(parts=tuple(_exchanged(part, term, other) for part in expression.parts))


def unified(change: Change, term: Expression) -> Expression | None:
    """Return the condition under which a change may be of a term; None if it never is."""
    if change.term.head != term.head:
        return None
    condition = same(change.term, term)
    return None if condition == FALSE else condition


def bound_in(schema: TimedSchema, bound: Mapping[str, str]) -> TimedSchema:
    """Return a schema in which numbers are read and changed with variables replaced by others that are equal."""

    def numeric(condition: Expression) -> Expression:
        def leaf(each: Expression) -> Expression:
            return substituted(each, bound) if each.head in COMPLEMENT or each.head == "failed" else each

        return changed(condition, leaf)

    schema = schema.mapped(numeric)
    changes = (
        (time, before, replace(each, term=substituted(each.term, bound), amount=substituted(each.amount, bound)))
        for time, before, each in schema.changes
    )
    durations = schema.durations
    if durations is not None:
        durations = tuple((time, how, substituted(amount, bound)) for time, how, amount in durations)
    return replace(schema, changes=tuple(changes), durations=durations)
