"""What the robots of a team can do and what it costs; they may differ."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field

from ..declare.declared import MOST, Number, Truth, Usual, declared

LONGEST = 1e9
"""Steps; far beyond the length of any episode."""

Suggestions = Literal["optimal", "all"]

NOTHING_DONE, SUGGESTION, EXECUTION = CLASSES = range(3)
"""The classes of robot actions, which cost differently."""


@dataclass(frozen=True)
class Best:
    """Marks a field of robots with what the best robot has that one could make of several (`Fleet.best`).

    Attributes
    ----------
    of : callable
        Returns the best of the robots' values: no robot can do what a robot with this value cannot, or at a lower cost.
    where : str, optional
        Field of truth values without which a robot's own value has no effect.
    """

    of: Callable[[list[Any]], Any]
    where: str | None = None


@dataclass(frozen=True)
class OfOnePerson:
    """Marks a field of a setting that concerns people one by one, so that it may differ in pools that are joined."""


@declared
class OfRobots:
    """What robots can do and what it costs; a `Setting` has these fields for robots that do not say otherwise."""

    execute: Annotated[
        Truth, Best(any), OfOnePerson(), Field(description="Whether the robot can also execute an action itself.")
    ] = False
    c_suggest: Annotated[
        Number,
        Best(min),
        OfOnePerson(),
        Usual(),
        Field(ge=0, le=MOST, description="Cost of a suggestion, in cost units."),
    ] = 1.0
    c_execute: Annotated[
        Number,
        Best(min, where="execute"),
        OfOnePerson(),
        Field(ge=0, le=MOST, description="Cost of an action that the robot executes, in cost units."),
    ] = 1.0
    c_move: Annotated[
        Number,
        Best(min),
        Usual(),
        Field(ge=0, le=MOST, description="Cost of moving by a distance of 1, in cost units."),
    ] = 0.5
    travel_time: Annotated[
        Number, Best(min), Field(ge=0, le=LONGEST, description="Steps for moving by a distance of 1.")
    ] = 0.0

    @property
    def costs(self) -> tuple[float, float, float]:
        """What each class of robot actions costs: to be with a person and do nothing, a suggestion, an execution.

        These are finite numbers of 0 or more (`costs_of`).
        """
        return 0.0, self.c_suggest, self.c_execute


def costs_of(robot: OfRobots) -> tuple[float, float, float]:
    """Return what each class of a robot's actions costs, as certified bounds assume it: no reward.

    Raises
    ------
    ValueError
        The costs are not three finite numbers of 0 or more.
    """
    costs = robot.costs
    if len(costs) != len(CLASSES) or not all(0 <= cost < math.inf for cost in costs):
        raise ValueError(
            f"{type(robot).__name__}.costs {tuple(costs)}: expected three numbers of 0 or more, the costs of waiting, "
            "of a suggestion and of an execution"
        )
    return costs


USUAL = OfRobots()
"""A robot that nothing else is said of."""


@declared(partial=True)
class Robot(OfRobots):
    """One robot of a team. Where a field of `OfRobots` is None, the robot has the value of the setting."""
