"""A task whose numbers may leave the values that they were given, as one in which leaving is a second way to the goal.

The compilation of a number without a proven bound has some of its values only. Another value is *beyond* these, and
nothing is known of a state in which a number is beyond (`Task.beyond`). Let L be the task in which a state that has a
beyond fact, or satisfies the goal, reaches a new goal at no cost.

Claim: if an optimal plan of L from a state s ends in a state that satisfies the goal and has no beyond fact before its
end, it is an optimal plan of the original task from s. If L has no plan from s, neither has the original task.

Proof: as long as no number is beyond, both tasks have the same states, actions and costs. A plan of the original task
from s either never leaves the values, and is a plan of L of the same cost; or its part up to the first state with a
beyond fact is one, of at most that cost. So the optimal cost of L is at most that of the original task, and infinite
only if that is. A plan of L that reaches the goal itself is a plan of the original task, so that its cost is at least
the optimal one. Hence both are equal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..system.limits import LimitError
from .task import Effect, Operator, Task, Variable

REACH, LEAVE = "(reach-the-goal)", "(leave-the-values)"


def with_leaving(task: Task) -> Task:
    """Return the task L; its last variable is the new goal."""
    new, first = len(task.variables), len(task.actions)
    reached = (Effect((), new, 1),)
    leave = tuple(Operator(first + 1, (fact,), reached) for fact in task.beyond)
    return replace(
        task,
        variables=(*task.variables, Variable("end", ("Atom open()", "Atom ended()"), -1)),
        actions=(*task.actions, REACH, LEAVE),
        costs=(*task.costs, 0, 0),
        operators=(*task.operators, Operator(first, task.goal, reached), *leave),
        initial=(*task.initial, 0),
        goal=((new, 1),),
    )


def without_leaving(task: Task, plan: Sequence[str] | None) -> list[str] | None:
    """Return the plan of a task for one of L; a `LimitError` says if that leaves the values."""
    if plan is None:
        return None
    if plan[-1] == LEAVE:
        raise LimitError(out_of_range(task))
    return list(plan[:-1])


def out_of_range(task: Task) -> str:
    """Return which numbers have no proven bound, as a sentence for a limit."""
    facts = (task.variables[variable].facts[value] for variable, value in task.beyond)
    names = sorted({fact.removeprefix("Atom ").partition("(")[0] for fact in facts})
    return f"a cheapest plan may need more values of {', '.join(names)} than were tried, as no bound is proven"
