"""The robots of a team as arrays of shape (M,), and the best robot that one could make of them.

A property of a robot is a field of `Robot`; `Fleet` has the fields of all M robots. Each field says itself what the
best of several robots has (`robots.Best`).

People's problems have the *best* robot: it can do what any robot of the team can, at the lowest cost and in the
shortest time of any. Policies and simulations add what an action of each robot costs more (`Fleet.extra`).

Claim. What the robots of a team do to a person is a policy of that person's subproblem with the best robot
(`attention_subproblem`), at costs that are not higher there. So the bound of `certify.team_bound`, in which people's
subproblems have the best robot, holds for the team.

Proof. The best robot's actions include those of each robot, at costs that are not higher. Where a robot of the team
needs longer for the way to the person, the best one sets out later, so that both arrive in the same step. Until then it
is away in the subproblem, which costs nothing. A robot that makes room for another one leaves for free, as in the
subproblem, and comes back at the cost of a move.

This is a statement about subproblems. M of the best robots need not be as good as the team. The faster robot has to be
somewhere until it sets out. There it may pay for waiting, or another robot may send it to the base, from where the way
may be longer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.system.arrays import frozen

from ..declare.declared import annotation_of, marks, names_of
from ..people.decision import Bools, Floats, Ints
from .robots import EXECUTION, NOTHING_DONE, SUGGESTION, USUAL, Best, OfRobots, Robot, costs_of


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
        """Return robots with the values of `usual`, such as a `Setting`, in its fields that are None in them."""
        shared = names_of(type(usual))
        return cls(tuple(
            replace(robot, **{
                name: getattr(usual, name) for name, value in vars(robot).items() if value is None and name in shared
            })
            for robot in robots
        ))  # fmt: skip

    def __len__(self) -> int:
        return len(self.robots)

    def scarce_for(self, people: int) -> bool:
        """Return whether the robots ever have to choose among so many people: there are fewer robots."""
        return len(self) < people

    def relays(self, entry_steps: int) -> bool:
        """Return whether one robot may leave a person while another is on its way there, so that no robot waits.

        `entry_steps` is the time in which a robot comes to the person. Without it, or for a robot alone, what waiting
        costs is paid in each step in which somebody is attended to and nothing is suggested.
        """
        return entry_steps > 0 and len(self) > 1

    def attention(self, people: ArrayLike) -> Floats:
        """Return the share of a robot's attention that each of so many people at work gets, at most 1."""
        return np.minimum(1.0, len(self) / np.maximum(1, people))

    def each(self, name: str) -> NDArray[Any]:
        """Return the value of a field for each robot, shape (M,)."""
        return np.array([getattr(robot, name) for robot in self.robots])

    @cached_property
    def executes(self) -> bool:
        """Whether any robot can execute an action."""
        return bool(self.each("execute").any())

    def with_effect(self, name: str) -> list[Any]:
        """Return the values of a field, of those robots of which it has an effect; there may be none."""
        where = _best(type(self.robots[0]), name).where
        return [getattr(robot, name) for robot in self.robots if where is None or getattr(robot, where)]

    @cached_property
    def best(self) -> Robot:
        """The best robot: it can do what any can, at the lowest cost and in the shortest time of any.

        The mark `Best` of each field says how the best value is made of those of the robots.
        """
        cls = type(self.robots[0])
        return cls(**{
            name: _best(cls, name).of(self.with_effect(name) or [getattr(robot, name) for robot in self.robots])
            for name in names_of(cls)
        })  # fmt: skip

    @cached_property
    def alike(self) -> bool:
        """Whether all robots have the same values in all fields that have an effect."""
        each = map(self.with_effect, names_of(type(self.robots[0])))
        return all(value == values[0] for values in each for value in values)

    @cached_property
    def extra(self) -> Floats:
        """What each robot's actions cost more than those of the best one, in cost units, by their class, shape (M, 3).

        It is infinite for the execution of an action by a robot that executes none, if others do.

        Raises
        ------
        ValueError
            A cost is less than 0; or an action of a robot costs less than one of the best robot.
        """
        more = np.array([costs_of(robot) for robot in self.robots]) - costs_of(self.best)
        more[~self.each("execute"), EXECUTION] = np.inf if self.executes else 0.0
        if (more < 0).any():
            robot, action = np.argwhere(more < 0)[0].tolist()
            what = ("waiting", "a suggestion", "an execution")[action]
            raise ValueError(
                f"robots: {what} costs robot {robot + 1} less than the best robot that has the marked fields of all; "
                f"expected marks and {type(self.robots[0]).__name__}.costs by which the best robot pays least"
            )
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

    @cached_property
    def waiting(self) -> Floats:
        """What each kind of robot pays for being with somebody at work and doing nothing, shape (U,)."""
        return frozen(self.best.costs[NOTHING_DONE] + self.kinds.extra[:, NOTHING_DONE])

    def extra_of(self, robot: Ints, executes: Bools) -> Floats:
        """Return the extra costs of actions of robots, given by their numbers from 0; others are suggestions."""
        return np.where(executes, self.extra[robot, EXECUTION], self.extra[robot, SUGGESTION])


def _best(cls: type[Robot], name: str) -> Best:
    """Return the mark of a field of robots.

    Raises
    ------
    ValueError
        It has none.
    """
    found = next((one for one in marks(annotation_of(cls, name)) if isinstance(one, Best)), None)
    if found is None:
        raise ValueError(
            f"{cls.__name__}.{name}: expected a mark in its annotation that says what the best of several robots has, "
            "such as Best(min)"
        )
    return found
