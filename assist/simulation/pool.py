"""The people from whom teams are drawn, and what the robot has worked out about each of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo, LimitError
from planner.system.arrays import frozen, outline
from planner.system.progress import Wanted, adding, shows_progress

from ..large_tasks.person_problem import WHOLE, is_whole
from ..large_tasks.truncated_policy import SharedTask, TruncatedPolicy
from ..people.arguments import Seed, entropy, positive, whole
from ..people.choices import Choices, require_goal
from ..people.human import Human, Mixture, Population
from ..people.memory import choices_of
from ..person.pomdp import AssistPOMDP, Later, Policy
from ..person.qmdp import qmdp
from ..team.attention_subproblem import policy_bytes
from ..team.policies import named
from ..team.policy_on_part import is_on_part
from ..team.settings import Setting
from ..team.state import TeamPolicy
from ..team.travel import Travel

LARGEST = 200_000
"""The largest task that is looked at whole because something is asked for that needs it."""

MEMORY_LIMIT_MB = 4000.0
"""What people's policies may take, unless more is allowed."""

OF_THE_TEAM = ("gamma", "c_move", "travel_time", "max_steps")
"""Fields of a setting that all people of a team share."""

PERSON = 2000
"""Bytes that a person takes at least, with their policy."""

ONE_FOR_ALL = "a smaller pool, one policy for all (knowledge 'exact'), or "


