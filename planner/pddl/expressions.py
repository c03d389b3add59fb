"""Expressions: exact numbers, and conditions in negation normal form, as the compiler of numbers and time uses them.

0.1 is a tenth. Numbers are integers where they can be, and fractions elsewhere, which Python compares and hashes alike.

The connectives are `and`, `or`, `forall` and `exists`; `not` stands before predicates and equalities of objects only.
A comparison of numbers is `<`, `<=`, `>`, `>=`, `==` or `!=`, so that `=` always compares objects. A comparison that
reads a number without a value, or divides by zero, is not satisfied, negated or not. `(failed COMPARISON)` holds where
it is not satisfied.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from fractions import Fraction
from functools import cache, lru_cache
from types import MappingProxyType

from .instances import Expression

Number = int | Fraction
"""An exact rational number."""

DURATION = "?duration"
"""The variable for the duration of a durative action."""

OPERATIONS = ("+", "-", "*", "/")
COMPARISONS = frozenset({"<", ">", "<=", ">="})


def word(text: str) -> Expression:
    """Return an expression that is a word and has no place."""
    return Expression(text)


def listed(*parts: Expression) -> Expression:
    """Return an expression that is a list and has no place."""
    return Expression("", parts)


def whole(value: Number) -> Number:
    """Return the number as an integer if it is one."""
    return int(value) if value.denominator == 1 else value


@cache
def number(text: str) -> Number | None:
    """Return the number that a word denotes; None if it denotes none."""
    if not re.fullmatch(r"-?(\d+\.?\d*|\.\d+)", text):
        return None
    return whole(Fraction(text))


def value_of(expression: Expression, term: Callable[[Expression], Number]) -> Number:
    """Return the value of a numeric expression. `term` gives the value of a function with its arguments.

    A division by zero raises a `ZeroDivisionError`.
    """
    if expression.word:
        found = number(expression.word)
        if found is None:
            raise ArithmeticError(expression.word)
        return found
    if expression.head not in OPERATIONS:
        return term(expression)
    return applied(expression.head, [value_of(part, term) for part in expression.parts[1:]])


def applied(operation: str, values: list[Number]) -> Number:
    """Return the sum, difference, product or quotient of values; the difference of one value is its negative."""
    found = values[0]
    if operation == "-" and len(values) == 1:
        return -found
    for value in values[1:]:
        if operation == "+":
            found = found + value
        elif operation == "-":
            found = found - value
        elif operation == "*":
            found = found * value
        elif value:
            found = Fraction(found) / value
        else:
            raise ZeroDivisionError
    return whole(found)


def compared(comparison: str, left: Number, right: Number) -> bool:
    """Whether a comparison of two numbers is true."""
    return {
        "<": left < right, "<=": left <= right, ">": left > right, ">=": left >= right,
        "==": left == right, "!=": left != right,
    }[comparison]  # fmt: skip


def terms_of(expression: Expression) -> list[Expression]:
    """Return the functions with their arguments that an expression reads, in the order of the text."""
    if expression.word:
        return []
    if expression.head in OPERATIONS:
        return [each for part in expression.parts[1:] for each in terms_of(part)]
    return [expression]


def linear(
    expression: Expression, static: Callable[[Expression], bool]
) -> tuple[dict[str, tuple[Expression, Number]], Expression] | None:
    """Return an expression as a sum: terms that change with constant factors, by their text, and a static rest.

    Returns None if it is not such a sum. `static` says whether an expression reads nothing that changes.
    """
    zero = Expression("0")
    if static(expression):
        return {}, expression
    head, parts = expression.head, expression.parts[1:]
    if head not in OPERATIONS:
        return {str(expression): (expression, 1)}, zero
    if head in ("*", "/"):
        varying = [part for part in parts if not static(part)]
        factors = [number(part.word) for part in parts if part is not varying[0]]
        if len(varying) > 1 or None in factors or (head == "/" and (varying[0] is not parts[0] or 0 in factors)):
            return None
        factor = applied(head, [1, *(each for each in factors if each is not None)])
        inner = linear(varying[0], static)
        if inner is None:
            return None
        rest = inner[1] if inner[1] == zero else Expression("", (Expression("*"), word_of(factor), inner[1]))
        return {text: (term, factor * by) for text, (term, by) in inner[0].items()}, rest
    sides = [linear(part, static) for part in parts]
    found: dict[str, tuple[Expression, Number]] = {}
    rests = []
    for place, side in enumerate(sides):
        if side is None:
            return None
        sign = -1 if head == "-" and (place > 0 or len(sides) == 1) else 1
        for text, (term, factor) in side[0].items():
            found[text] = term, found.get(text, (term, 0))[1] + sign * factor
        if side[1] != zero:
            rests.append(side[1] if sign == 1 else Expression("", (Expression("-"), side[1])))
    rest = zero if not rests else rests[0] if len(rests) == 1 else Expression("", (Expression("+"), *rests))
    return found, rest


def isolated(
    comparison: Expression, static: Callable[[Expression], bool]
) -> tuple[Expression, str, Expression, Number] | None:
    """Return a comparison of one changing term: the term, how it is compared with - rest / factor, rest, and factor.

    Returns None for other comparisons. Where the factor is 0, the term does not matter.
    """
    split = linear(listed(word("-"), *comparison.parts[1:]), static)
    if split is None or len(split[0]) != 1:
        return None
    ((term, factor),) = split[0].values()
    return term, comparison.head if factor > 0 else MIRRORED[comparison.head], split[1], factor


def word_of(value: Number) -> Expression:
    """Return a number as an expression."""
    if value.denominator == 1:
        return Expression(str(value))
    return Expression("", (Expression("/"), Expression(str(value.numerator)), Expression(str(value.denominator))))


def as_shown(value: Number) -> str:
    """Return a number as text: a decimal where it ends, else a fraction."""
    rest = value.denominator
    for prime in (2, 5):
        while rest % prime == 0:
            rest //= prime
    if rest > 1 or value.denominator > 10**9:
        return str(value)
    digits = 0
    while value * 10**digits % 1:
        digits += 1
    if not digits:
        return str(int(value))
    text = f"{int(abs(value) * 10**digits):0{digits + 1}d}"
    return f"{'-' if value < 0 else ''}{text[:-digits]}.{text[-digits:]}"


ZERO = word("0")
TRUE = listed(word("and"))
FALSE = listed(word("or"))
COMPLEMENT = {"<": ">=", ">=": "<", ">": "<=", "<=": ">", "==": "!=", "!=": "=="}
"""The comparison that is true of two numbers where another one is false."""
MIRRORED = {"<": ">", ">": "<", "<=": ">=", ">=": "<=", "==": "==", "!=": "!="}
"""The comparison that holds for numbers of which another one holds if their signs are changed."""
DUAL = {"and": "or", "or": "and", "forall": "exists", "exists": "forall"}
"""The connective of the negated parts of a condition that is negated."""
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


def joined(head: str, parts: Iterable[Expression]) -> Expression:
    """Return the conjunction or disjunction of conditions, whose head is "and" or "or"."""
    return conjunction(parts) if head == "and" else disjunction(parts)


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


def listing_of(kinds: Mapping[str, str]) -> Expression:
    """Return the typed list of variables with their types."""
    return listed(*(word(text) for name, kind in kinds.items() for text in (name, "-", kind)))


def key(term: Expression, bound: Mapping[str, str] = MappingProxyType({})) -> tuple[str, ...]:
    """Return the words of a term or atom, by which it is compared with others, with objects for bound variables."""
    return tuple(bound.get(part.word, part.word) for part in term.parts)


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
        return joined(head if holds else DUAL[head], inner)
    if head in ("forall", "exists"):
        return quantified(head if holds else DUAL[head], parts[0], normal_form(parts[1], objects, holds=holds))
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
        return joined(DUAL[head], map(unsatisfied, parts))
    if head in ("forall", "exists"):
        return quantified(DUAL[head], parts[0], unsatisfied(parts[1]))
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
        return joined(head, (changed(part, leaf) for part in parts))
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
