"""What a robot assumes of a person, from which the person's problem on any states of a task follows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from ..people.belief import Grid
from ..people.choice_model import ChoiceModel
from ..people.choices import Choices
from ..people.hidden_type import HiddenType
from ..people.human import Human, HumanModel
from ..people.ranges import Population
from ..people.trust_rules import EquationSeven, TrustRule, counts_of
from .behaviour import Behaviour
from .leaf_bounds import LeafBounds
from .pomdp import AssistPOMDP
from .robots import USUAL, OfRobots, Suggestions
from .settings import Setting


@dataclass(frozen=True, eq=False)
class Assumptions:
    """What a robot assumes of a person and may do for them.

    Attributes
    ----------
    population : Population
        The robot's prior.
    human : Human or None
        The person, if the robot knows their perceived costs; None if it knows the task only. The weights of a known
        person are known, too, if the population has weights.
    trust : TrustRule or None
        How theta moves; None stands for equation (7) with `eta` and `utility_scale`.
    gamma, robot, suggestions
        As in `AssistPOMDP.of`.
    lapse, eta, utility_scale : float
        As in `HumanModel`.
    types : callable
        As in `Behaviour`.
    """

    population: Population = field(default_factory=Population)
    human: Human | None = None
    trust: TrustRule | None = None
    gamma: float = 0.99
    robot: OfRobots = USUAL
    suggestions: Suggestions = "optimal"
    lapse: float = 1e-3
    eta: float = 0.2
    utility_scale: float = 1.0
    types: Callable[..., HiddenType] = HiddenType

    @classmethod
    def of(cls, setting: Setting, human: Human | None, population: Population) -> Assumptions:
        """Return what the robots of a setting assume of a person of a population, by the best of them (`Fleet.best`).

        Parameters
        ----------
        setting : Setting
        human : Human or None
            The person, if the robots know their perceived costs; None if they know the task only.
        population : Population
            The robots' prior.
        """
        return cls(
            population, human, setting.believed_rule(), gamma=setting.gamma, robot=setting.fleet.best,
            suggestions=setting.considered_suggestions, lapse=setting.lapse, eta=setting.eta,
            utility_scale=setting.utility_scale,
        )  # fmt: skip

    @property
    def chooses(self) -> ChoiceModel:
        """The robot's model of the person's choices."""
        human, weighs = self.human, self.population.weights
        return human.chooses if human is not None and human.weights and weighs else self.population.typical

    @property
    def grid(self) -> Grid:
        """The grid of beta and theta of the robot's belief."""
        rule = EquationSeven() if self.trust is None else self.trust
        return Grid.regular(self.population).with_counts(counts_of(rule))

    def model(self, choices: Choices) -> HumanModel:
        """Return the person as the robot knows them, in some states of a task."""
        rates = {"eta": self.eta, "lapse": self.lapse, "utility_scale": self.utility_scale}
        if self.human is None:
            return HumanModel.exact(choices, **rates)
        return HumanModel.own(choices, self.human, **rates)

    def problem(self, choices: Choices, frontier: LeafBounds | None = None) -> AssistPOMDP:
        """Return the problem of assisting the person in some states of a task, with bounds where it is truncated."""
        return AssistPOMDP.of(
            self.model(choices), behaviour=Behaviour(self.chooses, self.trust, self.types), grid=self.grid,
            population=self.population, gamma=self.gamma, robot=self.robot, suggestions=self.suggestions,
            frontier=frontier,
        )  # fmt: skip