@dataclass(frozen=True)
class Pool:
    """The people from whom teams are drawn, and what the robot has worked out about them.

    Attributes
    ----------
    setting : Setting
    people : tuple of Human
    policies : tuple of Policy
        For a person by themselves. People whom the robot cannot tell apart beforehand share one. Each
        works on the task of their policy. Those of `sample` are worked out when they are first needed.
    model : int array, shape (people,)
        Which policy is each person's.
    """

    setting: Setting
    people: tuple[Human, ...]
    policies: tuple[Policy, ...]
    model: NDArray[np.int64]

    __repr__ = outline

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
            expected = human.expects(self.choices(number))
            if len(expected) != len(self.choices(number)):
                raise ValueError(
                    f"person {number}: perceived costs-to-go of {len(expected)} states, and the task has "
                    f"{len(self.choices(number))}"
                )
        object.__setattr__(self, "model", frozen(self.model))

    @classmethod
    @shows_progress
    def sample(
        cls,
        table: CostToGo | Choices,
        size: int,
        *,
        seed: Seed,
        setting: Setting | None = None,
        population: Population | Mixture | None = None,
        prior: Population | Mixture | None = None,
        solver: Callable[[AssistPOMDP], Policy] = qmdp,
        memory_limit_mb: float = MEMORY_LIMIT_MB,
        states: int = WHOLE,
        region: int | None = None,
        progress: Wanted = None,
    ) -> Pool:
        """Draw people from a population, and set the POMDP of each up.

        It is solved when a team policy first needs it, so that whoever is in no team costs no time. Of a task with many
        states, or one that is asked on demand, only those are looked at to which people come (`TruncatedPolicy`).

        Parameters
        ----------
        table : CostToGo or Choices
            The cost-to-go of their task, as a table or on demand; choices are looked at whole, however many.
        size : int
        seed : int or Generator
        setting : Setting, optional
            The paper's unless given.
        population : Population or Mixture, optional
            From whom they are drawn; the paper's unless given. Where terms have weights, each state is divided by what
            people remember (`remembered`).
        prior : Population or Mixture, optional
            From whom the robot takes them to be drawn; `population` unless given. A robot whose prior has no weights
            believes that people choose by cost-to-go alone.
        solver : callable
            Gives the policy for one person's problem.
        memory_limit_mb : float
            What QMDP's policies of all may take, in megabytes; it is known before anything is allocated.
        states : int
            Tables of at most so many states are looked at whole; of at most `LARGEST` where people remember what they
            did, actions are executed or a solver is given.
        region : int, optional
            States that policies are worked out on where the task is not; `assist.large_tasks.truncated_policy.REGION`
            unless given.
        progress : callable or bool, optional
            Who is told how far it is, as in `planner.system.progress`: how many people's POMDPs have been set up.

        Raises
        ------
        ValueError
            What cannot be, such as a task whose goal cannot be reached, or one that would have to be looked at whole
            and is too large.
        LimitError
            People's policies would take more memory than is allowed.
        """
        assert callable(progress)
        size, states = whole("size", size, 1), whole("states", states)
        region = None if region is None else whole("region", region, 1)
        setting = setting or Setting()
        population = population or Population()
        prior = prior or population
        models = size if setting.knowledge == "own" else 1
        rng = np.random.default_rng(np.random.SeedSequence(entropy(seed), spawn_key=(0,)))
        needed = {"weights": population.weights or prior.weights, "execute": setting.execute, "solver": solver != qmdp}
        if not isinstance(table, Choices) and not is_whole(table, LARGEST if any(needed.values()) else states):
            for name, given in needed.items():
                if given:
                    raise ValueError(f"{name}: expected a task that is looked at whole, of at most {LARGEST:,} states")
            require_goal(float(table.lookup([table.initial])[0]))
            _allow_people(size, 0, memory_limit_mb)
            everybody = population.sample(None, size, rng)
            ground = SharedTask(table, prior, region)
            anybody = TruncatedPolicy(ground, setting)
            own = tuple(TruncatedPolicy(ground, setting, human, anybody) for human in everybody)
            if setting.knowledge == "exact":
                own = (anybody,)
            return cls(setting, tuple(everybody), own, np.arange(size) if models > 1 else np.zeros(size, np.int64))
        _allow(policy_bytes(len(table)), len(table), models, memory_limit_mb)  # before choices are made
        choices = choices_of(table, (*population.weights, *prior.weights))
        require_goal(choices.h[choices.initial])
        offered = choices.optimal if setting.suggestions == "optimal" else choices.applicable
        robots = 1 + int(offered.sum(axis=1).max(initial=0)) * (1 + setting.execute)
        one = policy_bytes(len(choices), slots=choices.applicable.shape[1], robots=robots)
        _allow(one, len(choices), models, memory_limit_mb)
        _allow_people(size, choices.h.nbytes, memory_limit_mb)
        people = population.sample(choices, size, rng)
        known: Sequence[Human | None] = people if setting.knowledge == "own" else [None]
        advance = adding(progress, "setting people's POMDPs up", len(known))
        policies = []
        for human in known:
            policies.append(Later(setting.problem(choices, human, prior), solver))
            advance(1)
        number = np.arange(size) if models > 1 else np.zeros(size, dtype=np.int64)
        return cls(setting, tuple(people), tuple(policies), number)

    @classmethod
    def joined(cls, pools: Sequence[Pool]) -> Pool:
        """Join pools of different tasks, models or costs of suggestions; the setting is that of the first.

        What a setting says of one person's problem is part of their policy, and may differ. What it says of the whole
        team (`OF_THE_TEAM`) has to be the same.

        Raises
        ------
        ValueError
            There is no pool, or their settings differ in that.
        """
        if not pools:
            raise ValueError("joined: expected one pool or more")
        for name in OF_THE_TEAM:
            values = [getattr(pool.setting, name) for pool in pools]
            if len(set(values)) > 1:
                raise ValueError(f"joined: {name} is {values} in these pools; expected the same in all")
        offsets = np.cumsum([0, *(len(pool.policies) for pool in pools[:-1])])
        return cls(
            pools[0].setting,
            tuple(human for pool in pools for human in pool.people),
            tuple(policy for pool in pools for policy in pool.policies),
            np.concatenate([pool.model + offset for pool, offset in zip(pools, offsets, strict=True)]),
        )

    def priced(self, c_suggest: float) -> Pool:
        """Return the same people where a suggestion costs something else, on tasks that are looked at whole."""
        policies = tuple(
            Later(policy.pomdp.priced(c_suggest), getattr(policy, "solver", qmdp)) for policy in self.policies
        )
        return replace(self, setting=replace(self.setting, c_suggest=c_suggest), policies=policies)

    @property
    def truncated(self) -> bool:
        """Whether policies are for truncated tasks, in place of enumerated ones."""
        kinds = {is_on_part(policy) for policy in self.policies}
        if len(kinds) > 1:
            raise ValueError("pools of enumerated tasks and of truncated ones: expected one kind")
        return kinds.pop()

    def choices(self, person: int) -> Choices:
        """Give the task of a person."""
        return self.policies[self.model[person]].pomdp.model.choices

    def policy(self, name: str, travel: Travel | None = None) -> TeamPolicy:
        """Make a team policy by its name; people's problems are solved when it first needs it.

        Parameters
        ----------
        name : str
            One of `POLICIES`.
        travel : Travel, optional
            The way between people, if it is not that of the setting.
        """
        # As all places are equally far, two stand for any number.
        return named(name, self.policies, travel or self.setting.travel(2))


def _allow(one: int, states: int, models: int, limit_mb: float) -> None:
    """Refuse policies, each of so many bytes, that would not fit the memory."""
    needed = (models + 1) * one / 1e6  # while values are put in order they are there twice
    if needed > positive("memory_limit_mb", limit_mb):
        who, less = ("one person", "") if models == 1 else (f"{models:,} people", ONE_FOR_ALL)
        raise LimitError(
            f"policies for {who} on a task of {states:,} states take about {needed:,.0f} MB of memory, and "
            f"{limit_mb:,.0f} MB are allowed; expected {less}a higher memory limit"
        )


def _allow_people(size: int, one: int, limit_mb: float) -> None:
    """Refuse people who would not fit the memory, each with so many bytes for what they take for the cost-to-go."""
    needed = size * (PERSON + one) / 1e6
    if needed > positive("memory_limit_mb", limit_mb):
        raise LimitError(
            f"{size:,} people take about {needed:,.0f} MB of memory, and {limit_mb:,.0f} MB are allowed; expected a "
            "smaller pool, or a higher memory limit"
        )
