"""Actions as parts with a time, for the compiler of numbers and durations.

A `TimedSchema` lists the conditions, effects on facts, and changes of numbers of an action, each at its start, while it
lasts, or at its end. An action without a duration has all of them at the start. `durative` makes a `Schema` of it,
in which nothing has a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

from .conditions import FALSE, TRUE, conjunction, normal_form, quantified, substituted, variables_of
from .declarations import Typed, refuse
from .formulas import CHANGES, listed, word
from .instances import Expression, Place
from .numeric_expressions import DURATION
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


def of_reading(reading: Reading) -> tuple[TimedSchema, ...]:
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
                return _sum([more, *parts[:at], *parts[at + 1 :]])
    if amount.head == "-" and len(parts) > 1 and (more := growth(term, parts[0])) is not None:
        return _sum([more, *(listed(word("-"), part) for part in parts[1:])])
    return None


def _sum(parts: Iterable[Expression]) -> Expression:
    found = [part for part in parts if part.word != "0"]
    return found[0] if len(found) == 1 else listed(word("+"), *found) if found else word("0")


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
