"""Conditions in negation normal form, as the compiler of numbers and time uses them.

The connectives are `and`, `or`, `forall` and `exists`; `not` stands before predicates and equalities of objects only.
A comparison of numbers is `<`, `<=`, `>`, `>=`, `==` or `!=`, so that `=` always compares objects. A comparison that
reads a number without a value, or divides by zero, is not satisfied, negated or not. `(failed COMPARISON)` holds where
it is not satisfied.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from functools import lru_cache

from .formulas import COMPARISONS, listed, word
from .instances import Expression
from .numeric_expressions import number, terms_of

TRUE = listed(word("and"))
FALSE = listed(word("or"))
COMPLEMENT = {"<": ">=", ">=": "<", ">": "<=", "<=": ">", "==": "!=", "!=": "=="}
"""The comparison that is true of two numbers where another one is false."""
SIGNS = {"<": {-1}, "<=": {-1, 0}, "==": {0}, "!=": {-1, 1}, ">=": {0, 1}, ">": {1}}
"""The signs of the differences, left minus right, of which a comparison is true."""


def conjunction(parts: Iterable[Expression]) -> Expression:
    """Return a flat conjunction of conditions."""
    found: list[Expression] = []
    for part in parts:
        if part == FALSE:
            return FALSE
        found += part.parts[1:] if part.head == "and" else [part]
    found = list(dict.fromkeys(found))
    return found[0] if len(found) == 1 else listed(word("and"), *found)


def disjunction(parts: Iterable[Expression]) -> Expression:
    """Return a flat disjunction of conditions."""
    found: list[Expression] = []
    for part in parts:
        if part == TRUE:
            return TRUE
        found += part.parts[1:] if part.head == "or" else [part]
    found = list(dict.fromkeys(found))
    return found[0] if len(found) == 1 else listed(word("or"), *found)


def conjuncts(condition: Expression) -> tuple[Expression, ...]:
    """Return the parts of a conjunction; any other condition is its only part."""
    return condition.parts[1:] if condition.head == "and" else (condition,)


def quantified(head: str, variables: Expression, body: Expression) -> Expression:
    """Return a condition under a quantifier; one that does not matter is left out."""
    return body if body in (TRUE, FALSE) or not variables.parts else listed(word(head), variables, body)


def variables_of(listing: Expression) -> dict[str, str]:
    """Return the variables of a typed list `(?a - t ?b - t)` with their types."""
    words = [each.word for each in listing.parts]
    return dict(zip(words[::3], words[2::3], strict=True))


def normal_form(formula: Expression, objects: Container[str], *, holds: bool = True) -> Expression:
    """Return a condition of a file, or its negation, in negation normal form."""
    head, parts = formula.head, formula.parts[1:]
    if head == "not":
        return normal_form(parts[0], objects, holds=not holds)
    if head == "imply":
        sides = normal_form(parts[0], objects, holds=not holds), normal_form(parts[1], objects, holds=holds)
        return disjunction(sides) if holds else conjunction(sides)
    if head in ("and", "or"):
        inner = (normal_form(part, objects, holds=holds) for part in parts)
        return conjunction(inner) if (head == "and") is holds else disjunction(inner)
    if head in ("forall", "exists"):
        head = head if holds else {"forall": "exists", "exists": "forall"}[head]
        return quantified(head, parts[0], normal_form(parts[1], objects, holds=holds))
    numeric = head in COMPARISONS or (
        head == "="
        and any(part.parts or (number(part.word) is not None and part.word not in objects) for part in parts)
    )
    if numeric or (head == "=" and any(part.word == "?duration" for part in parts)):
        comparison = "==" if head == "=" else head
        return formula._replace(parts=(word(comparison if holds else COMPLEMENT[comparison]), *parts))
    return formula if holds else listed(word("not"), formula)


def unsatisfied(condition: Expression) -> Expression:
    """Return the condition that holds exactly where a condition in normal form is not satisfied."""
    head, parts = condition.head, condition.parts[1:]
    if head == "not":
        return parts[0]
    if head in ("and", "or"):
        inner = map(unsatisfied, parts)
        return disjunction(inner) if head == "and" else conjunction(inner)
    if head in ("forall", "exists"):
        return quantified({"forall": "exists", "exists": "forall"}[head], parts[0], unsatisfied(parts[1]))
    if head == "failed":
        return parts[0]
    return listed(word("failed" if head in COMPLEMENT else "not"), condition)


def exclude(one: Expression, other: Expression) -> bool:
    """Whether two conditions surely never hold together, since a part of one is the opposite of a part of the other.

    Comparisons of one expression with numbers are compared, too. What follows from several parts is not considered.
    """
    return any(_opposite(part, each) for part in conjuncts(one) for each in conjuncts(other))


def _opposite(one: Expression, other: Expression) -> bool:
    if str(unsatisfied(one)) == str(other) or str(unsatisfied(other)) == str(one):
        return True
    if one.head not in COMPLEMENT or other.head not in COMPLEMENT or str(one.parts[1]) != str(other.parts[1]):
        return False
    if str(one.parts[2]) == str(other.parts[2]):
        return SIGNS[one.head].isdisjoint(SIGNS[other.head])
    limits = [number(each.parts[2].word) for each in (one, other)]
    if limits[0] is None or limits[1] is None or limits[0] == limits[1]:
        return False
    low, high = (one, other) if limits[0] < limits[1] else (other, one)
    return SIGNS[low.head] <= {-1, 0} and SIGNS[high.head] <= {0, 1}


def comparisons(condition: Expression) -> Iterator[Expression]:
    """Yield the comparisons of numbers within a condition, without `failed` around them."""
    if condition.head in COMPLEMENT:
        yield condition
    elif condition.head in ("and", "or", "failed"):
        for part in condition.parts[1:]:
            yield from comparisons(part)
    elif condition.head in ("forall", "exists"):
        yield from comparisons(condition.parts[2])


def compared_terms(condition: Expression) -> list[Expression]:
    """Return the functions with their arguments that the comparisons within a condition read."""
    return [term for each in comparisons(condition) for side in each.parts[1:] for term in terms_of(side)]


def is_numeric(condition: Expression) -> bool:
    """Whether a condition compares numbers."""
    return next(comparisons(condition), None) is not None


def changed(condition: Expression, leaf: Callable[[Expression], Expression]) -> Expression:
    """Return a condition with each predicate, equality and comparison (also negated ones) replaced by `leaf` of it."""
    head, parts = condition.head, condition.parts[1:]
    if head in ("and", "or"):
        inner = (changed(part, leaf) for part in parts)
        return conjunction(inner) if head == "and" else disjunction(inner)
    if head in ("forall", "exists"):
        return quantified(head, parts[0], changed(parts[1], leaf))
    return leaf(condition)


def substituted(expression: Expression, bound: Mapping[str, str]) -> Expression:
    """Return an expression with variables replaced by words. Quantified variables have names of their own."""
    if expression.word:
        return expression._replace(word=bound[expression.word]) if expression.word in bound else expression
    return expression._replace(parts=tuple(substituted(part, bound) for part in expression.parts))


@lru_cache(100_000)
def free_variables(expression: Expression) -> dict[str, None]:
    """Return the variables of an expression that no quantifier within it binds, in their order."""
    if expression.word:
        return {expression.word: None} if expression.word.startswith("?") else {}
    if expression.head in ("forall", "exists"):
        inner = free_variables(expression.parts[2])
        return {name: None for name in inner if name not in variables_of(expression.parts[1])}
    return {name: None for part in expression.parts for name in free_variables(part)}


def equal(left: Expression, right: Expression) -> Expression:
    """Return the condition that two terms, objects or variables, are the same object."""
    if left.word == right.word:
        return TRUE
    if not left.word.startswith("?") and not right.word.startswith("?"):
        return FALSE
    return listed(word("="), word(left.word), word(right.word))


def same(left: Expression, right: Expression) -> Expression:
    """Return the condition that two atoms of one predicate, or two terms of one function, have the same arguments."""
    return conjunction(map(equal, left.parts[1:], right.parts[1:]))
