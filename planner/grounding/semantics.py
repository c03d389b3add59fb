"""Reference semantics of a grounded task: plans and successors, one action at a time.

This module is independent of all code that computes costs-to-go. It uses neither packed states nor split operators,
only the operators and axioms of the translator.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ..system.errors import MismatchError
from .task import Effect, Fact, Operator, Task


def replay(task: Task, plan: Sequence[str]) -> int:
    """Execute a plan, ground actions as `(name arg ...)`, from the initial state, and return its cost.

    The cost is a multiple of the task's `unit`. An unknown or inapplicable action, or a goal that does not hold at the
    end, raises a `MismatchError`.
    """
    return sum(steps_along(task, plan)[1])


def steps_along(task: Task, plan: Sequence[str]) -> tuple[list[list[int]], list[int]]:
    """Return the states of a plan, from the initial state to a goal state, and the cost of each step.

    Costs and errors are as in `replay`.
    """
    states, costs = _executed(task, plan, task.initial)
    state = states[-1]
    missing = [task.variables[variable].facts[value] for variable, value in task.goal if state[variable] != value]
    if missing:
        raise MismatchError(f"the goal does not hold after the plan: {', '.join(missing)}")
    return states, costs


def plan_cost(task: Task, plan: Sequence[str], state: Sequence[int] | None = None) -> int:
    """Return the cost of a plan, a multiple of the task's `unit`.

    If costs depend on the state, the plan is executed from the given state, by default the initial one; an action that
    is not applicable then raises a `MismatchError`.
    """
    if len(task.numbers_of) == len(task.actions):
        return sum(task.costs[task.numbers_of[action][0]] for action in plan)
    return sum(_executed(task, plan, task.initial if state is None else state)[1])


def _executed(task: Task, plan: Sequence[str], start: Sequence[int]) -> tuple[list[list[int]], list[int]]:
    """Return the states along a plan from a state, and the cost of each step."""
    states, costs = [derived(task, start)], list[int]()
    for step, name in enumerate(plan):
        if name not in task.numbers_of:
            raise MismatchError(f"step {step}: {name} is no action of the task")
        numbers, state = task.numbers_of[name], states[-1]
        operator = next((o for o in task.operators if o.action in numbers and _hold(o.preconditions, state)), None)
        if operator is None:
            raise MismatchError(f"step {step}: {name} is not applicable")
        states.append(derived(task, _applied(operator, state)))
        costs.append(task.costs[operator.action])
    return states, costs


def successors(task: Task, state: Sequence[int]) -> dict[int, list[int]]:
    """Return the state after each applicable action, by actions in ascending order.

    States are the values of all variables, derived ones included. If several operators of an action apply, the first
    one counts.
    """
    first: dict[int, Operator] = {}
    for operator in task.operators:
        if operator.action not in first and _hold(operator.preconditions, state):
            first[operator.action] = operator
    return {action: derived(task, _applied(operator, state)) for action, operator in sorted(first.items())}


def derived(task: Task, state: Sequence[int]) -> list[int]:
    """Return the state with its derived variables, evaluated layer by layer to the least fixed point."""
    values = [
        value if variable.axiom_layer < 0 else default
        for value, default, variable in zip(state, task.initial, task.variables, strict=True)
    ]
    layers: dict[int, list[Effect]] = {}
    for axiom in task.axioms:
        layers.setdefault(task.variables[axiom.variable].axiom_layer, []).append(axiom)
    for layer in sorted(layers):
        changed = True
        while changed:
            changed = False
            for axiom in layers[layer]:
                if values[axiom.variable] != axiom.value and _hold(axiom.conditions, values):
                    values[axiom.variable] = axiom.value
                    changed = True
    return values


def _hold(facts: Iterable[Fact], state: Sequence[int]) -> bool:
    return all(state[variable] == value for variable, value in facts)


def _applied(operator: Operator, state: Sequence[int]) -> list[int]:
    after = list(state)
    for effect in operator.effects:
        if _hold(effect.conditions, state):
            after[effect.variable] = effect.value
    return after
