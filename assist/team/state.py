"""What a team is to its robot: the people's tasks, the way between them, and what a policy for them looks like.

A team policy is a function of what the robot knows (`TeamState`, many teams at a time) that returns where
the robot goes and what it says there (`TeamAction`). `assist.team.attention` has the paper's; any callable of
the same form will do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from ..people.human import Floats
from ..person.pomdp import Policy

BASE = -1
"""The robot's place before it has gone to anybody; also the last row of a distance matrix."""

NOBODY = -1


@dataclass(frozen=True)
class Travel:
    """The way between K people's places and the base, which comes last.

    Attributes
    ----------
    distance : float array, shape (K + 1, K + 1)
    steps : int array, shape (K + 1, K + 1)
        How many steps the robot is under way. With 0 it speaks in the step in which it leaves.
    c_move : float
        Cost of moving by a distance of 1, in cost units; paid on leaving.
    """

    distance: Floats
    steps: NDArray[np.int64]
    c_move: float

    def __post_init__(self) -> None:
        if not 0 <= self.c_move < math.inf:
            raise ValueError(f"c_move {self.c_move:g}: expected 0 or more")
        if self.distance.ndim != 2 or self.distance.shape[0] != self.distance.shape[1] or len(self.distance) < 2:
            raise ValueError(
                f"distance, shape {self.distance.shape}: expected a square, one row for each place and base"
            )
        if not ((self.distance >= 0) & np.isfinite(self.distance)).all() or self.distance.diagonal().any():
            raise ValueError("distance: expected 0 from each place to itself, and 0 or more to the others")
        if self.steps.shape != self.distance.shape or (self.steps < 0).any() or self.steps.diagonal().any():
            raise ValueError("steps: expected one number of 0 or more for each distance, and 0 to stay")
        self.distance.flags.writeable = False
        self.steps.flags.writeable = False

    @classmethod
    def of(
        cls, places: int, *, c_move: float = 0.5, travel_time: float = 0.0, distance: ArrayLike | None = None
    ) -> Travel:
        """Describe the way between so many people.

        Parameters
        ----------
        places : int
            K.
        travel_time : float
            Steps that a distance of 1 takes; what is left over counts as a whole step.
        distance : array, shape (K + 1, K + 1), optional
            1 between any two places unless given.
        """
        if not 0 <= travel_time < math.inf:
            raise ValueError(f"travel_time {travel_time:g}: expected 0 or more")
        if distance is None:
            row = np.ones(2 * places + 1)
            row[places] = 0.0
            return cls(_windows(row), _windows(_whole_steps(row * travel_time)), c_move)
        matrix = np.array(distance, dtype=float)
        if matrix.shape != (places + 1, places + 1):
            raise ValueError(
                f"distance, shape {matrix.shape}: expected ({places + 1}, {places + 1}), {places} people and the base"
            )
        return cls(matrix, _whole_steps(matrix * travel_time), c_move)

    def __len__(self) -> int:
        return len(self.distance) - 1

    @property
    def entry(self) -> Floats:
        """The least that it costs to come to each person from anywhere else, shape (K,)."""
        return self.c_move * np.array([np.delete(column, k).min() for k, column in enumerate(self.distance.T[:-1])])

    @property
    def entry_steps(self) -> NDArray[np.int64]:
        """The least number of steps that it takes to come to each person from anywhere else, shape (K,)."""
        return np.array([np.delete(column, k).min() for k, column in enumerate(self.steps.T[:-1])], dtype=np.int64)


def _whole_steps(steps: Floats) -> NDArray[np.int64]:
    # 3 times a distance of 0.1 is a little more than 0.3 and yet no further step.
    return np.ceil(steps - 1e-9).clip(0).astype(np.int64)


