"""People: as they really are, as they are drawn from populations, and as a robot takes them to be.

`Human` has parameters that nobody sees, a `Population` or a `Mixture` of some gives people, and a `HumanModel` is what
a robot takes for granted of a person whose beta and theta it does not know. How any of them chooses is a `ChoiceModel`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import numpy as np

from planner.system.arrays import frozen, outline

from .arguments import MOST, number, span
from .choice_model import ChoiceModel, Weighted, boltzmann, chances, value
from .choices import Choices
from .decision import Floats, perceived_cost
from .misconception import Misconception, Noise


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
    h : float array, shape (n,) or (n, A), or Misconception
        What they take for the cost-to-go of each state, or of what each choice leads to; or from what that follows
        for any part of a task.
    chooses : ChoiceModel
        How they choose; the paper's unless given.
    """

    beta: float
    theta: float
    sigma: float
    h: Floats | Misconception
    chooses: ChoiceModel = boltzmann

    def __post_init__(self) -> None:
        for name in ("beta", "theta", "sigma"):
            object.__setattr__(self, name, number(name, getattr(self, name)))
        if not (0 <= self.beta <= MOST and 0 <= self.sigma <= MOST and 0 <= self.theta <= 1):
            raise ValueError(
                f"beta {self.beta:g}, theta {self.theta:g}, sigma {self.sigma:g}: expected beta and sigma from 0 to "
                f"{MOST:g}, and theta from 0 to 1"
            )
        if not isinstance(self.h, Misconception):
            h = frozen(np.asarray(self.h, dtype=float))
            if h.ndim not in (1, 2) or np.isnan(h).any():
                raise ValueError(f"h, shape {h.shape}: expected a number for each state, or for each choice in it")
            object.__setattr__(self, "h", h)

    def expects(self, choices: Choices) -> Floats:
        """Give what they take for the cost-to-go in a task or a part of one, shape (n,) or (n, A)."""
        return self.h.of(choices) if isinstance(self.h, Misconception) else self.h

    @property
    def weights(self) -> Mapping[str, float]:
        """The weight of each term in how they choose."""
        return self.chooses.weights if isinstance(self.chooses, Weighted) else {}

    def chances(self, choices: Choices) -> Floats:
        """Give the chance of each of their choices where nothing is suggested, shape (n, A)."""
        return chances(self.chooses, choices, perceived_cost(choices, self.expects(choices)), np.array([self.beta]))[0]

    def value(self, choices: Choices) -> Floats:
        """Give V(x), shape (n,), at which their trust looks."""
        return value(self.chooses, choices, perceived_cost(choices, self.expects(choices)))


Range = tuple[float, float]


