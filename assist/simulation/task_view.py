"""What simulated people stand on: their tasks as a whole, or in each step the little of it that the step needs.

Of a task that is looked at whole everything is worked out once, and the rows of its arrays name its states. Of one that
is not (`large_tasks.truncated_policy`) the problem around those states in which people are is made when a step needs
it. Some of that is kept, up to a limit, and the rest forgotten, so that little more remains than what has been looked
up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from ..people.choice_model import chances, value
from ..people.choices import Choices
from ..people.decision import Floats, perceived_cost
from ..people.human import Human
from ..person.pomdp import AssistPOMDP, Policy
from ..person.problem_arrays import ProblemArrays, read_only
from .dynamics import Minds
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
        How they choose: of each of them, or in the model's world of each beta of the grid.
    people : int array
        Who they are, in the order of `minds`.
    row : int array, shape (people,)
        Where each of the pool's people is in `minds`; 0 for those who are not.
    states : int array, shape (n,), or None
        The task's states of the problem's rows; None if they are the rows.
    """

    arrays: ProblemArrays
    minds: Minds
    people: Ints
    row: Ints
    states: Ints | None = None

    @property
    def ends(self) -> NDArray[np.bool_]:
        """Where episodes end, shape (n,): nothing is known of what follows where a whole problem breaks off."""
        return self.arrays.final if self.states is None else self.arrays.goal

    @classmethod
    def of_model(cls, pool: Pool, number: int, world: World) -> ModelGroup:
        """Work out how all people of a model choose in a task that is looked at whole."""
        return cls.of(pool, pool.policies[number].pomdp, np.flatnonzero(pool.model == number), world)

    @classmethod
    def of(cls, pool: Pool, pomdp: AssistPOMDP, own: Ints, world: World, states: Ints | None = None) -> ModelGroup:
        """Work out how some people of a model choose.

        Parameters
        ----------
        pool : Pool
        pomdp : AssistPOMDP
            The model's problem, on the task or a part of it.
        own : int array
            Who they are.
        world : World
        states : int array, shape (n,), optional
        """
        model, choices = pomdp.model, pomdp.model.choices
        row = np.zeros(len(pool.people), dtype=np.int64)
        on_grid = world == "model"
        if on_grid:  # trust moves as the problem says
            p, v, lapse = np.ascontiguousarray(np.moveaxis(pomdp.chosen, 2, 0)), np.empty((0, 0)), model.lapse
        else:
            minds = [_mind(pool.people[i], choices) for i in own.tolist()]
            p, v, lapse = np.array([mind[0] for mind in minds]), np.array([mind[1] for mind in minds]), 0.0
            row[own] = np.arange(len(own))
        made = Minds(
            p, v, read_only(choices.optimal), eta=model.eta / model.utility_scale, lapse=lapse, on_grid=on_grid
        )
        return cls(ProblemArrays.of(pomdp), made, own, row, states)


def _mind(human: Human, choices: Choices) -> tuple[Floats, Floats]:
    """Give the chance of each choice of a person, shape (n, A), and what their trust looks at, shape (n,)."""
    q = perceived_cost(choices, human.expects(choices))
    return chances(human.chooses, choices, q, np.array([human.beta]))[0], value(human.chooses, choices, q)


@dataclass(frozen=True)
class StepView:
    """Everybody in one step, as team policies and compiled code see them; arrays of shape (N, K).

    Attributes
    ----------
    policies : sequence of Policy
    groups : mapping of int to ModelGroup
        By the numbers of policies.
    x : int array
        The row of each person in their policy's problem.
    model : int array
        Whose policy each person's is.
    who : int array
        The row of each person in their group's `Minds`.
    """

    policies: Sequence[Policy]
    groups: Mapping[int, ModelGroup]
    x: Ints
    model: Ints
    who: Ints


class TaskView(Protocol):
    """Either of the two, for a number of episodes."""

    @property
    def initial(self) -> Ints:
        """The state in which each person begins, shape (N, K)."""
        ...

    def view(self, x: Ints, active: Ints, *, deep: bool) -> StepView:
        """Look at everybody.

        Parameters
        ----------
        x : int array, shape (N, K)
            The state of each person.
        active : int array
            Who acts: places in `x` if it were flat.
        deep : bool
            Whether it has to be known what every suggestion would do to trust.
        """
        ...

    def heard(self, view: StepView, robot: Ints) -> StepView:
        """Give the view in which it is known what suggestions do to trust, robot actions being of shape (N, K)."""
        ...


class WholeTaskView:
    """Tasks that are looked at whole.

    Parameters
    ----------
    pool : Pool
    group_of : callable
        Gives the group of a model.
    world : World
    model, people, mind : int arrays, shape (N, K)
        Each person's model and number in the pool, and in the model's world their beta's.
    """

    def __init__(
        self, pool: Pool, group_of: Callable[[int], ModelGroup], world: World, model: Ints, people: Ints, mind: Ints
    ) -> None:
        self.initial = np.array([pool.choices(number).initial for number in range(len(pool.people))])[people]
        groups = {number: group_of(number) for number in np.unique(model).tolist()}
        # Each person is of one group, and has row 0 in the others.
        who = mind if world == "model" else np.sum([group.row for group in groups.values()], axis=0)[people]
        self._view = StepView(pool.policies, groups, self.initial, model, who)

    def view(self, x: Ints, active: Ints, *, deep: bool) -> StepView:  # noqa: ARG002
        """Give what there is; states are rows."""
        return replace(self._view, x=x)

    def heard(self, view: StepView, robot: Ints) -> StepView:  # noqa: ARG002
        """Give the same: all is known."""
        return view
