"""The parameters of a simulation: costs, time, trust, the robot's knowledge and its suggestions."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, PlainValidator

from planner.system.errors import require_kind

from ..declare.declared import (
    MOST,
    Beside,
    DeclarationError,
    Expected,
    Number,
    Usual,
    Whole,
    declared,
    default_of,
    is_declared,
    names_of,
    whole_number,
)
from ..people.given_rules import rule_given
from ..people.neighbours import Watched, WithSeen, moves_theta, own_seen_rule, seen_rule_of
from ..people.trust_rules import RULES, TrustRule, trust_rule
from ..people.user_code import function_beside
from .observation_model import ObservationModel
from .robots import OfOnePerson, OfRobots, Robot, Suggestions

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..people.neighbourhood import Neighbourhood
    from .fleet import Fleet
    from .travel import Travel

Knowledge = Literal["own", "exact"]


def _robots(given: Any) -> Any:
    """Return as many robots as a number says; anything else as it is."""
    if isinstance(given, list | tuple):
        return given
    return (Robot(),) * whole_number(given)


def _observed(given: ObservationModel | None) -> ObservationModel | None:
    """Return an observation model, or None if it makes no errors."""
    return None if given is None or given.is_perfect else given


def require_setting(given: Any) -> None:
    """Raise a `TypeError` if something else than a setting, or None, was given."""
    require_kind(given, Setting, "Setting(c_suggest=0.5)")


def own_rules(setting: Setting) -> dict[str, TrustRule]:
    """Return the rules of a setting that are the user's own, by their fields; what is seen as `SeenAlone`."""
    rules = {"trust": setting.trust, "believed_trust": setting.believed_trust} | own_seen_rule(setting.neighbours)
    return {n: rule for n, rule in rules.items() if not isinstance(rule, str | None) and not is_declared(type(rule))}


Rule = Annotated[
    str | TrustRule | None,
    PlainValidator(rule_given),
    Beside(function_beside),
    Expected('the name of a trust rule, your own FILE.py:RULE, or a table such as {rule = "outcome", gain = 0.1}'),
]


