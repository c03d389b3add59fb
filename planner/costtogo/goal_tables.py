"""Tables of several goals of one task, on one enumeration of its states.

The goals are those of problem files that differ in nothing else. One forward search finds the states, and a backward
search for each goal computes the cost-to-go. The translator may order variables by the goal, so that goals are
translated by the meaning of their facts. If a goal changes the grounding itself, as one with quantifiers or
disjunctions does, its task is swept by itself, and its table numbers the states in its own way.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from ..grounding.task import Effect, Fact, Task
from ..pddl.instances import PDDLError
from ..search.numbering import SweepOptions
from ..search.search_space import distances
from ..search.state_space import StateSpace
from ..system.limits import Budget, Deadline, processors
from ..system.progress import Wanted, shows_progress
from .load import task_of
from .table import Table, explored, require_sweepable

if TYPE_CHECKING:
    from .load import AnyTask

Meaning = tuple[frozenset[str], str]
"""A fact of a variable, with the meanings of all values of that variable."""


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
    budget = Budget.within(max_states, deadline=Deadline.after(time_limit).at)
    threads = threads or processors()
    enumerated: list[tuple[Task, list[tuple[int, Task]]]] = []  # first task of each enumeration, and its members
    for place, task in enumerate(loaded):
        require_sweepable(task)
        for head, members in enumerated:
            goal = _translated(task, head)
            if goal is not None:
                members.append((place, replace(head, goal=goal, instance=task.instance, note=task.note)))
                break
        else:
            enumerated.append((task, [(place, task)]))
    tables: dict[int, Table] = {}
    for head, members in enumerated:
        space, note = explored(head, budget, threads, progress, SweepOptions())
        for place, task in members:
            distance = distances(space, task.goal, budget, threads, progress)
            budget = budget.beside(distance.nbytes)
            states = StateSpace(task, len(distance), space.initial, space.transitions, space.index, budget.check_memory)
            tables[place] = Table(states, distance, note)
        budget = budget.beside(space.nbytes)
    return [tables[place] for place in range(len(loaded))]


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


def _translated(task: Task, head: Task) -> tuple[Fact, ...] | None:
    """Return a task's goal in the facts of another task, or None if their groundings differ in more than the order."""
    if task.axioms or head.axioms or _grounded(task) != _grounded(head):
        return None
    places = {
        (frozenset(variable.facts), fact): (number, value)
        for number, variable in enumerate(head.variables)
        for value, fact in enumerate(variable.facts)
    }
    own = task.variables
    return tuple(places[frozenset(own[variable].facts), own[variable].facts[value]] for variable, value in task.goal)


def _grounded(task: Task) -> frozenset[tuple[object, ...]]:
    """Return the variables and operators of a task by their meanings, whatever their order."""
    every = [frozenset(variable.facts) for variable in task.variables]

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
    return frozenset([(task.unit,), *((facts,) for facts in every), *operators])
