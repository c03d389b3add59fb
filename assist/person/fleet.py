"""The robots of a team as arrays of shape (M,), and the best robot that one could make of them.

A property of a robot is a field of `Robot`; `Fleet` has the fields of all M robots.

People's problems have the *best* robot: it can do what any robot of the team can, at the lowest cost and in the
shortest time of any. Policies and simulations add what an action of each robot costs more (`Fleet.extra`).

Claim. A bound on the value of all policies for M of the best robots is one for the team, too.

Proof. Any policy of the team is one of those robots, too. Where a robot of the team needs longer for a way, the faster
one sets out later, so that both arrive in the same step. Its actions are possible, and cost no more. A robot that makes
room for another one leaves for free, as in people's problems, and comes back at the cost of a move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import frozen

from ..declare.declared import names_of
from ..people.decision import Bools, Floats, Ints
from .robots import EXECUTION, SUGGESTION, USUAL, OfRobots, Robot


class Kinds(NamedTuple):
    """The U kinds of M robots.

    Attributes
    ----------
    extra : float array, shape (U, 3)
        What the actions of each kind cost more, as in `Fleet.extra`.
    of_robot : int array, shape (M,)
        The number of each robot's kind.
    """

    extra: Floats
    of_robot: Ints


@dataclass(frozen=True)
class Fleet:
    """The M robots of a team with all of their values, which none of their fields lacks.

    Attributes
    ----------
    robots : tuple of Robot
    """

    robots: tuple[Robot, ...]

    @classmethod
    def of(cls, robots: Sequence[Robot], usual: OfRobots = USUAL) -> Fleet:
        """Return robots with the values of `usual`, such as a `Setting`, in the fields that are None."""
        return cls(tuple(
            replace(robot, **{name: getattr(usual, name) for name, value in vars(robot).items() if value is None})
            for robot in robots
        ))  # fmt: skip

    def __len__(self) -> int:
        return len(self.robots)

    def each(self, name: str) -> NDArray[Any]:
        """Return the value of a field for each robot, shape (M,)."""
        return np.array([getattr(robot, name) for robot in self.robots])

    @cached_property
    def executes(self) -> bool:
        """Whether any robot can execute an action."""
        return bool(self.each("execute").any())

    def least(self, name: str) -> float:
        """Return the lowest value of a cost or time of any robot: of an execution, of any that can execute."""
        values = self.each(name)
        return float(values[self.each("execute")].min() if name == "c_execute" and self.executes else values.min())

    @property
    def best(self) -> Robot:
        """The best robot: it can do what any can, at the lowest cost and in the shortest time of any.

        Its fields are the least of any robot. A field of which more is better has to be told apart here, or bounds
        would not hold.
        """
        kind = type(self.robots[0])
        return kind(execute=self.executes, **{name: self.least(name) for name in names_of(kind) if name != "execute"})

    @cached_property
    def extra(self) -> Floats:
        """What each robot's actions cost more than those of the best one, in cost units, by their class, shape (M, 3).

        It is infinite for the execution of an action by a robot that executes none, if others do.
        """
        more = np.array(self.each("costs") - self.best.costs)
        more[~self.each("execute"), EXECUTION] = np.inf if self.executes else 0.0
        return frozen(more)

    @cached_property
    def costs_differ(self) -> bool:
        """Whether an action of any robot costs more than one of the best robot, so that it is to be added."""
        return bool(self.extra.any())

    @cached_property
    def kinds(self) -> Kinds:
        """The robots by what they cost more: those with the same costs are of one kind."""
        rows, number = np.unique(self.extra, axis=0, return_inverse=True)
        return Kinds(frozen(rows), frozen(number.reshape(-1)))

    def extra_of(self, robot: Ints, executes: Bools) -> Floats:
        """Return the extra costs of actions of robots, given by their numbers from 0; others are suggestions."""
        return np.where(executes, self.extra[robot, EXECUTION], self.extra[robot, SUGGESTION])
