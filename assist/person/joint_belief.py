"""The belief in a person whose actions are not all seen as they are: over the task state, the type and theta together.

The states that are possible are few at first, and grow with each uncertain observation. A `JointBelief` has an entry
for each of them; improbable ones are left out, and their probability is reported. It has situations (`person.rows`):
rows may come and go, and those of its situations are held where it is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.belief import ImpossibleObservationError
from ..people.decision import NOTHING, Floats
from ..people.type_kernels import is_mistake, leave_out_reached
from .belief_filter import posterior
from .evidence import Evidence
from .policy import Policy
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays

Ints = NDArray[np.int64]

LEAST = 1e-6
"""Probability below which a state is left out. It keeps some tens of states in a task of a thousand."""


@dataclass(frozen=True, eq=False)
class JointBelief:
    """A belief over task states and types of a person.

    Attributes
    ----------
    situations : int array, shape (S,)
        The possible states or, with terms, pairs of a state and a memory.
    joint : float array, shape (S, H, T)
        Probability of each state with each type and theta; the sum is 1.
    erred : float
        Probability that the last action was a mistake.
    pruned : float
        Sum of the probabilities that were left out so far.
    evidence : float
        Probability of what was seen last, before it was seen.
    """

    situations: Ints
    joint: Floats
    erred: float = 0.0
    pruned: float = 0.0
    evidence: float = 1.0

    @classmethod
    def at(cls, situation: int, belief: Floats) -> JointBelief:
        """Return the belief in a person whose situation is known, with a belief, shape (H, T)."""
        return cls(np.array([situation]), belief[None].copy())

    def rows(self, policy: Policy) -> Ints:
        """Return the rows of the situations in the person's problem, shape (S,), and hold them."""
        return policy.rows(self.situations, self)

    @cached_property
    def probability(self) -> Floats:
        """The probability of each possible state, shape (S,)."""
        return np.asarray(self.joint.sum(axis=(1, 2)))

    @property
    def likeliest(self) -> int:
        """The most probable situation."""
        return int(self.situations[self.probability.argmax()])

    @property
    def belief(self) -> Floats:
        """The belief in the person, shape (H, T)."""
        return np.asarray(self.joint.sum(axis=0))

    def after(
        self, evidence: Evidence, suggestion: int, policy: Policy, *, least: float = LEAST, works: bool = False
    ) -> JointBelief:
        """Return the belief after the person has acted once.

        People who have reached their goal do nothing, so that nothing is seen of them.

        Parameters
        ----------
        evidence : Evidence
            What was seen of the action.
        suggestion : int
            The ground action that was suggested before; `NOTHING` for none. In states in which it is not applicable,
            it has no effect.
        policy : Policy
            The policy for the person, which has their problem.
        least : float
            States of a lower probability are left out.
        works : bool
            Whether the person is known not to have reached the goal by this action.

        Raises
        ------
        ImpossibleObservationError
            What was seen has probability zero.
        """
        x = self.rows(policy)
        spoken = np.zeros(len(x), dtype=np.int64)
        if suggestion >= 0:
            spoken = _last(said_in(policy.pomdp, x) == suggestion)
            policy.problem.effects(x, spoken)
        choices = policy.pomdp.model.choices
        to, joint, erred = _advance(
            x, self.joint, spoken, evidence, choices.actions, choices.goals.optimal, policy.arrays, works
        )
        total = float(joint.sum())
        if not total > 0:
            raise ImpossibleObservationError("what was seen is impossible in all states that have been probable")
        found = JointBelief(policy.situations(to), joint / total, float(erred / total), self.pruned, total)
        return found.without(least)

    def after_some(self, evidence: Evidence, suggestion: int, policy: Policy, *, miss: float) -> JointBelief:
        """Return the belief after something was seen, before which the person may have acted unseen.

        Each action is missed with probability `miss`, so that the number of unseen ones is geometric. The first action
        answers the suggestion. Other arguments are as in `after`.

        Raises
        ------
        ImpossibleObservationError
            What was seen has probability zero.
        """
        return self._seen(self._unseen(suggestion, policy, miss), evidence, policy, miss)

    def after_each(self, evidence: Evidence, suggestion: int, policy: Policy, *, miss: float) -> dict[int, JointBelief]:
        """Return what `after_some` does for each ground action that may have been taken, if it was that one."""
        before, found = self._unseen(suggestion, policy, miss), dict[int, JointBelief]()
        rows = np.unique(np.concatenate([belief.rows(policy) for _, belief, _ in before]))
        choices = policy.pomdp.model.choices
        for action in np.unique(choices.actions[rows][choices.applicable[rows]]).tolist():
            with suppress(ImpossibleObservationError):
                found[action] = self._seen(before, evidence._replace(only=action), policy, miss)
        return found

    def _unseen(self, suggestion: int, policy: Policy, miss: float) -> list[tuple[float, JointBelief, int]]:
        """Return the belief after each number of unseen actions, with its weight and the suggestion that is open."""
        found = [(1.0, self, suggestion)]
        while (share := found[-1][0] * miss) >= LEAST:
            _, before, said = found[-1]
            unseen = Evidence.none(policy.pomdp.model.choices)
            found.append((share, before.after(unseen, said, policy), NOTHING))
        return found

    @staticmethod
    def _seen(
        before: Sequence[tuple[float, JointBelief, int]], evidence: Evidence, policy: Policy, miss: float
    ) -> JointBelief:
        found, total = list[JointBelief](), 0.0
        for share, belief, suggestion in before:
            with suppress(ImpossibleObservationError):
                seen = belief.after(evidence, suggestion, policy)
                total += share * seen.evidence
                found = [found[0].mixed(seen, share * seen.evidence / total)] if found else [seen]
        if not found:
            raise ImpossibleObservationError("what was seen is impossible in all states that have been probable")
        return replace(found[0].without(LEAST), evidence=total * (1 - miss))

    def answered(self, likelihood: Floats) -> JointBelief:
        """Return the belief after an answer, whose likelihood has a shape that broadcasts with (S, H, T).

        Raises
        ------
        ImpossibleObservationError
            The answer has probability zero.
        """
        joint = self.joint * likelihood
        total = float(joint.sum())
        if not total > 0:
            raise ImpossibleObservationError("the answer is impossible")
        return replace(self, joint=joint / total, evidence=total).without(LEAST)

    def without(self, least: float) -> JointBelief:
        """Return the belief without states of a probability below `least`."""
        keep = self.probability >= least
        if keep.all():
            return self
        kept = self.probability[keep].sum()
        return replace(
            self, situations=self.situations[keep], joint=self.joint[keep] / kept, pruned=self.pruned + float(1 - kept)
        )

    def states(self, policy: Policy) -> dict[int, float]:
        """Return the probability of each possible task state."""
        found: dict[int, float] = {}
        states = policy.problem.states(self.situations).tolist()
        for state, probability in zip(states, self.probability.tolist(), strict=True):
            found[state] = min(found.get(state, 0.0) + probability, 1.0)  # a sum of rounded numbers may be above 1
        return found

    def finished(self, policy: Policy) -> float:
        """Return the probability that the person has reached their goal."""
        x, m = self.rows(policy), policy.arrays
        reached = m.goal[:, x].T[:, m.goal_of]
        return float(self.joint.sum(axis=2)[reached].sum())

    def mixed(self, other: JointBelief, share: float) -> JointBelief:
        """Return the mixture of this belief and another one of weight `share`."""
        situations, row = np.unique(np.concatenate([self.situations, other.situations]), return_inverse=True)
        joint = np.zeros((len(situations), *self.joint.shape[1:]))
        np.add.at(joint, row, np.concatenate([(1 - share) * self.joint, share * other.joint]))
        pruned = (1 - share) * self.pruned + share * other.pruned
        return JointBelief(situations, joint, (1 - share) * self.erred + share * other.erred, pruned)


