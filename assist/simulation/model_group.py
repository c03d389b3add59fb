"""The people of one model, as compiled code and the trust rules of their setting see them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..people.choice_model import chances, value
from ..people.choices import Choices
from ..people.decision import Floats, perceived_cost
from ..people.human import Human
from ..people.trust_rules import PerceivedSuggestions, TrustRule, moved
from ..person.dynamics import Minds, PeopleArrays, act
from ..person.pomdp import AssistPOMDP
from ..person.problem_arrays import ProblemArrays, read_only
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
        before, theta, seen = people.x[rows], people.theta[rows], people.seen[rows]
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
        people.theta[rows[advised]], people.seen[rows[advised]] = moved(
            self.trust, theta[advised], seen[advised], event
        )


def _mind(human: Human, choices: Choices) -> tuple[Floats, Floats, Floats]:
    """Return a person's choice probabilities, shape (n, A), values V(x), shape (n,), and perceived costs, (n, A)."""
    q = perceived_cost(choices, human.expects(choices))
    return chances(human.chooses, choices, q, np.array([human.beta]))[0], value(human.chooses, choices, q), q
