"""How a person decides, takes advice and comes to trust it.

Pure functions of arrays for the four steps of the model (perceived cost, Boltzmann choice, influence,
trust), the people themselves (`Human`, drawn from a `Population`), and `HumanModel`: the same steps for
a person whose beta and theta are not known. Equations are those of Dahiya and Smith, "Adaptive Robot
Assistance: Expertise and Influence in Multi-User Task Planning"; see `docs/model.md`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .choices import Choices

Floats = NDArray[np.float64]
Noise = Literal["state", "action"]

NOTHING = -1
"""The suggestion slot that stands for no suggestion."""


def perceived_cost_to_go(choices: Choices, sigma: float, rng: np.random.Generator, noise: Noise = "state") -> Floats:
    """Draw what a person takes for the cost-to-go of every state, shape (n,), or after every choice, shape (n, A).

    h(x) = h*(x) + sigma * eps(x), eps standard normal: a lasting misconception, drawn once per person
    and state; with `noise="action"` once per person and choice, h(x, a) = h*(succ(x, a)) + sigma * eps(x, a),
    so that one state looks different from where one comes. The goal is recognised (h = 0) and dead ends stay
    infinite.
    """
    if noise == "action":
        after = choices.h[choices.targets]
        return np.where(choices.goal[choices.targets], 0.0, after + sigma * rng.standard_normal(after.shape))
    h = choices.h + sigma * rng.standard_normal(len(choices))
    return np.where(choices.goal, 0.0, h)


def perceived_cost(choices: Choices, h: Floats) -> Floats:
    """Give Q(x, a) = c(a) + h(succ(x, a)), shape (n, A), infinite in empty slots; `h` as a `Human` has it."""
    return np.where(choices.applicable, choices.costs + (h if h.ndim == 2 else h[choices.targets]), np.inf)


def perceived_value(choices: Choices, q: Floats) -> Floats:
    """Give V(x) = -min_a Q(x, a), shape (n,), with V(goal) = 0."""
    return np.where(choices.goal, 0.0, -q.min(axis=-1))


def choice(q: Floats, applicable: NDArray[np.bool_], beta: ArrayLike) -> Floats:
    """Give the Boltzmann policy of eq. 4: P(a | x) proportional to exp(-beta Q(x, a)).

    Parameters
    ----------
    q : float array, shape (..., A)
        Perceived costs; infinite where an action leads to a dead end.
    applicable : bool array, shape (..., A)
    beta : float or array, shape (...)
        Expertise, 0 or more. At 0 the choice is uniform over the applicable actions; for any larger
        value an action into a dead end is never chosen while there is another.

    Returns
    -------
    float array, shape (..., A)
        Probabilities; all zero where nothing is applicable. Where every action leads to a dead end the
        choice is uniform.
    """
    beta = np.asarray(beta, dtype=float)[..., None]
    best = np.min(q, axis=-1, keepdims=True, where=applicable, initial=np.inf)
    # The best action's exponent is 0, so the largest weight is 1 whatever beta and the cost scale are.
    with np.errstate(invalid="ignore"):
        exponent = -beta * (q - best)
    exponent = np.where(np.isfinite(best) & (beta > 0), exponent, 0.0)
    weights = np.where(applicable, np.exp(exponent), 0.0)
    total = weights.sum(axis=-1, keepdims=True)
    return np.divide(weights, total, out=np.zeros_like(weights), where=total > 0)


def influence(p: Floats, suggestion: ArrayLike, theta: ArrayLike) -> Floats:
    """Weigh a choice by a suggestion (eq. 5): theta for the suggested action, 1 - theta for the others.

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
    """Mix a choice, shape (..., A), with a uniform one, which has the weight `rate`."""
    count = applicable.sum(axis=-1, keepdims=True)
    return np.where(applicable, (1.0 - rate) * p + rate / np.maximum(count, 1), 0.0)


