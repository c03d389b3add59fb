"""What simulated people stand on: their tasks as a whole, or in each step the little of it that the step needs.

Of a task that is looked at whole everything is worked out once, and the rows of its arrays name its states. Of one that
is not (`team.wide`) the problem around those states in which people are is made when a step needs it. Some of that is
kept, up to a limit, and the rest forgotten, so that little more remains than what has been looked up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from ..people.choice_model import chances, value
from ..people.choices import Choices
from ..people.decision import NOTHING, Floats, perceived_cost
from ..people.human import Human
from ..person.pomdp import AssistPOMDP, Policy
from ..person.qmdp import Arrays, read_only
from ..team.pool import Pool
from ..team.state import by_model
from ..team.wide import Around, WidePolicy
from .dynamics import Minds

World = Literal["people", "model"]

Ints = NDArray[np.int64]

MORE = 4
"""Problems are made around at most so many times the states that are wanted, to be kept."""

LARGEST = 20_000
"""Rows of all problems that are kept, about: each takes some kilobytes."""


@dataclass(frozen=True)
class Group:
    """The people of one model, as compiled code reads them.

    Attributes
    ----------
    arrays : Arrays
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

    arrays: Arrays
    minds: Minds
    people: Ints
    row: Ints
    states: Ints | None = None

    @property
    def ends(self) -> NDArray[np.bool_]:
        """Where episodes end, shape (n,): nothing is known of what follows where a whole problem breaks off."""
        return self.arrays.final if self.states is None else self.arrays.goal

    @classmethod
    def of_model(cls, pool: Pool, number: int, world: World) -> Group:
        """Work out how all people of a model choose in a task that is looked at whole."""
        return cls.of(pool, pool.policies[number].pomdp, np.flatnonzero(pool.model == number), world)

    @classmethod
    def of(cls, pool: Pool, pomdp: AssistPOMDP, own: Ints, world: World, states: Ints | None = None) -> Group:
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
        return cls(Arrays.of(pomdp), made, own, row, states)


def _mind(human: Human, choices: Choices) -> tuple[Floats, Floats]:
    """Give the chance of each choice of a person, shape (n, A), and what their trust looks at, shape (n,)."""
    q = perceived_cost(choices, human.expects(choices))
    return chances(human.chooses, choices, q, np.array([human.beta]))[0], value(human.chooses, choices, q)


@dataclass(frozen=True)
class View:
    """Everybody in one step, as team policies and compiled code see them; arrays of shape (N, K).

    Attributes
    ----------
    policies : sequence of Policy
    groups : mapping of int to Group
        By the numbers of policies.
    x : int array
        The row of each person in their policy's problem.
    model : int array
        Whose policy each person's is.
    who : int array
        The row of each person in their group's `Minds`.
    """

    policies: Sequence[Policy]
    groups: Mapping[int, Group]
    x: Ints
    model: Ints
    who: Ints


class Ground(Protocol):
    """Either of the two, for a number of episodes."""

    @property
    def initial(self) -> Ints:
        """The state in which each person begins, shape (N, K)."""
        ...

    def view(self, x: Ints, active: Ints, *, deep: bool) -> View:
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

    def heard(self, view: View, robot: Ints) -> View:
        """Give the view in which it is known what suggestions do to trust, robot actions being of shape (N, K)."""
        ...


class Whole:
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
        self, pool: Pool, group_of: Callable[[int], Group], world: World, model: Ints, people: Ints, mind: Ints
    ) -> None:
        self.initial = np.array([pool.choices(number).initial for number in range(len(pool.people))])[people]
        groups = {number: group_of(number) for number in np.unique(model).tolist()}
        # Each person is of one group, and has row 0 in the others.
        who = mind if world == "model" else np.sum([group.row for group in groups.values()], axis=0)[people]
        self._view = View(pool.policies, groups, self.initial, model, who)

    def view(self, x: Ints, active: Ints, *, deep: bool) -> View:  # noqa: ARG002
        """Give what there is; states are rows."""
        return replace(self._view, x=x)

    def heard(self, view: View, robot: Ints) -> View:  # noqa: ARG002
        """Give the same: all is known."""
        return view


