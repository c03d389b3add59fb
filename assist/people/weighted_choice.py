"""Choice by cost-to-go and terms: what else than cost speaks for an action, with a weight for each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from .choice_model import boltzmann
from .choices import Choices
from .decision import Floats, choice
from .user_code import UserCodeError


@dataclass(frozen=True)
class Weighted:
    """Choice by cost-to-go and terms; a `ChoiceModel`.

    P(a | x, m) proportional to exp(-beta Q(x, a) + sum_j w_j f_j(x, a, m)), where m is the person's last action.

    Attributes
    ----------
    weights : mapping of str to float
        Weight w_j of each term by its name; other terms have weight 0.
    """

    weights: Mapping[str, float] = field(default_factory=dict, hash=False)

    def __call__(self, choices: Choices, q: Floats, beta: Floats, /) -> Floats:
        """Return the probability of each choice, shape (B, n, A)."""
        known = choices.terms or ()
        if unknown := self.weights.keys() - set(known):
            named = ", ".join(sorted(unknown))
            raise UserCodeError(f"terms {named}: the choices do not have them; expected `remembered(table, terms)`")
        if choices.features is None:
            return boltzmann(choices, q, beta)
        bias = choices.features @ np.array([self.weights.get(name, 0.0) for name in known])
        return np.stack([choice(q, choices.applicable, one, bias) for one in beta])
