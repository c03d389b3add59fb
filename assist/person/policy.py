"""Policies for one person's problem, whatever the size of the task.

Most policies are for problems whose states are enumerated, and their rows are the states of the task. A policy for a
task that is too large for that (`large_tasks.truncated_policy`) keeps values of some states only. Users of a policy do
not need to distinguish them: they ask for the policy of the next step in some states (`Policy.local`), and for the rows
of these states there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo

from ..people.choices import Choices
from ..people.decision import Floats
from .pomdp import AssistPOMDP
from .ties import first_best
from .visiting_robot import VisitingRobot

Ints = NDArray[np.int64]


class Policy:
    """A policy for one person's problem. Its methods take N people at a time.

    A subclass has the attribute `pomdp` and the method `q_values`. Everything else holds for enumerated tasks.

    Attributes
    ----------
    pomdp : AssistPOMDP
        The problem.
    states : int array, shape (n,), or None
        Task state of each row of the problem; None if rows and states are the same.
    """

    if TYPE_CHECKING:

        @property
        def pomdp(self) -> AssistPOMDP:
            """The problem."""

    @property
    def states(self) -> Ints | None:
        """The task state of each row of the problem, shape (n,); None if rows and states are the same."""
        return None

    def q_values(self, x: Ints, belief: Floats) -> Floats:
        """Return the Q-values of all robot actions, shape (N, R); minus infinity in padding.

        Parameters
        ----------
        x : int array, shape (N,)
        belief : float array, shape (N, H, T)
        """
        raise NotImplementedError

    def value(self, x: Ints, belief: Floats) -> Floats:
        """Return the value of each person's problem, shape (N,), in cost units; arguments as in `q_values`."""
        return np.asarray(self.q_values(x, belief).max(axis=1))

    def choose(self, x: Ints, belief: Floats) -> Ints:
        """Return the best robot action for each person, shape (N,). Ties favour 0, doing nothing."""
        return first_best(self.q_values(x, belief))

    def prepare(self) -> Any:
        """Solve now what would otherwise be solved on first use."""
        return self

    @property
    def task(self) -> Choices | CostToGo:
        """The whole task: the choices in all of its states, or its cost-to-go."""
        return self.pomdp.model.choices

    def task_of(self, goal: int) -> Choices | CostToGo:
        """Return the whole task with one of the goals, given by its number."""
        return self.pomdp.model.choices.of_goal(goal)

    @property
    def size(self) -> float:
        """The number of states whose values are kept; infinite if they are not those of the whole task."""
        return len(self.pomdp.robot_actions)

    @property
    def searches(self) -> bool:
        """Whether a state that was not visited before takes a slow search."""
        return False

    @property
    def cheapest(self) -> float:
        """The smallest positive cost of an action, in cost units; 1 if all actions are free."""
        return self.pomdp.model.choices.unit

    @property
    def dearest(self) -> float:
        """The largest cost of an action or a wait, in cost units."""
        return float(self.pomdp.model.choices.costs.max())

    def require_enumerated(self, what: str) -> None:
        """Check that the values of all states are kept. If not, the `ValueError` says that `what` needs them."""

    def local(self, states: Ints, *, deep: bool = True) -> Policy:
        """Return a policy for the next step of people in some states.

        Parameters
        ----------
        states : int array, shape (N,)
            States of the task. `rows` returns their rows in the problem of the local policy.
        deep : bool
            Whether the effect of every suggestion on trust is needed. If not, `after_suggestions` adds the effects of
            those that are made.
        """
        del states, deep
        return self

    def rows(self, states: Ints, *, deep: bool = True) -> Ints | None:
        """Return the row of each state, shape (N,); None if the policy does not cover all of them as in `local`."""
        del deep
        return states

    def after_suggestions(self, x: Ints, robot: Ints) -> Policy:
        """Return the policy with the effects on trust of robot actions in some rows, both of shape (N,)."""
        del x, robot
        return self

    def with_robot(self, robot: VisitingRobot) -> Any:
        """Return the person's solved problem with a robot that comes and goes (`VisitingRobot.solved`)."""
        return robot.solved(self)

    def bounded(self, entry: float, **limits: Any) -> list[tuple[float, Any]] | None:
        """Return each goal's probability and the problem whose upper bound holds for the whole task.

        None if that is `pomdp` itself. The arguments are those of `large_tasks.truncated_bound.bounded`.
        """
        del entry, limits
        return None


def not_worth_its_cost(c_suggest: float) -> str:
    """Return the sentence on a policy that weighs costs and makes no suggestion at this cost of one, in cost units."""
    return f"no suggestion was worth its cost (c_suggest {c_suggest:g})"
