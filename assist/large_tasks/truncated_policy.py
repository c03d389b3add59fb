"""One person's policy on a task of any size.

A policy cannot keep values for the states of a task with millions of states, or of a task whose states are solved on
demand. A `TruncatedPolicy` is solved on the states that are most likely to be visited (a `TruncatedTask`). In any state
of the task it does one exact Bellman backup, with the person's misconceptions there. The values of the successors are
those of the truncated task, or estimates by the exact cost-to-go outside it (`large_tasks.leaf_estimates`). So it
suggests optimal actions where the person would err, in the whole task, and it keeps no data of other states.

The next step of people in some states is a problem of its own (`LocalProblem`), whose frontier follows after one step.
Its arrays have a row for each of these states and their successors. Team policies receive the people's states in this
problem.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo
from planner.system.progress import told

from ..people.belief import Grid
from ..people.decision import Floats
from ..people.human import Human, Mixture, Population
from ..person.pomdp import AssistPOMDP
from ..person.qmdp import QMDP, SOLVING, look_ahead
from ..team.attention_subproblem import AttentionSubproblem
from ..team.settings import Setting
from .leaf_estimates import LeafEstimates
from .state_cache import NONE, StateCache
from .truncated_bound import TruncatedProblem, bounded
from .truncated_task import TruncatedTask

REGION = {"sweep": 20_000, "orbits": 3_000, "on-demand": 200}
"""Number of states of a policy's truncated task, by the kind of cost-to-go.

