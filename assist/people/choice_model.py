"""Choice models: the probability of every choice in every state, for each type of person.

Filter, policies, solvers, bounds and simulation use these probabilities only. So any function of this form can replace
the paper's model: terms and habits (`Weighted`), or a function of the user.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from .choices import Choices
from .decision import Floats, choice, perceived_value
from .user_code import UserCodeError


class ChoiceModel(Protocol):
    """A choice model: any callable of this form.

    Trust (equation 7) depends on V(x) = -min_a Q(x, a), unless the callable has an attribute `value`: a function of
    (choices, q) that returns V, shape (n,).
    """

    def __call__(self, choices: Choices, q: Floats, beta: Floats, /) -> Floats:
        """Return the probability of each choice, shape (B, n, A): 0 in empty slots, with sum 1 if there is a choice.

        Parameters
        ----------
        choices : Choices
            The n states with up to A choices each.
        q : float array, shape (n, A)
            Perceived costs, infinite in empty slots and for choices into dead ends.
        beta : float array, shape (B,)
            Types of people: their expertise, or another parameter of the model.
        """
        ...


def boltzmann(choices: Choices, q: Floats, beta: Floats, /) -> Floats:
    """Return the probabilities of choice by cost-to-go alone, as in the paper (equation 5); a `ChoiceModel`.

    Parameters
    ----------
    choices : Choices
    q : float array, shape (n, A)
        Perceived costs.
    beta : float array, shape (B,)

    Returns
    -------
    float array, shape (B, n, A)
    """
    return np.stack([choice(q, choices.applicable, one) for one in beta])


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


def chances(chooses: ChoiceModel, choices: Choices, q: Floats, beta: Floats) -> Floats:
    """Return the checked probabilities of a choice model, shape (B, n, A).

    Raises
    ------
    UserCodeError
        The shape is wrong, a number is negative or not finite, or the sum in a state is not 1.
    """
    p = chooses(choices, q, beta)
    if chooses is boltzmann:
        return p
    named = getattr(chooses, "__name__", type(chooses).__name__)
    p, shape = np.asarray(p, dtype=float), (len(beta), *choices.applicable.shape)
    if p.shape != shape:
        raise UserCodeError(f"{named}: gives an array of shape {p.shape}; expected {shape}: types, states, choices")
    wanted = choices.applicable.any(axis=1).astype(float)
    total = p.sum(axis=2)
    unbalanced = ~(np.abs(total - wanted) <= 1e-9)  # more than rounding errors, or NaN
    wrong = ~((p >= 0) & (choices.applicable | (p == 0))).all(axis=2) | unbalanced
    if wrong.any():
        b, x = np.argwhere(wrong)[0]
        raise UserCodeError(
            f"{named}: chances {p[b, x].tolist()} in state {x} for beta {beta[b]:g}; expected 0 or more, 0 in empty "
            f"slots, adding up to {wanted[x]:g}"
        )
    return p / np.where(np.abs(total - wanted) > 1e-12, total, 1.0)[..., None]


def value(chooses: ChoiceModel, choices: Choices, q: Floats) -> Floats:
    """Return V(x), shape (n,), by which theta changes (equation 7), for a choice model."""
    own = getattr(chooses, "value", perceived_value)
    v = np.asarray(own(choices, q), dtype=float)
    if v.shape != choices.h.shape or np.isnan(v).any():
        named = getattr(chooses, "__name__", type(chooses).__name__)
        raise UserCodeError(f"{named}: value of shape {v.shape}; expected a number for each of {len(choices)} states")
    return v
