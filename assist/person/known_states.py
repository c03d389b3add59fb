"""Beliefs in people whose task states are known, as dense arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import copy
from typing import Self

import numpy as np

from planner.system.jit import ReadableFirst

from ..people.belief import ImpossibleObservationError
from ..people.decision import Bools, Floats, Ints
from ..people.neighbourhood import NOBODY_SEES, Neighbourhood
from .belief_filter import update_compiled
from .belief_update import update_readable
from .beliefs import Ask, Groups, PersonModel
from .joint_belief import JointBelief
from .policy import Policy
from .pomdp import AssistPOMDP
from .problem_arrays import Acts


class KnownStates:
    """Beliefs in people whose task states are known.

    Parameters
    ----------
    x : int array, shape (P,)
        The states. The array is kept, and `observe` does not change it: in a simulation it is the array of people's
        rows, in which `dynamics.act` has moved them before.
    belief : float array, shape (P, H, T)
        The beliefs, which are kept likewise; without rows for a robot that has none.
    erred : bool array, shape (P,)
    neighbours : Neighbourhood, optional
        As in `Beliefs`.
    """

    sees_states: bool = True

    def __init__(self, x: Ints, belief: Floats, erred: Bools, neighbours: Neighbourhood = NOBODY_SEES) -> None:
        self.x, self.belief, self.erred, self.neighbours = x, belief, erred, neighbours

    def observe(self, acts: Acts, said: Ints, groups: Groups, draw: Callable[[int], Floats]) -> None:
        """Update the beliefs, as in `Beliefs`."""
        del said, draw
        for model, people in groups:
            self.update(people, acts.of(people), model)

    def update(self, people: Ints, acts: Acts, model: PersonModel) -> None:
        """Update the beliefs by actions that were seen, as in `Beliefs`."""
        _update(people, acts, self.belief, self.erred, model.optimal, model.possible, model.arrays)

    def answered(self, person: int, likelihood: Floats, policy: Policy) -> None:
        """Update a belief by an answer, as in `Beliefs`."""
        del policy
        joint = self.belief[person] * likelihood
        total = joint.sum()
        if not total > 0:
            raise ImpossibleObservationError("the answer is impossible; expected an error rate above 0")
        self.belief[person] = joint / total

    def expected(self, ask: Ask, policy: Policy, people: Ints) -> Floats:
        """Return the answers about some people, as in `Beliefs`."""
        if not len(self.belief):
            raise ValueError("the policy has said that it uses no beliefs")
        if len(people) == len(self.x):  # all of them, so that nothing needs to be copied
            return ask(policy, self.x, self.belief)
        return ask(policy, self.x[people], self.belief.take(people, axis=0))  # faster than by an index

    def finished(self, person: int, policy: Policy) -> float:
        """Return the probability that a person has reached their goal, as in `Beliefs`."""
        reached = policy.arrays.goal[:, self.x[person]]
        return float(reached[0]) if reached.all() == reached.any() else self.joint(person, policy).finished(policy)

    def heard(self, said: Ints, x: Ints, groups: Iterable[tuple[AssistPOMDP, Ints]]) -> Ints:
        """Return what people hear, as in `Beliefs`: the very actions."""
        del x, groups
        return said

    def joint(self, person: int, policy: Policy) -> JointBelief:
        """Return the belief in a person over situations and types, as in `Beliefs`."""
        return JointBelief.at(int(policy.situations(self.x[person : person + 1])[0]), self.belief[person])

    @property
    def pruned(self) -> Floats:
        """The probability of states that were left out: none, shape (P,)."""
        return np.zeros(len(self.x))

    def of(self, people: Ints) -> Self:
        """Return the beliefs in some people, as in `Beliefs`."""
        found, belief = copy(self), self.belief
        found.belief = belief.take(people, axis=0) if len(belief) else belief
        found.x, found.erred = self.x[people], self.erred[people]
        return found


def _work(people: Ints, _acts: Acts, belief: Floats, *_: object) -> float:
    """Return the work of `update_readable`, in nanoseconds."""
    return 60_000 + len(people) * 20 * (belief[0].size if len(belief) else 1)


_update = ReadableFirst(update_readable, update_compiled, _work)
