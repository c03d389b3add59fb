"""How many steps of a team have prices of attention, unless the user says so."""

from __future__ import annotations

import math

import numpy as np

from ..people.choices import Choices
from ..team.baselines import NoAssistance
from ..team.pool import Pool
from ..team.simulate import simulate


def window_of(pool: Pool, team: tuple[int, ...], seed: int, *, at_work: int = 5, plans: int = 6) -> int:
    """Return the number of steps with prices; any number gives a valid bound.

    It is twice the number of actions of the longest optimal plan. For a large team it may be more: the number of steps
    in which more than `at_work` people per robot are at work if none is helped, but at most `plans` times that number
    of actions. Free actions do not count: if the plan costs less than so many of the cheapest actions that are not
    free, then it counts as that many.
    """
    tasks = {id(task): task for task in map(pool.choices, team)}
    each = [one for task in tasks.values() for one in task.of_each_goal]
    shortest = max(min(plan_length(one, one.initial), float(one.h[one.initial]) / one.unit) for one in each)
    alone = simulate(pool, NoAssistance(), humans=list(team), episodes=64, seed=seed, world="model").actions
    steps = np.arange(math.ceil(plans * shortest))
    working = (alone[:, :, None] > steps).sum(axis=1).mean(axis=0)
    return max(math.ceil(2 * shortest), int((working > at_work * len(pool.setting.robots)).sum()))


def plan_length(choices: Choices, row: int) -> float:
    """Return the smallest number of actions of an optimal plan from a row; infinite in a dead end.

    If the choices end before a goal, the rest of the plan counts in proportion to its cost.
    """
    if np.isinf(choices.h[row]):
        return math.inf
    reached, seen = np.array([row]), np.zeros(len(choices), dtype=bool)
    for length in range(len(choices)):
        if choices.goal[reached].any():
            return length
        ends = reached[~choices.optimal[reached].any(axis=1)]
        if len(ends):
            left = float(choices.h[ends].min())
            done = float(choices.h[row]) - left
            return length + left * (length / done if done > 0 else 1 / choices.unit)
        seen[reached] = True
        following = np.unique(choices.targets[reached][choices.optimal[reached]])
        reached = following[~seen[following]]
    return math.inf
