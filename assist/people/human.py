"""People, populations of people, and the robot's model of a person.

A `Human` has hidden parameters. People are drawn from a `Population`. A `HumanModel` is
the robot's model of a person whose beta and theta it does not know. How people choose is a `ChoiceModel`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field, PlainValidator
from pydantic_core import PydanticCustomError

from planner.system.arrays import frozen, outline

from ..declare.declared import MOST, Beside, Expected, Number, declared, default_of
from ..declare.declared import Range as Span
from .arguments import number
from .choice_model import ChoiceModel, boltzmann, chances, value
from .choices import Choices
from .decision import Floats, perceived_cost
from .misconception import Misconception, Noise
from .user_code import UserChoiceModel, function_beside, parse
from .weighted_choice import Weighted

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


Range = tuple[float, float]


def _ordered(least: float, most: float) -> Any:
    """Return the check of a range within limits."""

    def check(pair: Range) -> Range:
        if not least <= pair[0] <= pair[1] <= most:
            raise PydanticCustomError("kind", "a range")
        return pair

    return AfterValidator(check)


def _chooses(given: Any) -> Any:
    """Return a choice model; a text FILE.py:FUNCTION is the user's."""
    if isinstance(given, str):
        place = parse(given)
        if place is None:
            raise ValueError(f"'{given}'; expected FILE.py:FUNCTION")
        return UserChoiceModel.load(*place)
    if given is not None and not callable(given):
        raise ValueError(f"{given!r}; expected a function, or FILE.py:FUNCTION")
    return given


POSITIVE = Expected(f"two numbers, 0 <= low <= high <= {MOST:g}")
Weight = Annotated[Span, _ordered(-MOST, MOST), Expected(f"two numbers, -{MOST:g} <= low <= high <= {MOST:g}")]


@declared
class Population:
    """Ranges from which people's parameters are drawn uniformly; the defaults are the paper's Table I.

    A population of several parts is a piecewise uniform distribution; its own ranges are the smallest that contain
    those of all parts (`Population.mixed`).
    """

    beta: Annotated[
        Span, _ordered(0, MOST), POSITIVE, Field(description="Range of people's expertise, per cost unit.")
    ] = (0.1, 3.0)
    theta: Annotated[
        Span,
        _ordered(0, 1),
        Expected("two numbers, 0 <= low <= high <= 1"),
        Field(description="Range of the robot's influence on people at first."),
    ] = (0.5, 0.95)
    sigma: Annotated[
        Span,
        _ordered(0, MOST),
        POSITIVE,
        Field(description="Range of the standard deviation of people's misconceptions, in cost units."),
    ] = (0.1, 1.0)
    noise: Annotated[
        Noise, Field(description="Whether misconceptions are about states, or about the outcome of each choice.")
    ] = "state"
    weights: Annotated[
        dict[str, Weight], Field(description="Range of each term's weight, by its name; other terms have weight 0.")
    ] = field(default_factory=dict, hash=False)
    chooses: Annotated[
        ChoiceModel | None,
        PlainValidator(_chooses),
        Beside(function_beside),
        Expected("FILE.py:FUNCTION"),
        Field(description="Your own choice model FILE.py:FUNCTION, in place of cost-to-go and terms."),
    ] = None
    parts: Annotated[
        tuple[Population, ...], Field(description="Populations of which this one is a mixture, in place of ranges.")
    ] = ()
    shares: Annotated[tuple[Number, ...], Field(description="Share of each part; they add up to 1.")] = ()

    __repr__ = outline

    def __post_init__(self) -> None:
        if self.chooses is not None and self.weights:
            raise ValueError(f"weights of {', '.join(self.weights)}, and a choice model: expected one of them")
        if len(self.parts) != len(self.shares):
            raise ValueError(f"{len(self.parts)} parts, {len(self.shares)} shares: expected one share for each part")
        if self.parts:
            self._contain_parts()

    def _contain_parts(self) -> None:
        if not (min(self.shares) >= 0 and abs(sum(self.shares) - 1) <= 1e-6):
            raise ValueError(
                f"the shares add up to {sum(self.shares):g}; expected numbers of 0 or more that add up to 1"
            )
        first = self.parts[0]
        if any(part.chooses is not first.chooses for part in self.parts):
            raise ValueError("parts with different choice models; expected the same for all")
        names = dict.fromkeys(name for part in self.parts for name in part.weights)
        spans = {name: [part.weights.get(name, (0.0, 0.0)) for part in self.parts] for name in names}
        hull: dict[str, Any] = {name: _hull([getattr(part, name) for part in self.parts]) for name in RANGES}
        hull |= {"weights": {name: _hull(each) for name, each in spans.items()}, "chooses": first.chooses}
        for name, whole in hull.items():
            if getattr(self, name) not in (default_of(Population, name), whole):
                raise ValueError(f"{name}: a mixture has that of its parts; expected none")
            object.__setattr__(self, name, whole)

    @classmethod
    def mixed(cls, parts: Sequence[Population], shares: Sequence[float]) -> Population:
        """Return the mixture of several populations.

        Parameters
        ----------
        parts : sequence of Population
        shares : sequence of float
            Share of each part; they sum to 1.
        """
        if not parts:
            raise ValueError("0 parts: expected one or more")
        return cls(parts=tuple(parts), shares=tuple(shares))

    def sample(self, choices: Choices | None, count: int, rng: np.random.Generator) -> list[Human]:
        """Return people drawn for a task; weights do not change their other parameters.

        Without `choices`, the same people are returned in a form that suits any part of any task. So they are if the
        goal is one of several.
        """
        if self.parts:
            drawn = rng.choice(len(self.parts), size=count, p=np.asarray(self.shares) / sum(self.shares))
            return [person for part in drawn for person in self.parts[part].sample(choices, 1, rng)]
        people = []
        for _ in range(count):
            beta, theta, sigma = (float(rng.uniform(*span)) for span in (self.beta, self.theta, self.sigma))
            mistaken = Misconception.drawn(sigma, rng, self.noise)
            h = mistaken if choices is None or choices.unknown_goal is not None else mistaken.of(choices)
            people.append(Human(beta, theta, sigma, h, self._model(rng)))
        return people

    def _model(self, rng: np.random.Generator) -> ChoiceModel:
        """Return the choice model of a person, with weights drawn from their ranges."""
        if not self.weights:
            return self.chooses or boltzmann
        own = rng.spawn(1)[0]  # a separate stream, so that weights change nothing else
        return Weighted({name: float(own.uniform(*span)) for name, span in self.weights.items()})

    @property
    def typical(self) -> ChoiceModel:
        """The choice model of a typical person, with every weight at its mean."""
        if not self.weights:
            return self.chooses or boltzmann
        mean = dict.fromkeys(self.weights, 0.0)
        for share, part in zip(self.shares, self.parts, strict=True) if self.parts else [(1.0, self)]:
            for name, (low, high) in part.weights.items():
                mean[name] += share / (sum(self.shares) or 1.0) * (low + high) / 2
        return Weighted(mean)


