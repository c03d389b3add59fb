"""The streams of random numbers of an episode, by what the numbers are for."""

from __future__ import annotations

from enum import IntEnum


class Stream(IntEnum):
    """What uniform numbers are for; a change of a number changes all results for a seed."""

    TYPE = 0
    """A person's type and theta, in the robot's model."""
    CHOICE = 1
    THETA = 2
    """The grid point to which theta moves, in the robot's model."""
    TEAM = 3
    GOAL = 4
    MISSED = 5
    """Whether the robots miss an action."""
    TAKEN_FOR = 6
    """What they take it for."""
    ANSWER = 7
    NEIGHBOURS = 8
    """The grid point to which theta moves by what is seen of neighbours, in the robot's model."""
