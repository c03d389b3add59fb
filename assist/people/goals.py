"""Several goals, one of which a person pursues, in place of a task whose goal is known.

`Goals` holds the cost-to-go of each goal and a prior. The other functions take a task of either kind: a cost-to-go is
that of its only goal. What the robot believes about goals is in `hidden_type`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from planner import CostToGo, Table, Transitions, known_costs, optimal_choices
from planner.system.errors import expected

from .choices import WAIT, Choices
from .decision import Bools, Floats, Ints
from .hidden_type import KNOWN, OfGoals, several

if TYPE_CHECKING:
    from planner import AnyTask

Task = TypeVar("Task", bound=CostToGo)


def prior_over(goals: Mapping[str, CostToGo], prior: Mapping[str, float] | None, name: str = "prior") -> Floats:
    """Return the probability of each goal, after checking the given ones.

    Parameters
    ----------
    goals : mapping of str to CostToGo
    prior : mapping of str to float, or None
        None if all goals are equally probable.
    name : str
        What messages call the prior.

    Raises
    ------
    ValueError
        There is no goal, or the prior is no distribution over the goals.
    """
    if not goals:
        raise ValueError("no goals; expected one or more")
    if prior is None:
        return np.full(len(goals), 1 / len(goals))
    if set(prior) != set(goals):
        odd = min(set(prior) - set(goals), default=None)
        if odd is not None:
            raise ValueError(f"{name}: '{odd}' is no goal; {expected(odd, goals)}")
        raise ValueError(f"{name}: '{min(set(goals) - set(prior))}' is missing; expected {', '.join(goals)}")
    shares = np.array([float(prior[goal]) for goal in goals])
    wrong = [goal for goal, share in zip(goals, shares, strict=True) if not share >= 0]
    if wrong or not abs(shares.sum() - 1) <= 1e-6:
        found = f"'{wrong[0]}' has {float(prior[wrong[0]]):g}" if wrong else f"sum {shares.sum():g}"
        raise ValueError(f"{name}: {found}; expected numbers of 0 or more that add up to 1")
    return shares / shares.sum()


def each_of(task: Task | Goals) -> tuple[Task | Table, ...]:
    """Return the cost-to-go of each goal, all on the same states; of any other task, its own."""
    return tuple(task.tables.values()) if isinstance(task, Goals) else (task,)


def first_of(task: Task | Goals) -> Task | Table:
    """Return the task of the first of several goals, and any other task as it is."""
    return each_of(task)[0]


def prior_of(task: CostToGo | Goals) -> Mapping[str, float]:
    """Return the probability of each goal at the beginning of a task, by its name; a goal that is known is `KNOWN`."""
    return task.prior if isinstance(task, Goals) else {KNOWN: 1.0}


def text_of_goals(task: object) -> str:
    """Return what tells several goals from others of the same task, apart from the task's text; "" for other tasks."""
    if not isinstance(task, Goals):
        return ""
    each = (f"{name} {task.prior[name]} {table.task.goal}" for name, table in task.tables.items())
    return f"{''.join(each)}{'likeliest' * task.assume_likeliest} {task.sharpness}"


def require_possible_terms(task: Any, terms: Collection[str]) -> None:
    """Check that people who pursue one of several goals have no terms, which are about the goal.

    Raises
    ------
    ValueError
        There are several goals, and there are terms.
    """
    if terms and several(each_of(task)):
        raise ValueError("people with weights of terms: expected one goal")


def known_task(task: CostToGo | Goals | AnyTask) -> CostToGo | Goals:
    """Return goals as they are, and the cost-to-go of any other task that `planner.load` takes."""
    return task if isinstance(task, Goals) else known_costs(task)


def costs_to_go(task: CostToGo | Goals, states: Ints) -> Floats:
    """Return the exact cost-to-go of states, shape (N,), for each goal: shape (N, G)."""
    return np.stack([known.lookup(states) for known in each_of(task)], axis=1)


def goals_reached(task: CostToGo | Goals, states: Ints) -> Bools:
    """Return whether each goal is reached in states, shape (N,): shape (N, G)."""
    return np.stack([known.is_goal(states) for known in each_of(task)], axis=1)


