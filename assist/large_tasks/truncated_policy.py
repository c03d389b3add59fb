"""One person's policy on a task of any size.

A task of millions of states, or one that is only asked on demand, has no room for what a policy keeps of each of them.
A `TruncatedPolicy` is worked out on the states that are met most likely from the initial one on (a `TruncatedTask`),
and looks one step ahead from wherever somebody is: exactly, with the person's misconceptions there, on values that are
those of the region inside it and estimates by the exact cost-to-go outside (`large_tasks.leaf_estimates`). So it
suggests optimal actions where the person would err anywhere in the task, and forgets about states as soon as they are
left.

What the next step needs of the states in which people are is a problem of its own (`LocalProblem`), which breaks off at
once: its arrays have a row for each of these states and for those that come next. Team policies see the people in it.
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
from ..person.qmdp import QMDP, SOLVING, ahead
from ..team.attention_subproblem import AttentionSubproblem
from ..team.settings import Setting
from .leaf_estimates import LeafEstimates
from .state_cache import NONE, StateCache
from .truncated_bound import TruncatedProblem, bounded
from .truncated_task import TruncatedTask

REGION = {"sweep": 20_000, "orbits": 3_000, "on-demand": 200}
"""States that a policy is worked out on, by how a state's cost-to-go is come by."""


def how(known: CostToGo) -> str:
    """Say how a state's cost-to-go is come by: from a table, from that of orbits, or by a search."""
    return "orbits" if known.method == "on-demand" and not known.searches else known.method


class SharedTask:
    """A task that people of one pool share, and what has been met of it.

    Parameters
    ----------
    known : CostToGo
    prior : Population or Mixture
        From whom the robot takes people to be drawn.
    size : int, optional
        States of each person's region; `REGION` unless given.
    """

    def __init__(self, known: CostToGo, prior: Population | Mixture, size: int | None = None) -> None:
        self.known, self.prior, self.size = known, prior, size or REGION[how(known)]
        self.visited = StateCache(known)


@dataclass(frozen=True, eq=False)
class TruncatedPolicy:
    """One person's policy on a task of any size; states are named as the task's cost-to-go names them.

    Attributes
    ----------
    ground : SharedTask
    setting : Setting
    human : Human or None
        The person, as far as the robot knows what they are mistaken about; None: it knows the task only.
    like : TruncatedPolicy or None
        For somebody else, from whose values theirs are worked out; where there are many people that saves time.
    solved : dict
        What has been estimated so far, by what it depends on: the prices of attention, if there are any.
    bounds : dict
        The problems of which bounds have been asked for, by what coming costs and whether what is around is known.
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
        """The problem around the initial state: that is its state 0."""
        return self.around(np.array([self.ground.known.initial])).pomdp

    @cached_property
    def region(self) -> TruncatedTask:
        """The states that the person most likely meets from the initial one on."""
        ground = self.ground
        return TruncatedTask.of(ground.known, states=ground.size, population=ground.prior, human=self.human)

    def problem(self, region: TruncatedTask) -> AssistPOMDP:
        """Set up the problem on a part of the task, with bounds that hold for the whole where it breaks off."""
        beyond = region.bounds_of_anybody(self.setting.gamma, len(self.grid.theta))
        return self.setting.problem(region.choices, self.human, self.ground.prior, frontier=beyond)

    def bounded(
        self, entry: float, *, around: bool = False, until: float = math.inf, memory_limit_mb: float = math.inf,
        kept_mb: float = math.inf,
    ) -> TruncatedProblem:  # fmt: skip
        """Give the problem of which a bound is wanted, worked out once; arguments as in `bounded`."""
        if (entry, True) in self.bounds:  # which has all there is
            return self.bounds[entry, True]
        if (entry, around) not in self.bounds:
            ground = self.ground
            self.bounds[entry, around] = bounded(
                ground.known, self.setting, self.human, ground.prior, entry=entry, size=ground.size, around=around,
                until=until, memory_limit_mb=memory_limit_mb, kept_mb=kept_mb,
            )  # fmt: skip
        return self.bounds[entry, around]

    @cached_property
    def grid(self) -> Grid:
        """The values of beta and theta that the robot distinguishes."""
        return Grid.regular(self.ground.prior)

    def around(self, states: NDArray[np.int64], *, then: NDArray[np.int64] = NONE, deep: bool = False) -> LocalProblem:
        """Give the problem of the next step of people in some states; arguments as in `StateCache.around`."""
        optimal = self.setting.suggestions == "optimal"
        region = self.ground.visited.around(states, then=then, ahead=deep, advice_is_optimal=optimal)
        return LocalProblem(self, self.problem(region), region, len(states), deep)

    def prepare(self) -> LeafEstimates:
        """Give what the person's problem is worth with a robot that is always there; worked out once."""
        if () not in self.solved:
            with told(None) as tell:
                tell(SOLVING, 0, None)
                region, like = self.region, None if self.like is None else self.like.prepare()
                self.solved[()] = LeafEstimates.of(self.problem(region), region, like=like, progress=tell)
        return self.solved[()]

    def prepare_visits(self, entry: float, entry_steps: int, longest: int, price: float) -> LeafEstimates:
        """Give what it is worth with a robot that comes and goes, for each position; worked out once.

        Parameters
        ----------
        entry, entry_steps, longest
            As in `AttentionSubproblem.of`.
        price : float
            What each step of attention costs.
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
        """Give the value of each robot action, shape (N, R); minus infinity in padding."""
        return self.around(x, deep=True).q_values(np.arange(len(x)), belief)

    def value(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give the value of each person's problem, shape (N,)."""
        return np.asarray(self.q_values(x, belief).max(axis=1))

    def choose(self, x: NDArray[np.int64], belief: Floats) -> NDArray[np.int64]:
        """Give the best robot action for each person, shape (N,)."""
        return np.asarray(self.q_values(x, belief).argmax(axis=1))


