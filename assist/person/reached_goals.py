"""What the robot learns from a person who continues: no goal that is reached in their state is theirs; compiled.

Only beliefs over several goals (`people.goals`) are conditioned on that. Their shapes are those of `belief_filter`.
"""

from __future__ import annotations

from planner.system.jit import njit

from ..people.decision import Floats
from .problem_arrays import ProblemArrays


@njit()
def exclude_reached(belief: Floats, x: int, m: ProblemArrays) -> None:
    """Condition a belief, shape (G * B, T), on the goal not being reached in row `x`, since the person still works.

    A belief in which every goal is reached does not change.
    """
    betas = m.chosen.shape[2]
    goals = len(belief) // betas
    states = len(m.counts) // goals
    left = 0.0
    for goal in range(goals):
        if not m.goal[goal * states + x % states]:
            left += belief[goal * betas : (goal + 1) * betas].sum()
    if left <= 0.0:
        return
    for goal in range(goals):
        if m.goal[goal * states + x % states]:
            belief[goal * betas : (goal + 1) * betas] = 0.0
    belief /= left


@njit()
def leave_out_reached(belief: Floats, x: int, m: ProblemArrays) -> float:
    """Set the cells of a flat belief, shape (G * B * T,), whose goal is reached in task state x to 0; return the rest.

    `x` is a row of the first goal. With one goal, nothing changes.
    """
    size, rest = m.chosen.shape[2] * len(m.theta), 0.0
    goals = len(belief) // size
    for goal in range(goals):
        reached = goals > 1 and m.goal[goal * (len(m.counts) // goals) + x]
        for h in range(goal * size, (goal + 1) * size):
            if reached:
                belief[h] = 0.0
            rest += belief[h]
    return rest
