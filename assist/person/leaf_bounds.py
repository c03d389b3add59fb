"""Bounds on the values of the states at which a truncated problem ends."""

from __future__ import annotations

from dataclasses import dataclass, replace

from planner.system.arrays import outline

from ..people.decision import Floats, Ints


@dataclass(frozen=True)
class LeafBounds:
    """Bounds on the value of the frontier states of a truncated problem.

    A truncated problem ends when it reaches one of these states, the leaves. The bounds stand for the return from
    there.

    Attributes
    ----------
    states : int array, shape (m,)
        The frontier states.
    lower : float array, shape (m, H, T)
        Lower bound on the optimal value, in cost units, for each type and theta. It equals `upper` where only an upper
        bound is wanted (`person.truncated_bound`). A solver's lower bound then holds only for the truncated
        problem.
    upper : float array, shape (m, H, T)
        Upper bound on the value of every policy. In both arrays, an axis of length 1 stands for equal bounds. The
        axis of types may be one of goals until the problem is made (`of_types`).
    floor : float, optional
        Lower bound on the value of every policy that makes no further suggestion.
    away : float array, shape (m, H, T), optional
        Upper bound on the value of every policy whose robot must first travel to the person. If it is given, the
        subproblem of a team ends at these states.
    acting : int array, shape (m,), optional
        Row in which the person acts after the robot has executed an action that leads to each of these states. By
        default such an execution has no effect.
    value : float array, shape (m, G), optional
        V(x) of equation 7, the value that the person expects at these states, for each goal. The default is minus the
        exact cost-to-go.
    """

    states: Ints
    lower: Floats
    upper: Floats
    floor: float | None = None
    away: Floats | None = None
    value: Floats | None = None
    acting: Ints | None = None

    __repr__ = outline

    def __post_init__(self) -> None:
        for array in (self.states, self.lower, self.upper, self.away, self.value, self.acting):
            if array is not None:
                array.flags.writeable = False

    def of_types(self, goal_of: Ints) -> LeafBounds:
        """Return the bounds with an axis of types, shape (m, H, T), in the place of one of goals."""

        def by_type(bound: Floats) -> Floats:
            return bound if bound.shape[1] in (1, len(goal_of)) else bound[:, goal_of]

        return replace(self, lower=by_type(self.lower), upper=by_type(self.upper))
