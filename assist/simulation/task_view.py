"""The people's tasks as a step of a simulation sees them.

For an enumerated task, all data are computed once, and array rows correspond to states. Otherwise a step builds a local
problem of the people's states (`Policy.local`). A limited number of these are cached, so that the memory consists
mostly of visited states.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..people.choice_model import chances, value
from ..people.choices import Choices
from ..people.decision import Floats, perceived_cost
from ..people.human import Human
from ..people.trust_rules import PerceivedSuggestions, TrustRule
from ..person.policy import Policy
from ..person.pomdp import AssistPOMDP
from ..person.problem_arrays import ProblemArrays, read_only
from ..team.state import by_model
from .dynamics import Minds, PeopleArrays, act
from .pool import Pool

World = Literal["people", "model"]
GoalKnowledge = Literal["inferred", "likeliest", "known"]

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class ModelGroup:
    """The people of one model, as compiled code reads them.

    Attributes
    ----------
    arrays : ProblemArrays
        Their problem.
    minds : Minds
        Choices of each of them; in the robot's model, of each beta of the grid.
    people : int array
        Their numbers in the pool, in the order of `minds`.
    row : int array, shape (people,)
        Row of each person of the pool in `minds`; 0 for people of other models.
    states : int array, shape (n,), or None
        Task state of each row of the problem; None if rows and states are the same.
    trust : TrustRule or None
        Rule by which people's own theta changes; None for equation 7, and in the robot's model.
    perceived : float array, shape (m, n, A)
        Perceived costs of each of the people; empty if `trust` is None.
    """

    arrays: ProblemArrays
    minds: Minds
    people: Ints
    row: Ints
    states: Ints | None = None
    trust: TrustRule | None = None
    perceived: Floats = field(default_factory=lambda: np.empty((0, 0, 0)))

    @property
    def ends(self) -> NDArray[np.bool_]:
        """Whether episodes end in each state, shape (n,).

        They also end at the frontier of a problem whose choices were given as those of the whole task.
        """
        return self.arrays.final if self.states is None else self.arrays.goal

    @classmethod
    def of_model(cls, pool: Pool, number: int, world: World) -> ModelGroup:
        """Return the group of all people of a model on an enumerated task."""
        return cls.of(pool, pool.policies[number].pomdp, np.flatnonzero(pool.model == number), world)

    @classmethod
    def of(cls, pool: Pool, pomdp: AssistPOMDP, own: Ints, world: World, states: Ints | None = None) -> ModelGroup:
        """Return the group of some people of a model.

        Parameters
        ----------
        pool : Pool
        pomdp : AssistPOMDP
            Problem of the model, on the whole task or a part of it.
        own : int array
            Numbers of the people.
        world : World
        states : int array, shape (n,), optional
            As in the attributes of the class.
        """
        model, choices = pomdp.model, pomdp.model.choices
        row, q = np.zeros(len(pool.people), dtype=np.int64), np.empty((0, 0, 0))
        on_grid, rule, eta = world == "model", None, model.eta / model.utility_scale
        if on_grid:  # the problem defines the trust update
            p, v, lapse = np.ascontiguousarray(np.moveaxis(pomdp.chosen, 2, 0)), np.empty((0, 0)), model.lapse
        else:
            minds = [_mind(pool.people[i], choices) for i in own.tolist()]
            p, v, lapse = np.array([mind[0] for mind in minds]), np.array([mind[1] for mind in minds]), 0.0
            row[own] = np.arange(len(own))
            if pool.setting.trust not in (None, "paper"):
                rule, eta, q = pool.setting.trust_rule(), 0.0, np.array([mind[2] for mind in minds])
        made = Minds(p, v, read_only(choices.optimal), eta=eta, lapse=lapse, on_grid=on_grid)
        return cls(ProblemArrays.of(pomdp), made, own, row, states, rule, q)

    def act(self, rows: Ints, people: PeopleArrays) -> None:
        """Let the people of some rows, all of this model, act once; theta moves by the rule of trust."""
        if self.trust is None:
            act(rows, people, self.minds, self.arrays)
            return
        before, theta = people.x[rows], people.theta[rows]
        act(rows, people, self.minds, self.arrays)
        who, robot = people.who[rows], people.robot[rows]
        suggested, value = self.arrays.suggested[before, robot], self.minds.value
        advised = np.flatnonzero(suggested >= 0)
        who, x, slot = who[advised], before[advised], suggested[advised]
        perceived = PerceivedSuggestions.of(
            self.perceived[who, x, slot], self.perceived[who, x].min(axis=1), value[who, x],
            value[who, self.arrays.targets[x, slot]], self.minds.optimal[x, slot],
        )  # fmt: skip
        event = perceived.event(people.slot[rows[advised]] == slot, self.trust.feedback)
        people.theta[rows[advised]] = self.trust.update(theta[advised], event)


def _mind(human: Human, choices: Choices) -> tuple[Floats, Floats, Floats]:
    """Return a person's choice probabilities, shape (n, A), values V(x), shape (n,), and perceived costs, (n, A)."""
    q = perceived_cost(choices, human.expects(choices))
    return chances(human.chooses, choices, q, np.array([human.beta]))[0], value(human.chooses, choices, q), q


@dataclass(frozen=True)
class StepView:
    """All people in one step, as team policies and compiled code see them; arrays of shape (N, K).

    Attributes
    ----------
    policies : sequence of Policy
    groups : mapping of int to ModelGroup
        By the index of the policy.
    x : int array
        Row of each person in their policy's problem.
    model : int array
        Index of each person's policy.
    who : int array
        Row of each person in their group's `Minds`.
    """

    policies: Sequence[Policy]
    groups: Mapping[int, ModelGroup]
    x: Ints
    model: Ints
    who: Ints


