"""The rows of one person's problem: all of them from the start, or those of situations in which people have been.

A policy asks its problem for the rows of situations (`person.rows`) and reads the problem on all rows so far. In a
`WholeProblem` all rows were added at the start. In a `GrowingProblem` a situation gets its row when somebody comes
there.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from planner import CostToGo

from ..people.choices import Choices
from ..people.decision import Ints
from .each_goal import NO_LIMITS, BoundLimits, Outer, TruncatedProblem, given_goals
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays, read_only
from .rows import NONE


class Snapshot(NamedTuple):
    """The problem on all rows so far. What becomes known of robot actions later appears in its arrays.

    Attributes
    ----------
    pomdp : AssistPOMDP
    arrays : ProblemArrays
        The problem in the form that compiled code reads.
    stamps : int array, shape (n,)
        A number for each row that is another one when the row has another situation.
    """

    pomdp: AssistPOMDP
    arrays: ProblemArrays
    stamps: Ints


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


class ProblemRows(Protocol):
    """One person's problem on rows. Methods take N situations or rows at a time.

    Attributes
    ----------
    region : int or None
        Number of states of the truncated task on which values are computed; None if all situations have rows.
    first : AssistPOMDP
        The problem before anybody has come to another situation than the initial one; or the whole problem.
    lasting : int array
        The rows of which everything is known and stays known: all of them, or none.
    task : Choices or CostToGo
        The whole task: the choices in all of its states, or its cost-to-go, that of the first goal if there are
        several.
    extent : Extent
        The largest numbers that occur anywhere in the task, for arrays of a fixed size.
    searches : bool
        Whether a state that was not visited before takes a slow search.
    cheapest, dearest : float
        The smallest positive cost of an action, 1 if all actions are free, and the largest cost of an action or a wait,
        in cost units.
    """

    region: int | None
    first: AssistPOMDP
    lasting: Ints
    task: Choices | CostToGo
    searches: bool
    cheapest: float
    dearest: float

    @property
    def extent(self) -> Extent: ...  # noqa: D102

    @property
    def whole(self) -> bool:
        """Whether all situations have rows, of which everything is known from the start."""
        return self.region is None

    def bounded(
        self, entry: float, entry_steps: int = 0, *, outer: Outer = "frontier", limits: BoundLimits = NO_LIMITS
    ) -> list[tuple[float, TruncatedProblem]]:
        """Return each possible goal's probability, and the problem given this goal whose upper bound holds for all.

        The arguments are those of `person.truncated_bound.bounded`.
        """
        ...

    def task_of(self, goal: int) -> Choices | CostToGo:
        """Return the whole task with one of the goals, given by its number."""
        ...

    def states(self, situations: Ints) -> Ints:
        """Return the task state of each situation, shape (N,)."""
        ...

    @property
    def now(self) -> Snapshot:
        """The problem on all rows so far."""
        ...

    def rows(self, situations: Ints, holder: object = None) -> Ints:
        """Return the row of each situation in which people are, shape (N,), and compute what is not known of it yet.

        Parameters
        ----------
        situations : int array, shape (N,)
            Places as in `person.rows`: states of the task or, with terms, pairs of a state and a memory.
        holder : object, optional
            What keeps these numbers until it asks for others, or no longer exists. Rows without a holder may be evicted
            when other rows are asked for.
        """
        ...

    def hold(self, holder: object, rows: Ints) -> None:
        """Let a holder hold these rows, shape (N,), in place of those that it held before."""

    def situations(self, rows: Ints) -> Ints:
        """Return the situation of each row, shape (N,)."""
        ...

    def effects(self, x: Ints, action: Ints) -> tuple[Ints, Ints]:
        """Compute what robot actions do to trust in some rows, both of shape (N,), where it is not known yet.

        Return the rows, shape (m,), whose choices decide what happens and which are not lasting, after the index of the
        robot action for each: the person's own row, and that to which a suggestion or an execution leads.
        """
        ...


class WholeProblem(ProblemRows):
    """One person's problem on a whole task: all rows were added at the start, and a row is its situation.

    Parameters
    ----------
    pomdp : AssistPOMDP
    """

    region, searches = None, False

    def __init__(self, pomdp: AssistPOMDP) -> None:
        self.first, self.lasting = pomdp, np.arange(len(pomdp.robot_actions))
        self.task = self._choices = pomdp.model.choices
        self.cheapest, self.dearest = self._choices.unit, float(self._choices.costs.max(initial=0.0))

    @property
    def extent(self) -> Extent:
        """The largest numbers that occur in the arrays."""
        h = self._choices.goals.h
        most, actions = self.first.suggested.shape
        return Extent(most, actions, float(h[np.isfinite(h)].max(initial=0.0)))

    def bounded(
        self, entry: float, entry_steps: int = 0, *, outer: Outer = "frontier", limits: BoundLimits = NO_LIMITS
    ) -> list[tuple[float, TruncatedProblem]]:
        """Return each goal's probability and its problem, which has no frontier."""
        del entry, entry_steps, outer, limits
        return [(chance, TruncatedProblem(problem)) for chance, problem in given_goals(self.first)]

    def task_of(self, goal: int) -> Choices:
        """Return the choices with one of the goals."""
        return self._choices.of_goal(goal)

    def states(self, situations: Ints) -> Ints:
        """Return the task state of each situation, shape (N,)."""
        return situations if self._choices.state is None else self._choices.state[situations]

    @cached_property
    def now(self) -> Snapshot:
        """The problem."""
        every = np.zeros(len(self.first.robot_actions), dtype=np.int64)
        return Snapshot(self.first, ProblemArrays.of(self.first), read_only(every))

    def rows(self, situations: Ints, holder: object = None) -> Ints:
        """Return the situations."""
        del holder
        return situations

    def hold(self, holder: object, rows: Ints) -> None:
        """Do nothing: no row is evicted."""

    def situations(self, rows: Ints) -> Ints:
        """Return the rows."""
        return rows

    def effects(self, x: Ints, action: Ints) -> tuple[Ints, Ints]:
        """Return no rows: all is known."""
        del x, action
        return NONE, NONE