@dataclass(frozen=True, eq=False)
class LocalProblem:
    """The problem of the next step of people in some states, and the policy there; itself a `Policy`.

    Attributes
    ----------
    source : TruncatedPolicy
        The policy that this problem is a part of.
    pomdp : AssistPOMDP
        Its first `count` states are those in which people are, and what it says of others is for their sake.
    region : TruncatedTask
        The task's states.
    count : int
    deep : bool
        Whether it is known what every suggestion in them would do to trust.
    solved : dict
        The problems with a robot that comes and goes that have been asked for, by the arguments of `visits`.
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
        return self._ahead(self.pomdp, value, np.arange(self.count))

    def visits(self, entry: float, entry_steps: int, longest: int, price: float) -> tuple[AttentionSubproblem, QMDP]:
        """Return the problem with a robot that comes and goes, and its policy; arguments as in `TruncatedPolicy`."""
        key = (entry, entry_steps, longest, price)
        if key not in self.solved:
            estimates = self.source.prepare_visits(*key)
            visits = AttentionSubproblem.of(self.pomdp, entry, entry_steps, longest=longest)
            layout = visits.layout
            value = estimates.at(self.region.states, self.region.choices.h)[layout.x, layout.position]
            here = np.flatnonzero(layout.x < self.count)
            self.solved[key] = visits, self._ahead(visits.at_price(price), value, here)
        return self.solved[key]

    def _ahead(self, pomdp: AssistPOMDP, value: Floats, states: NDArray[np.int64]) -> QMDP:
        value[pomdp.model.choices.goal] = 0.0
        return ahead(pomdp, value, states)

    def q_values(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give the value of each robot action, shape (N, R), for people in rows `x`."""
        return self._policy.q_values(x, belief)

    def value(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give the value of each person's problem, shape (N,)."""
        return np.asarray(self.q_values(x, belief).max(axis=1))

    def choose(self, x: NDArray[np.int64], belief: Floats) -> NDArray[np.int64]:
        """Give the best robot action for each person, shape (N,)."""
        return self._policy.choose(x, belief)
