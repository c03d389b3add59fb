"""How people choose and trust, as a robot assumes it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..people.choice_model import ChoiceModel, boltzmann
from ..people.hidden_type import HiddenType
from ..people.trust_rules import TrustRule


@dataclass(frozen=True)
class Behaviour:
    """How people choose and trust, and what is hidden about them.

    Attributes
    ----------
    chooses : ChoiceModel
        Model of people's choices, with beta as the person's type; equation 5 by default.
    trust : TrustRule or None
        How theta moves; None stands for equation (7) with the rate and the unit of utility of a `HumanModel`.
    types : callable
        What is hidden about the person: a class of `HiddenType`, or a function with its arguments. A class of one's own
        has further parts.
    """

    chooses: ChoiceModel = boltzmann
    trust: TrustRule | None = None
    types: Callable[..., HiddenType] = HiddenType


PAPER = Behaviour()
