"""How likely a person's choices are under a choice model of one's own, for any beta.

The model is asked once, on a grid of beta; between two of its points chances are interpolated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planner import CostToGo, Table

from ..people.choice_model import ChoiceModel, chances, value
from ..people.choices import Choices
from ..people.decision import NOTHING, perceived_cost
from .observations import Chances, Observations

POINTS = 257
"""Values of beta for which a model is asked: from 0, on a scale that is linear at first and then logarithmic."""

SMALL = 1e-3
"""Where it becomes so, as a share of the range."""

AT_ONCE = 8
"""Values of beta for which it is asked at a time: chances of all states are larger than those of the ones visited."""


def with_model(
    observations: Sequence[Observations], chooses: ChoiceModel, costs: CostToGo, table: Table, largest: float
) -> list[Observations]:
    """Return observations with the chances that a model gives, and with the gains in its own V.

    Parameters
    ----------
    observations : sequence of Observations
    chooses : ChoiceModel
    costs : CostToGo
        What `Observations.state` are numbers of.
    table : Table
        Of the same task.
    largest : float
        Where the range of beta ends.

    Raises
    ------
    ChoiceModelError
        The model fails, or gives no chances.
    """
    choices = Choices.of(table)
    q = perceived_cost(choices, choices.h)
    v = value(chooses, choices, q)
    numbers = [table.numbers(costs.values(o.state)) for o in observations]
    states, rows = np.unique(np.concatenate(numbers), return_inverse=True)
    beta = SMALL * largest * np.expm1(np.linspace(0.0, math.log1p(1 / SMALL), POINTS))
    beta[-1] = largest
    known = np.empty((len(states), choices.applicable.shape[1], POINTS))
    for begin in range(0, POINTS, AT_ONCE):
        block = slice(begin, begin + AT_ONCE)
        known[:, :, block] = np.moveaxis(chances(chooses, choices, q, beta[block])[:, states], 0, 2)
    found = []
    for o, number, own in zip(
        observations, numbers, np.split(rows, np.cumsum([len(n) for n in numbers])[:-1]), strict=True
    ):
        width = min(o.excess.shape[1], known.shape[1])
        chance = np.zeros((len(o), o.excess.shape[1], POINTS))
        chance[:, :width] = known[own, :width]
        told = o.suggested != NOTHING
        after = choices.targets[number, np.maximum(o.suggested, 0)]
        with np.errstate(invalid="ignore"):
            gain = np.where(told & (v[after] != v[number]), v[after] - v[number], 0.0)
        found.append(replace(o, gain=gain, own=Chances(beta, chance)))
    return found