def optimal_for_each(task: CostToGo | Goals, states: Ints, rows: Transitions) -> Bools:
    """Return whether each of m transitions is optimal for each goal, shape (m, G); see `planner.optimal_choices`."""
    return np.stack([optimal_choices(known, states, rows) for known in each_of(task)], axis=1)


def joined(task: CostToGo | Goals, each: Sequence[Choices]) -> Choices:
    """Return the choices of people who pursue one of the goals, from those with each goal in the same states.

    Where no action is applicable, people wait unless all goals are reached: the robot does not see which one was.
    """
    first = each[0]
    if not isinstance(task, Goals):
        return first
    goals = OfGoals(
        task.prior, np.stack([one.h for one in each]), np.stack([one.goal for one in each]),
        np.stack([one.optimal for one in each], axis=2), task.assume_likeliest, task.sharpness,
    )  # fmt: skip
    waits = np.any([one.applicable[:, 0] & (one.actions[:, 0] == WAIT) for one in each], axis=0)
    applicable, costs = first.applicable.copy(), first.costs.copy()
    applicable[waits, 0], costs[waits, 0] = True, 1.0
    return replace(
        first, h=goals.h.min(axis=0), goal=np.asarray(goals.goal.all(axis=0)), applicable=applicable, costs=costs,
        optimal=np.asarray((goals.optimal & ~goals.goal.T[:, None]).any(axis=2)), unknown_goal=goals,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Goals:
    """The goals of which a person pursues one, with a prior; it takes the place of a task.

    Attributes
    ----------
    tables : mapping of str to Table
        Cost-to-go of each goal, by the goal's name, as `planner.sweep_goals` returns them.
    prior : mapping of str to float
        Probability of each goal at the beginning of a task; by default all are equal.
    assume_likeliest : bool
        Whether the robot acts as if the most probable goal were certain.
    sharpness : float
        Power to which the robot raises the goals' probabilities before it averages its values over the goals. QMDP
        values count the goal as known from the next step on, so that waiting seems too good. Sharper probabilities
        counter that: powers from 3 to 8 were best with four and eight kits. 1 stands for the average.

    Raises
    ------
    ValueError
        A goal cannot be reached, the tables have different states (`sweep_goals`), or the prior is no distribution.
    """

    tables: Mapping[str, Table]
    prior: Mapping[str, float] = field(default_factory=dict)
    assume_likeliest: bool = False
    sharpness: float = 5.0

    def __post_init__(self) -> None:
        if not self.sharpness >= 1:
            raise ValueError(f"sharpness {self.sharpness:g}: expected a number from 1 upwards")
        shares = prior_over(self.tables, self.prior or None)
        object.__setattr__(self, "prior", dict(zip(self.tables, shares.tolist(), strict=True)))
        first = next(iter(self.tables.values()))
        for name, table in self.tables.items():
            if not isinstance(table, Table):
                raise ValueError(f"goal '{name}': expected a table of all states, as `sweep_goals` returns it")  # noqa: TRY004
            if table.space.numbering is not first.space.numbering:
                raise ValueError(
                    f"goal '{name}' has states of its own, as its table is of another call of `sweep_goals`, or as the "
                    "goal compares a number of which only some values are told apart; expected a goal of facts, or "
                    "of other numbers"
                )
            h, holds = table.lookup([table.initial])[0], table.is_goal([table.initial])[0]
            if holds or h == np.inf:
                what = "holds in" if holds else "cannot be reached from"
                raise ValueError(f"goal '{name}' {what} the initial state; expected goals that have to be pursued")

    @property
    def method(self) -> str:
        """How the cost-to-go was computed."""
        return next(iter(self.tables.values())).method

    def __len__(self) -> int:
        """Return the number of pairs of a goal and a state."""
        return sum(map(len, self.tables.values()))

    def choices(self) -> Choices:
        """Return the choices of people who pursue one of the goals."""
        return joined(self, [Choices.of(table) for table in self.tables.values()])