@declared
class Setting(OfRobots):
    """The parameters of a simulation or of a live team: costs, time, trust, the robots and what they know.

    Raises
    ------
    ValueError
        A parameter is out of its range.
    """

    gamma: Annotated[Number, Field(gt=0, lt=1, description="Discount factor per step.")] = 0.99
    eta: Annotated[
        Number, OfOnePerson(), Field(ge=0, le=MOST, description="Rate of the trust update (equation 7).")
    ] = 0.2
    utility_scale: Annotated[
        Number,
        OfOnePerson(),
        Field(ge=1 / MOST, le=MOST, description="Unit of value in the trust update, in cost units."),
    ] = 1.0
    lapse: Annotated[
        Number,
        OfOnePerson(),
        Field(ge=0, lt=1, description="Probability of a uniform choice in the robot's model of people."),
    ] = 1e-3
    knowledge: Annotated[
        Knowledge,
        OfOnePerson(),
        Field(description="Whether the robot knows each person's own perceived costs, or the exact costs only."),
    ] = "own"
    suggestions: Annotated[
        Suggestions,
        OfOnePerson(),
        Field(description="Whether the robot suggests optimal actions only, or any applicable action."),
    ] = "optimal"
    max_steps: Annotated[Whole, Field(ge=1, description="Steps after which an episode is cut off.")] = 500
    trust: Annotated[
        Rule,
        Usual("RULE"),
        Field(
            description=f"How influence (theta) moves: one of the names {', '.join(RULES)}, a table, or your own "
            "FILE.py:RULE; unless given, paper (equation 7) for simulated people, constant for real ones."
        ),
    ] = None
    believed_trust: Annotated[
        Rule,
        OfOnePerson(),
        Field(description="How the robot believes that theta moves; the rule of `trust` unless given."),
    ] = None
    robots: Annotated[
        tuple[Robot, ...],
        BeforeValidator(_robots),
        Usual("M", "1"),
        Expected("a number of robots, or a list of one table or more"),
        Field(
            min_length=1,
            description="The robots: their number, or a table for each with what differs from the setting.",
        ),
    ] = (Robot(),)
    observation: Annotated[
        ObservationModel | None,
        AfterValidator(_observed),
        Field(description="How reliably the robot sees people's actions; every action as it is unless given."),
    ] = None
    c_ask: Annotated[
        Number | None,
        Field(
            ge=0,
            le=MOST,
            description="Cost of asking a person for the goal or, live, the last action; unless given, or by a policy "
            "that uses no belief, none is asked.",
        ),
    ] = None
    ask_error: Annotated[
        Number, Field(ge=0, lt=0.5, description="Probability that the answer about a goal is wrong.")
    ] = 0.0
    neighbours: Watched = None

    def __post_init__(self) -> None:
        if self.observation is not None and moves_theta(self.neighbours):
            right = "neighbours: expected none with an observation model, as robots do not know then what people saw"
            raise DeclarationError.among(right, "neighbours", "observation")
        for m, robot in enumerate(self.robots, start=1):
            executes = self.execute if robot.execute is None else robot.execute
            if self.observation is not None and executes:
                own = self.robots[m - 1].execute is not None
                right = f"{f'robot {m}: ' * own}execute: expected actions that are all seen as they are"
                raise DeclarationError.among(right, "robots" if own else "execute", "observation")

    @classmethod
    def of(cls, other: Setting) -> Self:
        """Return the setting of this class with all fields that another one has, too."""
        require_setting(other)
        return cls(**{name: getattr(other, name) for name in names_of(cls) if hasattr(other, name)})

    @cached_property
    def fleet(self) -> Fleet:
        """The robots with all of their values."""
        from .fleet import Fleet

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

    def for_real_people(self) -> Self:
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

    def require_questions(self, *, possible: bool) -> None:
        """Raise an error if the robot would ask about people's goals, and no question about them is possible."""
        if self.c_ask is not None and not possible:
            raise ValueError(f"c_ask {self.c_ask:g} has no effect without several goals; expected None")
        if self.c_ask is None and self.ask_error:
            raise ValueError(f"ask_error {self.ask_error:g} has no effect without c_ask; expected 0")

    def without_effect(self) -> dict[str, str]:
        """Return the costs and rates that have no effect with the other parameters, each with what they need."""
        by_equation_seven = self.trust in (None, "paper") or self.believed_trust == "paper"
        found = {} if self.fleet.executes else {"c_execute": "robots that execute"}
        return found | ({} if by_equation_seven else dict.fromkeys(("eta", "utility_scale"), "trust 'paper'"))

    def rule_of_people(self) -> TrustRule:
        """Return the rule by which people's theta moves, also by what they see of each other."""
        return WithSeen(self.trust_rule(), seen_rule_of(self.neighbours))

    def neighbourhood(self, places: int) -> Neighbourhood:
        """Return what a team of `places` people see of each other.

        Raises
        ------
        ValueError
            The graph has fewer stations, or a pair names one that the team does not have.
        """
        from ..people.neighbourhood import Neighbourhood

        if self.neighbours is not None:
            self.neighbours.require_stations(places)
        return Neighbourhood.of(self.neighbours, places)

    def travel(self, places: int, distance: ArrayLike | None = None) -> Travel:
        """Return the travel between `places` people; `distance` as in `Travel.of`."""
        from .travel import Travel

        fleet = self.fleet
        return Travel.of(
            places, c_move=fleet.each("c_move"), travel_time=fleet.each("travel_time"), distance=distance
        )  # fmt: skip


def require_effect(settings: Iterable[Setting]) -> None:
    """Raise a `ValueError` if a cost or a rate was changed that has no effect in any of some settings."""
    every = list(settings)
    for name, what in every[0].without_effect().items():
        usual = default_of(Setting, name)
        changed = [value for one in every if (value := getattr(one, name)) != usual]
        if changed and all(name in one.without_effect() for one in every):
            raise ValueError(f"{name} {changed[0]:g} has no effect without {what}; expected {usual:g}")
