"""Questions about people's goals: "is it this one?", about which goal, and whether the answer is worth its cost.

What an answer is worth is estimated one step ahead. `benefit` is the increase of a person's expected discounted return
by a robot that helps them towards a goal from now on, if it is theirs. A robot that is not told the goal helps towards
the one with the largest expected benefit, and is useless to a person with another goal. An answer is worth the
expected increase of that benefit. Free information from later actions would lower the worth, and is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..people.hidden_type import HiddenType
from ..person.beliefs import Beliefs
from ..person.fleet import Fleet
from ..person.joint_belief import JointBelief, expected_answers
from ..person.policy import OfRows, Policy
from ..person.qmdp import qmdp
from ..person.rows_of_people import by_model
from ..person.settings import Setting
from ..person.ties import NEAR, first_best
from .by_policy import ByPolicy
from .state import worth_of_actions


@dataclass(frozen=True, eq=False)
class GoalQuestion:
    """The question "is this your goal?", an observation of a person's type.

    Attributes
    ----------
    goal : int
        Number of the goal.
    hidden : HiddenType
        The types of the person.
    error : float
        Probability of a wrong answer.
    """

    goal: int
    hidden: HiddenType
    error: float

    def likelihood(self, yes: bool) -> Floats:
        """Return the likelihood of an answer under each type, shape (H, 1), for `Beliefs.answered`."""
        return np.where((self.hidden.goal_of == self.goal) == yes, 1 - self.error, self.error)[:, None]

    def answer(self, goal: int, uniform: float) -> bool:
        """Return the answer of a person with a goal, given by its number; a uniform number tells if it is wrong."""
        return bool((goal == self.goal) != (uniform < self.error))


class Asked(NamedTuple):
    """A question to a person of a team, and what the answer is worth above its cost, in cost units."""

    team: int
    person: int
    question: GoalQuestion
    worth: float


class Questions:
    """Questions to the people of some policies, of whom each pursues one of several goals.

    Parameters
    ----------
    policies : sequence of Policy
    cost : float
        Cost of a question, in cost units.
    error : float
        Probability of a wrong answer.
    """

    def __init__(self, policies: Sequence[Policy], cost: float, error: float = 0.0) -> None:
        self.policies, self.cost, self.error = policies, cost, error
        self._benefit: ByPolicy[OfRows] = ByPolicy(policies, benefit)

    @classmethod
    def of(cls, policies: Sequence[Policy], setting: Setting) -> Questions | None:
        """Return the questions to the people of some policies; None if the robots of the setting do not ask."""
        return None if setting.c_ask is None else cls(policies, setting.c_ask, setting.ask_error)

    def best(
        self, policy: Policy, x: NDArray[np.int64], belief: Floats, attention: Floats
    ) -> tuple[NDArray[np.int64], Floats]:
        """Return the goal to ask each person about, and the worth of the answer minus its cost, both of shape (N,).

        Parameters
        ----------
        policy : Policy
        x : int array, shape (N,)
        belief : float array, shape (N, H, T)
        attention : float array, shape (N,)
            Share of a robot's attention that each person gets (`Fleet.attention`).
        """
        each = policy.pomdp.hidden.marginal(belief * self._benefit[policy](x), "goal")
        return self._best(each, attention)

    def of_teams(
        self, beliefs: Beliefs, active: NDArray[np.bool_], model: NDArray[np.int64], fleet: Fleet
    ) -> list[Asked]:
        """Return the question in each team that is worth most, where it is worth its cost.

        Parameters
        ----------
        beliefs : Beliefs
            Those in the N K people of the teams.
        active : bool array, shape (N, K)
            Who is at work.
        model : int array, shape (N, K)
            Index of each person's policy.
        fleet : Fleet
            The robots of each team.
        """
        attention = fleet.attention(active.sum(axis=1))
        goal, worth = np.zeros(active.shape, dtype=np.int64), np.full(active.shape, -np.inf)
        for number, flat in by_model(model.reshape(-1), np.flatnonzero(active), len(self.policies)):
            at = np.unravel_index(flat, active.shape)
            goal[at], worth[at] = self.best(
                self.policies[number], beliefs.x[flat], beliefs.belief[flat], attention[at[0]]
            )
        teams = np.flatnonzero(active.any(axis=1))
        person = first_best(worth[teams])
        return [
            Asked(
                n,
                k,
                GoalQuestion(int(goal[n, k]), self.policies[model[n, k]].pomdp.hidden, self.error),
                float(worth[n, k]),
            )
            for n, k in zip(teams.tolist(), person.tolist(), strict=True)
            if worth[n, k] > NEAR
        ]

    def best_of(self, policy: Policy, joint: JointBelief, attention: float) -> tuple[int, float]:
        """Return the goal to ask a person about whose task state may be uncertain, and the worth minus the cost.

        Parameters
        ----------
        policy : Policy
        joint : JointBelief
        attention : float
            As in `best`.
        """
        each = policy.pomdp.hidden.marginal(joint.joint * self._benefit[policy](joint.rows(policy)), "goal").sum(axis=0)
        goal, worth = self._best(each[None], np.array([attention]))
        return int(goal[0]), float(worth[0])

    def _best(self, each: Floats, attention: Floats) -> tuple[NDArray[np.int64], Floats]:
        """Return what `best` does, given the expected benefit of help towards each goal, shape (N, G)."""
        asked = np.eye(each.shape[1], dtype=bool)
        likelihood = np.where(asked, 1 - self.error, self.error)  # of yes: the question, the goal
        yes, no = ((each[:, None] * chance).max(axis=2) for chance in (likelihood, 1 - likelihood))
        worth = (yes + no - each.max(axis=1, keepdims=True)) * attention[:, None] - self.cost
        goal = first_best(worth)
        return goal, worth[np.arange(len(each)), goal]


def benefit(policy: Policy) -> OfRows:
    """Return the benefit of a robot that knows a person's type and theta, as a function of rows."""
    helped, unhelped = policy.helped, policy.unhelped
    if helped is None:
        helped = qmdp(policy.pomdp).value_mdp.__getitem__
    return lambda x: np.maximum(helped(x) - unhelped(x), 0.0)


def worth_of_knowing(policy: Policy, joint: JointBelief) -> float:
    """Return what it is worth to know a person's task state, type and theta, in cost units.

    It is the increase of the QMDP value; infinite for other policies.
    """
    helped = policy.helped
    if helped is None:
        return float("inf")
    rows = joint.rows(policy)
    likeliest = rows[joint.probability.argmax()][None]
    known = float((joint.joint * helped(rows)).sum())
    return known - float(expected_answers(worth_of_actions, policy, likeliest, [joint]).max())