def same_suggestions(pomdp: AssistPOMDP, of: Ints, there: Ints) -> Ints:
    """Return the robot actions that suggest the same ground actions in other states, shape (N, R).

    The entry of each robot action of the states `of` is a robot action of the states `there`, 0 where the suggested
    action is not applicable. Both have the shape (N,).
    """
    asked, offered = said_in(pomdp, of), said_in(pomdp, there)
    same = (asked[:, :, None] == offered[:, None]) & (asked != NOTHING)[:, :, None]
    return np.asarray(same.argmax(axis=2))


def said_in(pomdp: AssistPOMDP, x: Ints) -> Ints:
    """Return the ground action that each robot action suggests in some states, shape (N, R); `NOTHING` for others."""
    slot = pomdp.suggested[x]
    return np.where(slot == NOTHING, NOTHING, pomdp.model.choices.actions[x[:, None], np.maximum(slot, 0)])


def expected_answers(ask: Any, policy: Policy, x: Ints, joint: Sequence[JointBelief]) -> Floats:
    """Return the expected answers about some people, shape (N, W), over the states that are possible for each.

    With R robot actions, the last R - 1 columns of an answer are those of suggestions, if it has R columns or more, and
    the one before is that of a robot that is there and says nothing. The columns of suggestions are arranged as in the
    states `x`.

    Parameters
    ----------
    ask : callable
        As in `beliefs.Ask`.
    policy : Policy
    x : int array, shape (N,)
        A row of each person.
    joint : sequence of JointBelief
    """
    person = np.repeat(np.arange(len(x)), [len(one.situations) for one in joint])
    states = np.concatenate([one.rows(policy) for one in joint])
    weight = np.concatenate([one.probability for one in joint])
    pomdp = policy.pomdp
    answers = ask(policy, states, np.concatenate([one.joint for one in joint]) / weight[:, None, None])
    suggestions = pomdp.suggested.shape[1] - 1
    head = answers.shape[1] - suggestions
    if head >= 1 and suggestions:
        there = same_suggestions(pomdp, x[person], states)[:, 1:]
        # Who does not hear a suggestion still has a robot that is busy: it does not pay for doing nothing.
        silent = answers[:, head - 1, None] + (pomdp.robot_costs[states, :1] - pomdp.robot_costs[x[person], 1:])
        said = np.where(there > 0, np.take_along_axis(answers, head - 1 + there, axis=1), silent)
        offered = np.arange(1, suggestions + 1) < pomdp.robot_actions[x[person], None]
        answers = np.concatenate([answers[:, :head], np.where(offered, said, -np.inf)], axis=1)
    values = np.zeros((len(x), answers.shape[1]))
    np.add.at(values, person, weight[:, None] * answers)
    return values


