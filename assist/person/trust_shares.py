"""What suggestions do to theta on the grid of a robot's belief."""

from __future__ import annotations

import numpy as np

from ..people.belief import Grid
from ..people.choice_model import ChoiceModel, value
from ..people.decision import NOTHING, Floats, Ints
from ..people.human import HumanModel
from ..people.perceived_suggestions import PerceivedSuggestions, moved
from ..people.trust_rules import TrustRule
from .leaf_bounds import LeafBounds


def trust_shares(
    model: HumanModel, chooses: ChoiceModel, grid: Grid, rule: TrustRule, frontier: LeafBounds | None,
    suggested: Ints, *, followed: bool,
) -> tuple[Ints, Floats]:  # fmt: skip
    """Return the grid's shares of theta after each robot action, for each goal, both of shape (n, R, G, T).

    A robot action that suggests nothing leads to a step without a suggestion.
    """
    slot, shape = np.maximum(suggested, 0), (*suggested.shape, len(grid.theta))
    each = []
    for goal, (choices, q) in enumerate(model.of_each_goal):
        v = value(chooses, choices, q)
        if frontier is not None:  # no choices are known at the leaves, hence no value of the next state
            leaves = frontier.states
            v[leaves] = -choices.h[leaves] if frontier.value is None else frontier.value[:, goal]
        perceived = PerceivedSuggestions.of(
            np.take_along_axis(q, slot, axis=1)[:, :, None], q.min(axis=1)[:, None, None],
            v[:, None, None], v[np.take_along_axis(choices.targets, slot, axis=1)][:, :, None],
            np.take_along_axis(choices.optimal, slot, axis=1)[:, :, None],
        )  # fmt: skip
        event = perceived.event(followed, rule.feedback, suggested[:, :, None] != NOTHING)
        theta, count = (np.broadcast_to(part, shape) for part in moved(rule, grid.theta, grid.count, event))
        each.append(grid.shares(theta, count))
    return np.stack([low for low, _ in each], axis=2), np.stack([weight for _, weight in each], axis=2)
