"""How a person decides, takes advice and comes to trust it: the equations of the model, on arrays.

Perceived cost, Boltzmann choice (eq. 5), influence (eq. 6) and trust (eq. 7), numbered as in Dahiya and Smith,
"Adaptive Robot Assistance: Expertise and Influence in Multi-User Task Planning"; see `docs/model.md`.
The same equations stand compiled in `compiled`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .choices import Choices
from .misconception import Misconception, Noise

Floats = NDArray[np.float64]

NOTHING = -1
"""The suggestion slot that stands for no suggestion."""


def perceived_cost_to_go(choices: Choices, sigma: float, rng: np.random.Generator, noise: Noise = "state") -> Floats:
    """Draw what a person takes for the cost-to-go of every state, shape (n,), or after every choice, shape (n, A).

    h(x) = h*(x) + sigma * eps(x), eps standard normal: a lasting misconception, drawn once per person
    and state of the task, whatever the person did before they came there; with `noise="action"` once per person
    and choice, h(x, a) = h*(succ(x, a)) + sigma * eps(x, a), so that one state looks different from where one
    comes. The goal is recognised (h = 0) and dead ends stay
    infinite.

    Parameters
    ----------
    choices : Choices
    sigma : float
        Standard deviation, in cost units.
    rng : numpy.random.Generator
        One number is taken from it, whatever the size of the task: the person's seed (`Misconception`).
    noise : "state" or "action"
    """
    return Misconception.drawn(sigma, rng, noise).of(choices)


def perceived_cost(choices: Choices, h: Floats) -> Floats:
    """Give Q(x, a) = c(a) + h(succ(x, a)), shape (n, A), infinite in empty slots; `h` as a `Human` has it.

    Parameters
    ----------
    choices : Choices
    h : float array, shape (n,) or (n, A)
    """
    return np.where(choices.applicable, choices.costs + (h if h.ndim == 2 else h[choices.targets]), np.inf)


def perceived_value(choices: Choices, q: Floats) -> Floats:
    """Give V(x) = -min_a Q(x, a), shape (n,), with V(goal) = 0.

    Parameters
    ----------
    choices : Choices
    q : float array, shape (n, A)
        Perceived costs.
    """
    return np.where(choices.goal, 0.0, -q.min(axis=-1))


def choice(q: Floats, applicable: NDArray[np.bool_], beta: ArrayLike, bias: Floats | None = None) -> Floats:
    """Give the Boltzmann policy of eq. 5: P(a | x) proportional to exp(-beta Q(x, a) + bias(x, a)).

    Parameters
    ----------
    q : float array, shape (..., A)
        Perceived costs; infinite where an action leads to a dead end.
    applicable : bool array, shape (..., A)
    beta : float or array, shape (...)
        Expertise, 0 or more. At 0 the choice is uniform over the applicable actions; for any larger
        value an action into a dead end is never chosen while there is another.
    bias : float array, shape (..., A), optional
        What else speaks for each action, such as weighted terms; finite. There is none in the paper.

    Returns
    -------
    float array, shape (..., A)
        Probabilities; all zero where nothing is applicable. Where every action leads to a dead end the
        choice is uniform, or only the bias speaks.
    """
    beta = np.asarray(beta, dtype=float)[..., None]
    best = np.min(q, axis=-1, keepdims=True, where=applicable, initial=np.inf)
    # The best action's exponent is 0, so the largest weight is 1 whatever beta and the cost scale are.
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
    """Weigh a choice by a suggestion (eq. 6): theta for the suggested action, 1 - theta for the others.

    Parameters
    ----------
    p : float array, shape (..., A)
        The choice without a suggestion.
    suggestion : int or array, shape (...)
        The suggested slot, `NOTHING` where nothing is suggested.
    theta : float or array, shape (...)
        Influence in [0, 1]; 0.5 leaves the choice as it is.

    Returns
    -------
    float array, shape (..., A)
        Probabilities. A suggestion that would leave no action possible is ignored.
    """
    suggestion = np.asarray(suggestion)[..., None]
    theta = np.asarray(theta, dtype=float)[..., None]
    weights = p * np.where(np.arange(p.shape[-1]) == suggestion, theta, 1.0 - theta)
    total = weights.sum(axis=-1, keepdims=True)
    heard = (suggestion != NOTHING) & (total > 0)
    return np.where(heard, np.divide(weights, total, out=np.zeros_like(weights), where=total > 0), p)


def lapse(p: Floats, applicable: NDArray[np.bool_], rate: float) -> Floats:
    """Mix a choice, shape (..., A), with a uniform one, which has the weight `rate`.

    Parameters
    ----------
    p : float array, shape (..., A)
    applicable : bool array, shape (..., A)
    rate : float
    """
    count = applicable.sum(axis=-1, keepdims=True)
    return np.where(applicable, (1.0 - rate) * p + rate / np.maximum(count, 1), 0.0)


def trust(theta: ArrayLike, value: ArrayLike, expected: ArrayLike, eta: float, utility_scale: float = 1.0) -> Floats:
    """Update theta after a suggestion (eq. 7).

    theta' = clip(theta + eta (V(x_r) - V(x)) / utility_scale, 0, 1)

    A suggestion into a dead end, whose value is minus infinity, ends trust: theta' = 0. From one dead end to another
    trust does not change, and with eta = 0 it never does, dead ends included.

    Parameters
    ----------
    theta : float or array
        Influence before the suggestion.
    value, expected : float or array
        V(x), the person's value of the present state, and V(x_r), that of the state in which the
        suggested action would end.
    eta : float
        Rate.
    utility_scale : float
        The unit of V in cost units.
    """
    theta, value, expected = (np.asarray(a, dtype=float) for a in (theta, value, expected))
    with np.errstate(invalid="ignore"):
        gain = np.where((value == expected) | (eta == 0), 0.0, expected - value)
    return np.asarray(np.clip(theta + eta * gain / utility_scale, 0.0, 1.0), dtype=float)
