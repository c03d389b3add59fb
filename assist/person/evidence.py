"""What was seen of a person's action, as likelihoods."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..people.choices import WAIT, Choices
from ..people.decision import Floats


class Evidence(NamedTuple):
    """The likelihood of what was seen under each action, in the form that compiled code reads.

    Attributes
    ----------
    likelihood : float array, shape (names + 1,)
        Likelihood of each ground action, and of waiting, which is last. It is not used if `rate` is 0 or more.
    seen : int
        The ground action that was seen.
    rate : float
        Probability of seeing one of the other actions that are applicable; -1 if `likelihood` is used.
    unseen : bool
        Whether nothing was seen.
    only : int
        The one ground action that may have been taken; -2 if any may.
    """

    likelihood: Floats
    seen: int = WAIT
    rate: float = -1.0
    unseen: bool = False
    only: int = -2

    @classmethod
    def none(cls, choices: Choices) -> Evidence:
        """Return the evidence of a step in which nothing was seen."""
        return cls(np.ones(len(choices.names) + 1), unseen=True)

    @classmethod
    def of(cls, choices: Choices, likelihoods: Mapping[int, float]) -> Evidence:
        """Return the evidence with a likelihood for each of some ground actions, and 0 for the others."""
        each = np.zeros(len(choices.names) + 1)
        each[list(likelihoods)] = list(likelihoods.values())
        return cls(each)
