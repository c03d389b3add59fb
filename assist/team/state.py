"""What a team is to its robot: the people's tasks, the way between them, and what a policy for them looks like.

A team policy is a function of what the robot knows (`TeamState`, many teams at a time) that returns where
the robot goes and what it says there (`TeamAction`). `assist.team.attention` has the paper's; any callable of
the same form will do.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import outline

from ..people.decision import Floats
from ..person.pomdp import Policy
from .travel import Travel

T = TypeVar("T")

BASE = -1
"""The robot's place before it has gone to anybody; also the last row of a distance matrix."""

NOBODY = -1


Ask = Callable[[Policy, NDArray[np.int64], Floats], Floats]
"""Gives numbers, shape (m, W), for people of one policy, by their states, shape (m,), and beliefs, shape (m, B, T)."""


class PolicyError(ValueError):
    """A team policy that fails, or chooses what cannot be."""


class ByPolicy(Generic[T]):
    """What is worked out for each of some policies for one person, when it is first asked for; any thread may ask.

    Parameters
    ----------
    policies : iterable of Policy
    work_out : callable
    """

    def __init__(self, policies: Iterable[Policy], work_out: Callable[[Policy], T]) -> None:
        # By identity: policies are told apart as objects, whatever they hold. Each is kept as long as its number.
        self._policies = {id(policy): (policy, threading.Lock()) for policy in policies}
        self._known: dict[int, T] = {}
        self._work_out = work_out

    def __getitem__(self, policy: Policy) -> T:
        number = id(policy)
        if number not in self._policies:
            raise ValueError("a policy for people whom this team policy was not made for; expected one of those given")
        if number not in self._known:
            with self._policies[number][1]:
                if number not in self._known:
                    self._known[number] = self._work_out(policy)
        return self._known[number]


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


def worth_of_actions(policy: Policy, x: NDArray[np.int64], belief: Floats) -> Floats:
    """Give what each robot action is worth, shape (m, R): an `Ask`."""
    return policy.q_values(x, belief)


def by_model(model: NDArray[np.int64], rows: NDArray[np.int64], models: int) -> list[tuple[int, NDArray[np.int64]]]:
    """Return each model that some of the people have, of so many, and who they are; nothing where there are none.

    Parameters
    ----------
    model : int array, shape (N,)
        Everybody's.
    rows : int array, shape (m,)
        Who is asked about.
    models : int
    """
    if models == 1:  # nothing to sort
        return [(0, rows)] if len(rows) else []
    own = model[rows]
    return [(number, rows[own == number]) for number in np.unique(own).tolist()]


@dataclass(frozen=True)
class TeamState:
    """What the robot knows about N teams of K people each, where it is free to choose.

    All arrays are read-only, and so are those of the policies and the way: who chooses changes nothing by looking.

    Attributes
    ----------
    step : int
        How many steps the episodes have had.
    x : int array, shape (N, K)
        State of each person's task.
    active : bool array, shape (N, K)
        Who is there and has not finished.
    erred : bool array, shape (N, K)
        Whose last action was not an optimal choice.
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

    __repr__ = outline

    def __post_init__(self) -> None:
        for name in ("x", "active", "erred", "location", "model", "belief"):
            array = getattr(self, name)
            if array is not None and array.flags.writeable:  # whoever made it can go on writing into it
                view = array.view()
                view.flags.writeable = False
                object.__setattr__(self, name, view)

    def groups(self) -> list[tuple[int, NDArray[np.int64]]]:
        """Give each model that somebody active has, and who that is: places in the arrays if they were flat."""
        return by_model(self.model.ravel(), np.flatnonzero(self.active), len(self.policies))

    def known_of(self, rows: NDArray[np.int64]) -> tuple[NDArray[np.int64], Floats]:
        """Give state, shape (m,), and belief, shape (m, B, T), of people, as `groups` names them."""
        if self.belief is None:
            raise ValueError("the policy has said that it uses no beliefs")
        return self.x.ravel()[rows], self.belief.reshape(-1, *self.belief.shape[2:]).take(rows, axis=0)

    def of_each(self, ask: Ask) -> Floats:
        """Ask something about everybody who is active, shape (N, K, W).

        Minus infinity in padding, and for those who are not active. In a live team only those are asked about of whom
        something has changed since, so that the answer should depend on nothing else.

        Parameters
        ----------
        ask : Ask
            A function that stays the same from step to step.
        """
        found = [(rows, ask(self.policies[group], *self.known_of(rows))) for group, rows in self.groups()]
        values = np.full((self.x.size, max((each.shape[1] for _, each in found), default=1)), -np.inf)
        for rows, each in found:
            values[rows, : each.shape[1]] = each
        return values.reshape(*self.x.shape, -1)

    def q_values(self) -> Floats:
        """Give what each robot action is worth for each person, were they alone, shape (N, K, R).

        Minus infinity in padding, and for those who are not active.
        """
        return self.of_each(worth_of_actions)

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
        PolicyError
            What the policy did, and in which step.
        """
        shape, people = (len(self.x),), self.x.shape[1]

        def refused(fault: str) -> PolicyError:
            return PolicyError(f"step {self.step}: the policy {fault}")

        if not isinstance(action, TeamAction):
            raise refused(f"returned {type(action).__name__}; expected a TeamAction, as TeamState.act gives it")
        for array in (action.person, action.robot):
            if not isinstance(array, np.ndarray) or array.dtype.kind not in "iu" or array.shape != shape:
                found = f"an array of {array.dtype}, shape {array.shape}" if isinstance(array, np.ndarray) else array
                raise refused(f"chose {found!s:.80}; expected two int arrays of shape {shape}, an entry for each team")
        wrong = (action.person < NOBODY) | (action.person >= people)
        if wrong.any():
            raise refused(f"goes to person {action.person[wrong][0]} in a team of {people}")
        teams = np.flatnonzero(action.person != NOBODY)
        to, robot = action.person[teams], action.robot[teams]
        if not self.active[teams, to].all():
            raise refused("goes to a person who has finished or is not there")
        if (robot[self.travel.steps[self.location[teams], to] > 0] != 0).any():
            raise refused("speaks to a person before the robot has arrived")
        for number, rows in by_model(self.model[teams, to], np.flatnonzero(robot != 0), len(self.policies)):
            count = self.policies[number].pomdp.robot_actions[self.x[teams[rows], to[rows]]]
            if ((robot[rows] < 0) | (robot[rows] >= count)).any():
                raise refused("makes a suggestion that the person's state does not have")


class TeamPolicy(Protocol):
    """Any callable of this form; an attribute `uses_belief = False` saves the filtering."""

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Choose for N teams at a time."""
        ...
