"""People, and the robot's model of a person.

A `Human` has hidden parameters. A `HumanModel` is the robot's model of a person whose beta and theta it does not know.
How people choose is a `ChoiceModel`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass

import numpy as np

from planner.system.arrays import frozen, outline

from .arguments import MOST, number
from .choice_model import ChoiceModel, Weighted, boltzmann, chances, value
from .choices import Choices
from .decision import Floats, perceived_cost
from .misconception import Misconception

NO_MISCONCEPTION = Misconception(0.0, 0)
"""That of somebody who knows the true cost-to-go."""


@dataclass(frozen=True)
class Human:
    """A person with their true parameters.

    Attributes
    ----------
    beta : float
        Expertise (per cost unit), 0 or more.
    theta : float
        Initial influence of the robot, in [0, 1].
    sigma : float
        Standard deviation of the misconception, in cost units.
    h : float array, shape (n,) or (n, A), or Misconception
        Perceived cost-to-go of each state, or after each choice; or the misconception from which it follows in any
        part of a task. By default the person knows the true one.
    chooses : ChoiceModel
        Choice model; by default the paper's.
    name : str, optional
        What the person is called in pools and results.

    Raises
    ------
    ValueError
        A parameter is out of its range, or there is a sigma without a misconception.
    """

    beta: float
    theta: float
    sigma: float = 0.0
    h: Floats | Misconception = NO_MISCONCEPTION
    chooses: ChoiceModel = boltzmann
    name: str | None = None

    def __post_init__(self) -> None:
        for name in ("beta", "theta", "sigma"):
            object.__setattr__(self, name, number(name, getattr(self, name)))
        if not (0 <= self.beta <= MOST and 0 <= self.sigma <= MOST and 0 <= self.theta <= 1):
            raise ValueError(
                f"beta {self.beta:g}, theta {self.theta:g}, sigma {self.sigma:g}: expected beta and sigma from 0 to "
                f"{MOST:g}, and theta from 0 to 1"
            )
        if self.sigma > 0 and self.h is NO_MISCONCEPTION:
            raise ValueError(f"sigma {self.sigma:g}: expected h, too, such as Misconception({self.sigma:g}, seed=1)")
        if not isinstance(self.h, Misconception):
            h = frozen(np.asarray(self.h, dtype=float))
            if h.ndim not in (1, 2) or np.isnan(h).any():
                raise ValueError(f"h, shape {h.shape}: expected a number for each state, or for each choice in it")
            object.__setattr__(self, "h", h)

    def expects(self, choices: Choices) -> Floats:
        """Return the perceived cost-to-go in a task or a part of it, shape (n,) or (n, A)."""
        return self.h.of(choices) if isinstance(self.h, Misconception) else self.h

    @property
    def weights(self) -> Mapping[str, float]:
        """The weight of each term of the choice."""
        return self.chooses.weights if isinstance(self.chooses, Weighted) else {}

    def chances(self, choices: Choices) -> Floats:
        """Return the probability of each choice without a suggestion, shape (n, A)."""
        return chances(self.chooses, choices, perceived_cost(choices, self.expects(choices)), np.array([self.beta]))[0]

    def value(self, choices: Choices) -> Floats:
        """Return V(x), shape (n,), by which theta changes (equation 7)."""
        return value(self.chooses, choices, perceived_cost(choices, self.expects(choices)))


@dataclass(frozen=True)
class HumanModel:
    """The robot's model of a person whose beta and theta it does not know.

    Attributes
    ----------
    choices : Choices
    q : float array, shape (n, A, G)
        The person's perceived costs for each of G goals, or the exact costs if the robot does not know them.
    eta : float
        Learning rate of the trust update.
    lapse : float
        Weight of a uniform choice in the robot's model, so that no applicable action has probability zero.
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

    @property
    def of_each_goal(self) -> list[tuple[Choices, Floats]]:
        """The choices and perceived costs, shape (n, A), with each of the goals known."""
        return [(own, np.ascontiguousarray(self.q[:, :, goal])) for goal, own in enumerate(self.choices.of_each_goal)]

    @classmethod
    def exact(cls, choices: Choices, **rates: float) -> HumanModel:
        """Return the model of a person of whom only the task is known (`knowledge="exact"`): h* in place of h."""
        return cls(choices, np.stack([perceived_cost(own, own.h) for own in choices.of_each_goal], axis=2), **rates)

    @classmethod
    def own(cls, choices: Choices, human: Human, **rates: float) -> HumanModel:
        """Return the model of a person whose perceived costs are known (`knowledge="own"`, as in the paper)."""
        each = [perceived_cost(own, human.expects(own)) for own in choices.of_each_goal]
        return cls(choices, np.stack(each, axis=2), **rates)
