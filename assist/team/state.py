"""The state of a team as its robot knows it, and the form of a team policy.

A team policy is a function of the robot's knowledge of many teams at a time (`TeamState`). It returns where the robot
goes and what it suggests (`TeamAction`). `assist.team.attention` has the policies of the paper; any callable of the
same form can be used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.system.arrays import outline

from ..people.decision import Floats
from ..person.policy import Policy
from .robots import ExtraCosts
from .travel import Travel

BASE = -1
"""The robot's place before it has gone to a person; also the index of the base in a distance matrix."""

NOBODY = -1


Ask = Callable[[Policy, NDArray[np.int64], Floats], Floats]
"""A function of a policy, states, shape (m,), and beliefs, shape (m, B, T), that returns numbers, shape (m, W)."""


class PolicyError(ValueError):
    """A team policy fails, or chooses an impossible action."""


@dataclass(frozen=True)
class TeamAction:
    """The robot's action in each of N teams; with M robots per team, M > 1, both arrays have the shape (N, M).

    Attributes
    ----------
    person : int array, shape (N,)
        The person to whom the robot goes, or `NOBODY`: then it stays where it is and makes no suggestion. A robot that
        is under way must have `NOBODY`.
    robot : int array, shape (N,)
        Robot action in that person's POMDP; 0 makes no suggestion. It must be 0 if the travel takes time.
    """

    person: NDArray[np.int64]
    robot: NDArray[np.int64]


def worth_of_actions(policy: Policy, x: NDArray[np.int64], belief: Floats) -> Floats:
    """Return the Q-values of all robot actions, shape (m, R); this function is an `Ask`."""
    return policy.q_values(x, belief)


def by_model(model: NDArray[np.int64], rows: NDArray[np.int64], models: int) -> list[tuple[int, NDArray[np.int64]]]:
    """Return each model that occurs among some people, with the indices of its people.

    Parameters
    ----------
    model : int array, shape (N,)
        Model of each person.
    rows : int array, shape (m,)
        Indices of the people to consider.
    models : int
        Number of models.
    """
    if models == 1:  # no sorting is necessary
        return [(0, rows)] if len(rows) else []
    own = model[rows]
    return [(number, rows[own == number]) for number in np.unique(own).tolist()]