def trust(theta: ArrayLike, value: ArrayLike, expected: ArrayLike, eta: float, utility_scale: float = 1.0) -> Floats:
    """Update theta after a suggestion (eq. 6).

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


@dataclass(frozen=True)
class Human:
    """A person as they really are.

    Attributes
    ----------
    beta : float
        Expertise (per cost unit), 0 or more.
    theta : float
        Influence of the robot at the beginning, in [0, 1].
    sigma : float
        Standard deviation of their misconception, in cost units.
    h : float array, shape (n,) or (n, A)
        What they take for the cost-to-go of each state, or of what each choice leads to.
    """

    beta: float
    theta: float
    sigma: float
    h: Floats

    def __post_init__(self) -> None:
        self.h.flags.writeable = False


Range = tuple[float, float]


@dataclass(frozen=True)
class Population:
    """Ranges from which people's parameters are drawn uniformly; the defaults are the paper's Table I.

    Attributes
    ----------
    beta, theta, sigma : pair of float
    noise : "state" or "action"
        Whether a person is mistaken about states, or about the outcome of each choice in each state.
    """

    beta: Range = (0.1, 3.0)
    theta: Range = (0.5, 0.95)
    sigma: Range = (0.1, 1.0)
    noise: Noise = "state"

    def __post_init__(self) -> None:
        if self.noise not in ("state", "action"):
            raise ValueError(f"noise '{self.noise}': expected 'state' or 'action'")
        for name, (low, high), most in (
            ("beta", self.beta, np.inf), ("theta", self.theta, 1.0), ("sigma", self.sigma, np.inf),
        ):  # fmt: skip
            if not (0 <= low <= high <= most and np.isfinite(high)):
                raise ValueError(
                    f"{name} range ({low:g}, {high:g}): expected 0 <= low <= high" + f" <= {most:g}" * (most < np.inf)
                )

    def sample(self, choices: Choices, count: int, rng: np.random.Generator) -> list[Human]:
        """Draw people for a task."""
        people = []
        for _ in range(count):
            beta, theta, sigma = (float(rng.uniform(*span)) for span in (self.beta, self.theta, self.sigma))
            people.append(Human(beta, theta, sigma, perceived_cost_to_go(choices, sigma, rng, self.noise)))
        return people


@dataclass(frozen=True)
class Mixture:
    """A population of several parts, of which each makes up a share: any distribution, piece by piece uniform.

    Attributes
    ----------
    parts : tuple of Population
    shares : tuple of float
        They add up to 1.
    """

    parts: tuple[Population, ...]
    shares: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.parts or len(self.parts) != len(self.shares):
            raise ValueError(f"{len(self.parts)} parts, {len(self.shares)} shares: expected one share for each part")
        if min(self.shares) < 0 or abs(sum(self.shares) - 1) > 1e-6:
            raise ValueError(
                f"the shares add up to {sum(self.shares):g}; expected numbers of 0 or more that add up to 1"
            )

    @property
    def beta(self) -> Range:
        """The range that holds all parts."""
        return min(part.beta[0] for part in self.parts), max(part.beta[1] for part in self.parts)

    @property
    def theta(self) -> Range:
        """The range that holds all parts."""
        return min(part.theta[0] for part in self.parts), max(part.theta[1] for part in self.parts)

    @property
    def sigma(self) -> Range:
        """The range that holds all parts."""
        return min(part.sigma[0] for part in self.parts), max(part.sigma[1] for part in self.parts)

    def sample(self, choices: Choices, count: int, rng: np.random.Generator) -> list[Human]:
        """Draw people for a task."""
        shares = np.asarray(self.shares) / sum(self.shares)
        drawn = rng.choice(len(self.parts), size=count, p=shares)
        return [person for part in drawn for person in self.parts[part].sample(choices, 1, rng)]


@dataclass(frozen=True)
class HumanModel:
    """What the robot takes for granted about a person whose beta and theta it does not know.

    Attributes
    ----------
    choices : Choices
    q : float array, shape (n, A)
        The person's perceived costs, or the exact ones where the robot does not know them.
    eta : float
        Rate of the trust update.
    lapse : float
        Weight of a uniform choice in the robot's model of the person's choice, so that no applicable
        action has probability zero and no belief dies.
    utility_scale : float
        The unit of V in the trust update, in cost units.
    """

    choices: Choices
    q: Floats
    eta: float = 0.2
    lapse: float = 1e-3
    utility_scale: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.lapse < 1:
            raise ValueError(f"lapse {self.lapse:g}: expected 0 <= lapse < 1")
        if not (0 <= self.eta < np.inf and 0 < self.utility_scale < np.inf):
            raise ValueError(f"eta {self.eta:g}, utility_scale {self.utility_scale:g}: expected eta >= 0, scale > 0")
        self.q.flags.writeable = False

    @classmethod
    def exact(
        cls, choices: Choices, *, eta: float = 0.2, lapse: float = 1e-3, utility_scale: float = 1.0
    ) -> HumanModel:
        """Model a person of whom only the task is known (`knowledge="exact"`): h* for their h."""
        return cls(choices, perceived_cost(choices, choices.h), eta, lapse, utility_scale)

    @classmethod
    def own(
        cls, choices: Choices, human: Human, *, eta: float = 0.2, lapse: float = 1e-3, utility_scale: float = 1.0
    ) -> HumanModel:
        """Model a person whose own perceived costs are known (`knowledge="own"`, as in the paper)."""
        return cls(choices, perceived_cost(choices, human.h), eta, lapse, utility_scale)
