"""The state of a team as its robot knows it, and the form of a team policy.

A team policy is a function of the robot's knowledge of many teams at a time (`TeamState`). It returns where the robot
goes and what it suggests (`TeamAction`). `attention` and `baselines` have the policies of the paper; any callable of
the same form can be used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.system.arrays import outline

from ..people.decision import NOTHING, Floats
from ..people.hidden_type import mean_over_goals
from ..people.user_code import UserCodeError
from ..person.beliefs import Ask, Beliefs
from ..person.fleet import Fleet
from ..person.policy import Policy
from ..person.robots import EXECUTION, NOTHING_DONE, SUGGESTION, Robot
from ..person.rows_of_people import by_model
from ..person.travel import Travel

BASE = -1
"""The robot's place before it has gone to a person; also the index of the base in a distance matrix."""

NOBODY = -1


@dataclass(frozen=True)
class TeamAction:
    """The actions of the M robots of each of N teams.

    Attributes
    ----------
    person : int array, shape (N, M)
        The person to whom a robot goes, or `NOBODY`: then it makes no suggestion, and stays, or makes room for a robot
        that comes (`assignment.placed`). A robot that is under way must have `NOBODY`.
    action : int array, shape (N, M)
        Robot action in that person's POMDP; 0 makes no suggestion. It must be 0 if the travel takes time.
    """

    person: NDArray[np.int64]
    action: NDArray[np.int64]


def worth_of_actions(policy: Policy, x: NDArray[np.int64], belief: Floats) -> Floats:
    """Return the Q-values of all robot actions, shape (m, R); this function is an `Ask`."""
    return policy.q_values(x, belief)


