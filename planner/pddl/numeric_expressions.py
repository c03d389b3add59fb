"""Numbers of PDDL, exactly: reading a number, and the value of an expression.

0.1 is a tenth. Numbers are integers where they can be, and fractions elsewhere, which Python compares and hashes alike.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from fractions import Fraction

from .s_expressions import Expression

Number = int | Fraction
"""An exact rational number."""

DURATION = "?duration"
"""The variable for the duration of a durative action."""

OPERATIONS = ("+", "-", "*", "/")


class NoValueError(ArithmeticError):
    """An expression has no value: a function has none for its arguments."""


def whole(value: Number) -> Number:
    """Return the number as an integer if it is one."""
    return int(value) if value.denominator == 1 else value


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
            raise NoValueError(expression.word)
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
