"""Assignments to a variable that are written as one effect for each of its old values.

The translator has no assignment. `(assign (load) 0)` is compiled to "for each value: if it is the old one, replace it".
Of this it makes conditional effects: as many as the variable has other values, all with the same new one. Together they
are the effect without a condition on the old value, since one of the values is always the old one. Fast Downward has
more heuristics for operators without conditional effects, and the sweep has fewer moves.
"""

from __future__ import annotations

from dataclasses import replace

from .task import Effect, Fact, Operator, Task


def with_plain_assignments(task: Task) -> Task:
    """Return a task with the same transitions, in which each assignment is one effect."""
    sizes = task.sizes
    return replace(task, operators=tuple(_plain(operator, sizes) for operator in task.operators))


def _plain(operator: Operator, sizes: list[int]) -> Operator:
    if not any(effect.conditions for effect in operator.effects):
        return operator
    of: dict[int, list[Effect]] = {}
    for effect in operator.effects:
        of.setdefault(effect.variable, []).append(effect)
    effects: list[Effect] = []
    for variable, own in of.items():
        effects += _joined(variable, own, sizes[variable])
    return replace(operator, effects=tuple(effects))


def _joined(variable: int, effects: list[Effect], size: int) -> list[Effect]:
    """Return the effects on a variable; those that differ in its old value only, and have all, are one."""
    values = {effect.value for effect in effects}
    if len(values) > 1:  # which of them counts may depend on their order
        return effects
    (value,) = values
    others: dict[tuple[Fact, ...], set[int]] = {}
    for effect in effects:
        rest = tuple(fact for fact in effect.conditions if fact[0] != variable)
        own = {fact[1] for fact in effect.conditions if fact[0] == variable}
        others.setdefault(rest, set()).update(own or range(size))
    if any(len(old | {value}) < size for old in others.values()):
        return effects
    return [Effect(rest, variable, value) for rest in others]
