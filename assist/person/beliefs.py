"""What a robot knows of people's tasks and types, and how it learns from what they do and say.

There is one interface with two storages. `Seen` is for people whose task states are known: dense arrays. `Hidden` is
for people whose actions may be missed or confused: it adds a distribution over task states for each person whose state
is uncertain. In both, the type is uncertain, and with it a goal that is unknown. Whoever holds beliefs does not ask
which of the two they are:

- `observe` updates them by a step of a simulation, `update` by actions that were seen as they are;
- `told` updates them by an answer, whose likelihood under each type is known;
- `expected` answers a question about people, as an expected value over what is uncertain;
- `x` has the most probable state of each person, `belief` the belief in their type, and `erred` whether their last
  action was probably a mistake; `finished` is the probability that they have reached their goal.

People have numbers from 0 to P - 1, in the order of the arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planner.system.compiling import ReadableFirst

from ..people.belief import ImpossibleObservationError, moved
from ..people.choices import Choices
from ..people.decision import NOTHING, Floats
from .belief_filter import update_seen
from .belief_update import mistaken, updated, without_reached
from .evidence import Evidence
from .joint_belief import JointBelief, expected_answers, said_in, same_suggestions
from .observation_model import ObservationModel
from .policy import Policy
from .pomdp import AssistPOMDP
from .problem_arrays import Acts, ProblemArrays, read_only

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

Ask = Callable[[Policy, Ints, Floats], Floats]
"""A function of a policy, states, shape (m,), and beliefs, shape (m, H, T), that returns numbers, shape (m, W)."""


@dataclass(frozen=True, eq=False)
class PersonModel:
    """The robot's model of a person, in which beliefs about them are updated.

    Attributes
    ----------
    policy : Policy
        Their policy, whose problem on all rows so far is that of the other attributes.
    pomdp : AssistPOMDP
    arrays : ProblemArrays
        The problem, as compiled code reads it.
    optimal : bool array, shape (n, A, G)
        Whether each choice is optimal for each goal.
    possible : float array, shape (H, 1)
        Probability of each type at the beginning: what a robot without beliefs knows.
    """

    policy: Policy
    pomdp: AssistPOMDP
    arrays: ProblemArrays
    optimal: Bools
    possible: Floats

    @classmethod
    def of(cls, policy: Policy) -> PersonModel:
        """Return the model of a policy's person."""
        pomdp, arrays = policy.pomdp, policy.arrays
        possible = read_only(pomdp.prior.sum(axis=1, keepdims=True))
        return cls(policy, pomdp, arrays, read_only(pomdp.model.choices.goals.optimal), possible)

    @property
    def choices(self) -> Choices:
        """The choices in each state."""
        return self.pomdp.model.choices


Groups = Iterable[tuple[PersonModel, Ints]]
"""Models, with the numbers of the people who have each."""


class Beliefs(Protocol):
    """What a robot knows of P people; see the module's docstring."""

    x: Ints
    belief: Floats
    erred: Bools

    def observe(self, acts: Acts, said: Ints, groups: Groups, draw: Callable[[int], Floats]) -> None:
        """Update the beliefs in people who have acted, given by their models and numbers.

        Parameters
        ----------
        acts : Acts
            What all P people did.
        said : int array, shape (P,)
            What the robot meant to say: a robot action in the most probable state.
        groups : iterable of pairs of PersonModel and int array
        draw : callable
            Returns uniform numbers, shape (P,), of a kind of `CommonRandomNumbers`.
        """
        ...

    def update(self, rows: Ints, acts: Acts, model: PersonModel) -> None:
        """Update the beliefs in some people of one model, shape (m,), by actions that were seen as they are."""
        ...

    def moved(self, rows: Ints, low: Ints, weight: Floats) -> None:
        """Move theta of some people, shape (m,), whose states are known, as `people.belief.moved` does."""
        ...

    def told(self, person: int, likelihood: Floats, policy: Policy) -> None:
        """Update the belief in a person with a policy by an answer.

        Parameters
        ----------
        person : int
        likelihood : float array
            Likelihood of the answer, in a shape that broadcasts with (S, H, T), for S states.
        policy : Policy

        Raises
        ------
        ImpossibleObservationError
            The answer has probability 0. Nothing has changed.
        """
        ...

    def expected(self, ask: Ask, policy: Policy, rows: Ints) -> Floats:
        """Return the answers about some people of one policy, shape (m, W), expected over what is uncertain.

        Parameters
        ----------
        ask : Ask
        policy : Policy
        rows : int array, shape (m,)
            Ascending numbers of the people.
        """
        ...

    def finished(self, person: int, policy: Policy) -> float:
        """Return the probability that a person with a policy has reached their goal."""
        ...

    def heard(self, robot: Ints, x: Ints, groups: Iterable[tuple[AssistPOMDP, Ints]]) -> Ints:
        """Return what people hear: robot actions in their states `x`, shape (P,), of those in the most probable one."""
        ...

    def joint(self, person: int, policy: Policy) -> JointBelief:
        """Return the belief in a person with a policy, over places and types together."""
        ...

    @property
    def pruned(self) -> Floats:
        """The probability of states that were left out, summed over the updates of each person, shape (P,)."""
        ...

    def of(self, people: Ints) -> Beliefs:
        """Return the beliefs in some people, given by their numbers; changes of these do not show there."""
        ...

    @property
    def sees_states(self) -> bool:
        """Whether all actions are seen as they are, so that task states are known."""
        ...


