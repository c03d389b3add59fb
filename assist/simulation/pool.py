"""Pools of people from whom teams are drawn, with the robot's policy for each person."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo, known_costs
from planner.system.arrays import frozen
from planner.system.progress import Progress, Wanted, adding, shows_progress
from planner.system.results import Result, same

from ..people.arguments import Seed, entropy, require_goal, whole
from ..people.choices import Choices
from ..people.goals import Goals, costs_to_go, each_of, first_of
from ..people.human import Human, Population
from ..people.misconception import Misconception
from ..person.lazy_policy import LazyPolicy
from ..person.memory_needed import MEMORY_LIMIT_MB, states_within
from ..person.person_problem import WHOLE, is_whole
from ..person.policy import Policy
from ..person.pomdp import AssistPOMDP
from ..person.qmdp import QMDP, qmdp
from ..person.settings import Setting
from ..person.travel import Travel
from ..person.truncated_policy import SharedTask, TruncatedPolicy, default_size
from ..team.policies import named
from ..team.state import TeamPolicy
from .affordable import affordable_choices, require_room_for_people
from .union import union

if TYPE_CHECKING:
    from planner import AnyTask

MAX_ENUMERATED = 200_000
"""Largest number of states of a task that is enumerated because a requested option requires it."""


def require_pool(pool: object) -> None:
    """Check that an argument is a pool.

    Raises
    ------
    TypeError
        It is something else, such as a task.
    """
    if not isinstance(pool, Pool):
        found, example = type(pool).__name__, "Pool.sample(task, 12, seed=1)"
        raise TypeError(f"pool: expected people at a task, a Pool, not what is a {found}; {example} is one")


@dataclass(frozen=True, eq=False, repr=False)
class Pool(Result):
    """The people from whom teams are drawn, with the robot's policy for each of them.

    Attributes
    ----------
    setting : Setting
    people : tuple of Human
    policies : tuple of Policy
        Policies for single people. People whom the robot cannot distinguish beforehand share one. Each person works on
        the task of their policy. The policies of `sample` are solved on first use.
    model : int array, shape (people,)
        Index of each person's policy.
    again : callable, optional
        Draws the same people with another setting; None unless `sample` made the pool.

    Raises
    ------
    ValueError
        The parts do not match: numbers of people, grids, discount factors, or numbers of states.
    """

    setting: Setting
    people: tuple[Human, ...]
    policies: tuple[Policy, ...]
    model: NDArray[np.int64]
    again: Callable[..., Pool] | None = field(default=None, repr=False)

    def __eq__(self, other: object) -> bool:
        """Whether both have the same people and problems, solved or not."""
        if not isinstance(other, Pool):
            return False
        problems, others = ([each.at_first for each in one.policies] for one in (self, other))
        known, given = ((one.setting, one.people, one.model) for one in (self, other))
        return same(known, given) and same(problems, others)

    def __repr__(self) -> str:
        return f"<Pool of {len(self.people)} people, {len(self.policies)} policies: {self.setting.knowledge} knowledge>"

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each person: `beta` (per cost unit), `theta`, `sigma` (cost units) and weights of terms."""
        return [
            {"person": number + 1, "beta": one.beta, "theta": one.theta, "sigma": one.sigma, **one.weights}
            for number, one in enumerate(self.people)
        ]

    def __post_init__(self) -> None:
        if not self.people or self.model.shape != (len(self.people),):
            raise ValueError(f"{len(self.people)} people, model {self.model.shape}: expected one entry for each person")
        if self.model.min() < 0 or self.model.max() >= len(self.policies):
            raise ValueError(f"model: expected numbers from 0 to {len(self.policies) - 1}")
        shapes = {policy.pomdp.grid.shape for policy in self.policies}
        if len(shapes) > 1:
            raise ValueError(f"grids of shapes {sorted(shapes)}: expected the same for everybody")
        goals = {len(policy.pomdp.hidden.goals) for policy in self.policies}
        if len(goals) > 1:
            raise ValueError(
                f"people with {' and '.join(map(str, sorted(goals)))} goals: expected as many for everybody"
            )
        for policy in self.policies:
            if policy.pomdp.gamma != self.setting.gamma:
                raise ValueError(f"gamma {policy.pomdp.gamma:g}: expected that of the setting, {self.setting.gamma:g}")
        for number, human in enumerate(self.people):
            if isinstance(human.h, Misconception):
                continue
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
        table: CostToGo | Choices | Goals | AnyTask,
        size: int,
        *,
        seed: Seed,
        setting: Setting | None = None,
        population: Population | None = None,
        prior: Population | None = None,
        solver: Callable[[AssistPOMDP], Policy] = qmdp,
        memory_limit_mb: float = MEMORY_LIMIT_MB,
        states: int = WHOLE,
        region: int | None = None,
        progress: Wanted = None,
    ) -> Pool:
        """Draw people from a population, and build the POMDP of each.

        A POMDP is solved when a team policy first needs it, so that people who are in no team cost no time. Tasks that
        are too large are not enumerated: policies are then solved on truncated tasks (`TruncatedPolicy`).

        Parameters
        ----------
        table : CostToGo, Choices, Goals, or whatever `planner.load` takes
            Cost-to-go of the people's task, as a table or on demand. `Choices` are enumerated, whatever their number.
            Of `Goals`, each person pursues one in each episode.
        size : int
            Number of people.
        seed : int or Generator
        setting : Setting, optional
            By default the paper's.
        population : Population, optional
            Population from which the people are drawn; by default the paper's. If it has weights of terms, each task
            state is split by the memory of people (`remembered`).
        prior : Population, optional
            The robot's prior; by default `population`. A robot whose prior has no weights assumes that people choose by
            cost-to-go alone.
        solver : callable
            Returns the policy for one person's problem.
        memory_limit_mb : float
            Memory of all QMDP policies in MB; it is estimated before anything is allocated.
        states : int
            Largest number of states of a table that is enumerated. It is `MAX_ENUMERATED` if people have a memory, if
            actions are executed, if a solver is given, or if people are asked about their goals. Tables of several
            goals are enumerated if their policies do not exceed the memory limit.
        region : int, optional
            Number of states of a policy's truncated task, for each goal; by default
            `assist.person.truncated_policy.default_size`, or fewer for many goals, by the memory limit.
        progress : callable or bool, optional
            Receives progress reports, as `planner.system.progress` describes: the number of POMDPs that have been
            built.

        Raises
        ------
        ValueError
            A parameter is out of its range, the goal is unreachable, or a task must be enumerated and is too large.
        LimitError
            The policies would exceed the memory limit.
        """
        assert callable(progress)
        table = table if isinstance(table, Choices | Goals) else known_costs(table)
        size, states = whole("size", size, 1), whole("states", states)
        region = None if region is None else whole("region", region, 1)
        setting = setting or Setting()
        population = population or Population()
        prior = prior or population
        number_of_seed = entropy(seed)
        again = partial(
            cls.sample, table, size, seed=number_of_seed, population=population, prior=prior, solver=solver,
            memory_limit_mb=memory_limit_mb, states=states, region=region,
        )  # fmt: skip
        rng = np.random.default_rng(np.random.SeedSequence(number_of_seed, spawn_key=(0,)))
        if isinstance(table, Goals) and (population.weights or prior.weights):
            raise ValueError("people with weights of terms: expected one goal")
        needed = {
            "weights": population.weights or prior.weights,
            "execute": setting.fleet.executes,
            "solver": solver != qmdp,
            "observation": isinstance(table, Goals) and setting.observation is not None,
        }
        people: Sequence[Human]
        choices: Choices | None = None
        asks = isinstance(table, Goals) and setting.c_ask is not None  # worth of answers: exact where it is affordable
        if isinstance(table, Choices) or is_whole(table, MAX_ENUMERATED if asks or any(needed.values()) else states):
            choices = affordable_choices(
                table, setting, population, prior, size, memory_limit_mb, required=any(needed.values())
            )
        if choices is not None:
            people = population.sample(choices, size, rng)
            policies = _enumerated(choices, people, setting, prior, solver, progress)
        else:
            assert not isinstance(table, Choices)
            for name, given in needed.items():
                if given:
                    raise ValueError(f"{name}: expected an enumerated task, of at most {MAX_ENUMERATED:,} states")
            require_goal(float(costs_to_go(table, np.array([first_of(table).initial])).min()))
            require_room_for_people(size, 0, memory_limit_mb)
            people = population.sample(None, size, rng)
            models = size if setting.knowledge == "own" else 1
            room = states_within(memory_limit_mb, len(each_of(table)), models)
            ground = SharedTask(table, region or min(default_size(table), room), models)
            policies = [of_task := TruncatedPolicy(ground, setting.assumptions(None, prior))]
            if setting.knowledge == "own":
                policies = [TruncatedPolicy(ground, setting.assumptions(one, prior), of_task) for one in people]
        number = np.arange(size) if len(policies) > 1 else np.zeros(size, dtype=np.int64)
        return cls(setting, tuple(people), tuple(policies), number, again)

    def under(self, setting: Setting) -> Pool:
        """Return the same people at the same task, with another setting of the robot.

        Parameters
        ----------
        setting : Setting

        Raises
        ------
        ValueError
            The pool is not one of `sample`.
        """
        if self.again is None:
            raise ValueError("another setting: expected a pool of Pool.sample, which knows how its people were drawn")
        return self.again(setting=setting)

    @classmethod
    def joined(cls, pools: Sequence[Pool]) -> Pool:
        """Return the union of pools with different tasks, models or costs of suggestions, as `union` does."""
        return union(pools)

    @property
    def goals(self) -> int:
        """The number of goals, one of which each person pursues."""
        return len(self.policies[0].pomdp.hidden.goals)

    def choices(self, person: int) -> Choices:
        """Return the choices of a person's task."""
        return self.policies[self.model[person]].pomdp.model.choices

    def policy(
        self, name: str, travel: Travel | None = None, solver: Callable[[AssistPOMDP], QMDP] = qmdp
    ) -> TeamPolicy:
        """Return a team policy by its name; people's problems are solved on its first use.

        Parameters
        ----------
        name : str
            One of `POLICIES`.
        travel : Travel, optional
            Travel between the places; by default that of the setting.
        solver : callable
            As in `team.policies.named`.
        """
        if name == "rollout":
            self.setting.require_all_seen("policy 'rollout'")
        # All distances are equal, so that travel between two places has the same costs as between more.
        return named(name, self.policies, travel or self.setting.travel(2), solver)


def _enumerated(
    choices: Choices, people: Sequence[Human], setting: Setting, prior: Population,
    solver: Callable[[AssistPOMDP], Policy], progress: Progress,
) -> list[Policy]:  # fmt: skip
    """Return a policy for each model of people on an enumerated task, solved on first use."""
    known: Sequence[Human | None] = people if setting.knowledge == "own" else [None]
    advance = adding(progress, "setting up people's POMDPs", len(known))
    policies: list[Policy] = []
    for human in known:
        policies.append(LazyPolicy(setting.problem(choices, human, prior), solver))
        advance(1)
    return policies
