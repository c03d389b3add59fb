"""Value sets of all fluents, with proven ranges for those that relaxed reachability alone does not bound.

A range is proven by a potential: x plus weighted numbers of other fluents and of facts (1 where a fact holds), which no
action makes larger. Let C be its value in the initial state. Then x <= C - m in all reachable states, where m is the
least value of the other summands. Conserved sums are such potentials (all stocks together), and so are loads that are
counted together with what is loaded. The weights are found by linear programming over the actions with objects for
their variables, rounded to fractions, and then checked exactly; what fails the check is no proof. Where a potential
contains an assigned x, C is also at least its value after the assignment.

An addition of a fact that may hold already, or a deletion of one that may not hold, counts as the worse of both cases.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from math import ceil, floor

from ..system.errors import UnsuitedError
from .declarations import refuse
from .expressions import (
    COMPLEMENT,
    FALSE,
    TRUE,
    Number,
    as_shown,
    conjuncts,
    free_variables,
    isolated,
    key,
    linear,
    terms_of,
    whole,
)
from .instances import Expression, PDDLError, Place
from .numeric_schemas import Costed
from .reader import Reading
from .static_facts import Statics, literal_number
from .value_sets import (
    MOST_TOGETHER,
    Fluent,
    GroundChange,
    Saturation,
    Trial,
    Value,
    ValueSets,
    computed,
)  # fmt: skip

Fact = tuple[str, ...]
Range = tuple[Number | None, Number | None]

MOST_WORK = 60_000
"""Work for the proofs of one instance, about ten seconds: ground actions, and thousands of rows that a step of the
linear programs has to do with. It is counted, so that the proofs do not depend on the load of the machine.
"""
MOST_ROWS = 20_000
"""Largest number of different ground actions in one linear program."""


class Bounds:
    """The search for the values of all fluents; it keeps the ranges that have been proven."""

    def __init__(self, proofs: Proofs, saturations: Mapping[Fluent, Saturation], most_values: int) -> None:
        self.proofs = proofs
        self.saturations = saturations
        self.most_values = most_values
        self.ranges: dict[Fluent, Range] = {}

    def sets(self, trial: Trial | None = None) -> ValueSets:
        """Return the values of all fluents.

        A fluent without a proven bound, or with more than `most_values` values, has the values of a trial. Without one,
        this raises an `UnprovenError`.
        """
        proofs, together, tried = self.proofs, MOST_TOGETHER, set[str]()
        while True:
            found = computed(
                proofs.of_all, proofs.begin, limit=self.most_values, saturations=self.saturations,
                ranges=self.ranges, together=together, tried=tried, trial=trial,
            )  # fmt: skip
            if found.costly and together > 1:
                together = 1
                continue
            fluent = self._most(found, tried) if found.costly else found.unbounded
            if fluent is None:
                return found
            low, high = self.ranges.get(fluent, (None, None))
            if found.costly and (fluent[0] in tried or (low is not None and high is not None)):
                refuse(proofs.file, proofs.place, "the numbers of this domain have too many combinations of values in "
                       f"one change, most of them of ({' '.join(fluent)}); expected fewer values, or simpler "
                       "expressions")  # fmt: skip
            if fluent in self.ranges and trial is None:
                raise unproven(proofs, fluent, self.ranges[fluent], self.most_values)
            if fluent in self.ranges:
                tried.add(fluent[0])
                together = MOST_TOGETHER
                continue
            for each in [other for other in proofs.initial if other[0] == fluent[0]]:
                self.ranges[each] = proofs.range_of(each)

    def _most(self, found: ValueSets, tried: Collection[str]) -> Fluent:
        """Return the fluent that has caused too many combinations: one with many values that follow from its own."""
        most = max(map(len, found.values.values()))

        def rank(fluent: Fluent) -> tuple[bool, bool, bool, int]:
            many = len(found.values[fluent])
            return fluent[0] in tried, 10 * many < most, fluent[0] in self.proofs.varying, -many

        return min(found.values, key=rank)


class UnprovenError(PDDLError):
    """A function has no proven bound, or too many values."""


def unproven(proofs: Proofs, fluent: Fluent, found: Range, most: int) -> UnprovenError:
    """Return the refusal of a fluent with too many values, or without a bound."""
    shown = f"({' '.join(fluent)})"
    of = (c.place for each in proofs.costed for c in each.schema.changes if c.term.head == fluent[0])
    place = next(of, proofs.place)

    def refusal(message: str) -> UnprovenError:
        return UnprovenError(proofs.file, None if place is None else place.line, message)

    low, high = found
    if low is not None and high is not None:
        return refusal(f"{shown} has more than {most} values, from {as_shown(low)} to {as_shown(high)}; expected "
                       "fewer, by a smaller capacity or larger steps, or a larger --most-values")  # fmt: skip
    ways: dict[str, set[str]] = defaultdict(set)
    for change in proofs.of_all:
        if change.fluent[0] == fluent[0] and (way := _way(change, proofs.initial.get(change.fluent))) is not None:
            ways[way].add(change.schema)
    verbs = [
        f"{way} ({', '.join(sorted(ways[way]))})" for way, bound in
        ((GROWS, high), (FALLS, low), (SHRINKS, low), (VARIES, None)) if bound is None and ways[way]
    ]  # fmt: skip
    unknown = not verbs or bool(ways[VARIES])
    guards = [
        f"(<= {shown} LARGEST) where it grows" if high is None and (unknown or ways[GROWS]) else "",
        f"(>= {shown} LEAST) where it falls" if low is None and (unknown or ways[FALLS] or ways[SHRINKS]) else "",
    ]
    return refusal(f"{shown} {' and '.join(verbs) or 'has no proven limit'}; expected conditions that bound it, such "
                   f"as {' and '.join(filter(None, guards))}")  # fmt: skip


GROWS, FALLS, SHRINKS, VARIES = (
    "grows without a limit", "falls without a limit", "comes ever closer to 0", "has no proven limit",
)  # fmt: skip
"""How a change leads to ever more values."""


def _way(change: GroundChange, begin: Value) -> str | None:
    """Return how a change leads to ever more values of a fluent that begins with a value; None if it does not."""
    amount = literal_number(change.amount)
    if amount is not None:
        return (GROWS if amount > 0 else FALLS if amount < 0 else None) if change.grows else None
    split = linear(change.amount, lambda each: not terms_of(each))
    if split is None or list(split[0]) != [f"({' '.join(change.fluent)})"] or begin is None or begin < 0:
        return VARIES
    ((_, factor),), more = split[0].values(), literal_number(split[1])
    factor += change.grows  # by its own multiple: n + (n + 1)
    if more is not None and factor >= 1 and more >= 0 and (more > 0 or (factor > 1 and begin > 0)):
        return GROWS
    return SHRINKS if more == 0 and 0 < factor < 1 and begin > 0 else VARIES


@dataclass
class Row:
    """What one ground action does to numbers and facts: amounts, and facts that surely or possibly change."""

    amounts: dict[Fluent, Number] = field(default_factory=dict)
    assigned: dict[Fluent, Number] = field(default_factory=dict)
    unsure: set[Fluent] = field(default_factory=set)
    """Fluents whose assignment has a condition."""
    sure: dict[Fact, int] = field(default_factory=dict)
    possible: dict[Fact, set[int]] = field(default_factory=dict)
    after: dict[Fact, bool] = field(default_factory=dict)

    def add(self, fact: Fact, ways: set[tuple[bool, bool]], before: bool | None) -> None:
        """Add the effects on a fact: whether it is made true, and whether surely; `before` is what it was, if known."""
        if (True, True) in ways:  # an addition outweighs a deletion
            self.after[fact] = True
            changes = {1}
        elif (False, True) in ways and (True, False) not in ways:
            self.after[fact] = False
            changes = {-1}
        else:
            changes = {1 if holds else -1 for holds, _ in ways}
        changes -= {1} if before is True else {-1} if before is False else set()
        if fact in self.after and before is not None and changes:
            self.sure[fact] = changes.pop()
        elif changes:
            self.possible[fact] = changes

    def text(self) -> str:
        """Return a text that is the same for rows that are the same."""
        return str((
            sorted(self.amounts.items()), sorted(self.assigned.items()), sorted(self.unsure), sorted(self.sure.items()),
            sorted((fact, sorted(ways)) for fact, ways in self.possible.items()), sorted(self.after.items()),
        ))  # fmt: skip


def _changed(costed: Costed) -> set[str]:
    """Return the predicates and functions that a schema changes."""
    literals, changes = costed.schema.literals, costed.schema.changes
    return {each.atom.head for each in literals} | {each.term.head for each in changes}


class Proofs:
    """The search for potentials of one instance."""

    def __init__(
        self,
        reading: Reading,
        statics: Statics,
        costed: Sequence[Costed],
        changes: Sequence[GroundChange],
        initial: Mapping[Fluent, Value],
        kinds: Mapping[str, Mapping[str, str]],
    ) -> None:
        self.statics = statics
        self.costed = costed
        self.file = reading.instance.domain
        self.of_all = changes
        self.begin = initial
        self.facts = set(reading.problem.facts)
        self.kinds = kinds
        self.initial: dict[Fluent, Value] = dict(initial)
        self.changes: dict[Fluent, list[GroundChange]] = defaultdict(list)
        for change in changes:
            self.changes[change.fluent].append(change)
            self.initial.setdefault(change.fluent, None)
        self.assigned = {change.fluent[0] for change in changes if not change.grows}
        self.varying = {
            change.fluent[0] for change in changes if literal_number(change.amount) is None
        }  # fmt: skip
        self.rows: dict[str, list[Row]] = {}
        self.work = MOST_WORK

    @cached_property
    def guarded(self) -> dict[Fluent, Range]:
        """The bounds of each fluent by conditions alone."""
        return {fluent: self._by_guards(fluent) for fluent in self.initial}

    @property
    def place(self) -> Place | None:
        """The place of the first action that changes a number."""
        names = {change.schema for change in self.of_all}
        return next((each.schema.place for each in self.costed if each.schema.name in names), None)

    def _by_guards(self, fluent: Fluent) -> Range:
        """Return the bounds that conditions on the fluent alone give to what changes it."""
        begin = self.initial[fluent]
        steps = [literal_number(change.amount) for change in self.changes[fluent]]
        integral = all(each is not None and each.denominator == 1 for each in [*steps, begin or 0])
        low: Number | None = begin
        high: Number | None = begin
        text = f"({' '.join(fluent)})"
        open_low = open_high = False
        for change in self.changes[fluent]:
            amount = literal_number(change.amount)
            if amount is None:
                open_low = open_high = True
            elif not change.grows:
                low = amount if low is None else min(low, amount)
                high = amount if high is None else max(high, amount)
            else:
                least, most = _bounds(change.guard, text, integral)
                if amount < 0:
                    open_low = open_low or least is None
                    low = low if least is None else least + amount if low is None else min(low, least + amount)
                elif amount > 0:
                    open_high = open_high or most is None
                    high = high if most is None else most + amount if high is None else max(high, most + amount)
        return (None if open_low else low), (None if open_high else high)

    def range_of(self, fluent: Fluent) -> Range:
        """Return the proven least and largest value of a fluent; None where there is no proof."""
        low, high = self.guarded[fluent]
        try:
            if high is None:
                high = self._potential(fluent, 1)
            if low is None:
                least = self._potential(fluent, -1)
                low = None if least is None else -least
        except UnsuitedError:
            return low, high
        return low, high

    def _rows_of(self, name: str) -> list[Row]:
        """Return the ground actions that change a function, or what is changed together with it."""
        if name in self.rows:
            return self.rows[name]
        heads = {name}
        for _ in range(2):  # what changes together with the function, and what changes together with that
            own = [each for each in self.costed if heads & _changed(each)]
            heads = heads.union(*map(_changed, own))
            heads -= {other for other in heads if other != name and other in self.assigned | self.varying}
        found: dict[str, Row] = {}
        for each in self.costed:
            for row in self._ground(each, heads):
                found.setdefault(row.text(), row)
                self.work -= 1
                if len(found) > MOST_ROWS or self.work <= 0:
                    raise UnsuitedError
        self.rows[name] = list(found.values())
        return self.rows[name]

    def _ground(self, costed: Costed, heads: set[str]) -> Iterable[Row]:
        schema = costed.schema
        literals = [each for each in schema.literals if each.atom.head in heads]
        changes = [each for each in schema.changes if each.term.head in heads]
        if not literals and not changes:
            return
        kinds = self.kinds[schema.name]
        names = dict.fromkeys(
            name for each in (*(each.atom for each in literals), *(each.term for each in changes),
                              *(each.amount for each in changes))
            for name in free_variables(each) if name in kinds
        )  # fmt: skip
        top = conjuncts(schema.precondition)
        terms = [
            term for change in changes if not change.variables for term in terms_of(change.amount)
            if term.head in self.statics.values
        ]  # fmt: skip
        variables = {name: kinds[name] for name in names}
        for bound in self.statics.bindings(variables, top, terms):
            row = Row()
            known: dict[Fact, bool] = {}
            for condition in top:
                inner, holds = (condition.parts[1], False) if condition.head == "not" else (condition, True)
                if inner.head in heads and free_variables(inner).keys() <= bound.keys():
                    known[key(inner, bound)] = holds
            effects: dict[Fact, set[tuple[bool, bool]]] = defaultdict(set)
            possible = True
            for literal in literals:
                for fact, certain in self._instances(literal.atom, literal.variables, literal.condition, bound):
                    effects[fact].add((literal.holds, certain))
            for fact, ways in effects.items():
                row.add(fact, ways, known.get(fact))
            for change in changes:
                for fluent, certain in self._instances(change.term, change.variables, change.condition, bound):
                    amount = literal_number(self.statics.evaluated(change.amount, bound)) if not change.variables else (
                        literal_number(change.amount))  # fmt: skip
                    if amount is None:
                        continue
                    if change.grows and certain:
                        row.amounts[fluent] = row.amounts.get(fluent, 0) + amount
                        possible = possible and not self._never_defined(fluent)
                    elif not change.grows:
                        row.assigned[fluent] = amount
                        if not certain:
                            row.unsure.add(fluent)
            if possible:
                yield row

    def _never_defined(self, fluent: Fluent) -> bool:
        """Whether a fluent never has a value, so that an action that lets it grow is never applicable."""
        return self.initial.get(fluent) is None and fluent[0] not in self.assigned

    def _instances(
        self, atom: Expression, variables: Mapping[str, str], condition: Expression, bound: Mapping[str, str]
    ) -> Iterable[tuple[Fact, bool]]:
        """Yield the facts or fluents of an effect, and whether the effect is surely made."""
        inner = self.statics.simplified(condition, bound)
        if inner == FALSE:
            return
        own = [name for name in variables if name in free_variables(atom)]
        for row in self.statics.bindings({name: variables[name] for name in own}, conjuncts(inner)):
            yield key(atom, {**bound, **row}), inner == TRUE

    def _potential(self, fluent: Fluent, sign: int) -> Number | None:
        """Return an upper bound of `sign` times a fluent; None if there is no proof."""
        if fluent[0] in self.varying or (self.initial[fluent] is None and fluent[0] not in self.assigned):
            return None
        rows = self._rows_of(fluent[0])
        features: dict[Fact, None] = {}
        for row in rows:
            features.update(dict.fromkeys(row.sure))
            features.update(dict.fromkeys(row.possible))
            for other in row.amounts:
                if other != fluent and other[0] not in self.assigned and self.initial[other] is not None:
                    features.setdefault(other)
        return _solved(self, fluent, sign, rows, list(features))


def _bounds(guard: Expression, text: str, integral: bool) -> Range:
    """Return the least and the largest value of a fluent, perhaps a whole number, for which a condition may hold."""
    low: Number | None = None
    high: Number | None = None
    for condition in conjuncts(guard):
        if condition.head not in COMPLEMENT:
            continue
        found = isolated(condition, lambda each: not terms_of(each))
        if found is None or str(found[0]) != text or not found[3] or (rest := literal_number(found[2])) is None:
            continue
        head, limit = found[1], whole(Fraction(-rest) / found[3])
        strict = integral and head in ("<", ">")
        if head in ("==", ">=", ">"):
            least = floor(limit) + 1 if strict else limit
            low = least if low is None else max(low, least)
        if head in ("==", "<=", "<"):
            most = ceil(limit) - 1 if strict else limit
            high = most if high is None else min(high, most)
    return low, high


def _solved(proofs: Proofs, fluent: Fluent, sign: int, rows: Sequence[Row], features: Sequence[Fact]) -> Number | None:
    """Find weights by linear programming, and return the bound that they prove."""
    import numpy as np
    from scipy.optimize import linprog
    from scipy.sparse import csr_matrix

    column = {feature: number for number, feature in enumerate(features)}
    width = 2 * len(features) + 1  # positive and negative parts, and the constant C
    fluents = [feature in proofs.initial for feature in features]
    upper: list[tuple[float | None, float | None]] = []
    objective = np.zeros(width)
    objective[-1] = 1
    for number, feature in enumerate(features):
        if fluents[number]:
            low, high = proofs.guarded[feature]
            upper += [(0, None if low is not None else 0), (0, None if high is not None else 0)]
            objective[2 * number] = 0 if low is None else -float(low)
            objective[2 * number + 1] = 0 if high is None else float(high)
        else:
            upper += [(0, None), (0, None)]
            objective[2 * number + 1] = 1
    lines = [line for row in rows for line in _lines(proofs, fluent, sign, row, column)]
    begin = proofs.initial[fluent]
    if begin is not None:
        start: dict[int, Number] = {}
        for feature, number in column.items():
            value = proofs.initial[feature] if fluents[number] else int(feature in proofs.facts)
            if value:
                start[2 * number], start[2 * number + 1] = value, -value
        lines.append(({**start, width - 1: -1}, -sign * begin))
    entries = [(n, at, float(value)) for n, (line, _) in enumerate(lines) for at, value in line.items() if value]
    matrix = csr_matrix(
        ([each[2] for each in entries], ([each[0] for each in entries], [each[1] for each in entries])),
        shape=(len(lines), width),
    )  # fmt: skip
    each = 1 + len(lines) // 1_000
    if proofs.work < each:
        return None
    result = linprog(
        objective, A_ub=matrix, b_ub=np.array([float(limit) for _, limit in lines]), bounds=[*upper, (None, None)],
        method="highs-ds", options={"maxiter": proofs.work // each},
    )  # type: ignore[call-overload]  # fmt: skip
    proofs.work -= each * (1 + result.nit)
    if result.status != 0:
        return None
    for largest in (12, 1_000, 1_000_000):
        weights = [Fraction(float(value)).limit_denominator(largest) for value in result.x]
        weights[-1] = max(
            (-limit + sum((Fraction(value) * weights[at] for at, value in line.items() if at != width - 1), Fraction(0))
             for line, limit in lines if (width - 1) in line), default=weights[-1],
        )  # fmt: skip
        if all(sum((value * weights[at] for at, value in line.items()), Fraction(0)) <= limit for line, limit in lines):
            if any(weight < 0 for weight in weights[:-1]):
                continue
            total = weights[-1]
            for number, feature in enumerate(features):
                plus, minus = weights[2 * number], weights[2 * number + 1]
                if fluents[number]:
                    low, high = proofs.guarded[feature]
                    if (plus and low is None) or (minus and high is None):
                        break
                    total += -plus * low if plus and low is not None else 0
                    total += minus * high if minus and high is not None else 0
                else:
                    total += minus
            else:
                return whole(total)
    return None


def _lines(
    proofs: Proofs, fluent: Fluent, sign: int, row: Row, column: Mapping[Fact, int]
) -> Iterable[tuple[dict[int, Number], Number]]:
    """Yield the inequalities (coefficients, limit) of one ground action: the potential does not grow."""
    last = 2 * len(column)
    line: dict[int, Number] = {}
    for fact, way in row.sure.items():
        line[2 * column[fact]], line[2 * column[fact] + 1] = way, -way
    for fact, ways in row.possible.items():
        at = 2 * column[fact]
        if 1 in ways:
            line[at] = 1  # the fact may become true: its weight counts if it is positive
        if -1 in ways:
            line[at + 1] = 1
    for other, amount in row.amounts.items():
        if other in column:
            line[2 * column[other]], line[2 * column[other] + 1] = amount, -amount
    if fluent not in row.assigned or fluent in row.unsure:
        yield line, -sign * row.amounts.get(fluent, 0)
    if fluent not in row.assigned:
        return
    # After an assignment, the potential is at most C: all other summands count as their largest value.
    after: dict[int, Number] = {last: -1}
    for feature, number in column.items():
        if feature in proofs.initial:
            low, high = proofs.guarded[feature]
            if high is None or low is None:
                after = {}
                break
            after[2 * number], after[2 * number + 1] = high, -low
        elif feature in row.after:
            if row.after[feature]:
                after[2 * number], after[2 * number + 1] = 1, -1
        else:
            after[2 * number] = 1
    if after:
        yield after, -sign * row.assigned[fluent]
    else:  # no proof: a constraint that cannot be met
        yield {}, -1