def _last(which: NDArray[np.bool_]) -> Ints:
    """Return the last column that is true in each row, shape (N,); 0 if there is none."""
    last = which.shape[1] - 1 - which[:, ::-1].argmax(axis=1)
    return np.where(which.any(axis=1), last, 0)


@njit(inner=True)
def _chance(likelihood: Floats, seen: int, rate: float, action: int, count: int, applicable: bool) -> float:
    """Return the likelihood of what was seen, if an action was taken in a state with a number of choices."""
    if rate < 0.0:
        return likelihood[action]
    if count == 1:
        return 1.0 if action == seen else 0.0
    if action == seen:
        return 1.0 - rate
    return rate / (count - 1) if applicable else 0.0


@njit(nogil=True)
def _advance(
    x: Ints, joint: Floats, spoken: Ints, evidence: Evidence, actions: Ints, optimal: NDArray[np.bool_],
    m: ProblemArrays, works: bool,
) -> tuple[Ints, Floats, float]:  # fmt: skip
    """Return the possible rows after an action, their unnormalised probabilities, and that of a mistake.

    Whole-array forms (a[:] = b) would double the time that compiling takes, as in `hsvi`.
    """
    likelihood, seen, rate, unseen, only = evidence
    types, thetas, number, found = joint.shape[1], joint.shape[2], 0, 0
    for s in range(len(x)):
        number += m.counts[x[s]] + 1
    row = np.full(len(m.counts), -1)
    to = np.empty(min(number, len(m.counts)), dtype=np.int64)
    moved, erred = np.zeros((len(to), types, thetas)), 0.0
    working, after = np.empty((types, thetas)), np.empty((types, thetas))
    for s in range(len(x)):
        origin, applicable = x[s], False
        for a in range(m.counts[origin]):
            applicable |= actions[origin, a] == seen
        for h in range(types):
            for t in range(thetas):
                working[h, t] = joint[s, h, t]
            if not m.goal[m.goal_of[h], origin]:
                continue
            if unseen and not works:  # who has finished does nothing
                if row[origin] < 0:
                    row[origin], to[found] = found, origin
                    found += 1
                for t in range(thetas):
                    moved[row[origin], h, t] += joint[s, h, t]
            for t in range(thetas):
                working[h, t] = 0.0
        for a in range(m.counts[origin]):
            chance = _chance(likelihood, seen, rate, actions[origin, a], m.counts[origin], applicable)
            if chance == 0.0 or (only != -2 and actions[origin, a] != only):
                continue
            target = m.targets[origin, a]
            mass = posterior(working.reshape(types * thetas), after.reshape(types * thetas), origin, spoken[s], a, m)
            if works:
                mass = leave_out_reached(after.reshape(types * thetas), mass, target, m.goal, m.goal_of)
            if mass == 0.0:
                continue
            if row[target] < 0:
                row[target], to[found] = found, target
                found += 1
            for h in range(types):
                for t in range(thetas):
                    moved[row[target], h, t] += chance * after[h, t]
            if is_mistake(optimal[origin, a], joint[s], origin, m.goal, m.goal_of):
                erred += chance * mass
    return to[:found], moved[:found], erred
