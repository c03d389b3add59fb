"""What the robots of a team can do and what it costs; they may differ."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from ..declare.declared import MOST, Number, Truth, Usual, declared

LONGEST = 1e9
"""Steps; far beyond the length of any episode."""

Suggestions = Literal["optimal", "all"]

NOTHING_DONE, SUGGESTION, EXECUTION = range(3)
"""The classes of robot actions, which cost differently."""


@declared
class OfRobots:
    """What robots can do and what it costs; a `Setting` has these fields for robots that do not say otherwise."""

    execute: Annotated[Truth, Field(description="Whether the robot can also execute an action itself.")] = False
    c_suggest: Annotated[Number, Usual(), Field(ge=0, le=MOST, description="Cost of a suggestion, in cost units.")] = (
        1.0
    )
    c_execute: Annotated[
        Number, Field(ge=0, le=MOST, description="Cost of an action that the robot executes, in cost units.")
    ] = 1.0
    c_move: Annotated[
        Number, Usual(), Field(ge=0, le=MOST, description="Cost of moving by a distance of 1, in cost units.")
    ] = 0.5
    travel_time: Annotated[Number, Field(ge=0, le=LONGEST, description="Steps for moving by a distance of 1.")] = 0.0

    @property
    def costs(self) -> tuple[float, float, float]:
        """What each class of robot actions costs: to be with a person and do nothing, a suggestion, an execution."""
        return 0.0, self.c_suggest, self.c_execute


USUAL = OfRobots()
"""A robot that nothing else is said of."""


@declared(partial=True)
class Robot(OfRobots):
    """One robot of a team. Where a field is None, the robot has the value of the setting."""
