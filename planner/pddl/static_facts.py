"""What no action changes: objects by type, facts and values, and the objects that satisfy conditions on them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Container, Iterable, Mapping, Sequence
from functools import cache
from math import prod

from ..system.errors import UnsuitedError
from .expressions import (
    COMPLEMENT,
    FALSE,
    OPERATIONS,
    TRUE,
    Number,
    compared,
    conjuncts,
    free_variables,
    joined,
    listed,
    number,
    terms_of,
    value_of,
    variables_of,
    word_of,
)
from .instances import Expression
from .reader import Reading

LARGEST_JOIN = 300_000
"""Largest number of combinations of objects that are enumerated at a time, about ten seconds."""
MOST_WORK = 5_000_000
"""Work with objects for one instance, about 20 seconds: combinations that are enumerated, and conditions on these."""
FEW = 200
"""Objects for which a condition without numbers is written out."""
COMPARISON = 50
"""Work of one comparison of numbers."""


class Statics:
    """The static part of an instance.

    `predicates` and `functions` are those that no action changes and no rule derives.
    """

    def __init__(self, reading: Reading, predicates: Iterable[str], functions: Iterable[str]) -> None:
        self.of_kind = cache(reading.of_kind)
        self._work = 0
        self.facts: dict[str, set[tuple[str, ...]]] = {name: set() for name in predicates}
        for name, *arguments in reading.problem.facts:
            if name in self.facts:
                self.facts[name].add(tuple(arguments))
        self.values: dict[str, dict[tuple[str, ...], Number]] = {name: {} for name in functions}
        for (name, *arguments), value in reading.problem.values.items():
            if name in self.values:
                self.values[name][tuple(arguments)] = value

    def is_static(self, expression: Expression) -> bool:
        """Whether a numeric expression reads static functions only."""
        return all(term.head in self.values for term in terms_of(expression))

    def value(self, expression: Expression, bound: Mapping[str, str]) -> Number:
        """Return the value of a static expression; raise an `ArithmeticError` if it has none."""

        def term(each: Expression) -> Number:
            arguments = tuple(bound.get(part.word, part.word) for part in each.parts[1:])
            try:
                return self.values[each.head][arguments]
            except KeyError:
                raise ArithmeticError(str(each)) from None

        return value_of(expression, term)

    def evaluated(self, expression: Expression, bound: Mapping[str, str]) -> Expression:
        """Return an expression with objects for all its variables, and its static parts computed.

        If one of these has no value, this raises an `ArithmeticError`.
        """
        if self.is_static(expression):
            return word_of(self.value(expression, bound))
        if expression.head in OPERATIONS:
            parts = (self.evaluated(part, bound) for part in expression.parts[1:])
            return expression._replace(parts=(expression.parts[0], *parts))
        return bound_terms(expression, bound)

    def bindings(
        self, variables: Mapping[str, str], conditions: Iterable[Expression], terms: Iterable[Expression] = ()
    ) -> list[dict[str, str]]:
        """Return the objects for variables, with their types, that satisfy conditions as far as these are static.

        Conditions on other variables too are only used in so far as some object may satisfy them. The static `terms`
        must have a value. More than `LARGEST_JOIN` combinations raise an `UnsuitedError`.
        """
        relations, filters = [], []
        for condition in (each for whole in conditions for each in conjuncts(whole)):
            if condition.head in self.facts:
                relations.append(relation(condition, self.facts[condition.head], variables))
            elif free_variables(condition).keys() <= variables.keys() and self._decides(condition):
                filters.append(condition)
        relations += [relation(term, self.values[term.head].keys(), variables) for term in terms]
        kinds = {name: set(self.of_kind(kind)) for name, kind in variables.items()}
        kept = []
        for names, rows in relations:
            rows = {row for row in rows if all(word in kinds[name] for name, word in zip(names, row, strict=True))}
            if not rows:
                return []
            if names:
                kept.append((names, rows))
        return self._joined(variables, kept, filters)

    def _decides(self, condition: Expression) -> bool:
        """Whether a condition may be false whatever the changing facts and numbers are."""
        head, parts = condition.head, condition.parts[1:]
        if head in COMPLEMENT:
            return all(map(self.is_static, parts))
        if head in ("and", "or"):
            return any(map(self._decides, parts))
        if head in ("not", "failed"):
            return self._decides(parts[0])
        if head in ("forall", "exists"):
            return self._decides(parts[1])
        return head == "=" or head in self.facts

    def _joined(
        self,
        variables: Mapping[str, str],
        relations: list[tuple[tuple[str, ...], set[tuple[str, ...]]]],
        filters: list[Expression],
    ) -> list[dict[str, str]]:
        names: tuple[str, ...] = ()
        found: list[tuple[str, ...]] = [()]
        waiting = list(relations)
        while waiting or len(names) < len(variables):
            if waiting:
                waiting.sort(key=lambda each: (-len(set(each[0]) & set(names)), len(each[1])))
                columns, rows = waiting.pop(0)
            else:
                free = min((n for n in variables if n not in names), key=lambda n: len(self.of_kind(variables[n])))
                columns, rows = (free,), {(word,) for word in self.of_kind(variables[free])}
            shared = [n for n, name in enumerate(columns) if name in names]
            new = [n for n, name in enumerate(columns) if name not in names]
            at = [names.index(columns[n]) for n in shared]
            index: dict[tuple[str, ...], list[tuple[str, ...]]] = defaultdict(list)
            for row in rows:
                index[tuple(row[n] for n in shared)].append(tuple(row[n] for n in new))
            longer = []
            for before in found:
                longer += [before + after for after in index.get(tuple(before[n] for n in at), ())]
                if len(longer) > LARGEST_JOIN:
                    raise UnsuitedError
            self._count(len(longer))
            names += tuple(columns[n] for n in new)
            known = set(names)
            ready = [each for each in filters if free_variables(each).keys() <= known]
            filters = [each for each in filters if each not in ready]
            if ready:
                longer = [
                    row for row in longer
                    if all(self.simplified(each, dict(zip(names, row, strict=True))) != FALSE for each in ready)
                ]  # fmt: skip
            found = longer
        order = [names.index(name) for name in variables]
        return [dict(zip(variables, row, strict=True)) for row in sorted(tuple(row[n] for n in order) for row in found)]

    def simplified(self, condition: Expression, bound: Mapping[str, str]) -> Expression:
        """Return a condition with variables replaced by objects, and its static parts by what they are."""
        head, parts = condition.head, condition.parts[1:]
        if head in ("and", "or"):
            return joined(head, (self.simplified(part, bound) for part in parts))
        if head in ("not", "failed"):
            inside = self.simplified(parts[0], bound)
            return {TRUE: FALSE, FALSE: TRUE}.get(inside) or listed(condition.parts[0], inside)
        if head in ("forall", "exists"):
            body = self.simplified(parts[1], bound)
            return body if body in (TRUE, FALSE) else listed(condition.parts[0], parts[0], body)
        if head in COMPLEMENT:
            return self._compared(condition, bound)
        words = tuple(bound.get(part.word, part.word) for part in parts)
        if head == "=" and words[0] == words[1]:
            return TRUE
        if not any(word.startswith("?") for word in words):
            if head == "=":
                return FALSE
            if head in self.facts:
                return TRUE if words in self.facts[head] else FALSE
        return listed(condition.parts[0], *(Expression(word) for word in words))

    def _count(self, work: int) -> None:
        """Count work; an `UnsuitedError` says that it is too much."""
        self._work += work
        if self._work > MOST_WORK:
            raise UnsuitedError

    def _compared(self, comparison: Expression, bound: Mapping[str, str]) -> Expression:
        self._count(COMPARISON)
        sides = comparison.parts[1:]
        if free_variables(comparison).keys() - bound.keys():
            return comparison._replace(parts=(comparison.parts[0], *(bound_terms(side, bound) for side in sides)))
        try:
            if all(map(self.is_static, sides)):
                left, right = (self.value(side, bound) for side in sides)
                return TRUE if compared(comparison.head, left, right) else FALSE
            return comparison._replace(parts=(comparison.parts[0], *(self.evaluated(side, bound) for side in sides)))
        except ArithmeticError:
            return FALSE

    def expanded(self, condition: Expression) -> Expression:
        """Return a condition whose quantifiers around comparisons of numbers are written out for all objects.

        Other conditions for all objects are written out too if they are few: the translator would make a derived
        variable of them, with which sweeps are slower and searches have no heuristic.
        """
        head, parts = condition.head, condition.parts[1:]
        if head in ("and", "or"):
            return joined(head, map(self.expanded, parts))
        if head not in ("forall", "exists"):
            return condition
        numeric = any(each.head in COMPLEMENT for each in parts[1].walk())
        if not numeric and head == "exists":
            return condition
        body = self.expanded(parts[1])
        variables = variables_of(parts[0])
        if not numeric and prod(len(self.of_kind(kind)) for kind in variables.values()) > FEW:
            return listed(condition.parts[0], parts[0], body)
        rows = self.bindings(variables, conjuncts(body) if head == "exists" else ())
        if len(rows) * max(len(conjuncts(body)), 1) > 20_000:  # conditions: more would not be grounded
            raise UnsuitedError
        each = (self.simplified(body, row) for row in rows)
        return joined({"forall": "and", "exists": "or"}[head], each)


def bound_terms(expression: Expression, bound: Mapping[str, str]) -> Expression:
    """Return a numeric expression with the arguments of its functions replaced."""
    if expression.word:
        return expression
    if expression.head in OPERATIONS:
        return expression._replace(
            parts=(expression.parts[0], *(bound_terms(part, bound) for part in expression.parts[1:]))
        )
    words = (part._replace(word=bound.get(part.word, part.word)) for part in expression.parts[1:])
    return expression._replace(parts=(expression.parts[0], *words))


def relation(
    atom: Expression, rows: Iterable[Sequence[str]], variables: Container[str]
) -> tuple[tuple[str, ...], set[tuple[str, ...]]]:
    """Return the variables of an atom, and the objects for them for which one of the rows satisfies it."""
    words = [part.word for part in atom.parts[1:]]
    names = tuple(dict.fromkeys(word for word in words if word in variables))
    found = set()
    for row in rows:
        bound: dict[str, str] = {}
        for word, value in zip(words, row, strict=True):
            if word.startswith("?"):
                if bound.setdefault(word, value) != value:
                    break
            elif word != value:
                break
        else:
            found.add(tuple(bound[name] for name in names))
    return names, found


def literal_number(expression: Expression) -> Number | None:
    """Return the number that an expression is whatever the objects are; None if it reads a function."""
    if expression.word:
        return number(expression.word)
    if terms_of(expression):
        return None
    try:
        return value_of(expression, lambda _: 0)
    except ArithmeticError:
        return None
