"""Derived predicates that depend on themselves within a condition for all objects, which the translator refuses.

It writes such a condition as "there is no object without it", a negation, through which nothing may depend on itself.
But there are finitely many objects: what holds for all of them is a conjunction, which only grows as facts are derived,
so that the least fixed point of the rules exists as without it. Here the condition gets a derived predicate of its own,
with a further argument for each quantified variable, and the conjunction of its atoms stands in its place. No negation
is taken out: what depends on its own negation still does, and is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from math import prod

from .conditions import free_variables, substituted, variables_of
from .declarations import OBJECT, Symbol, Typed, refuse
from .formulas import listed, word
from .instances import Expression
from .reader import Reading, Rule

MOST_OBJECTS = 10_000
"""Largest number of combinations of objects for which a condition is written out."""


def without_recursive_quantifiers(reading: Reading) -> Reading:
    """Return a reading in which no derived predicate depends on itself within a condition for all objects."""
    domain = reading.domain
    rules = _Rules(reading)
    entries = [
        replace(each, condition=rules.formula(each, each.condition, {}, holds=True)) if isinstance(each, Rule) else each
        for each in domain.entries
    ]
    if not rules.added:
        return reading
    added = {
        rule.head.name: replace(
            rule.head, parameters=tuple(replace(each, kinds=(OBJECT,)) for each in rule.head.parameters)
        )
        for rule in rules.added
    }
    return replace(
        reading,
        domain=replace(
            domain,
            constants=reading.objects,  # which the rules name
            predicates={**domain.predicates, **added},
            entries=(*entries, *rules.added),
        ),
        problem=replace(reading.problem, objects={}),
    )


class _Rules:
    """The rules of a reading, and those that are `added` for conditions that are written out."""

    def __init__(self, reading: Reading) -> None:
        self.reading = reading
        self.added: list[Rule] = []
        reads: dict[str, set[str]] = {}
        for rule in reading.domain.rules:
            reads.setdefault(rule.head.name, set()).update(each.head for each in rule.condition.walk())
        self.below = {name: reads.keys() & names for name, names in reads.items()}
        """By derived predicate: those that its rules read, directly or not."""
        for middle in reads:
            for name, names in self.below.items():
                if middle in names:
                    self.below[name] = names | self.below[middle]

    def formula(self, rule: Rule, formula: Expression, kinds: Mapping[str, str], *, holds: bool) -> Expression:
        """Return a part of a rule's condition that has to hold, or not to hold, in which nothing is to be refused.

        `kinds` are the types of the quantified variables around it.
        """
        head, parts = formula.head, formula.parts[1:]
        if head in ("and", "or", "not", "imply"):
            turned = [head == "not" or (head == "imply" and place == 0) for place in range(len(parts))]
            inner = (
                self.formula(rule, part, kinds, holds=holds != turn) for part, turn in zip(parts, turned, strict=True)
            )
            return listed(formula.parts[0], *inner)
        if head not in ("forall", "exists"):
            return formula
        own = variables_of(parts[0])
        body = self.formula(rule, parts[1], {**kinds, **own}, holds=holds)
        recursive = any(rule.head.name in self.below.get(each.head, ()) for each in parts[1].walk())
        if (head == "forall") is not holds or not recursive:
            return listed(*formula.parts[:2], body)
        found = self._written_out(rule, formula, body if holds else listed(word("not"), body), {**kinds, **own})
        return found if holds else listed(word("not"), found)

    def _written_out(self, rule: Rule, formula: Expression, body: Expression, kinds: Mapping[str, str]) -> Expression:
        """Return the conjunction of a new predicate's atoms, whose rule has the body as condition."""
        own, place = variables_of(formula.parts[1]), rule.head.place
        objects = [self.reading.of_kind(kind) for kind in own.values()]
        if prod(map(len, objects)) > MOST_OBJECTS:
            refuse(self.reading.instance.domain, place, f"'{rule.head.name}' depends on itself within (forall ...), "
                   f"for more than {MOST_OBJECTS} combinations of objects; expected fewer")  # fmt: skip
        outer = [name for name in free_variables(body) if name not in own]
        of_rule = {each.name: each for each in rule.head.parameters}
        typed = [of_rule.get(name) or Typed(name, (kinds[name],), place) for name in (*outer, *own)]
        name = (
            f"new-axiom@for-all-{len(self.added) + 1}"  # facts of such names are not shown, as those of the translator
        )
        self.added.append(Rule(Symbol(name, tuple(typed), place), body))
        atom = listed(word(name), *map(word, outer), *map(word, own))
        return listed(word("and"), *(substituted(atom, dict(zip(own, row, strict=True))) for row in product(*objects)))
