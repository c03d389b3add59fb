"""What a robot can do for a person in each state: nothing, suggestions, and executions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..people.choices import Choices
from ..people.decision import NOTHING, Floats, Ints
from .leaf_bounds import LeafBounds
from .robots import OfRobots, Suggestions, costs_of


class RobotActions(NamedTuple):
    """The robot actions of each state; attributes as in `AssistPOMDP`."""

    number: Ints
    suggested: Ints
    afterstate: Ints
    costs: Floats

    @classmethod
    def of(
        cls, choices: Choices, suggestions: Suggestions, robot: OfRobots, frontier: LeafBounds | None
    ) -> RobotActions:
        """Number the robot actions of each state: nothing, the suggestions, and the executions if it executes."""
        nothing, suggestion, execution = costs_of(robot)
        best = choices.optimal if choices.offered is None else choices.offered
        offered = best if suggestions == "optimal" else choices.applicable & (choices.actions >= 0)
        offered = offered & ~choices.goal[:, None]
        count = offered.sum(axis=1)
        robot_actions = 1 + count * (1 + robot.execute)
        shape = (len(choices), int(robot_actions.max(initial=1)))
        suggested = np.full(shape, NOTHING, dtype=np.int64)
        afterstate = np.repeat(np.arange(len(choices))[:, None], shape[1], axis=1)
        costs = np.zeros(shape)
        costs[~choices.goal, 0] = nothing
        state, slot = np.nonzero(offered)
        column = np.cumsum(offered, axis=1)[state, slot]
        suggested[state, column] = slot
        costs[state, column] = suggestion
        if robot.execute:
            acting = np.arange(len(choices))
            if frontier is not None:
                acting[frontier.states] = NOTHING if frontier.acting is None else frontier.acting
            there = acting[choices.targets[state, slot]]
            afterstate[state, column + count[state]] = np.where(there == NOTHING, state, there)
            costs[state, column + count[state]] = execution
        return cls(robot_actions, suggested, afterstate, costs)