class Seen:
    """Beliefs in people whose task states are known.

    Parameters
    ----------
    x : int array, shape (P,)
        The states. The array is kept, and `observe` does not change it: in a simulation it is the array of people's
        rows, in which `dynamics.act` has moved them before.
    belief : float array, shape (P, H, T)
        The beliefs, which are kept likewise; without rows for a robot that has none.
    erred : bool array, shape (P,)
    """

    sees_states: bool = True

    def __init__(self, x: Ints, belief: Floats, erred: Bools) -> None:
        self.x, self.belief, self.erred = x, belief, erred

    def observe(self, acts: Acts, said: Ints, groups: Groups, draw: Callable[[int], Floats]) -> None:
        """Update the beliefs, as in `Beliefs`."""
        del said, draw
        for model, rows in groups:
            self.update(rows, acts.of(rows), model)

    def update(self, rows: Ints, acts: Acts, model: PersonModel) -> None:
        """Update the beliefs by actions that were seen, as in `Beliefs`."""
        _update(rows, acts, self.belief, self.erred, model.optimal, model.possible, model.arrays)

    def moved(self, rows: Ints, low: Ints, weight: Floats) -> None:
        """Move theta of some people, as in `Beliefs`."""
        if len(self.belief):
            self.belief[rows] = moved(self.belief[rows], low, weight)

    def told(self, person: int, likelihood: Floats, policy: Policy) -> None:
        """Update a belief by an answer, as in `Beliefs`."""
        del policy
        joint = self.belief[person] * likelihood
        total = joint.sum()
        if not total > 0:
            raise ImpossibleObservationError("the answer is impossible; expected an error rate above 0")
        self.belief[person] = joint / total

    def expected(self, ask: Ask, policy: Policy, rows: Ints) -> Floats:
        """Return the answers about some people, as in `Beliefs`."""
        if not len(self.belief):
            raise ValueError("the policy has said that it uses no beliefs")
        if len(rows) == len(self.x):  # all of them, so that nothing needs to be copied
            return ask(policy, self.x, self.belief)
        return ask(policy, self.x[rows], self.belief.take(rows, axis=0))  # faster than by an index

    def finished(self, person: int, policy: Policy) -> float:
        """Return the probability that a person has reached their goal, as in `Beliefs`."""
        reached = policy.arrays.goal[:, self.x[person]]
        return float(reached[0]) if reached.all() == reached.any() else self.joint(person, policy).finished(policy)

    def heard(self, robot: Ints, x: Ints, groups: Iterable[tuple[AssistPOMDP, Ints]]) -> Ints:
        """Return what people hear, as in `Beliefs`: the very actions."""
        del x, groups
        return robot

    def joint(self, person: int, policy: Policy) -> JointBelief:
        """Return the belief in a person over places and types, as in `Beliefs`."""
        return JointBelief.at(int(policy.places(self.x[person : person + 1])[0]), self.belief[person])

    @property
    def pruned(self) -> Floats:
        """The probability of states that were left out: none, shape (P,)."""
        return np.zeros(len(self.x))

    def of(self, people: Ints) -> Seen:
        """Return the beliefs in some people, as in `Beliefs`."""
        belief = self.belief.take(people, axis=0) if len(self.belief) else self.belief
        return Seen(self.x[people], belief, self.erred[people])


