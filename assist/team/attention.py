"""Attention switching, the team policy of the paper (Algorithm 1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..person.policy import Policy
from ..person.ties import first_best
from .assignment import assigned
from .state import BASE, TeamAction, TeamState


@dataclass(frozen=True)
class AttentionSwitching:
    """The paper's Algorithm 1.

    For each person k, the action of their own policy is scored by its advantage over a reference, minus the cost of
    moving there:

        score_k = Q^k(b^k, a^k) - reference_k - c_move * distance(location, k)

    A robot whose waiting costs something pays for it where it is with somebody at work and does nothing. So nothing is
    charged in the reference of others, and a robot that waits saves the charge wherever it acts.

    The robots act on the largest sum of scores, each for another person; a robot does nothing without a person whose
    score is positive. The paper's text allows two readings. Here the reference is the value of doing
    nothing *once* and following the person's policy from the next step on. `attention_never` has the other one.
    """

    uses_belief, weighs_costs = True, True

    def prepare(self, policy: Policy) -> None:
        """Compute now the data about the people of a policy."""
        policy.prepare()

    def reference(self, team: TeamState, q: Floats) -> Floats:
        """Return the reference of each person's score, shape (N, U, K), or (N, 1, K) for all kinds of robots.

        `q` are the Q-values for each kind, as in `TeamState.by_kind`.
        """
        return q[..., 0] + team.fleet.waiting[None, : q.shape[1], None]

    def values(self, team: TeamState, q: Floats) -> Floats:
        """Return what robot actions are scored by, in the shape of `q`: these Q-values for each kind, as they are."""
        del team
        return q

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Return the assignment of robots to people with the largest sum of positive scores, in every team."""
        action, score = self.scores(team)
        return team.act(assigned(team, score), action)

    def scores(self, team: TeamState) -> tuple[NDArray[np.int64], Floats]:
        """Return each robot's action towards each person, and its score, both of shape (N, M, K)."""
        q = team.by_kind(team.q_values())
        each = self.values(team, q)
        action = first_best(each)
        worth = np.take_along_axis(each, action[..., None], axis=3)[..., 0]  # faster than a maximum over so few entries
        # People who are not active score minus infinity. Doing nothing is no reason to move, even if its value exceeds
        # that of never helping again.
        useful = team.active[:, None] & (action > 0)
        score = np.subtract(worth, self.reference(team, each), out=np.full(worth.shape, -np.inf), where=useful)
        kind, there = team.fleet.kinds.of_robot, np.maximum(team.location, 0)
        waits = (team.location != BASE) & np.take_along_axis(team.active, there, axis=1)
        saved = np.where(waits, team.fleet.waiting[kind], 0.0)
        return action[:, kind], score[:, kind] - team.to() + saved[..., None]