@dataclass(frozen=True)
class TeamState:
    """The robot's knowledge of N teams of K people each, when it chooses its next action.

    All arrays are read-only, including those of the policies and of the travel.

    Attributes
    ----------
    clock : int array, shape (N,)
        Number of steps since the beginning of each team's episode.
    active : bool array, shape (N, K)
        Whether the person is present and has not finished.
    location : int array, shape (N, M), with M = 1 for one robot
        The person at whose place each robot is, or `BASE`; of a robot that is under way, the person to whom it goes.
    model : int array, shape (N, K)
        Index of the policy that models each person.
    beliefs : Beliefs
        What the robot knows of the people, in the order of the flattened arrays.
    policies : sequence of Policy
        Policies for single people.
    travel : Travel
    ready : bool array, shape (N, M)
        Which robots are not under way; all, by default.
    fleet : Fleet
        The M robots, whose actions may cost more than in people's problems; one without fields of its own by default.
    x : int array, shape (N, K)
        Row of each person, that of the most probable state if it is uncertain; from `beliefs`.
    erred : bool array, shape (N, K)
        Whether the person's last action was a mistake: optimal for no goal that was possible; from `beliefs`.
    belief : float array, shape (N, K, H, T), or None
        The belief in each person's type, from `beliefs`. None if the policy has declared that it does not use beliefs
        (`uses_belief = False`).
    """

    clock: NDArray[np.int64]
    active: NDArray[np.bool_]
    location: NDArray[np.int64]
    model: NDArray[np.int64]
    beliefs: Beliefs
    policies: Sequence[Policy]
    travel: Travel
    ready: NDArray[np.bool_] = field(default_factory=lambda: np.ones((), dtype=bool), kw_only=True)
    fleet: Fleet = field(default=Fleet.of((Robot(),)), kw_only=True)
    x: NDArray[np.int64] = field(init=False)
    erred: NDArray[np.bool_] = field(init=False)
    belief: Floats | None = field(init=False)

    __repr__ = outline

    def __post_init__(self) -> None:
        if self.ready.shape != self.location.shape:
            object.__setattr__(self, "ready", np.broadcast_to(self.ready, self.location.shape))
        known, shape = self.beliefs, self.active.shape
        belief = known.belief.reshape(*shape, *known.belief.shape[1:]) if len(known.belief) else None
        given = {name: getattr(self, name) for name in ("clock", "active", "location", "model", "ready")}
        of_people = {"x": known.x.reshape(shape), "erred": known.erred.reshape(shape), "belief": belief}
        for name, array in (given | of_people).items():
            if array is not None and array.flags.writeable:  # the owner of the array may still write to it
                array = array.view()
                array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def step(self) -> int:
        """The clock of all teams; the largest one where they began at different times, as in environments."""
        return int(self.clock.max(initial=0))

    def of(self, teams: NDArray[np.int64]) -> Self:
        """Return the state of some teams, given by their numbers."""
        flat = (teams[:, None] * self.x.shape[1] + np.arange(self.x.shape[1])).reshape(-1)
        arrays = {name: getattr(self, name)[teams] for name in ("clock", "active", "location", "model", "ready")}
        return replace(self, beliefs=self.beliefs.of(flat), **arrays)

    def by_step(self, most: int) -> list[tuple[int, NDArray[np.int64] | slice, Self]]:
        """Return each step in which some teams are, with these and their state; all steps from `most` on are one."""
        step = np.minimum(self.clock, most)
        if (step == step[:1]).all():
            return [(number, slice(None), self) for number in step[:1].tolist()]
        each = [(number, np.flatnonzero(step == number)) for number in np.unique(step).tolist()]
        return [(number, teams, self.of(teams)) for number, teams in each]

    @property
    def robots(self) -> int:
        """The number of robots of each team, M."""
        return self.location.shape[1]

    def reachable(self) -> NDArray[np.bool_]:
        """Return to whom each robot may be sent, shape (N, M, K).

        A robot that is not under way may go to anybody at work, except those to whom another robot is under way.
        """
        may = self.ready[:, :, None] & self.active[:, None]
        if not self.ready.all():
            teams, robots = np.nonzero(~self.ready)
            may[teams, :, self.location[teams, robots]] = False
        return may

    @property
    def interchangeable(self) -> bool:
        """Whether each robot that is ready is worth the same everywhere, but where it stays.

        So it is if all distances are equal, and all robots are alike and wait for free.
        """
        return self.travel.equally_far and self.travel.alike and self.fleet.alike and not self.fleet.waiting.any()

    def refused(self, fault: str) -> UserCodeError:
        """Return the error for a fault of the policy in this step."""
        return UserCodeError(f"step {self.step}: {fault}")

    def by_policy(self) -> list[tuple[int, NDArray[np.int64]]]:
        """Return each model that an active person has, with the indices of its people in the flattened arrays."""
        return by_model(self.model.ravel(), np.flatnonzero(self.active), len(self.policies))

    def known_of(self, flat: NDArray[np.int64]) -> tuple[NDArray[np.int64], Floats]:
        """Return the states, shape (m,), and beliefs, shape (m, H, T), of people with indices as in `by_policy`."""
        if self.belief is None:
            raise ValueError("the policy has said that it uses no beliefs; expected no `uses_belief = False` here")
        return self.x.ravel()[flat], self.belief.reshape(-1, *self.belief.shape[2:]).take(flat, axis=0)

    def of_each(self, ask: Ask) -> Floats:
        """Return the answer to a question about every active person, shape (N, K, W), expected over what is uncertain.

        It is minus infinity in padding, and for people who are not active. A live team asks only about people whose
        state or belief has changed. So the answer must depend on nothing else.

        Parameters
        ----------
        ask : Ask
            The same function object in every step, as answers are cached by it.
        """
        found = [(flat, self.beliefs.expected(ask, self.policies[number], flat)) for number, flat in self.by_policy()]
        values = np.full((self.x.size, max((each.shape[1] for _, each in found), default=1)), -np.inf)
        for flat, each in found:
            values[flat, : each.shape[1]] = each
        return values.reshape(*self.x.shape, -1)

    def q_values(self) -> Floats:
        """Return the Q-values of all robot actions in each person's own problem, shape (N, K, R).

        They are minus infinity in padding, and for people who are not active.
        """
        return self.of_each(worth_of_actions)

    def first_optimal(self) -> NDArray[np.int64]:
        """Return each person's first robot action that suggests an optimal action, shape (N, K); 0 if there is none.

        Of several goals, it is optimal for the most probable one.
        """
        action = np.zeros(self.x.size, dtype=np.int64)
        for number, flat in self.by_policy():
            x, share = self.x.ravel()[flat], self._share_of_goals(number, flat)
            action[flat] = self.policies[number].pomdp.first_optimal[x, share.argmax(axis=-1)]
        return action.reshape(self.x.shape)

    def cost_to_go(self) -> Floats:
        """Return each person's exact cost-to-go, shape (N, K); 0 for people who are not active.

        Of several goals, it is the mean under the belief.
        """
        mean = np.zeros(self.x.size)
        for number, flat in self.by_policy():
            h = self.policies[number].pomdp.model.choices.goals.h[:, self.x.ravel()[flat]].T
            mean[flat] = mean_over_goals(h, self._share_of_goals(number, flat))
        return mean.reshape(self.x.shape)

    def mean_beta(self) -> Floats:
        """Return each person's expertise in the mean under the belief, shape (N, K); 0 for people not active."""
        return self._means(lambda policy: policy.pomdp.hidden.expertise[:, None])

    def mean_theta(self) -> Floats:
        """Return each person's influence in the mean under the belief, shape (N, K); 0 for people not active."""
        return self._means(lambda policy: policy.pomdp.grid.theta[None])

    def _means(self, values: Callable[[Policy], Floats]) -> Floats:
        """Return a mean for each person, shape (N, K), of values that broadcast with the belief, shape (H, T)."""
        mean = np.zeros(self.x.size)
        for number, flat in self.by_policy():
            mean[flat] = (self.known_of(flat)[1] * values(self.policies[number])).sum(axis=(1, 2))
        return mean.reshape(self.x.shape)

    def _share_of_goals(self, number: int, flat: NDArray[np.int64]) -> Floats:
        """Return the probability of each goal of some people, as `HiddenType.share_of_goals`."""
        hidden = self.policies[number].pomdp.hidden
        return hidden.share_of_goals(lambda: self.known_of(flat)[1])

    def to(self) -> Floats:
        """Return the cost of each robot's move to each person from its place, shape (N, M, K), in cost units."""
        return self.travel.costs_from(self.location)

    def executes(self, actions: int) -> NDArray[np.bool_]:
        """Return which of the first R robot actions are executions by the robot, shape (N, K, R).

        Action 0 and padding count as executions, too, as they suggest nothing. Where no robot can execute an action,
        the shape is (1, 1, R).
        """
        if not self.fleet.executes:
            return np.zeros((1, 1, actions), dtype=bool)
        executes = np.zeros((self.x.size, actions), dtype=bool)
        for number, flat in self.by_policy():
            suggested = self.policies[number].pomdp.suggested[self.x.ravel()[flat], :actions]
            executes[flat, : suggested.shape[1]] = suggested == NOTHING
        return executes.reshape(*self.x.shape, actions)

    def by_kind(self, q: Floats) -> Floats:
        """Return values of robot actions minus what they cost more, shape (N, U, K, R), for the U kinds of robots.

        Parameters
        ----------
        q : float array, shape (N, K, R)
            Values of the robot actions in people's problems.
        """
        return q[:, None] - self.extra_costs(q.shape[2]) if self.fleet.costs_differ else q[:, None]

    def extra_costs(self, actions: int) -> Floats:
        """Return what the first R robot actions cost more than in people's problems, for each kind of robot.

        Robots with the same costs are of one kind (`Fleet.kinds`). The shape is (N, U, K, R) for U kinds, or (1, U, 1,
        R) where no robot can execute an action. It is infinite for an action that robots of this kind cannot execute.
        """
        each = self.fleet.kinds.extra[:, None, None]
        costs = np.where(self.executes(actions)[:, None], each[..., EXECUTION], each[..., SUGGESTION])
        costs[..., :1] = each[..., NOTHING_DONE]
        return costs

    def act(self, person: ArrayLike, action: ArrayLike) -> TeamAction:
        """Return the action of sending each robot to a person.

        If the travel takes time, the robot makes no suggestion; it chooses again after its arrival.

        Parameters
        ----------
        person : int array, shape (N, M), or (N,) for one robot
            The person to whom each robot goes, or `NOBODY`.
        action : int array, shape (N, K), or (N, M, K)
            The robot action towards each person, of all robots or of each.

        Raises
        ------
        UserCodeError
            An array has another shape, is not of whole numbers, or a person is not one of the team.
        """
        person, action = np.asarray(person), np.asarray(action)
        (N, K), M, there = self.x.shape, self.robots, f", {NOBODY} for a robot that stays"
        given, person = person, person[:, None] if person.ndim == 1 else person
        if person.shape != (N, M) or person.dtype.kind not in "iu":
            each = f"each of {N} teams and {M} robot{'s' * (M > 1)}"
            raise self.refused(
                f"person, {_described(given)}: expected whole numbers, shape {(N, M)}, one for {each}{there}"
            )
        if action.shape not in [(N, K), (N, M, K)] or action.dtype.kind not in "iu":
            raise self.refused(
                f"action, {_described(action)}: expected whole numbers, shape {(N, K)}, a robot action for each person"
            )
        wrong = (person < NOBODY) | (person >= K)
        if wrong.any():
            raise self.refused(f"person {person[wrong][0]} in a team of {K}: expected 0 to {K - 1}{there}")
        speaks = (person != NOBODY) & (self.travel.steps_between(np.arange(M), self.location, person) == 0)
        each_robot = action if action.ndim > 2 else action[:, None]
        said = each_robot[np.arange(N)[:, None], np.arange(each_robot.shape[1]), person]
        return TeamAction(person, np.where(speaks, said, 0))


def _described(array: NDArray[Any]) -> str:
    return f"{array.dtype} array of shape {array.shape}"


class TeamPolicy(Protocol):
    """Any callable of this form.

    An attribute `uses_belief = False` turns the belief filter off. `weighs_costs = True` says that its
    suggestions are worth their cost. A method `beside` says what they are worth to others (`beside`).
    """

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Return the actions for N teams."""
        ...


def beside(policy: TeamPolicy, team: TeamState, actions: int) -> Floats:
    """Return what a policy takes the first R robot actions to be worth beside each person, shape (N, K, R).

    That is what its method `beside` returns, with the team and R, or that of its `base`; 0 if it has none.
    """
    own = getattr(policy, "beside", getattr(getattr(policy, "base", None), "beside", None))
    return np.broadcast_to(np.zeros(1) if own is None else own(team, actions), (*team.x.shape, actions))