class Hidden(Seen):
    """Beliefs in people whose actions may be missed or confused, so that their task states may be uncertain.

    The arrays have the most probable state of each person and the belief in their type over all states.

    Parameters
    ----------
    x, belief, erred
        As in `Seen`.
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
        uniform = np.stack([draw(5), draw(6)], axis=1)
        for model, people in groups:
            rows = people[(acts.slot[people] >= 0) & acts.goes_on[people]]
            words = np.take_along_axis(said_in(model.pomdp, self.x[rows]), said[rows, None], axis=1)[:, 0]
            seen = [
                self.sight.draw(model.choices, int(acts.x[n]), int(acts.slot[n]), uniform[n]) for n in rows.tolist()
            ]
            self.update_by(rows, words, [InOneStep(self.sight.evidence(model.choices, one)) for one in seen], model)

    def update(self, rows: Ints, acts: Acts, model: PersonModel) -> None:
        """Update the beliefs by actions that were seen, as in `Beliefs`, also where the state before was uncertain."""
        uncertain = np.array([k in self.joints for k in rows.tolist()], dtype=bool)
        if not uncertain.any():
            super().update(rows, acts, model)
            return
        super().update(rows[~uncertain], acts.of(np.flatnonzero(~uncertain)), model)
        at, actions = np.flatnonzero(uncertain), model.choices.actions
        x, robot, slot = acts.x[at], acts.robot[at], acts.slot[at]
        words = np.take_along_axis(said_in(model.pomdp, x), robot[:, None], axis=1)[:, 0]
        seen = [Reported(Evidence.of(model.choices, {action: 1.0})) for action in actions[x, slot].tolist()]
        self.update_by(rows[at], words, seen, model)

    def update_by(self, rows: Ints, said: Ints, evidence: Sequence[Glimpse], model: PersonModel) -> None:
        """Update the beliefs in some people of one model by what was seen of their actions.

        Parameters
        ----------
        rows : int array, shape (m,)
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
        for k, words, glimpse in zip(rows.tolist(), said.tolist(), evidence, strict=True):
            self._put(k, glimpse.after(self.joint(k, model.policy), words, model.policy), model.policy)

    def _put(self, person: int, joint: JointBelief, policy: Policy) -> None:
        """Set the belief in a person over places and types."""
        self.joints[person], self.x[person] = joint, joint.rows(policy)[joint.probability.argmax()]
        self.belief[person], self.erred[person] = joint.belief, joint.erred > 1 / 2

    def told(self, person: int, likelihood: Floats, policy: Policy) -> None:
        """Update a belief by an answer, as in `Beliefs`."""
        if person not in self.joints:
            super().told(person, likelihood, policy)
        else:
            self._put(person, self.joints[person].told(likelihood), policy)

    def expected(self, ask: Ask, policy: Policy, rows: Ints) -> Floats:
        """Return the answers about some people, as in `Beliefs`.

        They are expected values over the possible states (QMDP). A suggestion is one that is applicable in the most
        probable state. Where it is not applicable, it costs the same and has no effect.
        """
        if not self.joints or not any(k in self.joints for k in rows.tolist()):
            return super().expected(ask, policy, rows)
        return expected_answers(ask, policy, self.x[rows], [self.joint(k, policy) for k in rows.tolist()])

    def finished(self, person: int, policy: Policy) -> float:
        """Return the probability that a person has reached their goal, as in `Beliefs`."""
        known = self.joints.get(person)
        return super().finished(person, policy) if known is None else known.finished(policy)

    def heard(self, robot: Ints, x: Ints, groups: Iterable[tuple[AssistPOMDP, Ints]]) -> Ints:
        """Return what people hear, as in `Beliefs`; nothing, where the suggested action is not applicable."""
        there = np.zeros_like(robot)
        for pomdp, rows in groups:
            same = same_suggestions(pomdp, self.x[rows], x[rows])
            there[rows] = np.take_along_axis(same, robot[rows, None], axis=1)[:, 0]
        return there

    def joint(self, person: int, policy: Policy) -> JointBelief:
        """Return the belief in a person over places and types, as in `Beliefs`."""
        return self.joints.get(person) or super().joint(person, policy)

    def of(self, people: Ints) -> Hidden:
        """Return the beliefs in some people, as in `Beliefs`."""
        known = enumerate(people.tolist()) if self.joints else ()
        own = {n: self.joints[k] for n, k in known if k in self.joints}
        return Hidden(self.x[people], self.belief[people], self.erred[people], self.sight, own)


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
        return joint.mixed(acted, self.probability).without(1e-6)


def update_readable(
    rows: Ints, acts: Acts, belief: Floats, erred: Bools, optimal: Bools, possible: Floats, m: ProblemArrays
) -> None:
    """Do what `belief_filter.update_seen` does, in numpy: the definition of `Seen.update`."""
    erred[rows] = False
    acted = np.flatnonzero(acts.slot != NOTHING)
    rows, (x, robot, slot, goes_on) = rows[acted], acts.of(acted)
    if not len(rows):
        return
    acting = m.afterstate[x, robot]
    known = belief[rows] if len(belief) else possible[None]
    erred[rows] = mistaken(optimal[acting, slot], known, acting, m)
    if not len(belief):
        return
    after, y = updated(known, x, robot, slot, m), m.targets[acting, slot]
    on = np.flatnonzero(goes_on & m.goal[:, y].any(axis=0))
    after[on] = without_reached(after[on], y[on], m)
    belief[rows] = after


def _work(rows: Ints, _acts: Acts, belief: Floats, *_: object) -> float:
    """Return the work of `update_readable`, in nanoseconds."""
    return 60_000 + len(rows) * 20 * (belief[0].size if len(belief) else 1)


_update = ReadableFirst(update_readable, update_seen, _work)
