"""Numbers of PDDL, exactly: reading a number, and the value of an expression.

0.1 is a tenth. Numbers are integers where they can be, and fractions elsewhere, which Python compares and hashes alike.
Numeric fluents of a file are declared in `declarations` and read in `reader` (first values) and `formulas`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from fractions import Fraction
from functools import cache

from .instances import Expression

Number = int | Fraction
"""An exact rational number."""

DURATION = "?duration"
"""The variable for the duration of a durative action."""

OPERATIONS = ("+", "-", "*", "/")


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
