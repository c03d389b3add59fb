"""The people of one model, as compiled code and the trust rules of their setting see them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..people.choice_model import chances, value
from ..people.choices import Choices
from ..people.decision import Floats, perceived_cost
from ..people.human import Human
from ..person.beliefs import PersonModel
from ..person.dynamics import Minds, PeopleArrays, act
from ..person.pomdp import AssistPOMDP
from ..person.problem_arrays import ProblemArrays, read_only
from .pool import Pool
from .trust_of_people import TrustOfPeople

World = Literal["people", "model"]


Ints = NDArray[np.int64]


@dataclass(frozen=True)
class ModelGroup:
    """The people of one model, as compiled code reads them.

    Attributes
    ----------
    model : PersonModel
        Their problem, as the robot knows it.
    minds : Minds
        Choices of each of them with each goal; in the robot's model, of each type.
    people : int array
        Their numbers in the pool, in the order of `minds`.
    row : int array, shape (people,)
        First row of each person of the pool in `minds`, that of the first goal; 0 for people of other models.
    states : int array, shape (n,), or None
        Task state of each row of the problem; None if rows and states are the same.
    trust : TrustOfPeople or None
        How people's own theta changes, if not by equation 7 or as in the robot's model.
    """

    model: PersonModel
    minds: Minds
    people: Ints
    row: Ints
    states: Ints | None = None
    trust: TrustOfPeople | None = None

    @property
    def arrays(self) -> ProblemArrays:
        """Their problem, as compiled code reads it."""
        return self.model.arrays

    @property
    def ends(self) -> NDArray[np.bool_]:
        """Whether episodes end in each state for each goal, shape (G, n).

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
        model, choices, row, trust = pomdp.model, pomdp.model.choices, np.zeros(len(pool.people), dtype=np.int64), None
        minds, known = Minds.of_model(pomdp), PersonModel.of(pomdp)  # the problem defines the trust update
        if world == "people":
            goals = choices.of_each_goal
            found = [_mind(pool.people[i], own_choices) for i in own.tolist() for own_choices in goals]
            p, v, q = (np.array(part) for part in zip(*found, strict=True))
            row[own] = np.arange(len(own)) * len(goals)
            eta = model.eta / model.utility_scale
            if pool.setting.trust not in (None, "paper"):
                trust, eta = TrustOfPeople(pool.setting.trust_rule(), q, known.optimal), 0.0
            goal = read_only(np.tile(np.arange(len(goals)), len(own)))
            minds = minds._replace(goal=goal, p=p, value=v, eta=eta, lapse=0.0, on_grid=False)
        return cls(known, minds, own, row, states, trust)

    def mind(self, people: Ints, goal: Ints) -> Ints:
        """Return the row of `minds` of some people, given by their numbers in the pool, with their goals."""
        return self.row[people] + goal

    def ended(self, rows: Ints, people: PeopleArrays) -> NDArray[np.bool_]:
        """Return whether the episode has ended for the people of some rows."""
        return np.asarray(self.ends[self.minds.goal[people.who[rows]], people.x[rows]])

    def states_of(self, rows: Ints) -> Ints:
        """Return the task state of some rows of the problem."""
        return rows if self.states is None else self.states[rows]

    def act(self, rows: Ints, people: PeopleArrays) -> None:
        """Let the people of some rows, all of this model, act once."""
        if self.trust is None:
            act(rows, people, self.minds, self.arrays)
        else:
            self.trust.act(rows, people, self.minds, self.arrays)


def _mind(human: Human, choices: Choices) -> tuple[Floats, Floats, Floats]:
    """Return a person's choice probabilities, shape (n, A), values V(x), shape (n,), and perceived costs, (n, A)."""
    q = perceived_cost(choices, human.expects(choices))
    return chances(human.chooses, choices, q, np.array([human.beta]))[0], value(human.chooses, choices, q), q
