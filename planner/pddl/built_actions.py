"""The parts of an action that was built in Python: what is read and changed, and when.

An action without a duration has no times; None stands for each of them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from unified_planning.model import Action, Effect, FNode, Problem, TimeInterval, Timing

Condition: TypeAlias = "tuple[TimeInterval | None, FNode]"
"""A condition, and when it has to hold."""
Change: TypeAlias = "tuple[Timing | None, Effect]"
"""An effect, and when it is made."""


def lasts(action: Action) -> bool:
    """Return whether an action has a duration."""
    from unified_planning.model import DurativeAction

    return isinstance(action, DurativeAction)


def is_temporal(problem: Problem) -> bool:
    """Return whether an action of a problem has a duration."""
    return any(map(lasts, problem.actions))


def conditions(action: Action) -> list[Condition]:
    """Return the conditions of an action."""
    if lasts(action):
        return [(interval, each) for interval, several in action.conditions.items() for each in several]
    return [(None, each) for each in action.preconditions]


def effects(action: Action) -> list[Change]:
    """Return the effects of an action."""
    if lasts(action):
        return [(timing, each) for timing, several in action.effects.items() for each in several]
    return [(None, each) for each in action.effects]


def rebuild(action: Action, read: Iterable[Condition], changed: Iterable[Change]) -> None:
    """Give an action other conditions and effects."""
    changed = list(changed)
    if lasts(action):
        action.clear_conditions()
        action.clear_effects()
        for interval, condition in read:
            action.add_condition(interval, condition)
        for timing, effect in changed:
            action._add_effect_instance(timing, effect)
        return
    action.clear_preconditions()
    action.clear_effects()
    for _, condition in read:
        action.add_precondition(condition)
    for _, effect in changed:
        action._add_effect_instance(effect)
