"""The people's tasks as a step of a simulation sees them: enumerated tasks, or local problems.

For an enumerated task, all data are computed once, and array rows correspond to states. For a task that is not
enumerated (`large_tasks.truncated_policy`), a step builds a local problem of the people's states. A limited number of
these are cached, so that the memory consists mostly of visited states.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from ..people.choice_model import chances, value
from ..people.choices import Choices
from ..people.decision import Floats, perceived_cost
from ..people.human import Human
from ..people.trust_rules import PerceivedSuggestions, TrustRule
from ..person.pomdp import AssistPOMDP, Policy
from ..person.problem_arrays import ProblemArrays, read_only
from .dynamics import Minds, PeopleArrays, act
from .pool import Pool

World = Literal["people", "model"]

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
    """Return a person's choice probabilities, shape (n, A), their V(x), shape (n,), and perceived costs, (n, A)."""
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


class TaskView(Protocol):
    """The view of people's tasks in a number of episodes."""

    @property
    def initial(self) -> Ints:
        """The initial state of each person, shape (N, K)."""
        ...

    def view(self, x: Ints, active: Ints, *, deep: bool) -> StepView:
        """Return the view of all people.

        Parameters
        ----------
        x : int array, shape (N, K)
            State of each person.
        active : int array
            Active people, as indices of the flattened `x`.
        deep : bool
            Whether the effect of every suggestion on trust must be known.
        """
        ...

    def after_suggestions(self, view: StepView, robot: Ints) -> StepView:
        """Return the view with the effects of suggestions on trust, given robot actions of shape (N, K)."""
        ...


class WholeTaskView:
    """The view of enumerated tasks.

    Parameters
    ----------
    pool : Pool
    group_of : callable
        Returns the group of a model.
    world : World
    model, people, mind : int arrays, shape (N, K)
        Each person's model, their number in the pool, and, in the robot's model, the index of their beta.
    """

    def __init__(
        self, pool: Pool, group_of: Callable[[int], ModelGroup], world: World, model: Ints, people: Ints, mind: Ints
    ) -> None:
        self.initial = np.array([pool.choices(number).initial for number in range(len(pool.people))])[people]
        groups = {number: group_of(number) for number in np.unique(model).tolist()}
        # Each person belongs to one group, and has row 0 in the others.
        who = mind if world == "model" else np.sum([group.row for group in groups.values()], axis=0)[people]
        self._view = StepView(pool.policies, groups, self.initial, model, who)

    def view(self, x: Ints, active: Ints, *, deep: bool) -> StepView:  # noqa: ARG002
        """Return the view; states are rows."""
        return replace(self._view, x=x)

    def after_suggestions(self, view: StepView, robot: Ints) -> StepView:  # noqa: ARG002
        """Return the same view, which contains the effects of all suggestions."""
        return view
