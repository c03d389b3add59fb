"""A grounded task with the names and numbers of the file, instead of those of its compilation.

Parameters that the compilation added are left out of the actions. An action whose cost depends on the state then
occurs several times in `Task.actions`, once for each cost. No two of these are applicable in the same state, since the
state determines the cost.
"""

from __future__ import annotations

import re
from dataclasses import replace

from ..pddl.compilation import Compilation
from .task import Task


def in_the_files_terms(task: Task, compilation: Compilation) -> Task:
    """Return a task that was grounded from a compilation with the names, numbers and unit of cost of the file."""
    if not compilation.actions and not compilation.numbers:
        return task if task.unit == compilation.unit else replace(task, unit=compilation.unit)
    named = [_action(action, compilation) for action in task.actions]
    priced = list(zip(named, task.costs, strict=True))
    kept = sorted(set(priced))
    number = {action: place for place, action in enumerate(kept)}
    return replace(
        task,
        variables=tuple(
            replace(variable, facts=tuple(_fact(fact, compilation) for fact in variable.facts))
            for variable in task.variables
        ),
        actions=tuple(name for name, _ in kept),
        costs=tuple(cost for _, cost in kept),
        operators=tuple(replace(one, action=number[priced[one.action]]) for one in task.operators),
        unit=compilation.unit,
    )


def _action(action: str, compilation: Compilation) -> str:
    name, *arguments = action[1:-1].split()
    if name not in compilation.actions:
        return action
    own, parameters = compilation.actions[name]
    return f"({' '.join([own, *arguments[:parameters]])})"


def _fact(fact: str, compilation: Compilation) -> str:
    """Return a fact in the translator's notation; that of a function is `Atom stock(bin-1) = 3`."""
    found = re.fullmatch(r"(Negated)?Atom ([^()]+)\((.*)\)", fact)
    if found is None or found[2] not in compilation.numbers:
        return fact
    function, shown = compilation.numbers[found[2]]
    *arguments, value = found[3].split(", ")
    return f"{found[1] or ''}Atom {function}({', '.join(arguments)}) = {shown[value]}"
