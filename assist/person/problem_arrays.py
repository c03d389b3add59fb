"""A person's problem as arrays, for compiled code."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from .pomdp import AssistPOMDP


def read_only(array: NDArray[Any], dtype: type | None = None) -> NDArray[Any]:
    """Give a contiguous view that is read-only, wherever the array is from: compiled code is given nothing else.

    numba compiles once more for every mixture of arrays that may be written to and of others, and those that another
    process sends may be, whatever they were there.
    """
    view = np.ascontiguousarray(array, dtype=dtype).view()
    view.flags.writeable = False
    return view


class ProblemArrays(NamedTuple):
    """A problem in the form that compiled code reads; shapes as in `AssistPOMDP` and `Choices`.

    A named tuple, however long: numba takes no dataclasses.
    """

    counts: NDArray[np.int64]
    targets: NDArray[np.int64]
    costs: Floats
    goal: NDArray[np.bool_]
    final: NDArray[np.bool_]
    robot_actions: NDArray[np.int64]
    suggested: NDArray[np.int64]
    afterstate: NDArray[np.int64]
    robot_costs: Floats
    chosen: Floats
    unsuggested: Floats
    low: NDArray[np.int64]
    weight: Floats
    theta: Floats
    gamma: float
    lapse: float

    @classmethod
    def of(cls, pomdp: AssistPOMDP) -> ProblemArrays:
        """Collect the arrays of a problem."""
        choices = pomdp.model.choices
        arrays = {
            "counts": choices.applicable.sum(axis=1), "targets": choices.targets, "costs": choices.costs,
            "goal": choices.goal, "final": pomdp.final, "robot_actions": pomdp.robot_actions,
            "suggested": pomdp.suggested, "afterstate": pomdp.afterstate, "robot_costs": pomdp.robot_costs,
            "chosen": pomdp.chosen, "unsuggested": pomdp.unsuggested, "low": pomdp.low, "weight": pomdp.weight,
            "theta": pomdp.grid.theta,
        }  # fmt: skip
        return cls(
            **{name: read_only(array) for name, array in arrays.items()},
            gamma=float(pomdp.gamma),
            lapse=float(pomdp.model.lapse),
        )