A table answers at once; a query by symmetry takes longer, and a search may take seconds.
"""


def lookup_kind(known: CostToGo) -> str:
    """Return how cost-to-go is computed: "sweep" (a table), "orbits" (by symmetry) or "on-demand" (a search)."""
    return "orbits" if known.method == "on-demand" and not known.searches else known.method


class SharedTask:
    """The task of a pool of people, and the cache of its visited states.

    Parameters
    ----------
    known : CostToGo
    prior : Population or Mixture
        The robot's prior of people.
    size : int, optional
        Number of states of each person's truncated task; by default as in `REGION`.
    """

    def __init__(self, known: CostToGo, prior: Population | Mixture, size: int | None = None) -> None:
        self.known, self.prior, self.size = known, prior, size or REGION[lookup_kind(known)]
        self.visited = StateCache(known)


@dataclass(frozen=True, eq=False)
class TruncatedPolicy:
    """One person's policy on a task of any size; states have the numbers of the task's cost-to-go.

    Attributes
    ----------
    ground : SharedTask
    setting : Setting
    human : Human or None
        The person, if the robot knows their misconceptions; None if it knows the task only.
    like : TruncatedPolicy or None
        Policy of another person, whose values are the start of value iteration; this saves time for many people.
    solved : dict
        Cached estimates, by the parameters of the subproblem with a price of attention; the key is () without one.
    bounds : dict
        Cached problems for bounds, by the cost of coming and by whether the outer relaxation is included.
    """

    ground: SharedTask
    setting: Setting
    human: Human | None = None
    like: TruncatedPolicy | None = None
    solved: dict[tuple[float, ...], LeafEstimates] = field(default_factory=dict, repr=False)
    bounds: dict[tuple[float, bool], TruncatedProblem] = field(default_factory=dict, repr=False)
    on_part: ClassVar[bool] = True

    @property
    def known(self) -> CostToGo:
        """The cost-to-go of the whole task."""
        return self.ground.known

    @cached_property
    def pomdp(self) -> AssistPOMDP:
        """The local problem of the initial state, which is its state 0."""
        return self.around(np.array([self.ground.known.initial])).pomdp

    @cached_property
    def region(self) -> TruncatedTask:
        """The truncated task of the states that the person is most likely to visit."""
        ground = self.ground
        return TruncatedTask.of(ground.known, states=ground.size, population=ground.prior, human=self.human)

    def problem(self, region: TruncatedTask) -> AssistPOMDP:
        """Return the problem on a truncated task, with frontier bounds that hold for the whole task."""
        beyond = region.bounds_of_anybody(self.setting.gamma, len(self.grid.theta))
        return self.setting.problem(region.choices, self.human, self.ground.prior, frontier=beyond)

    def bounded(
        self, entry: float, *, with_outer: bool = False, until: float = math.inf, memory_limit_mb: float = math.inf,
        kept_mb: float = math.inf,
    ) -> TruncatedProblem:  # fmt: skip
        """Return the problem for an upper bound, computed once; arguments as in `truncated_bound.bounded`."""
        if (entry, True) in self.bounds:  # the problem with the outer relaxation includes everything
            return self.bounds[entry, True]
        if (entry, with_outer) not in self.bounds:
            ground = self.ground
            self.bounds[entry, with_outer] = bounded(
                ground.known, self.setting, self.human, ground.prior, entry=entry, size=ground.size,
                with_outer=with_outer, until=until, memory_limit_mb=memory_limit_mb, kept_mb=kept_mb,
            )  # fmt: skip
        return self.bounds[entry, with_outer]

    @cached_property
    def grid(self) -> Grid:
        """The grid of beta and theta of the robot's belief."""
        return Grid.regular(self.ground.prior)

    def around(self, states: NDArray[np.int64], *, then: NDArray[np.int64] = NONE, deep: bool = False) -> LocalProblem:
        """Return the problem of the next step of people in some states; arguments as in `StateCache.around`."""
        optimal = self.setting.suggestions == "optimal"
        region = self.ground.visited.around(states, then=then, ahead=deep, advice_is_optimal=optimal)
        return LocalProblem(self, self.problem(region), region, len(states), deep)

    def prepare(self) -> LeafEstimates:
        """Return value estimates for a robot that is always present, computed once."""
        if () not in self.solved:
            with told(None) as tell:
                tell(SOLVING, 0, None)
                region, like = self.region, None if self.like is None else self.like.prepare()
                self.solved[()] = LeafEstimates.of(self.problem(region), region, like=like, progress=tell)
        return self.solved[()]

    def prepare_visits(self, entry: float, entry_steps: int, longest: int, price: float) -> LeafEstimates:
        """Return value estimates for a robot that comes and goes, for each position, computed once.

        Parameters
        ----------
        entry, entry_steps, longest
            As in `AttentionSubproblem.of`.
        price : float
            Price of each step of attention, in cost units.
        """
        key = (entry, entry_steps, longest, price)
        if key not in self.solved:
            region = self.region
            like = self.prepare() if self.like is None else self.like.prepare_visits(*key)
            visits = AttentionSubproblem.of(self.problem(region), entry, entry_steps, longest=longest)
            rows = np.stack([visits.states(0, position) for position in range(visits.layout.positions)])
            self.solved[key] = LeafEstimates.of(visits.at_price(price), region, rows, like=like)
        return self.solved[key]

    def q_values(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the Q-values of all robot actions, shape (N, R); minus infinity in padding."""
        return self.around(x, deep=True).q_values(np.arange(len(x)), belief)

    def value(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the value of each person's problem, shape (N,)."""
        return np.asarray(self.q_values(x, belief).max(axis=1))

    def choose(self, x: NDArray[np.int64], belief: Floats) -> NDArray[np.int64]:
        """Return the best robot action for each person, shape (N,)."""
        return np.asarray(self.q_values(x, belief).argmax(axis=1))


@dataclass(frozen=True, eq=False)
class LocalProblem:
    """The problem of the next step of people in some states, with its policy; it is a `Policy` itself.

    Attributes
    ----------
    source : TruncatedPolicy
        The policy of the whole task.
    pomdp : AssistPOMDP
        Its first `count` states are the states of people. The other rows exist only as successors.
    region : TruncatedTask
        The states and choices of the problem.
    count : int
    deep : bool
        Whether the effect on trust is known for every suggestion in these states.
    solved : dict
        Cached problems with a robot that comes and goes, by the arguments of `visits`.
    """

    source: TruncatedPolicy
    pomdp: AssistPOMDP
    region: TruncatedTask
    count: int
    deep: bool
    solved: dict[tuple[float, ...], tuple[AttentionSubproblem, QMDP]] = field(default_factory=dict, repr=False)
    for_one_step: ClassVar[bool] = True

    @cached_property
    def _policy(self) -> QMDP:
        estimates = self.source.prepare()
        value = estimates.at(self.region.states, self.region.choices.h)[:, 0]
        return self._look_ahead(self.pomdp, value, np.arange(self.count))

    def visits(self, entry: float, entry_steps: int, longest: int, price: float) -> tuple[AttentionSubproblem, QMDP]:
        """Return the problem with a robot that comes and goes, and its policy; arguments as in `TruncatedPolicy`."""
        key = (entry, entry_steps, longest, price)
        if key not in self.solved:
            estimates = self.source.prepare_visits(*key)
            visits = AttentionSubproblem.of(self.pomdp, entry, entry_steps, longest=longest)
            layout = visits.layout
            value = estimates.at(self.region.states, self.region.choices.h)[layout.x, layout.position]
            here = np.flatnonzero(layout.x < self.count)
            self.solved[key] = visits, self._look_ahead(visits.at_price(price), value, here)
        return self.solved[key]

    def _look_ahead(self, pomdp: AssistPOMDP, value: Floats, states: NDArray[np.int64]) -> QMDP:
        value[pomdp.model.choices.goal] = 0.0
        return look_ahead(pomdp, value, states)

    def q_values(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the Q-values of all robot actions, shape (N, R), for people in rows `x`."""
        return self._policy.q_values(x, belief)

    def value(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the value of each person's problem, shape (N,)."""
        return np.asarray(self.q_values(x, belief).max(axis=1))

    def choose(self, x: NDArray[np.int64], belief: Floats) -> NDArray[np.int64]:
        """Return the best robot action for each person, shape (N,)."""
        return self._policy.choose(x, belief)
