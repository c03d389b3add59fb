"""The model's equations of a person's decisions, on arrays: perceived cost, choice, influence and trust.

Boltzmann choice (5), influence (6) and trust (7) have the numbers of Dahiya and Smith, "Adaptive Robot Assistance:
Expertise and Influence in Multi-User Task Planning"; see `docs/model.md`. `influence_kernels` has (6) and (7) for
compiled code.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .choices import Choices
from .hidden_type import Bools as Bools
from .hidden_type import Floats as Floats
from .hidden_type import Ints as Ints

NOTHING = -1
"""No slot: nothing is suggested, executed or chosen."""


def perceived_cost(choices: Choices, h: Floats) -> Floats:
    """Return Q(x, a) = c(a) + h(succ(x, a)), shape (n, A), infinite in empty slots; `h` is that of a `Human`.

    Parameters
    ----------
    choices : Choices
    h : float array, shape (n,) or (n, A)
    """
    return np.where(choices.applicable, choices.costs + (h if h.ndim == 2 else h[choices.targets]), np.inf)


def perceived_value(choices: Choices, q: Floats) -> Floats:
    """Return V(x) = -min_a Q(x, a), shape (n,), with V(goal) = 0.

    Parameters
    ----------
    choices : Choices
    q : float array, shape (n, A)
        Perceived costs.
    """
    return np.where(choices.goal, 0.0, -q.min(axis=-1))


def choice(q: Floats, applicable: Bools, beta: ArrayLike, bias: Floats | None = None) -> Floats:
    """Return the Boltzmann policy of equation (5): P(a | x) proportional to exp(-beta Q(x, a) + bias(x, a)).

    Parameters
    ----------
    q : float array, shape (..., A)
        Perceived costs; infinite if an action leads to a dead end.
    applicable : bool array, shape (..., A)
    beta : float or array, shape (...)
        Expertise, 0 or more. At 0 the choice is uniform over the applicable actions. For any larger value an action
        into a dead end is never chosen if there is another.
    bias : float array, shape (..., A), optional
        Finite terms in the exponent in addition to the cost; the paper has none.

    Returns
    -------
    float array, shape (..., A)
        Probabilities; all are zero if no action is applicable. If every action leads to a dead end, the choice depends
        on the bias only, and is uniform without one.
    """
    beta = np.asarray(beta, dtype=float)[..., None]
    best = np.min(q, axis=-1, keepdims=True, where=applicable, initial=np.inf)
    # The best action's exponent is 0, so that the largest weight is 1 for any beta and any scale of costs.
    with np.errstate(invalid="ignore"):
        exponent = -beta * (q - best)
    exponent = np.where(np.isfinite(best) & (beta > 0), exponent, 0.0)
    if bias is not None:
        exponent = np.where(applicable, exponent + bias, -np.inf)
        highest = exponent.max(axis=-1, keepdims=True)
        exponent = exponent - np.where(np.isfinite(highest), highest, 0.0)
    weights = np.where(applicable, np.exp(exponent), 0.0)
    total = weights.sum(axis=-1, keepdims=True)
    return np.divide(weights, total, out=np.zeros_like(weights), where=total > 0)


def influence(p: Floats, suggestion: ArrayLike, theta: ArrayLike) -> Floats:
    """Return choice probabilities after a suggestion, equation (6): weight theta for its action, 1 - theta for others.

    Parameters
    ----------
    p : float array, shape (..., A)
        The choice without a suggestion.
    suggestion : int or array, shape (...)
        The suggested slot; `NOTHING` without a suggestion.
    theta : float or array, shape (...)
        Influence in [0, 1]; 0.5 does not change the choice.

    Returns
    -------
    float array, shape (..., A)
        Probabilities. A suggestion after which no action would be possible is ignored.
    """
    suggestion = np.asarray(suggestion)[..., None]
    theta = np.asarray(theta, dtype=float)[..., None]
    weights = p * np.where(np.arange(p.shape[-1]) == suggestion, theta, 1.0 - theta)
    total = weights.sum(axis=-1, keepdims=True)
    heard = (suggestion != NOTHING) & (total > 0)
    return np.where(heard, np.divide(weights, total, out=np.zeros_like(weights), where=total > 0), p)


def lapse(p: Floats, applicable: Bools, rate: float) -> Floats:
    """Return the mixture of a choice, shape (..., A), and a uniform one of weight `rate`.

    Parameters
    ----------
    p : float array, shape (..., A)
    applicable : bool array, shape (..., A)
    rate : float
    """
    count = applicable.sum(axis=-1, keepdims=True)
    return np.where(applicable, (1.0 - rate) * p + rate / np.maximum(count, 1), 0.0)


def trust(theta: ArrayLike, value: ArrayLike, expected: ArrayLike, eta: float, utility_scale: float = 1.0) -> Floats:
    """Return theta after a suggestion, equation (7).

    theta' = clip(theta + eta (V(x_r) - V(x)) / utility_scale, 0, 1)

    The value of a dead end is minus infinity. So a suggestion into a dead end gives theta' = 0, and one from a dead end
    to another does not change theta. With eta = 0, theta never changes.

    Parameters
    ----------
    theta : float or array
        Influence before the suggestion.
    value, expected : float or array
        V(x) and V(x_r): the person's values of the present state and of the suggested action's successor.
    eta : float
        Learning rate.
    utility_scale : float
        The unit of V in cost units.
    """
    theta, value, expected = (np.asarray(a, dtype=float) for a in (theta, value, expected))
    with np.errstate(invalid="ignore"):
        gain = np.where((value == expected) | (eta == 0), 0.0, expected - value)
    return np.asarray(np.clip(theta + eta * gain / utility_scale, 0.0, 1.0), dtype=float)
