"""The people from whom teams are drawn, and what the robot has worked out about each of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..people.belief import Grid
from ..people.choices import Choices
from ..people.human import Human, HumanModel, Mixture, Population
from ..person.pomdp import AssistPOMDP, Policy, Suggestions
from ..person.qmdp import qmdp
from .attention import AttentionSwitching, NoAssistance, Reactive
from .priority import Priority
from .state import TeamPolicy, Travel

Knowledge = Literal["own", "exact"]
POLICIES = ("none", "reactive", "attention", "attention-never", "priority")
"""The names under which `Pool.policy` makes team policies."""

SIMULATED_STATES = 200_000
"""The largest task on which people are simulated: each person's POMDP takes about 3 KB a state."""


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
    execute : bool
        Whether the robot can also execute an action itself, at the cost `c_execute`.
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
        for name in ("c_move", "travel_time"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} {getattr(self, name):g}: expected 0 or more")
        if self.max_steps < 1:
            raise ValueError(f"max_steps {self.max_steps}: expected 1 or more")

    def travel(self, places: int, distance: ArrayLike | None = None) -> Travel:
        """Give the way between so many people; `distance` as in `Travel.of`."""
        return Travel.of(places, c_move=self.c_move, travel_time=self.travel_time, distance=distance)

    def problem(self, choices: Choices, human: Human | None, population: Population | Mixture) -> AssistPOMDP:
        """Set up the problem of assisting one person of a population; None: of whom the robot knows only the task."""
        known = {"eta": self.eta, "lapse": self.lapse, "utility_scale": self.utility_scale}
        model = HumanModel.exact(choices, **known) if human is None else HumanModel.own(choices, human, **known)
        return AssistPOMDP.of(
            model, grid=Grid.regular(population), population=population, gamma=self.gamma, c_suggest=self.c_suggest,
            suggestions=self.suggestions, execute=self.execute, c_execute=self.c_execute,
        )  # fmt: skip


@dataclass(frozen=True)
class Pool:
    """The people from whom teams are drawn, and what the robot has worked out about them.

    Attributes
    ----------
    setting : Setting
    people : tuple of Human
    policies : tuple of Policy
        For a person by themselves. People whom the robot cannot tell apart beforehand share one. Each
        works on the task of their policy.
    model : int array, shape (people,)
        Which policy is each person's.
    """

    setting: Setting
    people: tuple[Human, ...]
    policies: tuple[Policy, ...]
    model: NDArray[np.int64]

    def __post_init__(self) -> None:
        if not self.people or self.model.shape != (len(self.people),):
            raise ValueError(f"{len(self.people)} people, model {self.model.shape}: expected one entry for each person")
        if self.model.min() < 0 or self.model.max() >= len(self.policies):
            raise ValueError(f"model: expected numbers from 0 to {len(self.policies) - 1}")
        shapes = {policy.pomdp.grid.shape for policy in self.policies}
        if len(shapes) > 1:
            raise ValueError(f"grids of shapes {sorted(shapes)}: expected the same for everybody")
        for policy in self.policies:
            if policy.pomdp.gamma != self.setting.gamma:
                raise ValueError(f"gamma {policy.pomdp.gamma:g}: expected that of the setting, {self.setting.gamma:g}")
        for number, human in enumerate(self.people):
            if len(human.h) != len(self.choices(number)):
                raise ValueError(
                    f"person {number}: perceived costs-to-go of {len(human.h)} states, and the task has "
                    f"{len(self.choices(number))}"
                )
        self.model.flags.writeable = False

    @classmethod
    def sample(
        cls,
        choices: Choices,
        size: int,
        seed: int,
        *,
        setting: Setting | None = None,
        population: Population | Mixture | None = None,
        prior: Population | Mixture | None = None,
        solver: Callable[[AssistPOMDP], Policy] = qmdp,
        progress: Callable[[int, int], None] | None = None,
    ) -> Pool:
        """Draw people from a population and solve the POMDP of each.

        Parameters
        ----------
        population : Population or Mixture, optional
            From whom they are drawn; the paper's unless given.
        prior : Population or Mixture, optional
            From whom the robot takes them to be drawn; `population` unless given.
        solver : callable
            Gives the policy for one person's problem.
        progress : callable, optional
            Called with how many POMDPs have been solved, and of how many.
        """
        setting = setting or Setting()
        population = population or Population()
        prior = prior or population
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
        people = population.sample(choices, size, rng)
        known: Sequence[Human | None] = people if setting.knowledge == "own" else [None]
        policies = []
        for done, human in enumerate(known, start=1):
            policies.append(solver(setting.problem(choices, human, prior)))
            if progress is not None:
                progress(done, len(known))
        number = np.arange(size) if len(known) > 1 else np.zeros(size, dtype=np.int64)
        return cls(setting, tuple(people), tuple(policies), number)

    @classmethod
    def joined(cls, pools: Sequence[Pool]) -> Pool:
        """Put pools of different tasks, costs or models together; the setting is that of the first."""
        if not pools:
            raise ValueError("joined: expected one pool or more")
        offsets = np.cumsum([0, *(len(pool.policies) for pool in pools[:-1])])
        return cls(
            pools[0].setting,
            tuple(human for pool in pools for human in pool.people),
            tuple(policy for pool in pools for policy in pool.policies),
            np.concatenate([pool.model + offset for pool, offset in zip(pools, offsets, strict=True)]),
        )

    def choices(self, person: int) -> Choices:
        """Give the task of a person."""
        return self.policies[self.model[person]].pomdp.model.choices

    def policy(self, name: str, travel: Travel | None = None) -> TeamPolicy:
        """Make a team policy by its name.

        Parameters
        ----------
        name : str
            The paper's "none", "reactive" and "attention", "attention-never" for the other reading of its
            Algorithm 1, and our own "priority".
        travel : Travel, optional
            The way between people, if it is not that of the setting.
        """
        if name == "none":
            return NoAssistance()
        if name == "reactive":
            return Reactive()
        if name == "attention":
            return AttentionSwitching()
        if name == "attention-never":
            return AttentionSwitching.against_never(self.policies)
        if name == "priority":  # as all places are equally far, two stand for any number
            return Priority.of(self.policies, travel or self.setting.travel(2))
        raise ValueError(f"unknown policy '{name}'; expected one of {', '.join(POLICIES)}")