class Wide:
    """Tasks that are not.

    What has been made around some states is kept in `kept` and serves again where nobody is elsewhere: in a small task
    people soon come to no others. It is made anew with more states where they are not many more than are wanted, or as
    much has been made for once meanwhile.

    Parameters
    ----------
    pool : Pool
    world : World
    kept : dict
        By the policy's number: empty at first, and for all chunks of one policy's episodes the same.
    model, people, mind : int arrays, shape (N, K)
        As of `Whole`.
    """

    def __init__(self, pool: Pool, world: World, kept: dict[int, Kept], model: Ints, people: Ints, mind: Ints) -> None:
        self.pool, self.world, self.kept = pool, world, kept
        self.policies = [policy for policy in pool.policies if isinstance(policy, WidePolicy)]
        self.model, self.people, self.mind = model, people, mind
        self.initial = np.array([policy.ground.known.initial for policy in self.policies])[model]

    def view(self, x: Ints, active: Ints, *, deep: bool) -> View:
        """Look at the problem around everybody who acts."""
        arounds: list[Around] = []
        groups: dict[int, Group] = {}
        rows, models, who = np.zeros((3, x.size), dtype=np.int64)
        for number, flat in by_model(self.model.reshape(-1), active, len(self.policies)):
            states, people = x.reshape(-1)[flat], self.people.reshape(-1)[flat]
            part = self._part(number, np.unique(states), np.unique(people), deep)
            rows[flat] = part.rows(states)
            models[flat] = len(arounds)
            who[flat] = self.mind.reshape(-1)[flat] if self.world == "model" else part.group.row[people]
            groups[len(arounds)] = part.group
            arounds.append(part.around)
        return View(arounds, groups, rows.reshape(x.shape), models.reshape(x.shape), who.reshape(x.shape))

    def _part(self, number: int, states: Ints, people: Ints, deep: bool) -> Kept:
        """Give the problem around some states, ascending, for some of the people of a policy."""
        kept = self.kept.get(number)
        if kept is None:
            return self.kept.setdefault(number, self._made(number, states, people, deep))
        if kept.has(states, people, deep):
            return kept
        more, everybody = np.union1d(kept.states, states), np.union1d(kept.group.people, people)
        if len(more) <= max(MORE * len(states), kept.spent) and kept.size * len(more) <= (
            LARGEST // len(self.policies) * len(kept.states)
        ):
            self.kept[number] = self._made(number, more, everybody, deep)
            return self.kept[number]
        kept.spent += len(states)
        return self._made(number, states, people, deep)

    def _made(self, number: int, states: Ints, people: Ints, deep: bool) -> Kept:
        # What is looked up is there at once, so that it need not be asked for again for those who are advised.
        deep = deep or not self.policies[number].ground.known.searches
        around = self.policies[number].around(states, deep=deep)
        return Kept(around, Group.of(self.pool, around.pomdp, people, self.world, around.region.states))

    def heard(self, view: View, robot: Ints) -> View:
        """Look at the states to which people are advised to go."""
        groups, policies = dict(view.groups), list(view.policies)
        for number, flat in by_model(view.model.reshape(-1), np.flatnonzero(robot), len(policies)):
            around = policies[number]
            if not isinstance(around, Around) or around.deep:
                continue
            x, choices = view.x.reshape(-1)[flat], around.pomdp.model.choices
            slot = around.pomdp.suggested[x, robot.reshape(-1)[flat]]
            then = around.region.states[choices.targets[x, slot][slot != NOTHING]]
            again = around.wide.around(around.region.states[: around.count], then=then)
            own = groups[number].people
            groups[number] = Group.of(self.pool, again.pomdp, own, self.world, again.region.states)
            policies[number] = again
        return replace(view, groups=groups, policies=policies)


@dataclass(eq=False)
class Kept:
    """The problem around some states, and how some people choose there.

    Attributes
    ----------
    around : Around
    group : Group
    spent : int
        Around how many other states problems have been made since, for a step each.
    """

    around: Around
    group: Group
    spent: int = 0

    @property
    def states(self) -> Ints:
        """Those in which people may be, ascending."""
        return self.around.region.states[: self.around.count]

    @property
    def size(self) -> int:
        """How many rows it has, those of next states included."""
        return len(self.around.region.states)

    def has(self, states: Ints, people: Ints, deep: bool) -> bool:
        """Tell whether it serves people in these states."""
        if deep and not self.around.deep:
            return False
        place = np.minimum(np.searchsorted(self.states, states), self.around.count - 1)
        return bool((self.states[place] == states).all()) and bool(np.isin(people, self.group.people).all())

    def rows(self, states: Ints) -> Ints:
        """Give the rows of states, shape (N,), that it has."""
        return np.searchsorted(self.states, states)
