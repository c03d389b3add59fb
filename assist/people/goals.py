"""Several goals, one of which a person pursues, in place of a task whose goal is known.

`Goals` holds the cost-to-go of each goal and a prior. Its `Choices` have a row for each pair of a goal and a task
state. Row g * m + x is task state x of a person who pursues goal g, with m task states. A person stays in the rows of
their goal, so that a problem on these rows is one problem for each goal, side by side. The robot sees x only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo, Table, Transitions, optimal_choices

from .choices import WAIT, Choices
from .decision import Floats

Task = TypeVar("Task", bound=CostToGo)
Value = TypeVar("Value", bound=np.generic)


def prior_over(goals: Mapping[str, CostToGo], prior: Mapping[str, float] | None) -> Floats:
    """Return the probability of each goal, after checking the given ones.

    Parameters
    ----------
    goals : mapping of str to CostToGo
    prior : mapping of str to float, or None
        None if all goals are equally probable.

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
        odd = min(set(prior) ^ set(goals))
        raise ValueError(f"prior: '{odd}' is {'no goal' if odd in prior else 'missing'}; expected {', '.join(goals)}")
    shares = np.array([float(prior[name]) for name in goals])
    wrong = [name for name, share in zip(goals, shares, strict=True) if not share >= 0]
    if wrong or not abs(shares.sum() - 1) <= 1e-6:
        found = f"'{wrong[0]}' has {float(prior[wrong[0]]):g}" if wrong else f"sum {shares.sum():g}"
        raise ValueError(f"prior: {found}; expected numbers of 0 or more that add up to 1")
    return shares / shares.sum()


def goal_shares(belief: Floats, goals: int) -> Floats:
    """Return the probability of each goal, shape (..., G), under beliefs, shape (..., G * B, T).

    Parameters
    ----------
    belief : float array, shape (..., G * B, T)
    goals : int
        The number G.
    """
    return np.asarray(belief.reshape(*belief.shape[:-2], goals, -1).sum(axis=-1))


def in_task_states(values: NDArray[Value], goals: int) -> NDArray[Value]:
    """Return values of all rows, shape (G * m, ..., C), by task state: shape (m, ..., G * C). `goals` is G."""
    parts = np.moveaxis(values.reshape(goals, -1, *values.shape[1:]), 0, -2)
    return np.ascontiguousarray(parts.reshape(*parts.shape[:-2], -1))


def given_likeliest(belief: Floats, goals: int) -> Floats:
    """Return each belief conditioned on its most probable goal; arguments as in `goal_shares`.

    Ties favour the first goal.
    """
    share = goal_shares(belief, goals)[..., None, None]
    best = share == share.max(axis=-3, keepdims=True)
    best &= best.cumsum(axis=-3) == 1
    parts = belief.reshape(*belief.shape[:-2], goals, -1, belief.shape[-1])
    return np.where(best, parts / np.where(best, share, 1.0), 0.0).reshape(belief.shape)


def sharpened(belief: Floats, goals: int, power: float) -> Floats:
    """Return beliefs with the probability of each goal raised to a power; other arguments as in `goal_shares`."""
    if power == 1:
        return belief
    share = goal_shares(belief, goals)
    weight = (share / share.max(axis=-1, keepdims=True)) ** power
    factor = weight / weight.sum(axis=-1, keepdims=True) / np.where(share > 0, share, 1.0)
    parts = belief.reshape(*belief.shape[:-2], goals, -1, belief.shape[-1])
    return np.asarray(parts * factor[..., None, None]).reshape(belief.shape)


def first_of(task: Task | Goals) -> Task | Table:
    """Return the task of the first of several goals, and any other task as it is."""
    return next(iter(task.tables.values())) if isinstance(task, Goals) else task


def each_of(task: CostToGo | Goals) -> tuple[CostToGo, ...]:
    """Return the cost-to-go of each goal, all on the same states; of any other task, its own."""
    return tuple(task.tables.values()) if isinstance(task, Goals) else (task,)


