"""What a robot knows of people whose actions may be missed or confused: the second storage of `beliefs`.

`UncertainStates` keeps, for each person whose task state is uncertain, a belief over states and types together
(`joint_belief`). A `Glimpse` is what was seen of an action.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np

from ..people.belief import ImpossibleObservationError
from ..people.decision import Bools, Floats, Ints
from .beliefs import Ask, Groups, PersonModel
from .evidence import Evidence
from .joint_belief import LEAST, JointBelief, expected_answers, said_in, same_suggestions
from .known_states import KnownStates
from .observation_model import ObservationModel
from .policy import Policy
from .pomdp import AssistPOMDP
from .problem_arrays import Acts
from .random_streams import Stream


class UncertainStates(KnownStates):
    """Beliefs in people whose actions may be missed or confused, so that their task states may be uncertain.

    The arrays have the most probable state of each person and the belief in their type over all states.

    Parameters
    ----------
    x, belief, erred
        As in `KnownStates`.
    sight : ObservationModel, optional
        How reliably `observe` sees actions; all of them as they are, by default.
    joints : dict of int to JointBelief
        The belief over task states and types, by person; who is not in it has a known state.
    """

    sees_states = False

    def __init__(
        self, x: Ints, belief: Floats, erred: Bools, sight: ObservationModel | None = None,
        joints: dict[int, JointBelief] | None = None,
    ) -> None:  # fmt: skip
        super().__init__(x, belief, erred)
        self.sight, self.joints = sight or ObservationModel(), {} if joints is None else joints

    @property
    def pruned(self) -> Floats:
        """The probability of states that were left out, as in `Beliefs`."""
        return np.array([self.joints[k].pruned if k in self.joints else 0.0 for k in range(len(self.x))])

    def observe(self, acts: Acts, said: Ints, groups: Groups, draw: Callable[[int], Floats]) -> None:
        """Update the beliefs in those who go on, as in `Beliefs`; the robot sees who has reached their goal."""
        uniform = np.stack([draw(Stream.MISSED), draw(Stream.TAKEN_FOR)], axis=1)
        for model, theirs in groups:
            people = theirs[(acts.slot[theirs] >= 0) & acts.goes_on[theirs]]
            words = np.take_along_axis(said_in(model.pomdp, self.x[people]), said[people, None], axis=1)[:, 0]
            seen = [
                self.sight.draw(model.choices, int(acts.x[n]), int(acts.slot[n]), uniform[n]) for n in people.tolist()
            ]
            self.update_by(people, words, [InOneStep(self.sight.evidence(model.choices, one)) for one in seen], model)

    def update(self, people: Ints, acts: Acts, model: PersonModel) -> None:
        """Update the beliefs by actions that were seen, as in `Beliefs`, also where the state before was uncertain."""
        uncertain = np.array([k in self.joints for k in people.tolist()], dtype=bool)
        if not uncertain.any():
            super().update(people, acts, model)
            return
        super().update(people[~uncertain], acts.of(np.flatnonzero(~uncertain)), model)
        at, actions = np.flatnonzero(uncertain), model.choices.actions
        x, heard, slot = acts.x[at], acts.heard[at], acts.slot[at]
        words = np.take_along_axis(said_in(model.pomdp, x), heard[:, None], axis=1)[:, 0]
        seen = [Reported(Evidence.of(model.choices, {action: 1.0})) for action in actions[x, slot].tolist()]
        self.update_by(people[at], words, seen, model)

    def update_by(self, people: Ints, said: Ints, evidence: Sequence[Glimpse], model: PersonModel) -> None:
        """Update the beliefs in some people of one model by what was seen of their actions.

        Parameters
        ----------
        people : int array, shape (m,)
        said : int array, shape (m,)
            The ground action that was suggested before; `NOTHING` for none.
        evidence : sequence of Glimpse
            What was seen.
        model : PersonModel

        Raises
        ------
        ImpossibleObservationError
            What was seen has probability 0.
        """
        for k, words, glimpse in zip(people.tolist(), said.tolist(), evidence, strict=True):
            self._put(k, glimpse.after(self.joint(k, model.policy), words, model.policy), model.policy)

    def _put(self, person: int, joint: JointBelief, policy: Policy) -> None:
        """Set the belief in a person over situations and types."""
        self.joints[person], self.x[person] = joint, joint.rows(policy)[joint.probability.argmax()]
        self.belief[person], self.erred[person] = joint.belief, joint.erred > 1 / 2

    def answered(self, person: int, likelihood: Floats, policy: Policy) -> None:
        """Update a belief by an answer, as in `Beliefs`."""
        if person not in self.joints:
            super().answered(person, likelihood, policy)
        else:
            self._put(person, self.joints[person].answered(likelihood), policy)

    def expected(self, ask: Ask, policy: Policy, people: Ints) -> Floats:
        """Return the answers about some people, as in `Beliefs`.

        They are expected values over the possible states (QMDP). A suggestion is one that is applicable in the most
        probable state. Where it is not applicable, it costs the same and has no effect.
        """
        if not self.joints or not any(k in self.joints for k in people.tolist()):
            return super().expected(ask, policy, people)
        return expected_answers(ask, policy, self.x[people], [self.joint(k, policy) for k in people.tolist()])

    def finished(self, person: int, policy: Policy) -> float:
        """Return the probability that a person has reached their goal, as in `Beliefs`."""
        known = self.joints.get(person)
        return super().finished(person, policy) if known is None else known.finished(policy)

    def heard(self, said: Ints, x: Ints, groups: Iterable[tuple[AssistPOMDP, Ints]]) -> Ints:
        """Return what people hear, as in `Beliefs`; nothing, where the suggested action is not applicable."""
        there = np.zeros_like(said)
        for pomdp, people in groups:
            same = same_suggestions(pomdp, self.x[people], x[people])
            there[people] = np.take_along_axis(same, said[people, None], axis=1)[:, 0]
        return there

    def joint(self, person: int, policy: Policy) -> JointBelief:
        """Return the belief in a person over situations and types, as in `Beliefs`."""
        return self.joints.get(person) or super().joint(person, policy)

    def of(self, people: Ints) -> Self:
        """Return the beliefs in some people, as in `Beliefs`."""
        found, known = super().of(people), enumerate(people.tolist()) if self.joints else ()
        found.joints = {n: self.joints[k] for n, k in known if k in self.joints}
        return found


class Glimpse(Protocol):
    """What was seen of a person's action."""

    def after(self, joint: JointBelief, said: int, policy: Policy) -> JointBelief:
        """Return the belief after the ground action `said` was suggested and this was seen.

        Raises
        ------
        ImpossibleObservationError
            It has probability 0.
        """
        ...


