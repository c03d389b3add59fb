"""Pools of people from whom teams are drawn, with the robot's policy for each person."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import CostToGo, known_costs
from planner.system.arrays import frozen
from planner.system.errors import expected
from planner.system.limits import Deadline
from planner.system.progress import Progress, Wanted, adding, shows_progress
from planner.system.results import Result, same

from ..people.arguments import Seed, entropy, require_goal, whole
from ..people.choices import Choices
from ..people.goals import Goals, costs_to_go, each_of, first_of
from ..people.human import Human
from ..people.memory_on_demand import Remembering
from ..people.misconception import Misconception
from ..people.ranges import Population
from ..person.assumptions import Assumptions
from ..person.lazy_policy import LazyPolicy
from ..person.memory_needed import MEMORY_LIMIT_MB, states_within
from ..person.person_problem import WHOLE, is_whole
from ..person.policy import Policy
from ..person.pomdp import AssistPOMDP
from ..person.qmdp import QMDP, qmdp
from ..person.settings import Setting
from ..person.travel import Travel
from ..person.truncated_policy import SharedTask, TruncatedPolicy, default_size
from .affordable import affordable_choices, require_room_for_people
from .policies import named
from .state import TeamPolicy
from .union import union

if TYPE_CHECKING:
    from planner import AnyTask

MAX_ENUMERATED = 200_000
"""Largest number of states of a task that is enumerated because a requested option requires it."""


@runtime_checkable
class Estimated(Protocol):
    """People whose parameters were estimated, such as `assist.learning.FittedPeople`."""

    def simulated(self, setting: Setting) -> tuple[list[Human], Population, Setting]:
        """Return people whose true parameters are the estimates, the population like them, and their setting."""
        ...


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


def _all_human(people: Iterable[Any]) -> Iterator[Human]:
    """Yield people, each of whom is checked."""
    for human in people:
        if not isinstance(human, Human):
            raise TypeError(f"people: expected Human(beta, theta) for each, not what is a {type(human).__name__}")
        yield human


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
        The parts do not match: numbers of people, grids, discount factors, or numbers of states.
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
        cut = [policy.ground.size for policy in self.policies[:1] if isinstance(policy, TruncatedPolicy)]
        parts = f"; their problems are truncated to {cut[0]:,} states" if cut else ""
        return f"<Pool of {len(self.people)} people: {shown}{knows}{parts}>"

    @property
    def names(self) -> tuple[str, ...]:
        """What people are called; those without a name are human-1, human-2, ... by their place in the pool."""
        return tuple(one.name or f"human-{number}" for number, one in enumerate(self.people, 1))

    def numbers(self, team: ArrayLike) -> NDArray[np.int64]:
        """Return the places in the pool, from 0, of people given by name or by place, in an array of any shape.

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
        if not self.people or self.model.shape != (len(self.people),):
            raise ValueError(f"{len(self.people)} people, model {self.model.shape}: expected one entry for each person")
        twice = [name for name, count in Counter(self.names).items() if count > 1]
        if twice:
            raise ValueError(f"two people are called {twice[0]}; expected a name for each")
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
            perceived = human.expects(self.choices(number))
            if len(perceived) != len(self.choices(number)):
                raise ValueError(
                    f"person {number}: perceived costs-to-go of {len(perceived)} states, and the task has "
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
        time_limit: float | None = None,
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
            Returns the policy for one person's problem. On a truncated task, that problem has proven bounds at its
            frontier (`LeafBounds`). The policy acts in its states; elsewhere the robot looks one step ahead.
        memory_limit_mb : float
            Memory of all QMDP policies in MB; it is estimated before anything is allocated.
        states : int
            Largest number of states of a table that is enumerated. It is `MAX_ENUMERATED` if people have a memory, if
            actions are executed, if another solver is given, or if people are asked for their goals. Tables of several
            goals are enumerated if their policies do not exceed the memory limit.
        region : int, optional
            Number of states of a policy's truncated task, for each goal; by default
            `assist.person.truncated_policy.default_size`, or fewer for many goals, by the memory limit.
        time_limit : float, optional
            Seconds after which no further POMDP is built, and a `LimitError` says for how many people it was.
        progress : callable or bool, optional
            Receives progress reports, as `planner.system.progress` describes: the number of POMDPs that have been
            built.

        Raises
        ------
        ValueError
            A parameter is out of its range, the goal is unreachable, or a task must be enumerated and is too large.
        LimitError
            The policies would exceed the memory limit, or the time is up.
        """
        population = population or Population()
        size = whole("size", size, 1)
        return cls._at(
            table, partial(_drawn, population, size, entropy(seed)), size, tuple(population.weights), setting,
            prior=prior or population, solver=solver, memory_limit_mb=memory_limit_mb, states=states, region=region,
            time_limit=time_limit, progress=progress,
        )  # fmt: skip

    @classmethod
    @shows_progress
    def of(
        cls,
        table: CostToGo | Choices | Goals | AnyTask,
        people: Iterable[Human] | Mapping[str, Human] | Estimated,
        *,
        setting: Setting | None = None,
        prior: Population | None = None,
        solver: Callable[[AssistPOMDP], Policy] = qmdp,
        memory_limit_mb: float = MEMORY_LIMIT_MB,
        states: int = WHOLE,
        region: int | None = None,
        time_limit: float | None = None,
        progress: Wanted = None,
    ) -> Pool:
        """Return certain people at a task, such as those of a log, and build the POMDP of each.

        Parameters
        ----------
        table
            As in `sample`.
        people : iterable of Human, mapping of names to Human, or FittedPeople
            People as they are in truth, such as `{"ann": Human(beta=1.2, theta=0.7)}`; or what `fit` returned, whose
            estimates are then taken for the truth: those of each person (`FittedPeople.humans`), and the rate of trust
            unless the setting has a trust rule or another `eta` than the default.
        prior : Population, optional
            The robot's prior; by default the paper's, or the population of fitted people.
        setting, solver, memory_limit_mb, states, region, time_limit, progress
            As in `sample`.

        Raises
        ------
        TypeError
            `people` is something else.
        ValueError, LimitError
            As in `sample`; or two people have one name.
        """
        if isinstance(people, Estimated):
            people, population, setting = people.simulated(setting or Setting())
            prior = prior or population
        if isinstance(people, Mapping):
            every = zip(people, _all_human(people.values()), strict=True)
            people = [replace(human, name=name) for name, human in every]
        them = list(_all_human(people))
        terms = tuple(dict.fromkeys(name for human in them for name in human.weights))
        return cls._at(
            table, partial(_given, them), whole("number of people", len(them), 1), terms, setting,
            prior=prior or Population(), solver=solver, memory_limit_mb=memory_limit_mb, states=states, region=region,
            time_limit=time_limit, progress=progress,
        )  # fmt: skip

    @classmethod
    @shows_progress
    def _at(
        cls, table: CostToGo | Choices | Goals | AnyTask, drawn: Callable[[Choices | None], Sequence[Human]], size: int,
        weights: tuple[str, ...], setting: Setting | None, *, prior: Population, time_limit: float | None = None,
        progress: Wanted = None, **how: Any,
    ) -> Pool:  # fmt: skip
        """Return people at a task; `drawn` returns them for its choices, or for any part of it."""
        assert callable(progress)
        ends = Deadline.after(time_limit)
        table = table if isinstance(table, Choices | Goals) else known_costs(table)
        setting = setting or Setting()
        if not isinstance(setting, Setting):
            raise TypeError(f"a {type(setting).__name__} where a Setting was expected, such as Setting(c_suggest=0.5)")
        again = partial(cls._at, table, drawn, size, weights, prior=prior, **how)
        terms = (*weights, *prior.weights)
        solver, limit, region = how["solver"], how["memory_limit_mb"], how["region"]
        states, region = whole("states", how["states"]), None if region is None else whole("region", region, 1)
        if isinstance(table, Goals) and terms:
            raise ValueError("people with weights of terms: expected one goal")
        own = solver if solver != qmdp else None
        people: Sequence[Human]
        choices: Choices | None = None
        asks = isinstance(table, Goals) and setting.c_ask is not None  # worth of answers: exact where it is affordable
        most = MAX_ENUMERATED if asks or own or terms or setting.fleet.executes else states
        if isinstance(table, Choices) or is_whole(table, most):
            choices = affordable_choices(table, setting, terms, size, limit, required=bool(terms))
        if choices is not None:
            people = drawn(choices)
            policies = _enumerated(choices, people, setting, prior, solver, ends, progress)
        else:
            assert not isinstance(table, Choices)
            require_goal(float(costs_to_go(table, np.array([first_of(table).initial])).min()))
            require_room_for_people(size, 0, limit)
            people = drawn(None)
            models = size if setting.knowledge == "own" else 1
            room = states_within(limit, len(each_of(table)), models)
            known = Remembering(first_of(table), dict.fromkeys(terms)) if terms else table
            ground = SharedTask(known, region or min(default_size(table), room), models)
            policies = [of_task := TruncatedPolicy(ground, Assumptions.of(setting, None, prior), solver=own)]
            if setting.knowledge == "own":
                policies = [
                    TruncatedPolicy(ground, Assumptions.of(setting, one, prior), of_task, own) for one in people
                ]
        number = np.arange(size) if len(policies) > 1 else np.zeros(size, dtype=np.int64)
        return cls(setting, tuple(people), tuple(policies), number, again, table)

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


def _drawn(population: Population, size: int, seed: int, choices: Choices | None) -> list[Human]:
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    return population.sample(choices, size, rng)


def _given(people: list[Human], choices: Choices | None) -> list[Human]:
    del choices
    return people


def _enumerated(
    choices: Choices, people: Sequence[Human], setting: Setting, prior: Population,
    solver: Callable[[AssistPOMDP], Policy], ends: Deadline, progress: Progress,
) -> list[Policy]:  # fmt: skip
    """Return a policy for each model of people on an enumerated task, solved on first use."""
    known: Sequence[Human | None] = people if setting.knowledge == "own" else [None]
    advance = adding(progress, "setting up people's POMDPs", len(known))
    policies: list[Policy] = []
    for human in known:
        ends.check(f"setting up {len(policies)} of {len(known)} people's POMDPs; expected fewer people, or more time")
        problem = replace(Assumptions.of(setting, human, prior).problem(choices), alike=len(known))
        policies.append(LazyPolicy(problem, solver))
        advance(1)
    return policies
