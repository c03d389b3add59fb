"""Whom to help: team policies.

A team policy is a function of what the robot knows (`TeamState`, many teams at a time) that returns where
the robot goes and what it suggests there (`TeamAction`). Here are the paper's three: no assistance, reactive
assistance, and attention switching (its Algorithm 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .human import Floats
from .pomdp import Policy

BASE = -1
"""The robot's place before it has gone to anybody; also the last row of a distance matrix."""

NOBODY = -1


@dataclass(frozen=True)
class TeamState:
    """What the robot knows about N teams of K people each.

    Attributes
    ----------
    x : int array, shape (N, K)
        State of each person's task.
    active : bool array, shape (N, K)
        Who has not finished.
    erred : bool array, shape (N, K)
        Whose last action did not lower the exact cost-to-go.
    location : int array, shape (N,)
        Whom the robot is with, or `BASE`.
    model : int array, shape (N, K)
        Which of the policies given to the simulation models each person.
    belief : float array, shape (N, K, B, T), or None
        None where the policy has said that it does not use it.
    """

    x: NDArray[np.int64]
    active: NDArray[np.bool_]
    erred: NDArray[np.bool_]
    location: NDArray[np.int64]
    model: NDArray[np.int64]
    belief: Floats | None


@dataclass(frozen=True)
class TeamAction:
    """What the robot does in each of N teams.

    Attributes
    ----------
    person : int array, shape (N,)
        To whom it goes, or `NOBODY`: then it stays where it is and says nothing.
    robot : int array, shape (N,)
        The robot action in that person's POMDP; 0 is to say nothing.
    """

    person: NDArray[np.int64]
    robot: NDArray[np.int64]


class TeamPolicy(Protocol):
    """Any callable of this form; an attribute `uses_belief = False` saves the filtering."""

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Choose for N teams at a time."""
        ...


def distances(places: int) -> Floats:
    """Give the default distance matrix, shape (K + 1, K + 1): 1 between any two places, the base last."""
    return 1.0 - np.eye(places + 1)


@dataclass(frozen=True)
class NoAssistance:
    """The paper's base case: the robot does nothing."""

    uses_belief = False

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Choose nothing for every team."""
        nobody = np.full(len(team.x), NOBODY, dtype=np.int64)
        return TeamAction(nobody, np.zeros_like(nobody))


@dataclass(frozen=True)
class Reactive:
    """Go to a person whose last action was no progress, and suggest an optimal action.

    Where several have erred the robot stays with the person it is with, if that is one of them, and
    takes the first otherwise. In a dead end there is nothing to suggest.
    """

    policies: Sequence[Policy]
    uses_belief = False

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Choose a person who has erred, in every team that has one."""
        robot = np.zeros_like(team.x)
        for group, policy in enumerate(self.policies):
            rows = team.active & team.erred & (team.model == group)
            robot[rows] = policy.pomdp.first_optimal[team.x[rows]]
        wanted = robot > 0
        teams = np.arange(len(team.x))
        stay = (team.location >= 0) & wanted[teams, team.location]
        person = np.where(stay, team.location, np.where(wanted.any(axis=1), wanted.argmax(axis=1), NOBODY))
        return TeamAction(person, np.where(person >= 0, robot[teams, person], 0))


@dataclass(frozen=True)
class AttentionSwitching:
    """The paper's Algorithm 1.

    For each person k the action of their own policy is scored by what it is worth more than doing
    nothing once, minus what going there costs:

        score_k = Q^k(b^k, a^k) - Q^k(b^k, nothing) - c_move * distance(location, k)

    The largest score is acted on, and nothing is done where none is positive.

    Attributes
    ----------
    policies : sequence of Policy
    c_move : float
        Cost of moving by a distance of 1, in cost units.
    distance : float array, shape (K + 1, K + 1)
        Distances between the people's places; the base last.
    """

    policies: Sequence[Policy]
    c_move: float
    distance: Floats
    uses_belief = True

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Choose the person with the largest positive score, in every team that has one."""
        robot, score = self.scores(team)
        teams = np.arange(len(team.x))
        best = score.argmax(axis=1)
        person = np.where(score[teams, best] > 0, best, NOBODY)
        return TeamAction(person, np.where(person >= 0, robot[teams, best], 0))

    def scores(self, team: TeamState) -> tuple[NDArray[np.int64], Floats]:
        """Give each person's robot action and its score, both of shape (N, K)."""
        if team.belief is None:
            raise ValueError("attention switching needs the team's beliefs")
        robot = np.zeros_like(team.x)
        score = np.full(team.x.shape, -np.inf)
        for group, policy in enumerate(self.policies):
            rows = team.active & (team.model == group)
            if rows.any():
                q = policy.q_values(team.x[rows], team.belief[rows])
                robot[rows] = q.argmax(axis=1)
                score[rows] = q.max(axis=1) - q[:, 0]
        places = np.arange(team.x.shape[1])
        return robot, score - self.c_move * self.distance[team.location[:, None], places]