@dataclass(frozen=True)
class Population:
    """Ranges from which people's parameters are drawn uniformly; the defaults are the paper's Table I.

    Attributes
    ----------
    beta, theta, sigma : pair of float
    noise : "state" or "action"
        Whether a person is mistaken about states, or about the outcome of each choice in each state.
    weights : mapping of str to pair of float
        The range of each term's weight, by its name; other terms have weight 0.
    chooses : ChoiceModel, optional
        How they choose, in place of cost-to-go and terms.
    """

    beta: Range = (0.1, 3.0)
    theta: Range = (0.5, 0.95)
    sigma: Range = (0.1, 1.0)
    noise: Noise = "state"
    weights: Mapping[str, Range] = field(default_factory=dict, hash=False)
    chooses: ChoiceModel | None = None

    def __post_init__(self) -> None:
        weights = {name: span(f"weight range of {name}", pair) for name, pair in self.weights.items()}
        object.__setattr__(self, "weights", weights)
        for name in ("beta", "theta", "sigma"):
            object.__setattr__(self, name, span(f"{name} range", getattr(self, name)))
        if self.chooses is not None and self.weights:
            raise ValueError(f"weights of {', '.join(self.weights)}, and a choice model: expected one of them")
        for name, (low, high) in self.weights.items():
            if not -MOST <= low <= high <= MOST:
                raise ValueError(
                    f"weight range ({low:g}, {high:g}) of {name}: expected -{MOST:g} <= low <= high <= {MOST:g}"
                )
        if self.noise not in ("state", "action"):
            raise ValueError(f"noise '{self.noise}': expected 'state' or 'action'")
        for name, (low, high), most in (
            ("beta", self.beta, MOST), ("theta", self.theta, 1.0), ("sigma", self.sigma, MOST),
        ):  # fmt: skip
            if not 0 <= low <= high <= most:
                raise ValueError(f"{name} range ({low:g}, {high:g}): expected 0 <= low <= high <= {most:g}")

    def sample(self, choices: Choices | None, count: int, rng: np.random.Generator) -> list[Human]:
        """Draw people for a task; with weights or without, they are otherwise the same.

        Without choices they are people for any part of any task, and the same as they would be with them.
        """
        people = []
        for _ in range(count):
            beta, theta, sigma = (float(rng.uniform(*span)) for span in (self.beta, self.theta, self.sigma))
            mistaken = Misconception.drawn(sigma, rng, self.noise)
            h = mistaken if choices is None else mistaken.of(choices)
            people.append(Human(beta, theta, sigma, h, self._model(rng)))
        return people

    def _model(self, rng: np.random.Generator) -> ChoiceModel:
        """Draw how a person chooses."""
        if not self.weights:
            return self.chooses or boltzmann
        own = rng.spawn(1)[0]  # a stream of its own
        return Weighted({name: float(own.uniform(*span)) for name, span in self.weights.items()})

    @property
    def typical(self) -> ChoiceModel:
        """How they choose as far as that is the same for all: every weight is the middle of its range."""
        if not self.weights:
            return self.chooses or boltzmann
        return Weighted({name: (low + high) / 2 for name, (low, high) in self.weights.items()})

    def as_dict(self) -> dict[str, Any]:
        """Give the ranges as plain data; weights and a model of one's own only where there are some."""
        record: dict[str, Any] = {name: getattr(self, name) for name in ("beta", "theta", "sigma", "noise")}
        if self.weights:
            record["weights"] = dict(self.weights)
        if self.chooses is not None:
            record["chooses"] = str(getattr(self.chooses, "__name__", self.chooses))
        return record


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
        object.__setattr__(self, "parts", tuple(self.parts))
        object.__setattr__(self, "shares", tuple(number("share", share) for share in self.shares))
        if not self.parts or len(self.parts) != len(self.shares):
            raise ValueError(f"{len(self.parts)} parts, {len(self.shares)} shares: expected one share for each part")
        if not (min(self.shares) >= 0 and abs(sum(self.shares) - 1) <= 1e-6):
            raise ValueError(
                f"the shares add up to {sum(self.shares):g}; expected numbers of 0 or more that add up to 1"
            )
        if any(part.chooses is not self.parts[0].chooses for part in self.parts):
            raise ValueError("parts with different choice models; expected the same for all")

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

    @property
    def weights(self) -> Mapping[str, Range]:
        """The range of each term's weight that holds all parts."""
        names = dict.fromkeys(name for part in self.parts for name in part.weights)
        spans = {name: [part.weights.get(name, (0.0, 0.0)) for part in self.parts] for name in names}
        return {name: (min(low for low, _ in own), max(high for _, high in own)) for name, own in spans.items()}

    @property
    def chooses(self) -> ChoiceModel | None:
        """The choice model of one's own that all parts have, if they do."""
        return self.parts[0].chooses

    @property
    def typical(self) -> ChoiceModel:
        """How they choose as far as that is the same for all: every weight is the mean."""
        if not self.weights:
            return self.parts[0].typical
        mean = dict.fromkeys(self.weights, 0.0)
        for share, part in zip(self.shares, self.parts, strict=True):
            for name, (low, high) in part.weights.items():
                mean[name] += share / sum(self.shares) * (low + high) / 2
        return Weighted(mean)

    def as_dict(self) -> dict[str, Any]:
        """Give parts and shares as plain data."""
        return {"parts": [part.as_dict() for part in self.parts], "shares": self.shares}

    def sample(self, choices: Choices | None, count: int, rng: np.random.Generator) -> list[Human]:
        """Draw people for a task, or without choices for any part of any task."""
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
    _: KW_ONLY
    eta: float = 0.2
    lapse: float = 1e-3
    utility_scale: float = 1.0

    __repr__ = outline

    def __post_init__(self) -> None:
        for name in ("eta", "lapse", "utility_scale"):
            object.__setattr__(self, name, number(name, getattr(self, name)))
        if not 0 <= self.lapse < 1:
            raise ValueError(f"lapse {self.lapse:g}: expected 0 <= lapse < 1")
        if not (0 <= self.eta <= MOST and 1 / MOST <= self.utility_scale <= MOST):
            raise ValueError(
                f"eta {self.eta:g}, utility_scale {self.utility_scale:g}: expected eta from 0 to {MOST:g}, and a scale "
                f"from {1 / MOST:g} to {MOST:g}"
            )
        object.__setattr__(self, "q", frozen(self.q))

    @classmethod
    def exact(
        cls, choices: Choices, *, eta: float = 0.2, lapse: float = 1e-3, utility_scale: float = 1.0
    ) -> HumanModel:
        """Model a person of whom only the task is known (`knowledge="exact"`): h* for their h."""
        q = perceived_cost(choices, choices.h)
        return cls(choices, q, eta=eta, lapse=lapse, utility_scale=utility_scale)

    @classmethod
    def own(
        cls, choices: Choices, human: Human, *, eta: float = 0.2, lapse: float = 1e-3, utility_scale: float = 1.0
    ) -> HumanModel:
        """Model a person whose own perceived costs are known (`knowledge="own"`, as in the paper)."""
        q = perceived_cost(choices, human.expects(choices))
        return cls(choices, q, eta=eta, lapse=lapse, utility_scale=utility_scale)