@dataclass(eq=False)
class CachedPart:
    """A policy for some or all states of a task, with the choices of some people there.

    Attributes
    ----------
    policy : Policy
    group : ModelGroup
    states : int array, shape (m,)
        Ascending states in which people may be, if the policy does not cover all.
    spent : int
        Number of other states for which local problems have been built since, for one step each.
    """

    policy: Policy
    group: ModelGroup
    states: Ints
    spent: int = 0

    def has(self, states: Ints, people: Ints, deep: bool) -> bool:
        """Return whether it covers these states and people."""
        return self.policy.rows(states, deep=deep) is not None and bool(np.isin(people, self.group.people).all())


class TaskParts:
    """The parts of people's tasks that are in use, for all episodes of a simulation. It is thread-safe.

    A policy for an enumerated task covers all states. A local problem is used again while all people are in its states:
    in a small task, people soon visit no new states. It is rebuilt with more states if these are not many more than are
    needed, or if as many have been built for single steps since.

    Parameters
    ----------
    pool : Pool
    world : World
    """

    def __init__(self, pool: Pool, world: World) -> None:
        self.pool, self.world = pool, world
        self._kept: dict[int, CachedPart] = {}
        self._lock = threading.Lock()

    def of(self, number: int, states: Ints, people: Ints, deep: bool) -> CachedPart:
        """Return a part with some ascending states and some of the people of a policy.

        A rebuilt local problem has at most four times the needed number of states, unless many were built for single
        steps. All cached problems together have about 20,000 rows, of some kilobytes each.
        """
        with self._lock:
            kept = self._kept.get(number)
            if kept is None:
                return self._kept.setdefault(number, self._built(number, states, people, deep))
            if kept.has(states, people, deep):
                return kept
            more, everybody = np.union1d(kept.states, states), np.union1d(kept.group.people, people)
            size, most = len(kept.policy.pomdp.robot_actions), 20_000 // len(self.pool.policies)
            if len(more) <= max(4 * len(states), kept.spent) and size * len(more) <= most * len(kept.states):
                self._kept[number] = self._built(number, more, everybody, deep)
                return self._kept[number]
            kept.spent += len(states)
            return self._built(number, states, people, deep)

    def _built(self, number: int, states: Ints, people: Ints, deep: bool) -> CachedPart:
        policy = self.pool.policies[number]
        # Where no state takes a search, the states after suggestions are included from the beginning.
        local = policy.local(states, deep=deep or not policy.searches)
        if local.states is None:  # it is built once, for everybody
            people = np.flatnonzero(self.pool.model == number)
        return CachedPart(local, self.group(local, people), states)

    def group(self, policy: Policy, people: Ints) -> ModelGroup:
        """Return the group of some people of a policy."""
        return ModelGroup.of(self.pool, policy.pomdp, people, self.world, policy.states)


class TaskView:
    """The people's tasks in a number of episodes that are simulated together; `view` returns those of a step.

    Parameters
    ----------
    parts : TaskParts
    model, people, mind : int arrays, shape (N, K)
        Each person's model, their number in the pool, and, in the robot's model, the index of their beta.
    """

    def __init__(self, parts: TaskParts, model: Ints, people: Ints, mind: Ints) -> None:
        self.parts, self.model, self.people, self.mind = parts, model, people, mind
        policies = parts.pool.policies
        self.initial = np.array([policy.task.initial for policy in policies])[model]
        self._whole: StepView | None = None
        if all(np.isfinite(policies[number].size) for number in np.unique(model)):
            self._whole = self._view(self.initial, np.arange(model.size), deep=True)

    def view(self, x: Ints, active: Ints, *, deep: bool) -> StepView:
        """Return the view of all people in given states.

        Parameters
        ----------
        x : int array, shape (N, K)
            State of each person.
        active : int array
            Active people, as indices of the flattened `x`.
        deep : bool
            Whether local problems must have the effect of every suggestion on trust, not only of those that are made.
        """
        return self._view(x, active, deep) if self._whole is None else replace(self._whole, x=x)

    def _view(self, x: Ints, active: Ints, deep: bool) -> StepView:
        policies, groups = list(self.parts.pool.policies), dict[int, ModelGroup]()
        rows, who = np.zeros((2, x.size), dtype=np.int64)
        for number, flat in by_model(self.model.reshape(-1), active, len(policies)):
            states, people = x.reshape(-1)[flat], self.people.reshape(-1)[flat]
            part = self.parts.of(number, np.unique(states), np.unique(people), deep)
            own = part.policy.rows(states, deep=deep)
            assert own is not None
            policies[number], groups[number], rows[flat] = part.policy, part.group, own
            who[flat] = self.mind.reshape(-1)[flat] if self.parts.world == "model" else part.group.row[people]
        return StepView(policies, groups, rows.reshape(x.shape), self.model, who.reshape(x.shape))

    def after_suggestions(self, view: StepView, robot: Ints) -> StepView:
        """Return the view after the given robot actions, shape (N, K), which can be simulated from it.

        A local problem has the effect on trust of only those suggestions that are made; they are added here. A view
        of enumerated tasks has all effects, and is returned unchanged.
        """
        if self._whole is not None:
            return view
        groups, policies = dict(view.groups), list(view.policies)
        for number, flat in by_model(view.model.reshape(-1), np.flatnonzero(robot), len(policies)):
            again = policies[number].after_suggestions(view.x.reshape(-1)[flat], robot.reshape(-1)[flat])
            if again is not policies[number]:
                groups[number], policies[number] = self.parts.group(again, groups[number].people), again
        return replace(view, groups=groups, policies=policies)
