"""Pools of people from whom teams are drawn, with the robot's policy for each person."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import CostToGo
from planner.system.arrays import frozen
from planner.system.errors import expected
from planner.system.progress import Wanted, shows_progress
from planner.system.results import Result, same

from ..people.arguments import Seed
from ..people.choices import Choices
from ..people.goals import Goals, known_task
from ..people.hidden_type import HiddenType
from ..people.human import Human
from ..people.ranges import Population, require_populations
from ..person.policy import Policy
from ..person.pomdp import AssistPOMDP
from ..person.qmdp import QMDP, qmdp
from ..person.settings import Setting, require_setting
from ..person.travel import Travel
from .drawn import Drawn, Estimated
from .matching import require_matching, union
from .policies import named
from .solving import AnyTable, Solving, solved_on_demand
from .state import TeamPolicy


def require_pool(pool: object) -> None:
    """Check that an argument is a pool.

    Raises
    ------
    TypeError
        It is something else, such as a task.
    """
    if not isinstance(pool, Pool):
        found = type(pool).__name__
        example = "Pool.of(task, people)" if isinstance(pool, Estimated) else "Pool.sample(task, 12, seed=1)"
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
        Returns the same people with another setting; None unless `sample` or `of` made the pool.
    known : CostToGo, Choices or Goals, optional
        People's task as `sample` or `of` had it.

    Raises
    ------
    ValueError
        The parts do not match (`require_matching`).
    """

    setting: Setting
    people: tuple[Human, ...]
    policies: tuple[Policy, ...]
    model: NDArray[np.int64]
    again: Callable[..., Pool] | None = field(default=None, repr=False)
    known: CostToGo | Choices | Goals | None = field(default=None, repr=False)

    def __eq__(self, other: object) -> bool:
        """Whether both have the same people and problems, solved or not."""
        if not isinstance(other, Pool):
            return False
        problems, others = ([each.problem.first for each in one.policies] for one in (self, other))
        known, given = ((one.setting, one.people, one.model) for one in (self, other))
        return same(known, given) and same(problems, others)

    def __repr__(self) -> str:
        shown = ", ".join(self.names[:3]) + ", ..." * (len(self.people) > 3)
        own = "everybody" if self.setting.knowledge == "own" else "nobody"
        knows = f"; the robot knows {own}'s misconceptions" if any(one.sigma for one in self.people) else ""
        region = self.policies[0].problem.region
        parts = "" if region is None else f"; their problems are truncated to {region:,} states"
        return f"<Pool of {len(self.people)} people: {shown}{knows}{parts}>"

    @property
    def names(self) -> tuple[str, ...]:
        """What people are called; those without a name are human-1, human-2, ... in the order of the pool."""
        return tuple(one.name or f"human-{number}" for number, one in enumerate(self.people, 1))

    def numbers(self, team: ArrayLike) -> NDArray[np.int64]:
        """Return the numbers in the pool, from 0, of people given by name or by number, in an array of any shape.

        Raises
        ------
        ValueError
            Somebody is not in the pool.
        """
        given = np.asarray(team)
        if given.dtype.kind in "UO" and all(isinstance(one, str) for one in given.ravel()):
            for one in given.ravel().tolist():
                if one not in self.names:
                    raise ValueError(f"person {one!r}; {expected(one, self.names)}")
            found = [self.names.index(one) for one in given.ravel().tolist()]
            return np.array(found, dtype=np.int64).reshape(given.shape)
        if given.dtype.kind not in "iu" or not given.size or given.min() < 0 or given.max() >= len(self.people):
            most = len(self.people) - 1
            raise ValueError(f"team {given.tolist()}: expected names of people, or their numbers from 0 to {most}")
        return given.astype(np.int64)

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each person: name, `beta` (per cost unit), `theta`, `sigma` (cost units) and weights."""
        return [
            {"person": name, "beta": one.beta, "theta": one.theta, "sigma": one.sigma, **one.weights}
            for name, one in zip(self.names, self.people, strict=True)
        ]

    def __post_init__(self) -> None:
        require_matching(self)
        object.__setattr__(self, "model", frozen(self.model))

    @classmethod
    @shows_progress
    def sample(
        cls,
        table: AnyTable,
        size: int,
        *,
        seed: Seed,
        setting: Setting | None = None,
        population: Population | None = None,
        prior: Population | None = None,
        progress: Wanted = None,
        **solving: Unpack[Solving],
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
        progress : callable or bool, optional
            Receives progress reports, as `planner.system.progress` describes: the number of POMDPs that have been
            built.
        **solving
            How POMDPs are built and solved, and what that may take: see `Solving`.

        Raises
        ------
        ValueError
            A parameter is out of its range, the goal is unreachable, or a task must be enumerated and is too large.
        LimitError
            The policies would exceed the memory limit, or the time is up.
        """
        require_populations(population, prior)
        population = population or Population()
        them = Drawn.of_population(population, size, seed)
        return cls._at(table, them, setting, prior=prior or population, progress=progress, **solving)

    @classmethod
    @shows_progress
    def of(
        cls,
        table: AnyTable,
        people: Iterable[Human] | Mapping[str, Human] | Estimated,
        *,
        setting: Setting | None = None,
        prior: Population | None = None,
        progress: Wanted = None,
        **solving: Unpack[Solving],
    ) -> Pool:
        """Return certain people at a task, such as those of a log, and build the POMDP of each.

        Parameters
        ----------
        table, setting, progress, **solving
            As in `sample`.
        people : iterable of Human, mapping of names to Human, or FittedPeople
            People as they are in truth, such as `{"ann": Human(beta=1.2, theta=0.7)}`; or what `fit` returned, whose
            estimates are then taken for the truth: those of each person (`FittedPeople.humans`), and the rate of trust
            unless the setting has a trust rule, also "paper", or another `eta` than the default.
        prior : Population, optional
            The robot's prior; by default the paper's, or the population of fitted people.

        Raises
        ------
        TypeError
            `people` is something else.
        ValueError, LimitError
            As in `sample`; or two people have one name.
        """
        require_setting(setting)
        require_populations(prior)
        if isinstance(people, Estimated):
            people, population, setting = people.simulated(setting or Setting())
            prior = prior or population
        them = Drawn.given(people)
        return cls._at(table, them, setting, prior=prior or Population(), progress=progress, **solving)

    @classmethod
    @shows_progress
    def _at(
        cls, table: AnyTable, them: Drawn, setting: Setting | None, *, prior: Population, progress: Wanted = None,
        **solving: Unpack[Solving],
    ) -> Pool:  # fmt: skip
        """Return people at a task."""
        assert callable(progress)
        table = table if isinstance(table, Choices) else known_task(table)
        require_setting(setting)
        setting = setting or Setting()
        people, policies = solved_on_demand(table, them, setting, prior, progress, **solving)
        number = np.arange(them.size) if len(policies) > 1 else np.zeros(them.size, dtype=np.int64)
        solving.pop("time_limit", None)
        again = partial(cls._at, table, them, prior=prior, **solving)
        pool = cls(setting, tuple(people), tuple(policies), number, again, table)
        if setting.observation is not None:
            setting.observation.require_actions_of(pool.choices(0))
        return pool

    def under(self, setting: Setting) -> Pool:
        """Return the same people at the same task, with another setting of the robot.

        Parameters
        ----------
        setting : Setting

        Raises
        ------
        ValueError
            The pool is not one of `sample` or `of`.
        """
        if setting == self.setting:
            return self
        if self.again is None:
            raise ValueError("another setting: expected a pool of Pool.sample or Pool.of, which know the task")
        return self.again(setting)

    @classmethod
    def joined(cls, pools: Sequence[Pool]) -> Pool:
        """Return the union of pools with different tasks, models or costs of suggestions, as `union` does."""
        if isinstance(pools, Pool):
            raise TypeError("joined: expected a list of pools, such as [pool, other]")
        return union(pools)

    @property
    def hidden(self) -> HiddenType:
        """The types of the first person; others have as many goals."""
        return self.policies[0].pomdp.hidden

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
            One of `POLICIES`, or FILE.py:NAME, a function of the user.
        travel : Travel, optional
            Travel between the places; by default that of the setting.
        solver : callable
            As in `team.policies.named`.
        """
        if name == "rollout":
            self.setting.require_all_seen("policy 'rollout'")
        # All distances are equal, so that travel between two places has the same costs as between more.
        return named(name, self.policies, travel or self.setting.travel(2), solver)
