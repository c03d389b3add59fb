"""The interface of whatever knows the exact cost-to-go, and the optimal choices that follow from it."""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..grounding.task import Task
from ..states.packing import Ints
from ..states.successors import Transitions


class CostToGo(Protocol):
    """The exact cost-to-go of a task, however it is come by. States are named by numbers."""

    @property
    def task(self) -> Task:
        """The task."""

    @property
    def initial(self) -> int:
        """The number of the initial state."""

    @property
    def method(self) -> Literal["sweep", "on-demand"]:
        """How the answers are come by."""

    @property
    def searches(self) -> bool:
        """Whether looking a state up may take a search of its own, which takes its time."""

    def __len__(self) -> int:
        """Count the states that have numbers."""

    def lookup(self, states: ArrayLike) -> NDArray[np.float64]:
        """Give h* of states, shape (N,), infinite at dead ends."""

    def choices(self, states: ArrayLike) -> Transitions:
        """Give the choices of states, shape (N,), as compressed rows."""

    def is_goal(self, states: ArrayLike) -> NDArray[np.bool_]:
        """Tell of states, shape (N,), which are goal states."""

    def values(self, states: ArrayLike) -> Ints:
        """Give the values, shape (N, variables), of states of shape (N,)."""

    def numbers(self, values: ArrayLike) -> Ints:
        """Give the numbers, shape (N,), of states with values of shape (N, variables)."""

    def plan_lengths(self, states: ArrayLike) -> Ints:
        """Give how many actions the shortest of the cheapest plans from states has, shape (N,); `UNREACHED` if none."""

    def optimal_plan(self, state: int | None = None) -> list[str] | None:
        """Give an optimal plan from a state (the initial one unless given); None from a dead end."""


def optimal_choices(known: CostToGo, states: ArrayLike, rows: Transitions) -> NDArray[np.bool_]:
    """Tell of each choice of some states, shape (m,), whether a cheapest way to the goal begins with it.

    Where a task has actions of cost zero, only the cheapest ways with the fewest actions count. So optimal choices lead
    to no circles: each lowers the cost-to-go or, that being equal, the number of actions to come, and who follows them,
    whichever, reaches the goal.

    Parameters
    ----------
    known : CostToGo
    states : int array, shape (N,)
    rows : Transitions
        Their choices, as `known.choices` gives them.
    """
    costs, counts = np.asarray(known.task.costs), np.diff(rows.offsets)
    h = np.repeat(known.lookup(states), counts)
    cheapest = np.isfinite(h) & (costs[rows.actions] + known.lookup(rows.targets) == h)
    if 0 not in costs:
        return cheapest
    sources = np.repeat(np.asarray(states, dtype=np.int64), counts)
    both = np.concatenate([sources[cheapest], rows.targets[cheapest]])
    before, after = np.split(known.plan_lengths(both), 2)
    cheapest[cheapest] = after < before
    return cheapest