RANGES = ("beta", "theta", "sigma")


def _hull(ranges: Sequence[Range]) -> Range:
    """Return the smallest range that contains others."""
    return min(low for low, _ in ranges), max(high for _, high in ranges)


@dataclass(frozen=True)
class HumanModel:
    """The robot's model of a person whose beta and theta it does not know.

    Attributes
    ----------
    choices : Choices
    q : float array, shape (n, A), or (n, A, G) if the goal is one of several
        The person's perceived costs, or the exact costs if the robot does not know them.
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
        q = self.q.reshape(*self.q.shape[:2], -1)
        return [(own, np.ascontiguousarray(q[:, :, goal])) for goal, own in enumerate(self.choices.of_each_goal)]

    @classmethod
    def exact(
        cls, choices: Choices, *, eta: float = 0.2, lapse: float = 1e-3, utility_scale: float = 1.0
    ) -> HumanModel:
        """Return the model of a person of whom only the task is known (`knowledge="exact"`): h* in place of h."""
        q = _of_goals(perceived_cost(own, own.h) for own in choices.of_each_goal)
        return cls(choices, q, eta=eta, lapse=lapse, utility_scale=utility_scale)

    @classmethod
    def own(
        cls, choices: Choices, human: Human, *, eta: float = 0.2, lapse: float = 1e-3, utility_scale: float = 1.0
    ) -> HumanModel:
        """Return the model of a person whose perceived costs are known (`knowledge="own"`, as in the paper)."""
        q = _of_goals(perceived_cost(own, human.expects(own)) for own in choices.of_each_goal)
        return cls(choices, q, eta=eta, lapse=lapse, utility_scale=utility_scale)


def _of_goals(each: Iterable[Floats]) -> Floats:
    """Return arrays of shape (n, A) for each goal as one of shape (n, A, G); that of a single goal as it is."""
    found = list(each)
    return np.stack(found, axis=2) if len(found) > 1 else found[0]
