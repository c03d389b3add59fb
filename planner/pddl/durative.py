"""Actions as parts with a time, and compiled into one step of a person who does one action after the other.

A `TimedSchema` lists the conditions, effects on facts, and changes of numbers of an action, each at its start, while it
lasts, or at its end. An action without a duration has all of them at the start. In a `Schema` nothing has a time:
start effects turn the state s into s1 (deletions first, then additions); conditions `over all` and `at end` are those
of s1; end effects are made on s1. All of them are rewritten as conditions and effects in s (regression): a fact p holds
in s1 if the start adds it, or if it holds in s and the start does not delete it; variables of p and of the effect may
stand for the same object, which the new condition tests by equalities. A number read in s1 is the one after the start's
change of it; whether a term with a quantified variable is the changed one is tested by equalities, too.

In `(when (at start c) (at end e))`, c is read in s.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

from .declarations import Typed, refuse
from .expressions import (
    COMPLEMENT,
    DURATION,
    FALSE,
    OPERATIONS,
    TRUE,
    ZERO,
    changed,
    compared_terms,
    conjunction,
    disjunction,
    exclude,
    free_variables,
    key,
    listed,
    listing_of,
    normal_form,
    quantified,
    same,
    substituted,
    unsatisfied,
    variables_of,
    word,
)
from .formulas import CHANGES
from .instances import Expression, Place
from .reader import Action, DurativeAction, Reading, Rule

START, OVER, END = "start", "over", "end"


@dataclass(frozen=True)
class Literal:
    """An effect on a fact: it holds afterwards, or does not. It is made for all objects that fit the `variables`."""

    variables: Mapping[str, str]
    """Variables with their types."""
    condition: Expression
    atom: Expression
    holds: bool


@dataclass(frozen=True)
class Change:
    """A change of a number: the term gets the amount, or grows by it.

    An assignment stays one until it is the only change of its term: two that are alike are one, as growths are not.
    """

    variables: Mapping[str, str]
    """Variables with their types."""
    condition: Expression
    term: Expression
    amount: Expression
    grows: bool
    place: Place


@dataclass(frozen=True)
class TimedSchema:
    """An action in parts, each with its time."""

    name: str
    parameters: tuple[Typed, ...]
    conditions: tuple[tuple[str, Expression], ...]
    literals: tuple[tuple[str, Expression, Literal], ...]
    """Time, condition in the state before the action, and the effect, whose own condition is at its time."""
    changes: tuple[tuple[str, Expression, Change], ...]
    """Likewise, the changes of numbers."""
    durations: tuple[tuple[str, str, Expression], ...] | None
    """Constraints on the duration: time, comparison, number. None for an action without a duration."""
    place: Place

    def with_condition(self, condition: Expression) -> TimedSchema:
        """Return the schema with one more condition in the state before the action."""
        return replace(self, conditions=(*self.conditions, (START, condition)))

    def mapped(self, written: Callable[[Expression], Expression]) -> TimedSchema:
        """Return the schema with all its conditions as they are `written`."""
        return replace(
            self,
            conditions=tuple((time, written(each)) for time, each in self.conditions),
            literals=tuple(
                (time, written(before), replace(each, condition=written(each.condition)))
                for time, before, each in self.literals
            ),
            changes=tuple(
                (time, written(before), replace(each, condition=written(each.condition)))
                for time, before, each in self.changes
            ),
        )


def timed_schemas(reading: Reading) -> tuple[TimedSchema, ...]:
    """Return the actions of a reading."""
    found = []
    for entry in reading.domain.entries:
        if isinstance(entry, Rule):
            continue
        reader = _Reader(reading, entry.name, entry.place)
        if isinstance(entry, Action):
            reader.condition(START, entry.precondition)
            reader.effect(START, entry.effect)
            found.append(reader.schema(entry, None))
        else:
            reader.timed_condition(entry.condition)
            reader.timed_effect(entry.effect)
            found.append(reader.schema(entry, tuple(_durations(entry.duration, START))))
    return tuple(found)


def _durations(constraint: Expression, time: str) -> Iterator[tuple[str, str, Expression]]:
    if constraint.head == "at":
        yield from _durations(constraint.parts[2], constraint.parts[1].word)
    elif constraint.head == "and":
        for part in constraint.parts[1:]:
            yield from _durations(part, time)
    else:
        yield time, constraint.head, constraint.parts[2]


class _Reader:
    """The parts of one action, collected."""

    def __init__(self, reading: Reading, name: str, place: Place) -> None:
        self.place = place
        self.file = reading.instance.domain
        self.objects = reading.objects
        self.name = name
        self.conditions: list[tuple[str, Expression]] = []
        self.literals: list[tuple[str, Expression, Literal]] = []
        self.changes: list[tuple[str, Expression, Change]] = []

    def schema(
        self, entry: Action | DurativeAction, durations: tuple[tuple[str, str, Expression], ...] | None
    ) -> TimedSchema:
        """Return the action."""
        return TimedSchema(
            entry.name, entry.parameters, tuple(self.conditions), tuple(self.literals), tuple(self.changes),
            durations, entry.place,
        )  # fmt: skip

    def condition(self, time: str, condition: Expression) -> None:
        """Collect a condition."""
        self.conditions.append((time, normal_form(condition, self.objects)))

    def timed_condition(self, condition: Expression) -> None:
        """Collect conditions, each within its time."""
        for time, each in self._by_time(condition):
            self.conditions.append((time, each))

    def _by_time(self, condition: Expression) -> Iterator[tuple[str, Expression]]:
        head = condition.head
        if head == "and":
            for part in condition.parts[1:]:
                yield from self._by_time(part)
        elif head == "forall":
            for time, each in self._by_time(condition.parts[2]):
                yield time, quantified("forall", condition.parts[1], each)
        elif head in ("at", "over"):
            time = {"all": OVER}.get(condition.parts[1].word, condition.parts[1].word)
            yield time, normal_form(condition.parts[2], self.objects)
        else:
            parts = [each for each in condition.parts[1 if head == "or" else 2 :] if each != FALSE]
            if not parts:
                yield START, FALSE
                return
            times = {time for part in parts for time, _ in self._by_time(part)}
            if len(times) != 1:
                written = next((each for each in condition.walk() if each.place.line), condition)
                refuse(self.file, written, f"durative action '{self.name}': '{head}' joins conditions of different "
                       "times; expected one time around all of it")  # fmt: skip
            inner = [conjunction(each for _, each in self._by_time(part)) for part in parts]
            if head == "exists":
                yield times.pop(), quantified("exists", condition.parts[1], inner[0])
            else:
                yield times.pop(), listed(word("or"), *inner)

    def timed_effect(self, effect: Expression) -> None:
        """Collect effects, each within its time."""
        self._effect("", effect, {}, TRUE, {})

    def effect(self, time: str, effect: Expression) -> None:
        """Collect effects of one time."""
        self._effect(time, effect, {}, TRUE, {})

    def _effect(
        self, time: str, effect: Expression, variables: dict[str, str], before: Expression, at: dict[str, Expression]
    ) -> None:
        """Collect an effect. `before` is its condition before the action, `at` has conditions by their time."""
        head, parts = effect.head, effect.parts[1:]
        if head == "and":
            for part in parts:
                self._effect(time, part, variables, before, at)
        elif head == "forall":
            self._effect(time, parts[1], {**variables, **variables_of(parts[0])}, before, at)
        elif head == "when" and time:
            condition = normal_form(parts[0], self.objects)
            self._effect(time, parts[1], variables, before, {**at, time: conjunction((at.get(time, TRUE), condition))})
        elif head == "when":
            for when, condition in self._by_time(parts[0]):
                if when == START:
                    before = conjunction((before, condition))
                else:
                    at = {**at, END: conjunction((at.get(END, TRUE), condition))}
            self._effect(time, parts[1], variables, before, at)
        elif not time:
            self._effect(parts[0].word, parts[1], variables, before, at)
        else:
            own = at.get(time, TRUE)
            if time == START and END in at:
                refuse(self.file, self.place, f"durative action '{self.name}': an effect at start depends on a "
                       "condition at end; expected both at one time")  # fmt: skip
            if head in CHANGES:
                self.changes.append((time, before, _change(effect, variables, own)))
            else:
                atom = parts[0] if head == "not" else effect
                self.literals.append((time, before, Literal(variables, own, atom, head != "not")))


def _change(effect: Expression, variables: Mapping[str, str], condition: Expression) -> Change:
    head, term, amount = effect.head, *effect.parts[1:]
    if head == "decrease":
        amount = listed(word("-"), amount)
    elif head in ("scale-up", "scale-down"):
        amount = listed(word("*" if head == "scale-up" else "/"), term, amount)
    return Change(variables, condition, term, amount, head in ("increase", "decrease"), effect.place)


def growth(term: Expression, amount: Expression) -> Expression | None:
    """Return by how much a term grows that is assigned an amount such as `(+ TERM 2)`; None for other amounts."""
    if str(amount) == str(term):
        return word("0")
    parts = list(amount.parts[1:])
    if amount.head == "+":
        for at, part in enumerate(parts):
            if (more := growth(term, part)) is not None:
                return total([more, *parts[:at], *parts[at + 1 :]])
    if amount.head == "-" and len(parts) > 1 and (more := growth(term, parts[0])) is not None:
        return total([more, *(listed(word("-"), part) for part in parts[1:])])
    return None


def renamed(change: Change, bound: Mapping[str, str]) -> Change:
    """Return a change with some of its variables replaced by objects, or by other variables."""
    kept = {name: kind for name, kind in change.variables.items() if name not in bound}
    return replace(
        change, variables=kept, condition=substituted(change.condition, bound), term=substituted(change.term, bound),
        amount=substituted(change.amount, bound),
    )  # fmt: skip


def reads_duration(expression: Expression) -> bool:
    """Whether an expression reads `?duration`."""
    return any(each.word == DURATION for each in expression.walk())


@dataclass(frozen=True)
class Schema:
    """An action in which nothing has a time. All conditions are in negation normal form (see `expressions`).

    `duration` is None for an action that takes no time.
    """

    name: str
    parameters: tuple[Typed, ...]
    precondition: Expression
    literals: tuple[Literal, ...]
    changes: tuple[Change, ...]
    duration: Expression | None
    place: Place


def total(parts: Iterable[Expression]) -> Expression:
    """Return the sum of expressions, without zeros among them."""
    found = [part for part in parts if part.word != "0"]
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
    return quantified("exists", listing_of(variables), body)


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
