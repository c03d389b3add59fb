"""Robots that differ in what they can do and in what it costs.

A bound on the value of all policies for M robots that can each do what any of a team's robots can, at the lowest cost
and in the shortest time of any (`best_robots`), is one for that team, too.

Proof. Any policy of the team is one of those robots, too: where a robot of the team is still on its way, the faster one
has arrived and waits, which no other robot can disturb. Its actions are possible, and cost no more. A robot that makes
room for another one leaves for free, as in people's problems, and comes back at the cost of a move.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from planner.system.errors import expected

from ..people.arguments import whole
from ..people.decision import Floats

S = TypeVar("S", bound=Any)
"""The type of a `Setting`, whose field `robots` may hold a `Robot` for each of a team."""


@dataclass(frozen=True)
class Robot:
    """One robot of a team whose robots differ. Where a field is None, the robot has the value of the setting.

    Attributes
    ----------
    execute : bool, optional
        Whether the robot can also execute an action itself.
    c_suggest, c_execute, c_move : float, optional
        Costs of a suggestion, of an action that the robot executes, and of moving by a distance of 1, in cost units.
    travel_time : float, optional
        Steps for moving by a distance of 1.
    """

    execute: bool | None = None
    c_suggest: float | None = None
    c_execute: float | None = None
    c_move: float | None = None
    travel_time: float | None = None

    @classmethod
    def of(cls, plain: Robot | Mapping[str, Any]) -> Robot:
        """Return the robot that `as_dict` converted to plain data; a robot is returned unchanged.

        Raises
        ------
        ValueError
            It has unknown fields, or is no robot.
        """
        if isinstance(plain, Robot):
            return plain
        if not isinstance(plain, Mapping):
            raise ValueError(f"{plain!r}; expected a Robot")  # noqa: TRY004
        known = [one.name for one in fields(cls)]
        for name in plain:
            if name not in known:
                raise ValueError(f"{name!r} is unknown; {expected(str(name), known)}")
        return cls(**plain)

    def as_dict(self) -> dict[str, Any]:
        """Return the fields that are given, as plain data."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@dataclass(frozen=True)
class ExtraCosts:
    """How much more an action of each of M different robots costs than with the lowest cost of any, in cost units.

    Attributes
    ----------
    suggesting : float array, shape (M,)
        For a suggestion.
    executing : float array, shape (M,)
        For the execution of an action; infinite for a robot that executes none.
    """

    suggesting: Floats
    executing: Floats

    def __post_init__(self) -> None:
        self.suggesting.flags.writeable = self.executing.flags.writeable = False

    def of(self, robot: NDArray[np.int64], executes: NDArray[np.bool_]) -> Floats:
        """Return the extra costs of actions of robots, given by their numbers from 0; other actions are suggestions."""
        return np.where(executes, self.executing[robot], self.suggesting[robot])


def robots_of(robots: Any) -> int | tuple[Robot, ...]:
    """Return the checked number of robots, or each of them if a sequence is given.

    Raises
    ------
    ValueError
        It is neither a number from 1 upwards nor a sequence of robots.
    """
    if not isinstance(robots, Sequence) or isinstance(robots, str):
        return whole("robots", robots, 1)
    if not robots:
        raise ValueError("robots []: expected one or more")
    each = []
    for m, robot in enumerate(robots, start=1):
        try:
            each.append(Robot.of(robot))
        except ValueError as error:
            raise ValueError(f"robot {m}: {error}") from None
    return tuple(each)


def each_alone(setting: S) -> tuple[S, ...]:
    """Return the settings of a team with each of its robots alone.

    Raises
    ------
    ValueError
        A field of a robot is out of its range.
    """
    if not setting.differ:
        return (replace(setting, robots=1),) * setting.robots
    found = []
    for m, robot in enumerate(setting.robots, start=1):
        try:
            found.append(replace(setting, robots=1, **robot.as_dict()))
        except ValueError as error:
            raise ValueError(f"robot {m}: {error}") from None
    return tuple(found)


def best_robots(setting: S) -> S:
    """Return the setting of as many robots that are alike: each can do what any robot can, at the lowest cost of any.

    People's problems have these robots, and policies and simulations add the `extra_costs` of each.
    """
    if not setting.differ:
        return setting
    each = each_alone(setting)
    least = {name: min(getattr(one, name) for one in each) for name in ("c_suggest", "c_move", "travel_time")}
    execute = [one.c_execute for one in each if one.execute]
    return replace(
        setting, robots=len(each), execute=bool(execute), c_execute=min(execute, default=setting.c_execute), **least
    )


def extra_costs(setting: Any) -> ExtraCosts | None:
    """Return how much more the actions of each robot cost than those of `best_robots`; None if the robots are alike."""
    if not setting.differ:
        return None
    each, least = each_alone(setting), best_robots(setting)
    return ExtraCosts(
        np.array([one.c_suggest - least.c_suggest for one in each]),
        np.array([one.c_execute - least.c_execute if one.execute else np.inf for one in each]),
    )