def _windows(row: NDArray[Any]) -> NDArray[Any]:
    """Give the square matrix of which each row is the one before, one place further: without room of its own.

    For 10,000 people it would take 800 MB.
    """
    return np.asarray(sliding_window_view(row, len(row) // 2 + 1)[::-1])


@dataclass(frozen=True)
class TeamAction:
    """What the robot does in each of N teams.

    Attributes
    ----------
    person : int array, shape (N,)
        To whom it goes, or `NOBODY`: then it stays where it is and says nothing.
    robot : int array, shape (N,)
        The robot action in that person's POMDP; 0 is to say nothing, which is all that is possible where
        the way there takes time.
    """

    person: NDArray[np.int64]
    robot: NDArray[np.int64]


def by_model(model: NDArray[np.int64], rows: NDArray[np.int64], models: int) -> list[tuple[int, NDArray[np.int64]]]:
    """Sort some people by their models, of which there are so many; give each that one of them has, and who that is.

    Parameters
    ----------
    model : int array, shape (N,)
        Everybody's.
    rows : int array, shape (m,)
        Who is asked about.
    models : int
    """
    if models == 1:  # nothing to sort
        return [(0, rows)]
    own = model[rows]
    return [(number, rows[own == number]) for number in np.unique(own).tolist()]


@dataclass(frozen=True)
class TeamState:
    """What the robot knows about N teams of K people each, where it is free to choose.

    Attributes
    ----------
    step : int
        How many steps the episodes have had.
    x : int array, shape (N, K)
        State of each person's task.
    active : bool array, shape (N, K)
        Who is there and has not finished.
    erred : bool array, shape (N, K)
        Whose last action did not lower the exact cost-to-go.
    location : int array, shape (N,)
        Whom the robot is with, or `BASE`.
    model : int array, shape (N, K)
        Which of the policies models each person.
    belief : float array, shape (N, K, B, T), or None
        None where the policy has said that it does not use it (`uses_belief = False`).
    policies : sequence of Policy
        What the robot has worked out about the people, each by themselves.
    travel : Travel
    """

    step: int
    x: NDArray[np.int64]
    active: NDArray[np.bool_]
    erred: NDArray[np.bool_]
    location: NDArray[np.int64]
    model: NDArray[np.int64]
    belief: Floats | None
    policies: Sequence[Policy]
    travel: Travel

    def groups(self) -> list[tuple[int, NDArray[np.int64]]]:
        """Give each model that somebody active has, and who that is: places in the arrays if they were flat."""
        return by_model(self.model.ravel(), np.flatnonzero(self.active), len(self.policies))

    def known_of(self, rows: NDArray[np.int64]) -> tuple[NDArray[np.int64], Floats]:
        """Give state, shape (m,), and belief, shape (m, B, T), of people, as `groups` names them."""
        if self.belief is None:
            raise ValueError("the policy has said that it uses no beliefs")
        return self.x.ravel()[rows], self.belief.reshape(-1, *self.belief.shape[2:]).take(rows, axis=0)

    def q_values(self) -> Floats:
        """Give what each robot action is worth for each person, were they alone, shape (N, K, R).

        Minus infinity in padding, and for those who are not active.
        """
        actions = max(policy.pomdp.suggested.shape[1] for policy in self.policies)
        q = np.full((self.x.size, actions), -np.inf)
        for group, rows in self.groups():
            values = self.policies[group].q_values(*self.known_of(rows))
            q[rows, : values.shape[1]] = values
        return q.reshape(*self.x.shape, actions)

    def first_optimal(self) -> NDArray[np.int64]:
        """Give each person's first robot action that suggests an optimal action, shape (N, K); 0: there is none."""
        robot = np.zeros(self.x.size, dtype=np.int64)
        for group, rows in self.groups():
            robot[rows] = self.policies[group].pomdp.first_optimal[self.x.ravel()[rows]]
        return robot.reshape(self.x.shape)

    def cost_to_go(self) -> Floats:
        """Give each person's exact cost-to-go, shape (N, K); 0 for those who are not active."""
        h = np.zeros(self.x.size)
        for group, rows in self.groups():
            h[rows] = self.policies[group].pomdp.model.choices.h[self.x.ravel()[rows]]
        return h.reshape(self.x.shape)

    def to(self) -> Floats:
        """Give what it costs to go to each person from where the robot is, shape (N, K)."""
        return self.travel.c_move * self.travel.distance[self.location][:, :-1]

    def act(self, person: NDArray[np.int64], robot: NDArray[np.int64]) -> TeamAction:
        """Go to a person of each team, shape (N,), with each person's robot action, shape (N, K).

        Where the way takes time nothing is said before the robot has arrived and has chosen again.
        """
        teams = np.arange(len(self.x))
        speaks = (person != NOBODY) & (self.travel.steps[self.location, person] == 0)
        return TeamAction(person, np.where(speaks, robot[teams, person], 0))

    def check(self, action: TeamAction) -> None:
        """Refuse what no policy may do, instead of letting it silently do nothing.

        Raises
        ------
        ValueError
            What the policy did, and in which step.
        """
        shape, people = (len(self.x),), self.x.shape[1]
        if np.shape(action.person) != shape or np.shape(action.robot) != shape:
            raise ValueError(
                f"step {self.step}: the policy returned arrays of shapes {np.shape(action.person)} and "
                f"{np.shape(action.robot)}; expected {shape}, one entry for each team"
            )
        wrong = (action.person < NOBODY) | (action.person >= people)
        if wrong.any():
            raise ValueError(
                f"step {self.step}: the policy goes to person {action.person[wrong][0]} in a team of {people}"
            )
        teams = np.flatnonzero(action.person != NOBODY)
        to, robot = action.person[teams], action.robot[teams]
        if not self.active[teams, to].all():
            raise ValueError(f"step {self.step}: the policy goes to a person who has finished or is not there")
        if (robot[self.travel.steps[self.location[teams], to] > 0] != 0).any():
            raise ValueError(f"step {self.step}: the policy speaks to a person before the robot has arrived")
        for number, rows in by_model(self.model[teams, to], np.flatnonzero(robot != 0), len(self.policies)):
            count = self.policies[number].pomdp.robot_actions[self.x[teams[rows], to[rows]]]
            if ((robot[rows] < 0) | (robot[rows] >= count)).any():
                raise ValueError(
                    f"step {self.step}: the policy makes a suggestion that the person's state does not have"
                )


class TeamPolicy(Protocol):
    """Any callable of this form; an attribute `uses_belief = False` saves the filtering."""

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Choose for N teams at a time."""
        ...
