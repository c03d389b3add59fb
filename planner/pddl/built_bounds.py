"""Bounds of types of problems that were built in Python, such as `IntType(0, 9)`, as conditions of actions.

PDDL has no bounds. An action that would leave them is not applicable, so that each bound becomes a condition on the
values before the action. unified-planning's own compiler of bounded types asks for the bounds of all fluents before
each action instead, so that states beyond the bounds are reached, and then are dead ends.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import built_actions
from .instances import PDDLError

if TYPE_CHECKING:
    from unified_planning.model import Action, Effect, Fluent, FNode, Problem

MOST_TOGETHER = 6
"""Largest number of other effects of an action that may be on the same number; each doubles the conditions."""


def bounds(fluent: Fluent) -> tuple[Any, Any]:
    """Return the least and the largest value of a fluent by its type; None for what is not bounded."""
    kind = fluent.type
    return (kind.lower_bound, kind.upper_bound) if kind.is_int_type() or kind.is_real_type() else (None, None)


def add_bounds(problem: Problem, named: Path) -> None:
    """Add conditions to the actions of a problem that keep each number within the bounds of its type.

    A `PDDLError` about the file `named` refuses an action with too many effects that may be on the same number.
    """
    static = problem.get_static_fluents()
    bounded = {each for each in problem.fluents if each not in static and bounds(each) != (None, None)}
    for action in problem.actions:
        changes = built_actions.effects(action)
        if any(effect.fluent.fluent() in bounded for _, effect in changes):
            _bound(problem, action, changes, bounded, named)


def _bound(
    problem: Problem, action: Action, changes: list[built_actions.Change], bounded: set[Fluent], named: Path
) -> None:
    """Add the bounds of the numbers that an action changes to its conditions."""
    from unified_planning.model import TimePointInterval

    read = built_actions.conditions(action)
    for timing, effect in changes:
        if effect.fluent.fluent() not in bounded:
            continue
        together = [
            part for time, other in changes if time == timing and other.fluent.fluent() == effect.fluent.fluent()
            for part in other.expand_effect(problem)
        ]  # fmt: skip
        for part in effect.expand_effect(problem):
            others = list(together)
            others.remove(part)
            sure, perhaps = _same(problem, part, others)
            if len(perhaps) > MOST_TOGETHER:
                message = f"action '{action.name}' has {len(perhaps) + 1} effects that may be on the same {part.fluent}"
                raise PDDLError(named, None, f"{message}; expected at most {MOST_TOGETHER + 1}, or an unbounded type")
            when = None if timing is None else TimePointInterval(timing)
            read += [(when, condition) for condition in _conditions(part, sure, perhaps)]
    built_actions.rebuild(action, read, changes)


def _same(problem: Problem, part: Effect, others: Iterable[Effect]) -> tuple[list[Effect], list[tuple[FNode, Effect]]]:
    """Return the additions that are surely on the same number as an effect, and others, each with its condition."""
    make = problem.environment.expression_manager
    sure: list[Effect] = []
    perhaps: list[tuple[FNode, Effect]] = []
    for other in others:
        if part.is_assignment() or other.is_assignment():
            continue
        pairs = zip(part.fluent.args, other.fluent.args, strict=True)
        same = make.And([make.Equals(*pair) for pair in pairs]).simplify()
        if same.is_true() and other.condition.is_true():
            sure.append(other)
        elif not same.is_false():
            perhaps.append((make.And(other.condition, same), other))
    return sure, perhaps


def _conditions(part: Effect, sure: list[Effect], perhaps: list[tuple[FNode, Effect]]) -> Iterable[FNode]:
    """Yield the conditions under which an effect, with others that are on the same number, stays within the bounds."""
    make = part.environment.expression_manager
    for chosen in itertools.product((True, False), repeat=len(perhaps)):
        made = [match if one else make.Not(match) for (match, _), one in zip(perhaps, chosen, strict=True)]
        also = [other for (_, other), one in zip(perhaps, chosen, strict=True) if one]
        within = _within(part.fluent, _value(part, [*sure, *also]))
        yield make.Implies(make.And(part.condition, *made), within)


def _value(part: Effect, others: Iterable[Effect]) -> FNode:
    """Return the value of a number after effects on it."""
    make = part.environment.expression_manager
    if part.is_assignment():
        return part.value
    amounts = [make.Times(-1, each.value) if each.is_decrease() else each.value for each in (part, *others)]
    return make.Plus(part.fluent, *amounts)


def _within(number: FNode, value: FNode) -> FNode:
    """Return the condition that a value is within the bounds of a number's type."""
    make = number.environment.expression_manager
    low, high = bounds(number.fluent())
    limits = [] if low is None else [make.GE(value, low)]
    return make.And(*limits, *([] if high is None else [make.LE(value, high)]))
