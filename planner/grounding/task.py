"""The grounded finite-domain task.

A frozen `Task` consists of variables with finitely many values, ground actions with their costs, operators as
preconditions and (conditional) effects, axioms, the initial state and the goal, all numbered. It is the SAS+
representation of Fast Downward's translator (Bäckström and Nebel 1995; Helmert, "Concise finite-domain representations
for PDDL planning tasks", 2009). It is read once and never changed. The SAS text for Fast Downward's search is generated
from these fields, so that a task with replaced fields is consistent everywhere.

The functions at the end are the reference semantics: plans and successors, one action at a time. They are independent
of all code that computes costs-to-go. They use neither packed states nor split operators, only the operators and axioms
of the translator.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from numbers import Integral
from pathlib import Path
from typing import overload

import numpy as np
from numpy.typing import NDArray

from ..pddl import instances
from ..system.errors import MismatchError
from ..system.results import Pictured

Fact = tuple[int, int]
"""A variable and one of its values."""


@dataclass(frozen=True)
class Variable:
    """A finite-domain variable; `facts[v]` is the meaning of value `v` in the translator's notation.

    The notation is `Atom on(a, b)`, `NegatedAtom on(a, b)`, or `<none of those>`.

    The axiom layer of a derived variable is 0 or more, that of a primary variable -1.

    Attributes
    ----------
    name : str
    facts : tuple of str
    axiom_layer : int
    """

    name: str
    facts: tuple[str, ...]
    axiom_layer: int


@dataclass(frozen=True)
class Effect:
    """The assignment `variable := value`, made if all conditions hold in the state before.

    Attributes
    ----------
    conditions : tuple of Fact
    variable, value : int
    """

    conditions: tuple[Fact, ...]
    variable: int
    value: int


@dataclass(frozen=True)
class Operator:
    """One way to apply a ground action; a disjunctive precondition gives an action several.

    Attributes
    ----------
    action : int
        Number of the ground action.
    preconditions : tuple of Fact
    effects : tuple of Effect
    """

    action: int
    preconditions: tuple[Fact, ...]
    effects: tuple[Effect, ...]


def _is_cost(cost: object) -> bool:
    """Return whether something is a cost: a whole number of 0 or more."""
    return isinstance(cost, Integral) and int(cost) >= 0


@dataclass(frozen=True)
class Task(Pictured):
    """A grounded planning task.

    Attributes
    ----------
    instance : Instance
        Files of the task. For a problem that was built in Python, these files do not exist.
    variables : tuple of Variable
    actions : tuple of str
        Ground actions as `(name arg ...)`, sorted. An action occurs once for each cost that it may have; in each state
        at most one of these is applicable.
    costs : tuple of int
        The cost of each action, a multiple of `unit`: its PDDL cost, or 1 where the problem has no metric.
    operators, axioms : tuple
        Operators, and axioms as effects on derived variables.
    initial : tuple of int
        Value of each variable; for a derived variable, its value when no axiom applies.
    goal : tuple of Fact
    mutexes : tuple of tuple of Fact
        Groups of facts such that operators preserve that at most one of each group holds. They are used only to speed
        up searches.
    note : str or None
        What the user should know: that unified-planning has not validated the files, or what was assumed.
    unit : Fraction
        Cost in the file's unit that a cost of 1 stands for. It is 1 unless the file has decimals.
    """

    instance: instances.Instance
    variables: tuple[Variable, ...]
    actions: tuple[str, ...]
    costs: tuple[int, ...]
    operators: tuple[Operator, ...]
    axioms: tuple[Effect, ...]
    initial: tuple[int, ...]
    goal: tuple[Fact, ...]
    mutexes: tuple[tuple[Fact, ...], ...] = ()
    note: str | None = None
    unit: Fraction = Fraction(1)

    def __repr__(self) -> str:
        return f"<Task {self.name}: {len(self.actions):,} actions, {len(self.variables):,} variables>"

    def __post_init__(self) -> None:
        """Check the costs, the initial state and the goal."""
        if not all(map(_is_cost, self.costs)):
            raise ValueError(f"costs {self.costs!r:.40}: expected whole numbers of 0 or more")
        if len(self.costs) != len(self.actions):
            raise ValueError(f"{len(self.costs)} costs; expected one for each of the {len(self.actions)} actions")
        if len(self.initial) != len(self.variables):
            raise ValueError(f"an initial state of {len(self.initial)} values; expected {len(self.variables)}")
        if self.unit <= 0:
            raise ValueError(f"a unit of {self.unit}; expected more than 0")
        for where, facts in (("initial state", enumerate(self.initial)), ("goal", self.goal)):
            for variable, value in facts:
                if not 0 <= variable < len(self.variables):
                    raise ValueError(f"{where}: variable {variable}; expected 0 to {len(self.variables) - 1}")
                size = len(self.variables[variable].facts)
                if not 0 <= value < size:
                    raise ValueError(f"{where}: value {value} of variable {variable}; expected 0 to {size - 1}")

    @property
    def name(self) -> str:
        """The problem file's name without its ending."""
        return Path(self.instance.problem).stem

    @property
    def sizes(self) -> list[int]:
        """Number of values of each variable."""
        return [len(variable.facts) for variable in self.variables]

    @property
    def decided_by_translator(self) -> bool:
        """Whether the translator decided the task and dropped its states.

        This happens if the goal is unreachable even when delete effects are ignored, or if it consists of facts that
        always hold. The result is a dummy task of one state; `astar` tells the two cases apart.
        """
        dummy = [("Atom dummy(val1)", "Atom dummy(val2)")]
        return not self.operators and [variable.facts for variable in self.variables] == dummy

    @cached_property
    def beyond(self) -> tuple[Fact, ...]:
        """The facts that a number has left the values that were tried for it, as no bound is proven (`astar`).

        Without such facts the task is exact. With them it is not swept; its states are solved on demand.
        """
        return tuple(
            (number, value)
            for number, variable in enumerate(self.variables)
            for value, fact in enumerate(variable.facts)
            if fact.startswith("Atom ") and fact.endswith(") = beyond")
        )

    @cached_property
    def sas(self) -> str:
        """The task as SAS text (file format version 3), for Fast Downward's search and `from_sas`."""
        return _rendered(self)

    @cached_property
    def reduced(self) -> Task:
        """The task with costs divided by their greatest common divisor."""
        divisor = math.gcd(*self.costs)
        return self if divisor <= 1 else replace(self, costs=tuple(cost // divisor for cost in self.costs))

    @cached_property
    def numbers_of(self) -> dict[str, tuple[int, ...]]:
        """The numbers of each ground action, by its text; several if its cost depends on the state."""
        found: dict[str, tuple[int, ...]] = {}
        for number, action in enumerate(self.actions):
            found[action] = (*found.get(action, ()), number)
        return found

    @cached_property
    def first_of_name(self) -> NDArray[np.int32]:
        """For each action, the number of the first action of the same name, shape (actions,); read-only.

        As an action occurs several times only if its cost depends on the state, these are the actions that a person
        tells apart.
        """
        found = np.array([self.numbers_of[action][0] for action in self.actions], dtype=np.int32)
        found.flags.writeable = False
        return found

    @cached_property
    def most_at_once(self) -> int:
        """A number of actions of which no state has more: the most that may apply at any value of some variable."""
        names, found = self.first_of_name.tolist(), len(set(self.actions))
        for variable, size in enumerate(self.sizes):
            each: list[set[int]] = [set() for _ in range(size)]
            for operator in self.operators:
                value = dict(operator.preconditions).get(variable)
                for some in each if value is None else each[value : value + 1]:
                    some.add(names[operator.action])
            found = min(found, max(map(len, each)))
        return found

    @cached_property
    def action_costs(self) -> NDArray[np.float64]:
        """The cost of each action in the file's unit, shape (actions,); read-only."""
        costs = np.asarray(self.in_unit(np.array(self.costs, dtype=np.float64)))
        costs.flags.writeable = False
        return costs

    @overload
    def in_unit(self, whole: NDArray[np.float64]) -> NDArray[np.float64]: ...

    @overload
    def in_unit(self, whole: float) -> float: ...

    def in_unit(self, whole: NDArray[np.float64] | float) -> NDArray[np.float64] | float:
        """Return costs in the file's unit, from multiples of `unit` (`in_unit`)."""
        return in_unit(whole, self.unit)

    def facts(self, values: Sequence[int]) -> list[str]:
        """Return the PDDL atoms that hold in a state, among those that can change, sorted.

        Atoms that the translator invents for quantified conditions are none of them.
        """
        facts = (variable.facts[value] for variable, value in zip(self.variables, values, strict=True))
        return sorted(fact.removeprefix("Atom ") for fact in facts if re.match(r"Atom (?!new-axiom@)", fact))


@overload
def in_unit(whole: NDArray[np.float64], unit: Fraction) -> NDArray[np.float64]: ...


@overload
def in_unit(whole: float, unit: Fraction) -> float: ...


def in_unit(whole: NDArray[np.float64] | float, unit: Fraction) -> NDArray[np.float64] | float:
    """Return costs in the file's unit, from multiples of `unit`: a number, or an array of any shape.

    Each is the nearest floating-point number if it stays below 2^53 when multiplied by the numerator of `unit`.
    """
    return whole if unit == 1 else whole * unit.numerator / unit.denominator


def pddl_fact(fact: str) -> str:
    """Return the meaning of a variable's value in PDDL notation; `<none of those>` is returned unchanged.

    The value of a function is `(= (stock bin-1) 3)`.
    """
    match = re.fullmatch(r"(Negated)?Atom ([^()]+)\(([^()]*)\)(?: = (.*))?", fact)
    if match is None:
        return fact
    atom = f"({' '.join([match[2], *(match[3].split(', ') if match[3] else [])])})"
    if match[4] is not None:
        atom = f"(= {atom} {match[4]})"
    return f"(not {atom})" if match[1] else atom


def _rendered(task: Task) -> str:
    """Return a task as the SAS text that `from_sas` reads."""

    def listed(facts: Sequence[Fact]) -> list[str]:
        return [str(len(facts)), *(f"{variable} {value}" for variable, value in facts)]

    has_costs = any(cost != 1 for cost in task.costs)
    lines = ["begin_version", "3", "end_version", "begin_metric", str(int(has_costs)), "end_metric"]
    lines.append(str(len(task.variables)))
    for variable in task.variables:
        lines += ["begin_variable", variable.name, str(variable.axiom_layer), str(len(variable.facts))]
        lines += [*variable.facts, "end_variable"]
    # A mutex group is valid only if it is satisfied in the initial state.
    initial = set(enumerate(task.initial))
    groups = [group for group in task.mutexes if len(initial.intersection(group)) <= 1]
    lines.append(str(len(groups)))
    for group in groups:
        lines += ["begin_mutex_group", *listed(group), "end_mutex_group"]
    lines += ["begin_state", *map(str, task.initial), "end_state", "begin_goal"]
    # In another order, Fast Downward's h^m landmarks, which do not sort the goal as they sort preconditions, are wrong.
    lines += [*listed(sorted(set(task.goal))), "end_goal"]
    lines.append(str(len(task.operators)))
    for operator in task.operators:
        # The precondition on a variable that changes is written with its effects, the other conditions separately.
        changed, before = {effect.variable for effect in operator.effects}, dict(operator.preconditions)
        lines += ["begin_operator", _name_in_sas(task.actions[operator.action])]
        lines += listed([(v, x) for v, x in operator.preconditions if v not in changed or x != before[v]])
        lines.append(str(len(operator.effects)))
        for effect in operator.effects:
            conditions = "".join(f" {variable} {value}" for variable, value in effect.conditions)
            change = f"{effect.variable} {before.get(effect.variable, -1)} {effect.value}"
            lines.append(f"{len(effect.conditions)}{conditions} {change}")
        lines += [str(task.costs[operator.action]), "end_operator"]
    lines.append(str(len(task.axioms)))
    for axiom in task.axioms:
        lines += ["begin_rule", *listed(axiom.conditions)]
        lines += [f"{axiom.variable} {task.initial[axiom.variable]} {axiom.value}", "end_rule"]
    return "\n".join([*lines, ""])


def _name_in_sas(action: str) -> str:
    """Return an action in the translator's notation, with a space after the name even if it has no arguments."""
    name = action[1:-1]
    return name if " " in name else f"{name} "


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
