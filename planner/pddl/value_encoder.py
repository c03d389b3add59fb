"""The words of one encoding of numbers as facts: objects for values, predicates for functions, static relations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from .declarations import OBJECT, Symbol, Typed, refuse
from .instances import Place
from .numeric_expressions import Number, as_shown
from .static_facts import Statics
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
