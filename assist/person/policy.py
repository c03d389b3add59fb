"""Policies for one person's problem, whatever the size of the task.

The problem of a policy has a row for each place where people may be (`person.problem_rows`). If all states of the task
are enumerated, all rows are there from the start. In a task that is too large for that (`person.truncated_policy`), a
place gets its row when somebody comes there. Users of a policy do not distinguish them: they ask for the rows of the
places where people are (`Policy.rows`), and for the place of a row.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo

from ..people.choices import Choices
from ..people.decision import Floats
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays
from .problem_rows import ProblemRows, WholeProblem
from .ties import first_best
from .visiting_robot import VisitingRobot

Ints = NDArray[np.int64]

OfRows = Callable[[Ints], Floats]
"""A function of rows, shape (N,), that returns values for known type and theta, shape (N, H, T), in cost units."""


class Extent(NamedTuple):
    """The largest numbers that occur in a person's problem, or upper bounds on them if states are solved on demand.

    Attributes
    ----------
    states : int
        Number of states.
    robot_actions : int
        R, the largest number of robot actions in a state.
    farthest : float
        The largest finite cost-to-go of any goal, in cost units; infinite if it is unknown.
    """

    states: int
    robot_actions: int
    farthest: float


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
    def extent(self) -> Extent:
        """The largest numbers that occur anywhere in the task, for arrays of a fixed size."""
        h = self.pomdp.model.choices.goals.h
        most, robots = self.pomdp.suggested.shape
        return Extent(most, robots, float(h[np.isfinite(h)].max(initial=0.0)))

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

    def require_enumerated(self, what: str, why: str) -> None:
        """Check that all states are enumerated. If not, the `ValueError` says that `what` needs them, and `why`."""

    @cached_property
    def problem(self) -> ProblemRows:
        """The problem with its rows; those of a whole task unless a subclass says otherwise."""
        return WholeProblem(self.pomdp)

    def rows(self, places: Ints, holder: object = None) -> Ints:
        """Return the row of each place where people are, shape (N,); arguments as in `ProblemRows.rows`."""
        return self.problem.rows(places, holder)

    def places(self, rows: Ints) -> Ints:
        """Return the place of each row, shape (N,)."""
        return self.problem.places(rows)

    def states(self, places: Ints) -> Ints:
        """Return the task state of each place, shape (N,)."""
        state = self.pomdp.model.choices.state
        return places if state is None else state[places]

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
    def unhelped(self) -> OfRows | None:
        """Values of a robot that never helps; None if they follow from `pomdp` alone."""
        return None

    def bounded(self, entry: float, **limits: Any) -> list[tuple[float, Any]] | None:
        """Return each goal's probability and the problem whose upper bound holds for the whole task.

        None if that is `pomdp` itself. The arguments are those of `person.truncated_bound.bounded`.
        """
        del entry, limits
        return None


def not_worth_its_cost(c_suggest: float) -> str:
    """Return the sentence on a policy that weighs costs and makes no suggestion at this cost of one, in cost units."""
    return f"no suggestion was worth its cost (c_suggest {c_suggest:g})"
