"""What a simulation takes for granted: costs, time, trust, and what the robot knows and may say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from ..people.arguments import MOST, number, whole
from ..people.belief import Grid
from ..people.choice_model import ChoiceModel
from ..people.choices import Choices
from ..people.human import Human, HumanModel, Mixture, Population
from ..person.pomdp import AssistPOMDP, LeafBounds, Suggestions
from .travel import Travel

Knowledge = Literal["own", "exact"]


@dataclass(frozen=True)
class Setting:
    """What a simulation takes for granted.

    Attributes
    ----------
    gamma : float
        Discount factor per step.
    c_suggest, c_move : float
        Cost of a suggestion, and of moving by a distance of 1, in cost units.
    travel_time : float
        Steps that moving by a distance of 1 takes.
    eta : float
        Rate of the trust update.
    utility_scale : float
        The unit of value in the trust update, in cost units.
    lapse : float
        Weight of a uniform choice in the robot's model of people.
    knowledge : "own" or "exact"
        Whether the robot knows each person's perceived costs (as in the paper) or only h*.
    suggestions : "optimal" or "all"
        Which actions the robot may suggest: those that a cheapest way begins with, or any.
    execute : bool
        Whether the robot can also execute an action itself.
    c_execute : float
        What that costs, in cost units.
    max_steps : int
        An episode is cut off after this many steps.
    """

    gamma: float = 0.99
    c_suggest: float = 1.0
    c_move: float = 0.5
    travel_time: float = 0.0
    eta: float = 0.2
    utility_scale: float = 1.0
    lapse: float = 1e-3
    knowledge: Knowledge = "own"
    suggestions: Suggestions = "optimal"
    execute: bool = False
    c_execute: float = 1.0
    max_steps: int = 500

    def __post_init__(self) -> None:
        for name in ("gamma", "c_suggest", "c_move", "travel_time", "eta", "utility_scale", "lapse", "c_execute"):
            object.__setattr__(self, name, number(name, getattr(self, name)))
        if not 0 < self.gamma < 1:
            raise ValueError(f"gamma {self.gamma:g}: expected 0 < gamma < 1")
        if not 0 <= self.lapse < 1:
            raise ValueError(f"lapse {self.lapse:g}: expected 0 <= lapse < 1")
        if not 1 / MOST <= self.utility_scale <= MOST:
            raise ValueError(f"utility_scale {self.utility_scale:g}: expected a number from {1 / MOST:g} to {MOST:g}")
        for cost in ("c_suggest", "c_execute", "eta"):
            if not 0 <= getattr(self, cost) <= MOST:
                raise ValueError(f"{cost} {getattr(self, cost):g}: expected a number from 0 to {MOST:g}")
        for name, expected in (("knowledge", get_args(Knowledge)), ("suggestions", get_args(Suggestions))):
            if getattr(self, name) not in expected:
                raise ValueError(f"{name} {getattr(self, name)!r}: expected {' or '.join(map(repr, expected))}")
        if not isinstance(self.execute, bool | np.bool_):
            raise ValueError(f"execute {self.execute!r}: expected True or False")  # noqa: TRY004
        object.__setattr__(self, "execute", bool(self.execute))
        object.__setattr__(self, "max_steps", whole("max_steps", self.max_steps, 1))
        self.travel(1)  # refuses a way that cannot be

    def travel(self, places: int, distance: ArrayLike | None = None) -> Travel:
        """Give the way between so many people; `distance` as in `Travel.of`."""
        return Travel.of(places, c_move=self.c_move, travel_time=self.travel_time, distance=distance)

    def chooses(self, human: Human | None, population: Population | Mixture) -> ChoiceModel:
        """Give how the robot takes somebody of a population to choose, knowing who they are or not."""
        return human.chooses if human is not None and human.weights and population.weights else population.typical

    def problem(
        self,
        choices: Choices,
        human: Human | None,
        population: Population | Mixture,
        *,
        frontier: LeafBounds | None = None,
    ) -> AssistPOMDP:
        """Set up the problem of assisting one person of a population; None: of whom the robot knows only the task.

        With a frontier the choices are a part of a task's, and break off there. Of somebody whose perceived costs are
        known, the weights are, too, if people of that population have any.
        """
        known = {"eta": self.eta, "lapse": self.lapse, "utility_scale": self.utility_scale}
        model = HumanModel.exact(choices, **known) if human is None else HumanModel.own(choices, human, **known)
        return AssistPOMDP.of(
            model, chooses=self.chooses(human, population), grid=Grid.regular(population),
            population=population, gamma=self.gamma, c_suggest=self.c_suggest, suggestions=self.suggestions,
            execute=self.execute, c_execute=self.c_execute, frontier=frontier,
        )  # fmt: skip
