"""A person's problem, and what people did, as named tuples of arrays, for compiled code."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from .pomdp import AssistPOMDP


def read_only(array: NDArray[Any], dtype: type | None = None) -> NDArray[Any]:
    """Return a contiguous, read-only view of an array, the only kind that compiled code receives.

    numba compiles a function separately for every combination of writable and read-only arguments. Arrays that were
    sent by another process may be writable, even if they were read-only there.
    """
    if array.flags.c_contiguous and not array.flags.writeable and dtype in (None, array.dtype):
        return array
    view = np.ascontiguousarray(array, dtype=dtype).view()
    view.flags.writeable = False
    return view


class Acts(NamedTuple):
    """What m people did.

    Attributes
    ----------
    x : int array, shape (m,)
        Row before the step: at their time, `x` of people and beliefs is the row after it.
    heard : int array, shape (m,)
        The robot action that the person heard, in that state; 0 is nothing.
    slot : int array, shape (m,)
        Slot of the person's choice; `NOTHING` if they did not act.
    goes_on : bool array, shape (m,)
        Whether the robot sees that the person has not reached their goal.
    """

    x: NDArray[np.int64]
    heard: NDArray[np.int64]
    slot: NDArray[np.int64]
    goes_on: NDArray[np.bool_]

    def of(self, rows: NDArray[np.int64]) -> Acts:
        """Return what some of the people did, given by their numbers."""
        return Acts(self.x[rows], self.heard[rows], self.slot[rows], self.goes_on[rows])


class ProblemArrays(NamedTuple):
    """A problem in the form that compiled code reads; shapes as in `AssistPOMDP` and `Choices`.

    It is a named tuple because numba does not accept dataclasses. `counts` is the number of choices in each state, and
    `goal` and `final` have the shape (G, n), and `ends` (n,), as in `AssistPOMDP`. `goal_of`, shape (H,), is the goal
    of each type.
    """

    counts: NDArray[np.int64]
    targets: NDArray[np.int64]
    costs: Floats
    goal: NDArray[np.bool_]
    final: NDArray[np.bool_]
    ends: NDArray[np.bool_]
    goal_of: NDArray[np.int64]
    robot_actions: NDArray[np.int64]
    suggested: NDArray[np.int64]
    afterstate: NDArray[np.int64]
    robot_costs: Floats
    chosen: Floats
    unsuggested: Floats
    moves: NDArray[np.bool_]
    low: NDArray[np.int64]
    weight: Floats
    followed_low: NDArray[np.int64]
    followed_weight: Floats
    uses_answer: bool
    theta: Floats
    gamma: float
    lapse: float

    @classmethod
    def of(cls, pomdp: AssistPOMDP) -> ProblemArrays:
        """Return the arrays of a problem."""
        choices = pomdp.model.choices
        arrays = {
            "counts": choices.applicable.sum(axis=1), "targets": choices.targets, "costs": choices.costs,
            "goal": choices.goals.goal, "final": pomdp.final, "ends": pomdp.ends, "goal_of": pomdp.hidden.goal_of,
            "robot_actions": pomdp.robot_actions, "suggested": pomdp.suggested, "afterstate": pomdp.afterstate,
            "robot_costs": pomdp.robot_costs,
            "chosen": pomdp.chosen, "unsuggested": pomdp.unsuggested, "moves": pomdp.moves,
            "low": pomdp.low, "weight": pomdp.weight, "theta": pomdp.grid.theta,
            "followed_low": pomdp.low if pomdp.followed_low is None else pomdp.followed_low,
            "followed_weight": pomdp.weight if pomdp.followed_weight is None else pomdp.followed_weight,
        }  # fmt: skip
        return cls(
            **{name: read_only(array) for name, array in arrays.items()},
            uses_answer=pomdp.followed_low is not None,
            gamma=float(pomdp.gamma),
            lapse=float(pomdp.model.lapse),
        )
