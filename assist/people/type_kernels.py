"""Compiled functions for several possible goals: a goal that was reached is excluded, and what a mistake is.

`hidden_type` has the definitions.
"""

from __future__ import annotations

from planner.system.jit import njit

from .hidden_type import Bools, Floats, Ints


@njit(inner=True)
def leave_out_reached(belief: Floats, mass: float, x: int, goal: Bools, goal_of: Ints) -> float:
    """Set the cells of a flat belief, shape (H * T,), whose goal is reached in state x to 0; return the mass left.

    Parameters
    ----------
    belief : float array, shape (H * T,)
    mass : float
        Its sum.
    x : int
    goal : bool array, shape (G, n)
    goal_of : int array, shape (H,)
    """
    some = False
    for g in range(len(goal)):
        some |= goal[g, x]
    if not some:
        return mass
    thetas, left = len(belief) // len(goal_of), 0.0
    for h in range(len(goal_of)):
        for cell in range(h * thetas, (h + 1) * thetas):
            if goal[goal_of[h], x]:
                belief[cell] = 0.0
            left += belief[cell]
    return left


@njit()
def exclude_reached(belief: Floats, x: int, goal: Bools, goal_of: Ints) -> None:
    """Condition a belief, shape (H, T), on its goal not being reached in state `x`, since the person goes on.

    A belief in which every goal is reached does not change. The other arguments are those of `leave_out_reached`.
    """
    some, left = False, 0.0
    for g in range(len(goal)):
        some |= goal[g, x]
    if not some:
        return
    for h in range(len(goal_of)):
        part = 0.0
        for t in range(belief.shape[1] if not goal[goal_of[h], x] else 0):
            part += belief[h, t]
        left += part
    if left <= 0.0:
        return
    for h in range(len(goal_of)):
        for t in range(belief.shape[1]):
            belief[h, t] = 0.0 if goal[goal_of[h], x] else belief[h, t] / left


@njit()
def is_mistake(optimal: Bools, belief: Floats, x: int, goal: Bools, goal_of: Ints) -> bool:
    """Return whether an action in state x is optimal for no goal that is possible: probable, and not reached.

    Parameters
    ----------
    optimal : bool array, shape (G,)
        Whether the action is optimal for each goal.
    belief : float array, shape (H, T)
    x, goal, goal_of
        As in `leave_out_reached`.
    """
    for h in range(len(goal_of)):
        if optimal[goal_of[h]] and not goal[goal_of[h], x]:
            for t in range(belief.shape[1]):
                if belief[h, t] > 0.0:
                    return False
    return True
