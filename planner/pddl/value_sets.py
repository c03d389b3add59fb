"""The values that each number of an instance may have in a reachable state.

The sets are found by relaxed reachability: facts that actions change may hold or not, and a number keeps all values
that it ever had. The sets contain each value of a reachable state. A value outside of a proven range is not reachable,
and is left out. Where only thresholds of a number matter, values beyond the last of them are one (see `saturation`).
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from .conditions import COMPLEMENT, FALSE, comparisons, conjunction, conjuncts, free_variables
from .durative import Schema, key
from .numeric_expressions import NoValueError, Number, compared, terms_of, value_of
from .s_expressions import Expression
from .schemas import Change
from .static_facts import Statics, literal_number

Fluent = tuple[str, ...]
"""A function that changes, with its objects."""

Value = Number | None
"""A number, or None for a fluent that has no value."""

MOST_STEPS = 3_000_000
"""Largest number of combinations of values that are computed."""
MOST_TOGETHER = 100_000
"""Largest number of combinations of values at which a condition on several numbers is used."""


class UnboundedError(ValueError):
    """A fluent has more values than allowed."""

    def __init__(self, fluent: Fluent) -> None:
        self.fluent = fluent
        super().__init__(fluent)


class TooIntricateError(ValueError):
    """The sets are too expensive to compute."""


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
    initial: Mapping[Fluent, Value]
    exceeded: set[Fluent] = field(default_factory=set)
    limited: set[Fluent] = field(default_factory=set)
    """Fluents of which a value outside of the proven range has been left out."""


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
            inner = list(comparisons(condition))
            if not inner:
                continue
            own = free_variables(condition)
            read = {term.head for each in inner for side in each.parts[1:] for term in terms_of(side)}
            if read & heads or own.keys() <= variables.keys():
                variables.update(own)
                numeric.append(condition)
        for bound in _rows(statics, change, {name: scope[name] for name in variables}, conditions):
            guard = conjunction(statics.simplified(each, bound) for each in numeric)
            if guard == FALSE:
                continue
            fluent = tuple(bound.get(word, word) for word in key(change.term))
            try:
                amount = statics.evaluated(change.amount, bound)
            except (NoValueError, ZeroDivisionError):
                continue
            one = GroundChange(schema.name, fluent, amount, change.grows, guard)
            found.setdefault((fluent, str(amount), change.grows, str(guard)), one)
    return list(found.values())


def _rows(
    statics: Statics, change: Change, variables: Mapping[str, str], conditions: Iterable[Expression]
) -> Iterable[dict[str, str]]:
    terms = [term for term in terms_of(change.amount) if term.head in statics.values]
    plain = [each for each in conditions if not any(True for _ in comparisons(each)) or each.head in COMPLEMENT]
    for row in statics.bindings(variables, plain, terms):
        yield dict(zip(variables, row, strict=True))


def possible(condition: Expression, known: Mapping[str, Value]) -> bool:
    """Whether a ground condition may be true; the values of some fluents are known, by their texts."""
    head, parts = condition.head, condition.parts[1:]
    if head == "and":
        return all(possible(part, known) for part in parts)
    if head == "or":
        return any(possible(part, known) for part in parts)
    if head == "failed":
        true = _truth(parts[0], known)
        return not true
    if head in COMPLEMENT:
        return _truth(condition, known) is not False
    return True


def _truth(comparison: Expression, known: Mapping[str, Value]) -> bool | None:
    """Return whether a comparison is satisfied; None if it is not known."""
    texts = [str(term) for side in comparison.parts[1:] for term in terms_of(side)]
    if not all(text in known for text in texts):
        return None
    if any(known[text] is None for text in texts):
        return False
    try:
        left, right = (value_of(side, lambda term: known[str(term)]) for side in comparison.parts[1:])  # type: ignore[arg-type,return-value]
    except (ZeroDivisionError, NoValueError):
        return False
    return compared(comparison.head, left, right)


class _Rule:
    """A change as a function of the values of the fluents that it reads."""

    def __init__(self, change: GroundChange, sizes: Mapping[Fluent, int]) -> None:
        self.fluent = change.fluent
        self.grows = change.grows
        self.amount = change.amount
        self.constant = literal_number(change.amount)
        own = [change.fluent] if change.grows else []
        reads = dict.fromkeys([*own, *map(key, terms_of(change.amount))])
        self.guards: list[Expression] = []
        for guard in conjuncts(change.guard):
            inner = [key(t) for each in comparisons(guard) for side in each.parts[1:] for t in terms_of(side)]
            if not inner:
                continue
            self.guards.append(guard)
            more = dict.fromkeys([*reads, *inner])
            product = 1
            for each in more:
                product *= max(sizes.get(each, 1), 1)
            if (set(inner) & set(reads) and product <= MOST_TOGETHER) or len(more) == 1:
                reads = more
        self.reads: tuple[Fluent, ...] = tuple(reads)
        self.texts = tuple(f"({' '.join(each)})" for each in self.reads)

    def result(self, values: tuple[Value, ...]) -> Number | None:
        """Return the value after the change, given those of the fluents that are read; None if it is not made."""
        known = dict(zip(self.texts, values, strict=True))
        if not all(possible(guard, known) for guard in self.guards):
            return None
        if self.constant is not None:
            if not self.grows:
                return self.constant
            return None if values[0] is None else values[0] + self.constant
        try:
            amount = value_of(self.amount, lambda term: _defined(known[str(term)]))
        except (ZeroDivisionError, NoValueError):
            return None
        if not self.grows:
            return amount
        return None if values[0] is None else values[0] + amount


def _defined(value: Value) -> Number:
    if value is None:
        raise NoValueError
    return value


def computed(
    changes: Iterable[GroundChange],
    initial: Mapping[Fluent, Value],
    *,
    limit: int,
    saturations: Mapping[Fluent, Saturation],
    ranges: Mapping[Fluent, tuple[Number | None, Number | None]],
    most_steps: int = MOST_STEPS,
) -> ValueSets:
    """Return the values of all fluents.

    A fluent with more than `limit` values raises an `UnboundedError`, and more than `most_steps` combinations raise a
    `TooIntricateError`.
    """
    changes = list(changes)
    begin = dict(initial)
    for change in changes:
        begin.setdefault(change.fluent, None)
    found = ValueSets({fluent: set() for fluent in begin}, begin)
    sizes = {fluent: min(limit, 50) for fluent in begin}
    rules = [_Rule(change, sizes) for change in changes]
    readers: dict[Fluent, list[_Rule]] = defaultdict(list)
    for rule in rules:
        for fluent in rule.reads:
            readers[fluent].append(rule)
    waiting: list[tuple[Fluent, Value]] = []
    steps = 0

    def reached(fluent: Fluent, value: Value) -> None:
        if value is not None:
            low, high = ranges.get(fluent, (None, None))
            if (low is not None and value < low) or (high is not None and value > high):
                found.limited.add(fluent)
                return
            if (saturation := saturations.get(fluent)) is not None:
                normal = saturation.normal(value)
                if normal != value:
                    found.exceeded.add(fluent)
                value = normal
        if value not in found.values[fluent]:
            found.values[fluent].add(value)
            if len(found.values[fluent]) > limit:
                raise UnboundedError(fluent)
            waiting.append((fluent, value))

    for fluent, value in begin.items():
        reached(fluent, value)
    for rule in rules:
        if not rule.reads and (after := rule.result(())) is not None:
            reached(rule.fluent, after)
    active: dict[Fluent, list[Value]] = defaultdict(list)
    position = 0
    while position < len(waiting):
        fluent, value = waiting[position]
        position += 1
        active[fluent].append(value)
        for rule in readers[fluent]:
            pools = [[value] if each == fluent else active[each] for each in rule.reads]
            for values in itertools.product(*pools):
                steps += 1
                if (after := rule.result(values)) is not None:
                    reached(rule.fluent, after)
            if steps > most_steps:
                raise TooIntricateError
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