def costs_to_go(task: CostToGo | Goals, states: NDArray[np.int64]) -> Floats:
    """Return the exact cost-to-go of states, shape (N,), for each goal: shape (N, G)."""
    return np.stack([known.lookup(states) for known in each_of(task)], axis=1)


def goals_reached(task: CostToGo | Goals, states: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return whether each goal is reached in states, shape (N,): shape (N, G)."""
    return np.stack([known.is_goal(states) for known in each_of(task)], axis=1)


def optimal_for_each(task: CostToGo | Goals, states: NDArray[np.int64], rows: Transitions) -> NDArray[np.bool_]:
    """Return whether each of m transitions is optimal for each goal, shape (m, G); see `planner.optimal_choices`."""
    return np.stack([optimal_choices(known, states, rows) for known in each_of(task)], axis=1)


def joined(task: CostToGo | Goals, each: Sequence[Choices]) -> Choices:
    """Return the choices of all goals, from those of each goal in the same m states: m rows for each goal.

    Where no action is applicable, people wait unless they have reached their goal. Rows of one state have the same
    choices, since the robot does not see which goal was reached.
    """
    first, count, m = each[0], len(each), len(each[0])
    if not isinstance(task, Goals):
        return first
    waiting = [np.flatnonzero(one.applicable[:, 0] & (one.actions[:, 0] == WAIT)) for one in each]
    waits = np.concatenate([one + number * m for one in waiting for number in range(count)])

    def every(name: str) -> np.ndarray:
        return np.concatenate([getattr(one, name) for one in each])

    applicable, costs = every("applicable"), every("costs")
    applicable[waits, 0], costs[waits, 0] = True, 1.0
    return Choices(
        every("h"), every("goal"), applicable, every("actions"),
        np.concatenate([one.targets + number * m for number, one in enumerate(each)]), costs, every("optimal"),
        first.names, first.initial, state=np.tile(np.arange(m), count),
        key=None if first.key is None else np.tile(first.key, count), goals=task.prior,
        assume_likeliest=task.assume_likeliest, sharpness=task.sharpness,
    )  # fmt: skip


def acting_belief(choices: Choices, belief: Floats) -> Floats:
    """Return the beliefs, shape (..., G * B, T), on which the robot acts."""
    if choices.assume_likeliest:
        return given_likeliest(belief, choices.goal_count)
    return belief if choices.goal_count == 1 else sharpened(belief, choices.goal_count, choices.sharpness)


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
        A goal cannot be reached, the tables have different states, or the prior is no distribution.
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
                raise ValueError(f"goal '{name}' has states of its own; expected tables from one call of `sweep_goals`")
            h = table.lookup([table.initial])[0]
            if not 0 < h < np.inf:
                what = "holds in" if h == 0 else "cannot be reached from"
                raise ValueError(f"goal '{name}' {what} the initial state; expected goals that have to be pursued")

    @property
    def method(self) -> str:
        """How the cost-to-go was computed."""
        return next(iter(self.tables.values())).method

    def __len__(self) -> int:
        """Return the number of rows of the choices."""
        return sum(map(len, self.tables.values()))

    def choices(self) -> Choices:
        """Return the choices of all goals: m rows for each, in the order of the goals."""
        return joined(self, [Choices.of(table) for table in self.tables.values()])


def drawn_goals(every: Sequence[Choices], model: NDArray[np.int64], uniform: Floats) -> NDArray[np.int64]:
    """Return the number of each person's goal, drawn from their model's prior by uniform numbers."""
    priors = [list((choices.goals or {}).values()) for choices in every]
    below = np.cumsum(priors, axis=1)[model]
    last = np.array([np.flatnonzero(shares)[-1] for shares in priors])[model]  # rounding must not select beyond it
    return np.minimum((uniform[..., None] >= below).sum(axis=-1), last)
