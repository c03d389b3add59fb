"""The belief in a person by brute force: a sum over all histories of states, goals, betas and thetas."""

from __future__ import annotations

import numpy as np

from assist.people import Choices
from assist.people.decision import choice, influence, lapse, perceived_value, trust
from assist.person import AssistPOMDP, ObservationModel

Steps = list[tuple[ObservationModel, str | None, str | None]]
"""How the robot sees, what it suggested, and the action that it saw, of each step."""


def chance_of_seeing(model: ObservationModel, c: Choices, row: int, slot: int, seen: str | None) -> float:
    """The probability of what is seen of an action, by the definition of the model."""
    if seen is None:
        return model.miss
    names = [c.name(row, n) for n in range(int(c.applicable[row].sum()))]
    done = names[slot]
    if not isinstance(model.confusion, float):
        others = model.confusion.get(done, {})
        p = 1 - sum(others.values()) if seen == done else others.get(seen, 0.0)
    elif len(names) == 1:
        p = float(seen == done)
    else:
        p = 1 - model.confusion if seen == done else model.confusion / (len(names) - 1) * (seen in names)
    return (1 - model.miss) * p


def by_enumeration(pomdp: AssistPOMDP, steps: Steps, *, works: bool | None = True) -> np.ndarray:
    """Sum over all histories of people at work, by the equations: each state with each goal, beta and theta.

    The last action may have reached the goal unless they are known to work on. With None the robot does not see who
    goes on: after their goal people act by lapses alone.
    """
    c, grid, each = pomdp.model.choices, pomdp.grid, pomdp.model.of_each_goal
    values, found = [perceived_value(*one) for one in each], np.zeros((len(c), len(c.goals), *grid.shape))

    def follow(row: int, g: int, b: int, weights: np.ndarray, left: Steps) -> None:
        if not left:
            found[row, g, b] += weights
            return
        goal, q, value = c.goals.goal[g], each[g][1], values[g]
        (model, suggestion, seen), *rest = left
        names = [c.name(row, n) for n in range(int(c.applicable[row].sum()))]
        slot = names.index(suggestion) if suggestion in names else -1
        moved = np.eye(len(grid.theta))
        if slot >= 0:
            after = [float(trust(t, value[row], value[c.targets[row, slot]], 0.2)) for t in grid.theta]
            moved = np.array([[np.interp(t, grid.theta, column) for column in np.eye(len(grid.theta))] for t in after])
        p = choice(q[row], c.applicable[row], grid.beta[b]) * (not goal[row])
        chances = [lapse(influence(p, slot, t), c.applicable[row], 0.01) for t in grid.theta]
        for a in range(len(names)):
            to, chance = int(c.targets[row, a]), chance_of_seeing(model, c, row, a, seen)
            if chance and not (goal[to] and (works or rest) and works is not None):
                follow(to, g, b, (weights * chance * [one[a] for one in chances]) @ moved, rest)

    prior = pomdp.prior.reshape(len(c.goals), *grid.shape)
    for g in range(len(c.goals)):
        for b in range(len(grid.beta)):
            follow(c.initial, g, b, prior[g, b], steps)
    return found