@dataclass(frozen=True, eq=False)
class InOneStep:
    """What was seen in one step of a simulation, perhaps nothing, of a person who has not reached the goal by then.

    If it is impossible, since the true state was left out, the action counts as unseen. If that is impossible, too, the
    belief stays.
    """

    evidence: Evidence

    def after(self, joint: JointBelief, said: int, policy: Policy) -> JointBelief:
        """Return the belief after it, as in `Glimpse`."""
        for evidence in (self.evidence, Evidence.none(policy.pomdp.model.choices)):
            try:
                return joint.after(evidence, said, policy, works=True)
            except ImpossibleObservationError:
                continue
        return joint


@dataclass(frozen=True, eq=False)
class Reported:
    """An action that was seen, before which the person may have acted unseen, with probability `miss` each time."""

    evidence: Evidence
    miss: float = 0.0

    def after(self, joint: JointBelief, said: int, policy: Policy) -> JointBelief:
        """Return the belief after it, as in `Glimpse`."""
        return joint.after_some(self.evidence, said, policy, miss=self.miss)


@dataclass(frozen=True, eq=False)
class PerhapsMissed:
    """An action that may have been taken unseen, with a probability."""

    probability: float

    def after(self, joint: JointBelief, said: int, policy: Policy) -> JointBelief:
        """Return the belief after it, as in `Glimpse`."""
        acted = joint.after(Evidence.none(policy.pomdp.model.choices), said, policy)
        return joint.mixed(acted, self.probability).without(LEAST)
