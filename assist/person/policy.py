"""Policies for one person's problem, whatever the size of the task.

The problem of a policy has a row for each situation of people (`person.problem_rows`). If all states of the task are
enumerated, all rows are there from the start. In a task that is too large for that (`person.truncated_policy`), a
situation gets its row when somebody comes there. Users of a policy do not distinguish them: they ask for the rows of
people's situations (`Policy.rows`), and for the situation of a row.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..people.decision import Floats, Ints
from .mdp_values import evaluate
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays
from .problem_rows import ProblemRows, WholeProblem
from .ties import first_best
from .visiting_robot import VisitingRobot

OfRows = Callable[[Ints], Floats]
"""A function of rows, shape (N,), that returns values for known type and theta, shape (N, H, T), in cost units."""


class Policy:
    """A policy for one person's problem. Its methods take N people at a time.

    A subclass has the attribute `pomdp` and the method `q_values`. Everything else holds for a task whose rows were
    all added at the start.

    Attributes
    ----------
    pomdp : AssistPOMDP
        The problem.
    """

    if TYPE_CHECKING:

        @property
        def pomdp(self) -> AssistPOMDP:
            """The problem."""

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

    @cached_property
    def problem(self) -> ProblemRows:
        """The problem with its rows; those of a whole task unless a subclass says otherwise."""
        return WholeProblem(self.pomdp)

    def rows(self, situations: Ints, holder: object = None) -> Ints:
        """Return the row of each situation in which people are, shape (N,); arguments as in `ProblemRows.rows`."""
        return self.problem.rows(situations, holder)

    def situations(self, rows: Ints) -> Ints:
        """Return the situation of each row, shape (N,)."""
        return self.problem.situations(rows)

    @property
    def arrays(self) -> ProblemArrays:
        """The problem in the form that compiled code reads."""
        return self.problem.now.arrays

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "problem"}

    def with_robot(self, robot: VisitingRobot) -> Any:
        """Return the person's solved problem with a robot that comes and goes (`VisitingRobot.solved`)."""
        return robot.solved(self)

    @property
    def helped(self) -> OfRows | None:
        """Values of a robot that helps a person whose type and theta it knows; None if `pomdp` has to be solved."""
        value = getattr(self.prepare(), "value_mdp", None)
        return None if value is None else value.__getitem__

    @property
    def unhelped(self) -> OfRows:
        """Values of a robot that never helps a person whose type and theta it knows; they are computed now."""
        never = np.zeros(len(self.pomdp.robot_actions), dtype=np.int64)
        return evaluate(self.pomdp.unattended(), never).__getitem__


def not_worth_its_cost(c_suggest: float) -> str:
    """Return the sentence on a policy that weighs costs and makes no suggestion at this cost of one, in cost units."""
    return f"no suggestion was worth its cost (c_suggest {c_suggest:g})"
