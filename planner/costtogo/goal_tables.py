"""Tables of several goals of one task, on one enumeration of its states.

The goals are those of problem files that differ in nothing else. One forward search finds the states, and a backward
search for each goal computes the cost-to-go. The translator may order variables by the goal, so that goals are
translated by the meaning of their facts. Of a goal with disjunctions or quantifiers it makes a derived variable, which
nothing else reads: the states are then enumerated with the derived variables of all goals. For a negation it divides
variables, so that the files are grounded anew, with a derived predicate as the goal. A task is swept by itself,
and its table numbers the states in its own way, if its goal changes more than that, as one that compares a number of
which only some values are told apart, or if its goal or operators read derived predicates of the domain.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from ..grounding.task import Effect, Fact, Operator, Task
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

Meaning = tuple[frozenset[str], str]
"""A fact of a variable, with the meanings of all values of that variable."""

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
    groundings = [_grounded(task) for task in loaded]
    alike = _alike(groundings)
    if len({*groundings} - {None}) > 1 and all(task.instance.problem.is_file() for task in loaded):
        derived = [
            task if grounding is None else _with_derived_goal(task, deadline)
            for task, grounding in zip(loaded, groundings, strict=True)
        ]
        if len(groups := _alike([_grounded(task) for task in derived])) < len(alike):
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


def _alike(groundings: Sequence[Grounding | None]) -> list[list[int]]:
    """Return the places of equal groundings; None is equal to no other."""
    found: dict[object, list[int]] = {}
    for place, grounding in enumerate(groundings):
        found.setdefault(place if grounding is None else grounding, []).append(place)
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

    The variables are those of the first task that are not derived, and then the derived ones of all.
    """
    if len(tasks) == 1:
        return list(tasks)
    head = tasks[0]
    kept = [number for number, variable in enumerate(head.variables) if variable.axiom_layer < 0]
    variables, initial = [head.variables[number] for number in kept], [head.initial[number] for number in kept]
    known = {
        (frozenset(variable.facts), fact): (number, value)
        for number, variable in enumerate(variables)
        for value, fact in enumerate(variable.facts)
    }
    goals, axioms, operators = list[tuple[Fact, ...]](), list[Effect](), tuple[Operator, ...]()
    for task in tasks:
        places: dict[Fact, Fact] = {}
        for number, (variable, first) in enumerate(zip(task.variables, task.initial, strict=True)):
            for value, fact in enumerate(variable.facts):
                derived = len(variables), value
                places[number, value] = derived if variable.axiom_layer >= 0 else known[frozenset(variable.facts), fact]
            if variable.axiom_layer >= 0:
                variables.append(replace(variable, name=f"var{len(variables)}"))
                initial.append(first)

        def moved(facts: Iterable[Fact], places: Mapping[Fact, Fact] = places) -> tuple[Fact, ...]:
            return tuple(places[fact] for fact in facts)

        def effect(one: Effect, places: Mapping[Fact, Fact] = places) -> Effect:
            return Effect(moved(one.conditions, places), *places[one.variable, one.value])

        goals.append(moved(task.goal))
        axioms += map(effect, task.axioms)
        operators = operators or tuple(
            Operator(one.action, moved(one.preconditions), tuple(map(effect, one.effects))) for one in task.operators
        )
    mutexes = tuple(
        tuple((kept.index(variable), value) for variable, value in group) for group in head.mutexes
        if all(variable in kept for variable, _ in group)
    )  # fmt: skip
    whole = replace(
        head, variables=tuple(variables), initial=tuple(initial), operators=operators, axioms=tuple(axioms),
        mutexes=mutexes, goal=goals[0],
    )  # fmt: skip
    return [
        replace(whole, goal=goal, instance=task.instance, note=task.note)
        for goal, task in zip(goals, tasks, strict=True)
    ]


def _grounded(task: Task) -> Grounding | None:
    """Return the variables and operators of a task by their meanings, whatever their order, without what is derived.

    None if operators read derived variables, or if some are of derived predicates of the domain: each goal would have
    its own copy of them.
    """
    every = [frozenset(variable.facts) for variable in task.variables]
    derived = {number for number, variable in enumerate(task.variables) if variable.axiom_layer >= 0}
    if any(re.match(r"(Negated)?Atom (?!new-axiom@)", fact) for number in derived for fact in every[number]):
        return None
    for one in task.operators:
        read = {variable for variable, _ in one.preconditions}
        read.update(variable for effect in one.effects for variable, _ in effect.conditions)
        if read & derived:
            return None

    def meanings(facts: Iterable[Fact]) -> frozenset[Meaning]:
        return frozenset((every[variable], task.variables[variable].facts[value]) for variable, value in facts)

    def effect(one: Effect) -> tuple[object, ...]:
        return meanings(one.conditions), meanings([(one.variable, one.value)])

    operators = [
        (
            task.actions[one.action],
            task.costs[one.action],
            meanings(one.preconditions),
            frozenset(map(effect, one.effects)),
        )
        for one in task.operators
    ]
    primary = ((facts,) for number, facts in enumerate(every) if number not in derived)
    return frozenset([(task.unit,), *primary, *operators])
