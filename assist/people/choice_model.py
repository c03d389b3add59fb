"""How people choose: the one place where a choice model is made, and what everything else knows of it.

A choice model gives the chance of every choice in every state, for each type of person. Filter, policies, search,
bounds and simulation work with these chances alone, so that whatever has this form can be put in the place of the
paper's: terms and habits (`Weighted`), or a function of one's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from .choices import Choices
from .decision import Floats, choice, perceived_value

BALANCED = 1e-9
"""How far the chances of a state may be from adding up to 1."""


class ChoiceModelError(ValueError):
    """A choice model that fails, or gives no chances."""


class ChoiceModel(Protocol):
    """Any callable of this form.

    Trust (eq. 7) looks at V(x) = -min_a Q(x, a), unless the callable has an attribute `value`: a function of
    (choices, q) that gives V, shape (n,).
    """

    def __call__(self, choices: Choices, q: Floats, beta: Floats, /) -> Floats:
        """Give the chance of each choice, shape (B, n, A): 0 in empty slots, adding up to 1 where there is a choice.

        Parameters
        ----------
        choices : Choices
            n states of up to A choices.
        q : float array, shape (n, A)
            Perceived costs, infinite in empty slots and where a dead end follows.
        beta : float array, shape (B,)
            The types of people: how expert they are, or what else the model makes of these numbers.
        """
        ...


def boltzmann(choices: Choices, q: Floats, beta: Floats, /) -> Floats:
    """Choose by cost-to-go alone, as in the paper (eq. 5); a `ChoiceModel`.

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
    """Choose by cost-to-go and terms; a `ChoiceModel`.

    P(a | x, m) proportional to exp(-beta Q(x, a) + sum_j w_j f_j(x, a, m)), m being what the person did last.

    Attributes
    ----------
    weights : mapping of str to float
        w_j of each term, by its name; a term that is not named has weight 0.
    """

    weights: Mapping[str, float] = field(default_factory=dict, hash=False)

    def __call__(self, choices: Choices, q: Floats, beta: Floats, /) -> Floats:
        """Give the chance of each choice, shape (B, n, A)."""
        known = choices.terms or ()
        if unknown := self.weights.keys() - set(known):
            named = ", ".join(sorted(unknown))
            raise ChoiceModelError(f"terms {named}: the choices do not have them; expected `remembered(table, terms)`")
        if choices.features is None:
            return boltzmann(choices, q, beta)
        bias = choices.features @ np.array([self.weights.get(name, 0.0) for name in known])
        return np.stack([choice(q, choices.applicable, one, bias) for one in beta])


def chances(chooses: ChoiceModel, choices: Choices, q: Floats, beta: Floats) -> Floats:
    """Give what a choice model says, shape (B, n, A), having looked at it.

    Raises
    ------
    ChoiceModelError
        No chances: another shape, numbers below 0 or that are none, or a state where they do not add up to 1.
    """
    p = chooses(choices, q, beta)
    if chooses is boltzmann:
        return p
    named = getattr(chooses, "__name__", type(chooses).__name__)
    p, shape = np.asarray(p, dtype=float), (len(beta), *choices.applicable.shape)
    if p.shape != shape:
        raise ChoiceModelError(f"{named}: gives an array of shape {p.shape}; expected {shape}: types, states, choices")
    wanted = choices.applicable.any(axis=1).astype(float)
    total = p.sum(axis=2)
    wrong = ~((p >= 0) & (choices.applicable | (p == 0))).all(axis=2) | ~(np.abs(total - wanted) <= BALANCED)
    if wrong.any():
        b, x = np.argwhere(wrong)[0]
        raise ChoiceModelError(
            f"{named}: chances {p[b, x].tolist()} in state {x} for beta {beta[b]:g}; expected 0 or more, 0 in empty "
            f"slots, adding up to {wanted[x]:g}"
        )
    return p


def value(chooses: ChoiceModel, choices: Choices, q: Floats) -> Floats:
    """Give V(x), shape (n,), at which the trust of a choice model's people looks (eq. 7)."""
    own = getattr(chooses, "value", perceived_value)
    v = np.asarray(own(choices, q), dtype=float)
    if v.shape != choices.h.shape or np.isnan(v).any():
        named = getattr(chooses, "__name__", type(chooses).__name__)
        raise ChoiceModelError(
            f"{named}: value of shape {v.shape}; expected a number for each of {len(choices)} states"
        )
    return v