@dataclass(frozen=True)
class TeamState:
    """The robot's knowledge of N teams of K people each, when it chooses its next action.

    All arrays are read-only, including those of the policies and of the travel.

    Attributes
    ----------
    step : int
        Number of steps since the beginning of the episodes.
    x : int array, shape (N, K)
        Task state of each person.
    active : bool array, shape (N, K)
        Whether the person is present and has not finished.
    erred : bool array, shape (N, K)
        Whether the person's last action was not an optimal choice.
    location : int array, shape (N,), or (N, M) if each team has M > 1 robots
        The person at whose place the robot is, or `BASE`; of a robot that is under way, the person to whom it goes.
    model : int array, shape (N, K)
        Index of the policy that models each person.
    belief : float array, shape (N, K, B, T), or None
        None if the policy has declared that it does not use beliefs (`uses_belief = False`).
    policies : sequence of Policy
        Policies for single people.
    travel : Travel
    free : bool array, shape (N, M), or None
        Which of several robots are not under way; None if all are free. A policy for one robot is only asked when that
        robot is free.
    extra : ExtraCosts or None
        What actions of each robot cost more than in people's problems, if the robots differ.
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
    free: NDArray[np.bool_] | None = field(default=None, kw_only=True)
    extra: ExtraCosts | None = field(default=None, kw_only=True)

    __repr__ = outline

    def __post_init__(self) -> None:
        for name in ("x", "active", "erred", "location", "model", "belief", "free"):
            array = getattr(self, name)
            if array is not None and array.flags.writeable:  # the owner of the array may still write to it
                view = array.view()
                view.flags.writeable = False
                object.__setattr__(self, name, view)

    @property
    def robots(self) -> int:
        """The number of robots of each team, M."""
        return self.location.shape[1] if self.is_joint else 1

    @property
    def is_joint(self) -> bool:
        """Whether `location` has an axis of robots, so that actions need one, too."""
        return self.location.ndim > 1

    def may_choose(self) -> NDArray[np.bool_]:
        """Return which robots are not under way, in the shape of `location`."""
        return np.ones(self.location.shape, dtype=bool) if self.free is None else self.free

    def refused(self, fault: str) -> PolicyError:
        """Return the error for a fault of the policy in this step."""
        return PolicyError(f"step {self.step}: {fault}")

    def groups(self) -> list[tuple[int, NDArray[np.int64]]]:
        """Return each model that an active person has, with the indices of its people in the flattened arrays."""
        return by_model(self.model.ravel(), np.flatnonzero(self.active), len(self.policies))

    def known_of(self, rows: NDArray[np.int64]) -> tuple[NDArray[np.int64], Floats]:
        """Return the states, shape (m,), and beliefs, shape (m, B, T), of people with indices as in `groups`."""
        if self.belief is None:
            raise ValueError("the policy has said that it uses no beliefs")
        return self.x.ravel()[rows], self.belief.reshape(-1, *self.belief.shape[2:]).take(rows, axis=0)

    def of_each(self, ask: Ask) -> Floats:
        """Return the answer to a question about every active person, shape (N, K, W).

        It is minus infinity in padding, and for people who are not active. A live team asks only about people whose
        state or belief has changed. So the answer must depend on nothing else.

        Parameters
        ----------
        ask : Ask
            The same function object in every step, as answers are cached by it.
        """
        found = [(rows, ask(self.policies[group], *self.known_of(rows))) for group, rows in self.groups()]
        values = np.full((self.x.size, max((each.shape[1] for _, each in found), default=1)), -np.inf)
        for rows, each in found:
            values[rows, : each.shape[1]] = each
        return values.reshape(*self.x.shape, -1)

    def q_values(self) -> Floats:
        """Return the Q-values of all robot actions in each person's own problem, shape (N, K, R).

        They are minus infinity in padding, and for people who are not active.
        """
        return self.of_each(worth_of_actions)

    def first_optimal(self) -> NDArray[np.int64]:
        """Return each person's first robot action that suggests an optimal action, shape (N, K); 0 if there is none."""
        robot = np.zeros(self.x.size, dtype=np.int64)
        for group, rows in self.groups():
            robot[rows] = self.policies[group].pomdp.first_optimal[self.x.ravel()[rows]]
        return robot.reshape(self.x.shape)

    def cost_to_go(self) -> Floats:
        """Return each person's exact cost-to-go, shape (N, K); 0 for people who are not active."""
        h = np.zeros(self.x.size)
        for group, rows in self.groups():
            self.policies[group].pomdp.model.choices.require_one_goal("the cost-to-go")
            h[rows] = self.policies[group].pomdp.model.choices.h[self.x.ravel()[rows]]
        return h.reshape(self.x.shape)

    def to(self) -> Floats:
        """Return the cost of moving to each person from the robot's place, shape (N, K), or (N, M, K)."""
        return self.travel.costs_from(self.location)

    def robot_numbers(self) -> NDArray[np.int64]:
        """Return the number of each robot within its team, from 0, in the shape of `location`."""
        return np.broadcast_to(np.arange(self.robots) if self.is_joint else 0, self.location.shape)

    def act(self, person: ArrayLike, robot: ArrayLike) -> TeamAction:
        """Return the action of going to a person in each team.

        `person` has the shape (N,), or (N, M) with M robots, and `robot` holds the robot actions of all people, shape
        (N, K), or (N, M, K) if robots differ. If the travel takes time, the robot makes no suggestion; it chooses again
        after its arrival.

        Raises
        ------
        PolicyError
            An array has another shape, is not of whole numbers, or a person is not one of the team.
        """
        person, robot = np.asarray(person), np.asarray(robot)
        (N, K), there = self.x.shape, f", {NOBODY} for a robot that stays"
        if person.shape != self.location.shape or person.dtype.kind not in "iu":
            each = f"each of {N} teams" + f" and {self.robots} robots" * self.is_joint
            raise self.refused(
                f"person, {_kind(person)}: expected whole numbers, shape {self.location.shape}, one for {each}{there}"
            )
        allowed = [(N, K), (N, self.robots, K)] if self.is_joint else [(N, K)]
        if robot.shape not in allowed or robot.dtype.kind not in "iu":
            raise self.refused(
                f"robot, {_kind(robot)}: expected whole numbers, shape {allowed[0]}, a robot action for each person"
            )
        wrong = (person < NOBODY) | (person >= K)
        if wrong.any():
            raise self.refused(f"person {person[wrong][0]} in a team of {K}: expected 0 to {K - 1}{there}")
        teams, number = np.arange(len(self.x)).reshape(-1, *[1] * (person.ndim - 1)), self.robot_numbers()
        speaks = (person != NOBODY) & (self.travel.steps_between(number, self.location, person) == 0)
        said = robot[teams, number, person] if robot.ndim > 2 else robot[teams, person]
        return TeamAction(person, np.where(speaks, said, 0))


def _kind(array: NDArray[Any]) -> str:
    return f"{array.dtype} array of shape {array.shape}"


class TeamPolicy(Protocol):
    """Any callable of this form.

    An attribute `uses_belief = False` turns the belief filter off. `weighs_costs = True` says that its
    suggestions are worth their cost.
    """

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Return the actions for N teams."""
        ...
