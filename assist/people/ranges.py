"""Populations: ranges from which people's parameters are drawn."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import field
from statistics import NormalDist
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, Field, PlainValidator
from pydantic_core import PydanticCustomError

from planner.system.errors import require_kind

from ..declare.declared import MOST, Beside, DeclarationError, Expected, Number, declared, default_of
from ..declare.declared import Range as Span
from .user_code import UserChoiceModel, function_beside, parse

if TYPE_CHECKING:
    import numpy as np

    from .choice_model import ChoiceModel
    from .choices import Choices
    from .human import Human

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
        source = parse(given)
        if source is None:
            raise ValueError(f"'{given}'; expected FILE.py:FUNCTION")
        return UserChoiceModel.load(*source)
    if given is not None and not callable(given):
        raise ValueError(f"{given!r}; expected a function, or FILE.py:FUNCTION")
    return given


OwnModel = Annotated[
    Callable[..., Any] | None, PlainValidator(_chooses), Beside(function_beside), Expected("FILE.py:FUNCTION")
]
"""A choice model of the user's own, or the text FILE.py:FUNCTION."""

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
        Literal["state", "action"],
        Field(description="Whether misconceptions are about states, or about the outcome of each choice."),
    ] = "state"
    weights: Annotated[
        dict[str, Weight], Field(description="Range of each term's weight, by its name; other terms have weight 0.")
    ] = field(default_factory=dict, hash=False)
    chooses: Annotated[
        OwnModel,
        Field(description="Your own choice model FILE.py:FUNCTION, in place of cost-to-go and terms."),
    ] = None
    parts: Annotated[
        tuple[Population, ...], Field(description="Populations of which this one is a mixture, in place of ranges.")
    ] = ()
    shares: Annotated[tuple[Number, ...], Field(description="Share of each part; they add up to 1.")] = ()

    def __repr__(self) -> str:
        from planner.system.arrays import outline

        return outline(self)

    def __post_init__(self) -> None:
        if self.chooses is not None and self.weights:
            right = f"weights of {', '.join(self.weights)}, and a choice model: expected one of them"
            raise DeclarationError.among(right, "weights", "chooses")
        if len(self.parts) != len(self.shares):
            right = f"{len(self.parts)} parts, {len(self.shares)} shares: expected one share for each part"
            raise DeclarationError.among(right, "shares", "parts")
        if self.parts:
            self._contain_parts()

    def _contain_parts(self) -> None:
        if not (min(self.shares) >= 0 and abs(sum(self.shares) - 1) <= 1e-6):
            right = f"the shares add up to {sum(self.shares):g}; expected numbers of 0 or more that add up to 1"
            raise DeclarationError.among(right, "shares")
        first = self.parts[0]
        if any(part.chooses is not first.chooses for part in self.parts):
            raise DeclarationError.among("parts with different choice models; expected the same for all", "parts")
        names = dict.fromkeys(name for part in self.parts for name in part.weights)
        spans = {name: [part.weights.get(name, (0.0, 0.0)) for part in self.parts] for name in names}
        hull: dict[str, Any] = {name: _hull([getattr(part, name) for part in self.parts]) for name in RANGES}
        hull |= {"weights": {name: _hull(each) for name, each in spans.items()}, "chooses": first.chooses}
        for name, whole in hull.items():
            if getattr(self, name) not in (default_of(Population, name), whole):
                raise DeclarationError.among(f"{name}: a mixture has that of its parts; expected none", name)
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
        import numpy as np

        from .human import Human
        from .misconception import Misconception

        if self.parts:
            drawn = rng.choice(len(self.parts), size=count, p=np.asarray(self.shares) / sum(self.shares))
            return [person for part in drawn for person in self.parts[part].sample(choices, 1, rng)]
        people = []
        for _ in range(count):
            beta, theta, sigma = (float(rng.uniform(*span)) for span in (self.beta, self.theta, self.sigma))
            mistaken = Misconception.drawn(sigma, rng, self.noise)
            h = mistaken if choices is None or choices.goals.distinguished else mistaken.of(choices)
            people.append(Human(beta, theta, sigma, h, self._model(rng)))
        return people

    def _model(self, rng: np.random.Generator) -> ChoiceModel:
        """Return the choice model of a person, with weights drawn from their ranges."""
        from .choice_model import Weighted, boltzmann

        if not self.weights:
            return self.chooses or boltzmann
        own = rng.spawn(1)[0]  # a separate stream, so that weights change nothing else
        return Weighted({name: float(own.uniform(*span)) for name, span in self.weights.items()})

    @property
    def typical(self) -> ChoiceModel:
        """The choice model of a typical person, with every weight at its mean."""
        from .choice_model import Weighted, boltzmann

        if not self.weights:
            return self.chooses or boltzmann
        mean = dict.fromkeys(self.weights, 0.0)
        for share, part in zip(self.shares, self.parts, strict=True) if self.parts else [(1.0, self)]:
            for name, (low, high) in part.weights.items():
                mean[name] += share / (sum(self.shares) or 1.0) * (low + high) / 2
        return Weighted(mean)


OF_ADVICE_TAKERS = ("beta", "sigma", "chooses")
"""Fields of a population whose influence is that of real people."""


def advice_takers(
    beta: Range = (0.1, 3.0), sigma: Range = (0.1, 1.0), *, center: float = 1.7, spread: float = 1.4,
    chooses: ChoiceModel | None = None,
) -> Population:  # fmt: skip
    """Return a population whose influence theta varies as much as in public data of people who received advice.

    logit(theta) is normal with mean `center` and standard deviation `spread`, in ten ranges of theta within which it is
    uniform. In two public data sets, of 401 people who bet on cards with attention and 91 who dated events, the fitted
    means are .4, 1.8 and 2.9, and the fitted standard deviations 1.2 to 1.6 (docs/results/trust.md). The defaults were
    chosen on these people, near the middle: half of all have an influence above .85, and one in nine below .5.

    Parameters
    ----------
    beta, sigma : pair of float
        As in `Population`.
    center, spread : float
        In log-odds.
    chooses : ChoiceModel, optional
        As in `Population`.
    """
    if not (-MOST <= center <= MOST and 0 < spread <= MOST):
        raise ValueError(f"center {center:g}, spread {spread:g}: expected log-odds, and a spread above 0")
    edges = [tenth * 0.1 for tenth in range(10)] + [1.0]
    below = [0.0, *(NormalDist(center, spread).cdf(math.log(e / (1 - e))) for e in edges[1:-1]), 1.0]
    parts = tuple(Population(beta, (low, high), sigma, chooses=chooses) for low, high in itertools.pairwise(edges))
    return Population.mixed(parts, [high - low for low, high in itertools.pairwise(below)])


def require_populations(*given: Any) -> None:
    """Raise a `TypeError` if something else than a population, or None, was given."""
    for one in given:
        require_kind(one, Population, "Population(beta=(0.5, 2.0))")


RANGES = ("beta", "theta", "sigma")


def _hull(ranges: Sequence[Range]) -> Range:
    """Return the smallest range that contains others."""
    return min(low for low, _ in ranges), max(high for _, high in ranges)
