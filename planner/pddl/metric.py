"""What a problem minimizes, as weights of time and of functions, and the costs of actions as whole numbers.

Without a metric, the cost is the sum of durations in a domain with durative actions, where an action without a duration
costs 1; elsewhere each action costs 1. A metric is a linear expression of `(total-time)`, `(total-cost)` and functions
that only grow, with weights of 0 or more. The values with which these begin are constants, and no part of the cost.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import lcm

from .declarations import refuse, shown
from .instances import Expression
from .numeric_expressions import Number, applied, number
from .reader import DurativeAction, Reading

TIME = "total-time"
COST = "total-cost"


@dataclass(frozen=True)
class Metric:
    """What is minimized.

    `plain` is the cost of an action without a duration, apart from what it changes; `time` is the weight of durations;
    `weights` are those of functions with their arguments. `notes` say what was assumed.
    """

    plain: Number
    time: Number
    weights: Mapping[tuple[str, ...], Number]
    notes: tuple[str, ...] = ()

    @property
    def functions(self) -> frozenset[str]:
        """The functions that matter."""
        return frozenset(name for name, *_ in self.weights)


def of_reading(reading: Reading, changing: frozenset[str]) -> Metric:
    """Return what a reading's problem minimizes; `changing` are the functions that an action changes."""
    durative = any(isinstance(each, DurativeAction) for each in reading.domain.entries)
    ignored = COST in changing
    if reading.problem.metric is None:
        costs = "; the declared costs of actions are ignored, since there is no metric" if ignored else ""
        if durative:
            return Metric(1, 1, {}, (f"no metric: the cost is the sum of durations{costs}",))
        return Metric(1, 0, {}, (f"no metric: each action costs 1{costs}",) if ignored else ())
    expression = reading.problem.minimized
    if expression is None:
        return Metric(0, 0, {(COST,): 1})
    time: Number = 0
    weights: dict[tuple[str, ...], Number] = {}
    for term, weight in _linear(reading, expression, changing).items():
        if term == ("",):
            continue
        if weight < 0:
            refuse(reading.instance.problem, expression, f"the metric subtracts '({' '.join(term)})'; expected weights "
                   "of 0 or more, since costs are minimized")  # fmt: skip
        if term == (TIME,) and TIME not in changing:
            time = weight
        elif term[0] in changing and weight:
            weights[term] = weight
    if time and not durative:
        notes = ("no durative actions: each action takes a time of 1",)
        return Metric(time, 0, weights, notes)
    return Metric(0, time, weights)


def _linear(reading: Reading, expression: Expression, changing: frozenset[str]) -> dict[tuple[str, ...], Number]:
    """Return the weights of the changing terms of an expression; that of the key `("",)` is its constant."""
    if (literal := number(expression.word)) is not None:
        return {("",): literal}
    head, parts = expression.head, expression.parts[1:]
    if head not in ("+", "-", "*", "/"):
        term = tuple(part.word for part in expression.parts)
        if head in changing or term in ((TIME,), (COST,)):
            return {term: 1}
        if term not in reading.problem.values:
            refuse(reading.instance.problem, expression, f"the metric reads '{expression}', which has no value and "
                   "which no action changes; expected a value in (:init ...)")  # fmt: skip
        return {("",): reading.problem.values[term]}
    sides = [_linear(reading, part, changing) for part in parts]
    if head == "+":
        return _sum(sides)
    if head == "-":
        minus = [{term: -weight for term, weight in side.items()} for side in sides]
        return _sum(minus if len(sides) == 1 else [sides[0], *minus[1:]])
    factors = [side for side in sides if set(side) <= {("",)}]
    varying = [side for side in sides if not set(side) <= {("",)}]
    if len(varying) > 1 or (head == "/" and sides[0] not in varying and varying):
        refuse(reading.instance.problem, expression, f"the metric is not linear: {shown(expression)}; expected a sum "
               "of functions with constant weights")  # fmt: skip
    if head == "/" and not factors[-1].get(("",), 0):
        refuse(reading.instance.problem, expression, f"the metric divides by zero: {shown(expression)}")
    base = varying[0] if varying else factors.pop(0)
    factor = applied(head, [1, *(side.get(("",), 0) for side in factors)])
    return {term: applied("*", [weight, factor]) for term, weight in base.items()}


def _sum(sides: Iterable[Mapping[tuple[str, ...], Number]]) -> dict[tuple[str, ...], Number]:
    found: dict[tuple[str, ...], Number] = {}
    for side in sides:
        for term, weight in side.items():
            found[term] = found.get(term, 0) + weight
    return found


def unit(costs: Iterable[Number]) -> Fraction:
    """Return the unit in which all costs are whole numbers: one by their least common denominator."""
    return Fraction(1, lcm(*{cost.denominator for cost in costs}))
