"""Conditional effects and axioms as masks on packed states, in the order in which they apply."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..grounding.task import Effect, Fact, Task
from ..states.packing import Packing, Words, can_hold

Masks = tuple[Words, Words, Words, Words]
"""Mask and bits of a rule's condition, then the bits that it clears and those that it sets."""


Rule = tuple[Sequence[Fact], Masks]
"""Condition of a rule as facts, and its masks."""


def possible_operators(task: Task) -> list[int]:
    """Return the operators whose preconditions are consistent, in the order of their actions."""
    possible = [n for n, operator in enumerate(task.operators) if can_hold(operator.preconditions)]
    return sorted(possible, key=lambda number: (task.operators[number].action, number))


def grouped(effects: Sequence[Effect], packing: Packing) -> list[Rule]:
    """Return effects as rules, one for each distinct condition that can hold."""
    groups: dict[tuple[Fact, ...], list[Fact]] = {}
    for effect in effects:
        if can_hold(effect.conditions):
            groups.setdefault(effect.conditions, []).append((effect.variable, effect.value))
    return [(facts, (*packing.condition(facts), *packing.condition(written))) for facts, written in groups.items()]


def axiom_stages(task: Task, packing: Packing) -> Iterator[tuple[list[Rule], bool]]:
    """Yield the stages of a task's axioms: the defaults of derived variables first, then layer by layer."""
    derived = [v for v, variable in enumerate(task.variables) if variable.axiom_layer >= 0]
    if derived:
        nothing = np.zeros(packing.words, dtype=np.uint64)
        yield [((), (nothing, nothing, *packing.condition([(v, task.initial[v]) for v in derived])))], False
    for layer in sorted({task.variables[v].axiom_layer for v in derived}):
        own = [axiom for axiom in task.axioms if task.variables[axiom.variable].axiom_layer == layer]
        yield from _stages(grouped(own, packing))


def _stages(layer: Sequence[Rule]) -> Iterator[tuple[list[Rule], bool]]:
    """Yield a layer's axioms in stages, each after the axioms that it needs, and whether the stage is cyclic."""
    left = list(layer)
    while left:
        open_ = np.bitwise_or.reduce([cleared for _, (_, _, cleared, _) in left])
        later = [bool((masks[0] & open_).any()) for _, masks in left]
        if all(later):
            yield left, True
            return
        yield [rule for rule, waits in zip(left, later, strict=True) if not waits], False
        left = [rule for rule, waits in zip(left, later, strict=True) if waits]
