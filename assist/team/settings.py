"""The parameters of a simulation: costs, time, trust, the robot's knowledge and its suggestions."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Literal, get_args

from numpy.typing import ArrayLike

from ..people.arguments import MOST, number, one_of, whole, within
from ..people.belief import Grid
from ..people.choice_model import ChoiceModel
from ..people.choices import Choices
from ..people.human import Human, HumanModel, Population
from ..people.mixture import Mixture
from ..people.trust_rules import TrustRule, rule_given, trust_rule
from ..person.leaf_bounds import LeafBounds
from ..person.observation_model import ObservationModel, observation_given
from ..person.pomdp import AssistPOMDP, Suggestions
from .robots import Fleet, Robot, robots_of
from .travel import Travel

Knowledge = Literal["own", "exact"]

RULES_OF = ("trust", "believed_trust")
"""Fields of a setting that are trust rules: of people, and of the robot's model of them."""


@dataclass(frozen=True)
class Setting:
    """The parameters of a simulation.

    Attributes
    ----------
    gamma : float
        Discount factor per step, in (0, 1).
    c_suggest, c_move : float
        Costs of a suggestion, and of moving by a distance of 1, in cost units.
    travel_time : float
        Steps for moving by a distance of 1.
    eta : float
        Rate of the trust update (equation 7).
    utility_scale : float
        Unit of value in the trust update, in cost units.
    lapse : float
        Probability of a uniform choice in the robot's model of people.
    knowledge : "own" or "exact"
        Whether the robot knows each person's perceived costs (as in the paper), or only h*.
    suggestions : "optimal" or "all"
        Whether the robot suggests optimal actions only, or any applicable action.
    execute : bool
        Whether the robot can also execute an action itself.
    c_execute : float
        Cost of an action executed by the robot, in cost units.
    max_steps : int
        Largest number of steps of an episode.
    robots : sequence of Robot, or int
        The M robots of a team. What a robot does not say, as everything if only their number is given, is as in this
        setting. All begin at the base.
    trust : str or TrustRule, optional
        How theta moves, for people and in the robot's model of them: "paper" (equation 7 with `eta` and
        `utility_scale`), "constant", "outcome", "outcome-at-disagreement", "reliability", or a rule. Unless given
        it is the paper's for simulated people, and constant for real people (`live`), as data of real people support.
    believed_trust : str or TrustRule, optional
        How the robot believes that theta moves; the rule of `trust` unless given. Bounds hold for the robot's model.
    c_ask : float, optional
        Cost of asking a person who pursues one of several goals "is it this one?", in cost units; a live robot also
        asks "what did you do last?" after uncertain actions. Unless given, the robot does not ask.
    ask_error : float
        Probability that the answer about a goal is wrong.
    observation : ObservationModel, optional
        How reliably the robot sees people's actions; every action as it is, by default. Otherwise the robot may suggest
        any applicable action, as with `suggestions="all"`, since it may mistake the state of a task.

    Raises
    ------
    ValueError
        A parameter is out of its range.
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
    trust: str | TrustRule | None = None
    believed_trust: str | TrustRule | None = None
    robots: tuple[Robot, ...] = (Robot(),)
    observation: ObservationModel | None = None
    c_ask: float | None = None
    ask_error: float = 0.0

    def __post_init__(self) -> None:
        usual = Robot(self.execute, self.c_suggest, self.c_execute, self.c_move, self.travel_time)
        for name, value in vars(usual).items():
            object.__setattr__(self, name, value)
        for name in ("gamma", "lapse", "ask_error"):
            object.__setattr__(self, name, number(name, getattr(self, name)))
        for name in ("eta", *(() if self.c_ask is None else ("c_ask",))):
            object.__setattr__(self, name, within(name, getattr(self, name), 0, MOST))
        object.__setattr__(self, "utility_scale", within("utility_scale", self.utility_scale, 1 / MOST, MOST))
        if not 0 < self.gamma < 1:
            raise ValueError(f"gamma {self.gamma:g}: expected 0 < gamma < 1")
        if not 0 <= self.lapse < 1:
            raise ValueError(f"lapse {self.lapse:g}: expected 0 <= lapse < 1")
        if not 0 <= self.ask_error < 1 / 2:
            raise ValueError(f"ask_error {self.ask_error:g}: expected 0 <= ask_error < 0.5")
        one_of("knowledge", self.knowledge, get_args(Knowledge))
        one_of("suggestions", self.suggestions, get_args(Suggestions))
        object.__setattr__(self, "max_steps", whole("max_steps", self.max_steps, 1))
        object.__setattr__(self, "robots", robots_of(self.robots))
        object.__setattr__(self, "observation", observation_given(self.observation))
        for m, robot in enumerate(self.fleet.robots, start=1):
            if self.observation is not None and robot.execute:
                who = f"robot {m}: " * (self.robots[m - 1].execute is not None)
                raise ValueError(f"{who}execute: expected actions that are all seen as they are")
        for name in RULES_OF:
            object.__setattr__(self, name, rule_given(name, getattr(self, name)))
        self.travel(1)  # raises an error for impossible travel
        self.trust_rule()  # raises an error for an unknown rule
        self.believed_rule()

    @cached_property
    def fleet(self) -> Fleet:
        """The robots with all of their values."""
        return Fleet.of(self.robots, self)

    def trust_rule(self) -> TrustRule:
        """Return the trust rule of people."""
        return trust_rule(self.trust, self.eta, self.utility_scale)

    @property
    def considered_suggestions(self) -> Suggestions:
        """Which suggestions a robot considers: all of them if it may mistake the state of a task."""
        return self.suggestions if self.observation is None else "all"

    def believed_rule(self) -> TrustRule:
        """Return the trust rule of the robot's model of people."""
        believed = self.trust if self.believed_trust is None else self.believed_trust
        return trust_rule(believed, self.eta, self.utility_scale)

    def for_real_people(self) -> Setting:
        """Return the setting with a constant theta, unless it has a trust rule already."""
        return replace(self, trust="constant") if self.trust is None else self

    def require_all_seen(self, what: str) -> None:
        """Raise an error if actions may be missed or confused, where they must be seen as they are.

        Raises
        ------
        ValueError
            It names `what` needs that.
        """
        if self.observation is not None:
            raise ValueError(f"observation: expected none, as {what} has actions that are all seen as they are")

    def require_questions(self, goals: int) -> None:
        """Raise an error if the robot would ask about people's goals, and each has the same one."""
        if self.c_ask is not None and goals == 1:
            raise ValueError(f"c_ask {self.c_ask:g} has no effect without several goals; expected None")
        if self.c_ask is None and self.ask_error:
            raise ValueError(f"ask_error {self.ask_error:g} has no effect without c_ask; expected 0")

    def require_effect(self) -> None:
        """Raise an error if a cost or a rate was changed that has no effect together with the other parameters."""
        usual = {field.name: field.default for field in fields(self)}
        without = {"c_execute": not self.fleet.executes and "robots that execute"}
        by_equation_seven = self.trust in (None, "paper") or self.believed_trust == "paper"
        without |= dict.fromkeys(("eta", "utility_scale"), not by_equation_seven and "trust 'paper'")
        for name, what in without.items():
            value = getattr(self, name)
            if what and value != usual[name]:
                raise ValueError(f"{name} {value:g} has no effect without {what}; expected {usual[name]:g}")

    def travel(self, places: int, distance: ArrayLike | None = None) -> Travel:
        """Return the travel between `places` people; `distance` as in `Travel.of`."""
        fleet = self.fleet
        return Travel.of(
            places, c_move=fleet.each("c_move"), travel_time=fleet.each("travel_time"), distance=distance
        )  # fmt: skip

    def chooses(self, human: Human | None, population: Population | Mixture) -> ChoiceModel:
        """Return the robot's model of a person's choices; `human` is None if the person is unknown to the robot."""
        return human.chooses if human is not None and human.weights and population.weights else population.typical

    def problem(
        self,
        choices: Choices,
        human: Human | None,
        population: Population | Mixture,
        *,
        frontier: LeafBounds | None = None,
    ) -> AssistPOMDP:
        """Return the problem of assisting one person of a population, by the best of its robots (`team.robots`).

        Parameters
        ----------
        choices : Choices
            Choices of the task, or of a truncated task with a frontier.
        human : Human or None
            The person, if the robot knows their perceived costs; None if it knows the task only. The weights of a known
            person are known, too, if the population has weights.
        population : Population or Mixture
            The robot's prior.
        frontier : LeafBounds, optional
            Bounds at the frontier of a truncated task.
        """
        known = {"eta": self.eta, "lapse": self.lapse, "utility_scale": self.utility_scale}
        model = HumanModel.exact(choices, **known) if human is None else HumanModel.own(choices, human, **known)
        return AssistPOMDP.of(
            model, chooses=self.chooses(human, population), grid=Grid.regular(population),
            population=population, gamma=self.gamma, c_suggest=self.fleet.least("c_suggest"),
            suggestions=self.considered_suggestions, execute=self.fleet.executes,
            c_execute=self.fleet.least("c_execute"), frontier=frontier, trust=self.believed_rule(),
        )  # fmt: skip
