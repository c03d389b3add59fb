"""The problems of people whose goal is known to be one of several, from the problem in which it is hidden.

They bound teams whose goals are unknown. If person k pursues goal g with probability p_k(g), the claim of
`certify.team_bound` holds with sum_g p_k(g) V_kg(lambda) in place of V_k(lambda), where V_kg is the optimal value of
their subproblem if the goal is known to be g.

Proof. A robot that knows all goals from the beginning can ignore them, so that no policy is better than its optimum.
For each vector of goals the claim bounds this optimum. Its mean over the goals is as stated, since prices do not depend
on goals and the sum over people is linear; goals of different people may depend on each other. The robot actions of
V_kg are those with the unknown goal: steps that are optimal for any goal may be suggested. V_kg ends when the goal is
reached, where a robot that does not see this could only pay for more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..people.choices import Choices
from ..people.decision import NOTHING
from .pomdp import AssistPOMDP


def of_each_goal(pomdp: AssistPOMDP) -> list[tuple[float, AssistPOMDP]]:
    """Return each possible goal's prior probability, and the problem of a person whose goal it is known to be.

    The robot actions are those of the problem with a hidden goal, so that some suggestions may be useless to that
    person. If the goal is known already, the problem is returned with probability 1.
    """
    choices, betas, found = pomdp.model.choices, len(pomdp.grid.beta), []
    if choices.goals is None or choices.goal_count == 1:
        return [(1.0, pomdp)]
    states = len(choices) // choices.goal_count
    for number, share in enumerate(choices.goals.values()):
        if share == 0:
            continue
        own = slice(number * states, (number + 1) * states)
        known, low, weight = _choices_of(choices, own), pomdp.followed_low, pomdp.followed_weight
        problem = replace(
            pomdp, model=replace(pomdp.model, choices=known, q=pomdp.model.q[own]),
            prior=pomdp.prior[number * betas : (number + 1) * betas] / share,
            robot_actions=np.where(known.goal, 1, pomdp.robot_actions[own]),
            suggested=np.where(known.goal[:, None], NOTHING, pomdp.suggested[own]),
            afterstate=pomdp.afterstate[own] - own.start, robot_costs=pomdp.robot_costs[own],
            chosen=pomdp.chosen[own], unsuggested=pomdp.unsuggested[own], low=pomdp.low[own], weight=pomdp.weight[own],
            followed_low=None if low is None else low[own],
            followed_weight=None if weight is None else weight[own],
        )  # fmt: skip
        found.append((share, problem))
    return found


def _choices_of(choices: Choices, own: slice) -> Choices:
    """Return the choices of people who pursue the goal with some rows; a row is a task state."""
    return replace(
        choices, h=choices.h[own], goal=choices.goal[own], applicable=choices.applicable[own],
        actions=choices.actions[own], targets=choices.targets[own] - own.start, costs=choices.costs[own],
        optimal=choices.optimal[own], state=None, key=None if choices.key is None else choices.key[own],
        goals=None, assume_likeliest=False,
    )  # fmt: skip
