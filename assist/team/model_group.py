"""The people of one model, as compiled code and the trust rules of their setting see them.

What a person would choose in a row is computed when somebody is there. In a whole task that is done at the start, for
all people and rows.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..people.choice_model import chances, value
from ..people.choices import Choices
from ..people.decision import Floats, perceived_cost
from ..people.human import Human
from ..people.trust_rules import TrustRule
from ..person.beliefs import PersonModel
from ..person.dynamics import act
from ..person.people_arrays import Minds, PeopleArrays
from ..person.policy import Policy
from ..person.pomdp import AssistPOMDP
from ..person.problem_arrays import ProblemArrays, read_only
from .trust_of_people import TrustOfPeople

Ints = NDArray[np.int64]


class ModelGroup:
    """All people of one model. It is thread-safe.

    Parameters
    ----------
    policy : Policy
    people : sequence of Human, optional
        People of a pool, each with every goal in turn; by default those of the robot's model, one of each type.
    trust : TrustRule, optional
        The rule by which theta of people of a pool moves; by default equation (7). Theta of people of the robot's
        model moves on the grid of the problem, by the rule that the problem has.

    Attributes
    ----------
    policy : Policy
    """

    def __init__(
        self, policy: Policy, people: Sequence[Human] | None = None, trust: TrustRule | None = None
    ) -> None:  # fmt: skip
        self.policy, self._people, self._rule = policy, people, trust
        pomdp, self._problem, self._model = policy.pomdp, policy.problem, PersonModel.of(policy)
        self._goals, self._lock = len(pomdp.hidden.goals), threading.Lock()
        self._minds = Minds.of_model(pomdp)  # the problem defines the trust update
        if people is not None:
            eta = 0.0 if trust is not None else pomdp.model.eta / pomdp.model.utility_scale
            goal = read_only(np.tile(np.arange(self._goals), len(people)))
            self._minds = self._minds._replace(goal=goal, eta=eta, lapse=0.0, on_grid=False)
        minds = len(self._minds.goal)
        self._stamps, self._value = np.full((minds, 0), -1), np.empty((minds, 0))
        self._p, self._perceived = np.empty((minds, 0, 0)), np.empty((minds, 0, 0))
        if len(rows := self._problem.lasting):
            self._reserve(len(rows), self.arrays)
            self._work_out(np.arange(minds), rows, pomdp)

    @property
    def arrays(self) -> ProblemArrays:
        """The problem, on all rows so far."""
        return self.policy.arrays

    @property
    def model(self) -> PersonModel:
        """The problem as the robot knows it, on all rows so far."""
        if self._model.arrays is not self.arrays:
            self._model = PersonModel.of(self.policy)
        return self._model

    def ended(self, flat: Ints, them: PeopleArrays) -> NDArray[np.bool_]:
        """Return whether the episode has ended for some people."""
        return np.asarray(self.arrays.final[self._minds.goal[them.who[flat]], them.x[flat]])

    def act(self, flat: Ints, them: PeopleArrays) -> None:
        """Let some people, all of this model, act once."""
        at, there = self._problem.effects(them.x[flat], them.heard[flat])
        model, minds, perceived = self._ready(them.who[flat[at]], there)
        if self._rule is None:
            act(flat, them, minds, model.arrays)
        else:
            TrustOfPeople(self._rule, perceived, model.optimal).act(flat, them, minds, model.arrays)

    def _ready(self, who: Ints, x: Ints) -> tuple[PersonModel, Minds, Floats]:
        """Compute what some people would choose in some rows, both of shape (N,), where it is not known yet."""
        if not len(who):
            return self.model, self._minds, self._perceived
        with self._lock:
            stamps, model = self._problem.now.stamps, self.model
            self._reserve(len(stamps), model.arrays)
            new = self._stamps[who, x] != stamps[x]
            if new.any():
                self._work_out(np.unique(who[new]), np.unique(x[new]), model.pomdp)
            return model, self._minds, self._perceived

    def _reserve(self, rows: int, arrays: ProblemArrays) -> None:
        """Make room for the choices in a number of rows of a problem."""
        minds, slots = self._stamps.shape[0], arrays.chosen.shape[1]
        if rows > self._stamps.shape[1] or slots > self._p.shape[2]:
            room = max(rows, 2 * self._stamps.shape[1])
            self._stamps = _larger(self._stamps, (minds, room), -1)
            self._p = _larger(self._p, (minds, room, slots), 0.0)
            if self._people is not None:
                self._value = _larger(self._value, (minds, room), 0.0)
                self._perceived = _larger(self._perceived, (minds, room, slots), np.inf)
            self._minds = self._minds._replace(p=self._p, value=self._value)

    def _work_out(self, minds: Ints, rows: Ints, pomdp: AssistPOMDP) -> None:
        """Compute what some people would choose in some rows."""
        at = np.ix_(minds, rows)
        self._stamps[at] = self._problem.now.stamps[rows]
        slots = slice(pomdp.chosen.shape[1])
        if self._people is None:
            self._p[:, rows, slots] = np.moveaxis(pomdp.chosen[rows], 2, 0)
            return
        each = _around(pomdp.model.choices, rows).of_each_goal
        for mind in minds.tolist():
            person, goal = divmod(mind, self._goals)
            p, v, q = _mind(self._people[person], each[goal])
            self._p[mind, rows, slots], self._value[mind, rows], self._perceived[mind, rows, slots] = (
                part[: len(rows)] for part in (p, v, q)
            )


def _around(choices: Choices, rows: NDArray[np.int64]) -> Choices:
    """Return the choices in some rows, shape (N,), which come first; their successors follow without choices.

    The choices in all rows are what they are.
    """
    if len(rows) == len(choices):
        return choices
    after = np.unique(choices.targets[rows])
    every, count = np.concatenate([rows, after]), len(rows)
    leaf = np.arange(len(every)) >= count
    targets = np.where(leaf, np.arange(len(every)), 0)[:, None].repeat(choices.targets.shape[1], axis=1)
    targets[:count] = count + np.searchsorted(after, choices.targets[rows])
    applicable = choices.applicable[every] & ~leaf[:, None]
    return choices.of_rows(every, applicable=applicable, targets=targets, key=choices.keys[every])


def _larger(array: NDArray[Any], shape: tuple[int, ...], blank: float) -> NDArray[Any]:
    """Return a copy of an array in a larger one, with a number elsewhere."""
    found = np.full(shape, blank, dtype=array.dtype)
    found[tuple(map(slice, array.shape))] = array
    return found


def _mind(human: Human, choices: Choices) -> tuple[Floats, Floats, Floats]:
    """Return a person's choice probabilities, shape (n, A), values V(x), shape (n,), and perceived costs, (n, A)."""
    q = perceived_cost(choices, human.expects(choices))
    return chances(human.chooses, choices, q, np.array([human.beta]))[0], value(human.chooses, choices, q), q
