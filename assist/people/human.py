"""People: as they really are, as they are drawn from populations, and as a robot takes them to be.

`Human` has parameters that nobody sees, a `Population` or a `Mixture` of some gives people, and a `HumanModel` is what
a robot takes for granted of a person whose beta and theta it does not know.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import numpy as np

from .choices import Choices
from .decision import Floats, Noise, perceived_cost, perceived_cost_to_go


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
    _: KW_ONLY
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
        q = perceived_cost(choices, choices.h)
        return cls(choices, q, eta=eta, lapse=lapse, utility_scale=utility_scale)

    @classmethod
    def own(
        cls, choices: Choices, human: Human, *, eta: float = 0.2, lapse: float = 1e-3, utility_scale: float = 1.0
    ) -> HumanModel:
        """Model a person whose own perceived costs are known (`knowledge="own"`, as in the paper)."""
        q = perceived_cost(choices, human.h)
        return cls(choices, q, eta=eta, lapse=lapse, utility_scale=utility_scale)
