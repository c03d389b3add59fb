"""Tables of several goals of one task, on one enumeration of its states.

The goals are those of problem files that differ in nothing else. One forward search finds the states, and a backward
search for each goal computes the cost-to-go. The translator may order variables by the goal, so that goals are
translated by the meaning of their facts. It keeps the derived variables that a goal needs, and makes one of a goal with
disjunctions or quantifiers: the states are enumerated with the derived variables of all goals. For a negation it
divides variables, so that the files are grounded anew, with a derived predicate as the goal. A task is swept by itself,
and its table numbers the states in its own way, if its goal changes more than that, as one that compares a number of
which only some values are told apart.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

from ..grounding.task import Effect, Fact, Operator, Task, Variable
from ..pddl.compilation import with_derived_goal
from ..pddl.instances import PDDLError
from ..pddl.reader import read
from ..search.numbering import SweepOptions
from ..search.search_space import distances
from ..search.state_space import StateSpace
from ..system.limits import Budget, Deadline, Limits, processors
from ..system.progress import Wanted, shows_progress
from .load import task_of
from .number_values import grounded
from .table import Table, explored, require_sweepable

if TYPE_CHECKING:
    from .load import AnyTask

Meaning = tuple[object, frozenset[object]]
"""A fact with all values of its variable, and the rules on which it depends."""

Grounding = frozenset[tuple[object, ...]]
"""The variables and operators of a task by their meanings."""


@shows_progress
def sweep_goals(
    tasks: Sequence[AnyTask],
    *,
    max_states: int | None = None,
    time_limit: float | None = None,
    threads: int | None = None,
    progress: Wanted = None,
) -> list[Table]:
    """Return the table of each task; the tasks differ in their goals only.

    Tables on one enumeration of the states have the same `space.numbering`, and hence the same state numbers.

    Parameters
    ----------
    tasks : sequence of Task, or of whatever `load` takes
        One task for each goal.
    max_states, time_limit, threads, progress
        As in `sweep`; the limit of states holds for each enumeration, that of time for all.

    Raises
    ------
    PDDLError
        Two tasks differ in more than their goals, or the translator decided a goal.
    LimitError
        A limit is reached.
    """
    assert callable(progress)
    if isinstance(tasks, str):
        raise TypeError(f"tasks {tasks!r}: expected a list of tasks, one for each goal")
    loaded = [task_of(task) for task in tasks]
    require_same_states(loaded)
    deadline = Deadline.after(time_limit)
    budget = Budget.within(max_states, deadline=deadline.at)
    threads = threads or processors()
    for task in loaded:
        require_sweepable(task)
    alike = _alike(loaded)
    if len(alike) > 1 and all(task.instance.problem.is_file() for task in loaded):
        derived = [_with_derived_goal(task, deadline) for task in loaded]
        if len(groups := _alike(derived)) < len(alike):
            loaded, alike = derived, groups
    tables: dict[int, Table] = {}
    for places in alike:
        members = _joined([loaded[place] for place in places])
        head = members[0]
        space, note = explored(head, budget, threads, progress, SweepOptions())
        for place, task in zip(places, members, strict=True):
            distance = distances(space, task.goal, budget, threads, progress)
            budget = budget.beside(distance.nbytes)
            states = StateSpace(task, len(distance), space.initial, space.transitions, space.index, budget.check_memory)
            tables[place] = Table(states, distance, note)
        budget = budget.beside(space.nbytes)
    return [tables[place] for place in range(len(loaded))]


def _alike(tasks: Sequence[Task]) -> list[list[int]]:
    """Return the places of tasks with equal groundings."""
    found: dict[Grounding, list[int]] = {}
    for place, task in enumerate(tasks):
        found.setdefault(_grounded(task), []).append(place)
    return list(found.values())


def _with_derived_goal(task: Task, deadline: Deadline) -> Task:
    """Return the task of the same files whose goal is a derived predicate; the task itself if there is none.

    There is none either if the task is not that of its files, as one with another goal that was made in Python.
    """

    def limits() -> Limits:
        deadline.check("grounding some of the goals")
        return Limits(None if deadline.at == math.inf else max(0.01, deadline.at - time.monotonic()))

    try:
        reading = read(task.instance)
        same = grounded(reading, limits())[1].sas == task.sas
        found = grounded(with_derived_goal(reading), limits())[1] if same else task
    except PDDLError:
        return task
    return task if found.decided_by_translator or found.beyond else replace(found, note=task.note)


def require_same_states(tasks: Sequence[Task]) -> None:
    """Check that tasks have the same actions, costs and initial state, and that no goal was decided by the translator.

    A task that differs in more than its goal from the first one raises a `PDDLError`.
    """
    first = tasks[0]
    for task in tasks:
        if task.decided_by_translator:
            message = "the goal is unreachable or holds in the initial state; expected one that has to be pursued"
            raise PDDLError(task.instance.problem, None, message)
    for task in tasks[1:]:
        what = "actions", "cost of actions", "initial state"
        for name, ours, theirs in zip(what, _signature(first), _signature(task), strict=True):
            if ours != theirs:
                odd = min(ours ^ theirs)
                where = first if odd in ours else task
                raise PDDLError(
                    task.instance.problem, None,
                    f"{name}: {odd} is in {where.instance.problem} only; expected problems that differ in their goals",
                )  # fmt: skip


def _signature(task: Task) -> tuple[frozenset[str], frozenset[str], frozenset[str]]:
    """Return what tasks with the same states share: their actions, the costs of these, and the initial facts."""
    primary = [(variable, value) for variable, value in zip(task.variables, task.initial, strict=True)]
    facts = (variable.facts[value] for variable, value in primary if variable.axiom_layer < 0)
    return (
        frozenset(task.actions),
        frozenset(f"{action} = {cost * task.unit}" for action, cost in zip(task.actions, task.costs, strict=True)),
        frozenset(fact.removeprefix("Atom ") for fact in facts if fact.startswith("Atom ")),
    )


def _joined(tasks: Sequence[Task]) -> list[Task]:
    """Return tasks of one grounding as tasks with the same variables, operators and axioms, and with their own goals.

    The variables are those of the first task, and the derived ones of the others that it does not have.
    """
    if len(tasks) == 1:
        return list(tasks)
    head = tasks[0]
    primary = sorted(range(len(head.variables)), key=lambda number: head.variables[number].axiom_layer >= 0)
    variables, initial, axioms, known = list[Variable](), list[int](), list[Effect](), dict[Meaning, Fact]()
    goals, first, layers = list[tuple[Fact, ...]](), dict[Fact, Fact](), 0
    for task in tasks:
        meanings, added, above = _meanings(task), set[int](), layers
        for number in primary if task is head else range(len(task.variables)):
            variable, values = task.variables[number], range(len(task.variables[number].facts))
            if any(meanings[number, value] not in known for value in values):
                known.update((meanings[number, value], (len(variables), value)) for value in values)
                layer = variable.axiom_layer + above if variable.axiom_layer >= 0 else -1
                variables.append(replace(variable, name=f"var{len(variables)}", axiom_layer=layer))
                initial.append(task.initial[number])
                added.add(number)
                layers = max(layers, layer + 1)
        places = {fact: known[meaning] for fact, meaning in meanings.items()}
        first = first or places
        goals.append(_moved(task.goal, places))
        axioms += [_moved_effect(axiom, places) for axiom in task.axioms if axiom.variable in added]
    operators = tuple(
        Operator(
            one.action, _moved(one.preconditions, first), tuple(_moved_effect(effect, first) for effect in one.effects)
        )
        for one in head.operators
    )  # fmt: skip
    mutexes = tuple(_moved(group, first) for group in head.mutexes)
    whole = replace(
        head, variables=tuple(variables), initial=tuple(initial), operators=operators, axioms=tuple(axioms),
        mutexes=mutexes,
    )  # fmt: skip
    return [
        replace(whole, goal=goal, instance=task.instance, note=task.note)
        for goal, task in zip(goals, tasks, strict=True)
    ]


def _moved(facts: Iterable[Fact], places: Mapping[Fact, Fact]) -> tuple[Fact, ...]:
    return tuple(places[fact] for fact in facts)


def _moved_effect(effect: Effect, places: Mapping[Fact, Fact]) -> Effect:
    return Effect(_moved(effect.conditions, places), *places[effect.variable, effect.value])


def _meanings(task: Task) -> dict[Fact, Meaning]:
    """Return the meaning of each fact. Facts of tasks with one grounding that mean the same hold in the same states.

    A derived fact means the rules that it depends on. The predicates that the translator adds, and those of goals, have
    no names of their own, since they are numbered differently for each goal.
    """
    every = [frozenset(variable.facts) for variable in task.variables]
    rules: dict[int, list[Effect]] = {number: [] for number, each in enumerate(task.variables) if each.axiom_layer >= 0}
    for axiom in task.axioms:
        rules[axiom.variable].append(axiom)
    unnamed = {number for number in rules if re.search(r"Atom new-axiom@(\d|goal)", "".join(every[number]))}

    def named(fact: Fact) -> object:
        variable, value = fact
        if variable in unnamed:
            return value == task.initial[variable], body(variable)
        return every[variable], task.variables[variable].facts[value]

    @cache
    def body(variable: int) -> frozenset[object]:
        return frozenset(frozenset(map(named, axiom.conditions)) for axiom in rules[variable])

    def below(variable: int) -> frozenset[object]:
        """Return the rules of all derived predicates on which a variable depends."""
        found, waiting = set[int](), [variable]
        while waiting:
            number = waiting.pop()
            if number in rules and number not in found:
                found.add(number)
                waiting += [fact[0] for axiom in rules[number] for fact in axiom.conditions]
        return frozenset((named((number, task.initial[number])), body(number)) for number in found - unnamed)

    found = dict[Fact, Meaning]()
    for number, variable in enumerate(task.variables):
        own = below(number)
        found.update(((number, value), (named((number, value)), own)) for value in range(len(variable.facts)))
    return found


def _grounded(task: Task) -> Grounding:
    """Return the variables and operators of a task by their meanings, whatever their order, and what operators read."""
    meaning = _meanings(task)

    def meanings(facts: Iterable[Fact]) -> frozenset[Meaning]:
        return frozenset(map(meaning.__getitem__, facts))

    def effect(one: Effect) -> tuple[object, ...]:
        return meanings(one.conditions), meaning[one.variable, one.value]

    operators = [
        (
            task.actions[one.action],
            task.costs[one.action],
            meanings(one.preconditions),
            frozenset(map(effect, one.effects)),
        )
        for one in task.operators
    ]
    primary = ((frozenset(each.facts),) for each in task.variables if each.axiom_layer < 0)
    return frozenset([(task.unit,), *primary, *operators])
