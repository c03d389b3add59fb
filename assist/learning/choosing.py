"""Choice probabilities of a user's choice model for recorded choices, as a function of beta.

The model is evaluated once, on a grid of beta. Between two grid points, probabilities are interpolated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planner import Table

from ..people.choice_model import ChoiceModel, chances, value
from ..people.choices import Choices
from ..people.decision import NOTHING, perceived_cost
from .likelihood import SMALL
from .observations import Chances, Observations


def with_model(
    observations: Sequence[Observations], chooses: ChoiceModel, table: Table, largest: float
) -> list[Observations]:
    """Return observations with the probabilities of a choice model, and with gains in its own V.

    Parameters
    ----------
    observations : sequence of Observations
    chooses : ChoiceModel
    table : Table
        Table of the task, whose state numbers `Observations.state` has.
    largest : float
        Upper end of the range of beta.

    Raises
    ------
    UserCodeError
        The model fails, or does not return probabilities.
    """
    choices = Choices.of(table)
    q = perceived_cost(choices, choices.h)
    v = value(chooses, choices, q)
    numbers = [o.state for o in observations]
    states, rows = np.unique(np.concatenate(numbers), return_inverse=True)
    beta = SMALL * largest * np.expm1(np.linspace(0.0, math.log1p(1 / SMALL), 257))
    beta[-1] = largest
    known = np.empty((len(states), choices.applicable.shape[1], len(beta)))
    for begin in range(0, len(beta), 8):  # a model returns all states, of which few are visited, for each beta
        block = slice(begin, begin + 8)
        known[:, :, block] = np.moveaxis(chances(chooses, choices, q, beta[block])[:, states], 0, 2)
    found = []
    for o, number, own in zip(
        observations, numbers, np.split(rows, np.cumsum([len(n) for n in numbers])[:-1]), strict=True
    ):
        width = min(o.excess.shape[1], known.shape[1])
        chance = np.zeros((len(o), o.excess.shape[1], len(beta)))
        chance[:, :width] = known[own, :width]
        told = o.suggested != NOTHING
        after = choices.targets[number, np.maximum(o.suggested, 0)]
        with np.errstate(invalid="ignore"):
            gain = np.where(told & (v[after] != v[number]), v[after] - v[number], 0.0)
        found.append(replace(o, gain=gain, own=Chances(beta, chance)))
    return found
