"""Our team policy: go where the robot's presence has the largest value.

Algorithm 1 scores a suggestion as if it had to pay for the move alone, and as if the robot were always within reach
afterwards. Here each person's problem contains the robot's position (`person.attention_subproblem`). So the value
of coming includes later suggestions without another move. Staying without a suggestion has a value of its own, and
travel time is planned through to the arrival. The value of the robot's attention to other people is a price: one for
all steps, or one for each step, as a bound on the team determines them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..people.decision import Floats
from ..person.attention_subproblem import AttentionSubproblem, backwards
from ..person.beliefs import Ask
from ..person.policy import Policy
from ..person.pomdp import AssistPOMDP
from ..person.qmdp import QMDP, qmdp
from ..person.robots import NOTHING_DONE
from ..person.ties import NEAR, first_best
from ..person.time_expansion import AWAY, HERE
from ..person.travel import Travel
from .assignment import assigned
from .by_policy import ByPolicy
from .outlook import outlook
from .state import BASE, NOBODY, TeamAction, TeamState


def to_the_best(team: TeamState, action: NDArray[np.int64], going: Floats, staying: Floats) -> TeamAction:
    """Return the action of going where the sum of worths is largest, where it is worth more than staying and than 0.

    No two robots go to one person, and none to a person with whom another one stays.

    Parameters
    ----------
    team : TeamState
    action : int array, shape (N, M, K)
        Each robot's action towards each person.
    going : float array, shape (N, M, K)
        Worth of going to each person.
    staying : float array, shape (N, M)
        Worth of staying without a suggestion.
    """
    there = np.nonzero(team.location != BASE)
    own = (*there, team.location[there])
    worth = going.copy()
    # Robots stay where that is worth as much as to go elsewhere.
    worth[own] = np.maximum(going[own], staying[there] + 2 * NEAR)
    person = assigned(team, worth)
    stays = (staying[there] >= going[own] - NEAR) & (person[there] == team.location[there])
    person[there] = np.where(stays, NOBODY, person[there])
    return team.act(person, action)


@dataclass(frozen=True, eq=False)
class SolvedSubproblem:
    """One person's problem with a robot that comes and goes, with its solution.

    Attributes
    ----------
    visits : AttentionSubproblem
    policy : QMDP
    states : int array, shape (W + 1, P, n)
        Number of each state of the subproblem, by step, robot position and task state; -1 where the task state is not
        reachable at that step.
    """

    visits: AttentionSubproblem
    policy: QMDP
    states: NDArray[np.int64]

    @classmethod
    def of(cls, visits: AttentionSubproblem, policy: QMDP) -> SolvedSubproblem:
        """Return the solution with its state numbers."""
        steps, positions = range(len(visits.layout.layers)), range(visits.layout.positions)
        return cls(visits, policy, np.array([[visits.states(t, position) for position in positions] for t in steps]))

    def q_values(self, step: int, position: int, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the Q-values of the robot's moves, shape (N, R + 1); minus infinity in padding.

        Parameters
        ----------
        step : int
            The step, or the last one with a price of its own.
        position : int
            Position of the robot, as in `TimeExpansion`.
        x : int array, shape (N,)
            Task state of each person.
        belief : float array, shape (N, H, T)

        Raises
        ------
        ValueError
            A state is not reachable at that step.
        """
        states = self.states[step, position, x]
        if (states < 0).any():
            raise ValueError(
                f"somebody is at step {step} where nobody can be so soon: with prices of steps all begin at step 0"
            )
        return self.policy.q_values(states, belief)

    def advantage(
        self, before: NDArray[np.int64], now: NDArray[np.int64], x: NDArray[np.int64], move: NDArray[np.int64],
        h: NDArray[np.int64], was: NDArray[np.int64], t: NDArray[np.int64],
    ) -> Floats:  # fmt: skip
        """Return the Q-value of each move minus the value before it, shape (N,), at a constant price of attention.

        Parameters
        ----------
        before, now : int arrays, shape (N,)
            Position of the robot before the decision, and where the move is made.
        x, move : int arrays, shape (N,)
        h, was, t : int arrays, shape (N,)
            The person's type, and their cell of theta for the value before and for the move.
        """
        states = self.states[0]
        solved = self.policy
        return np.asarray(solved.q_mdp[states[now, x], move, h, t] - solved.value_mdp[states[before, x], h, was])


@dataclass(frozen=True, eq=False)
class Priority:
    """Go where the robot's presence has the largest value.

    The value of presence for a person is the Q-value with the robot there, minus that without it in this step. Presence
    means to make a suggestion, to stay without one, or to arrive after the travel and continue from there. The cost of
    moving is subtracted. A suggestion is also worth what it is expected to do to those who see it (`outlook`). The
    robots act on the largest sum of differences, each for another person.

    Attributes
    ----------
    entry : float
        Cost of coming, in cost units.
    entry_steps, longest : int
        Mean and largest number of steps of coming.
    price : float array, shape (W + 1,)
        Price of the robot's attention at each step, in cost units; the last applies to all later steps. It counts from
        the next step on, since the needs of the present step are observed.
    known : ByPolicy of SolvedSubproblem
        Solutions for people on enumerated tasks; others keep theirs (`Policy.with_robot`).
    """

    entry: float
    entry_steps: int
    longest: int
    price: Floats
    known: ByPolicy[SolvedSubproblem]
    uses_belief, weighs_costs = True, True

    @classmethod
    def of(
        cls,
        policies: Sequence[Policy],
        travel: Travel,
        price: ArrayLike | None = None,
        solver: Callable[[AssistPOMDP], QMDP] = qmdp,
    ) -> Priority:
        """Return the policy for people with the given policies and travel.

        The data about each of them are computed on first use, or by `prepare`. If distances differ, a return counts
        with the mean distance.

        Parameters
        ----------
        policies : sequence of Policy
        travel : Travel
        price : float or float array, shape (W,), optional
            Price of a step of attention, in cost units. A number applies to every step; by default it is 0.15 times the
            cost of the cheapest action. Values from 0.1 to 0.2 times that cost were about equally good for teams of 2
            to 100 people. An array holds prices of the steps from 0 on, followed by 0. On an enumerated task the policy
            then knows the states that are reachable by each step, and refuses a person in another state: people all
            begin at step 0.
        solver : callable
            Solves people's problems.
        """
        if price is None:
            price = 0.15 * min(policy.problem.cheapest for policy in policies)
        (entry, mean_steps), longest = travel.mean_way, travel.longest_way
        steps = round(mean_steps)
        each = np.asarray(price, dtype=float)

        def presence(policy: Policy) -> SolvedSubproblem:
            free = AttentionSubproblem.of(policy.pomdp, entry, steps, longest=longest)
            if not each.ndim:
                return SolvedSubproblem.of(free, solver(free.at_price(float(each))))
            visits = AttentionSubproblem.of(policy.pomdp, entry, steps, each, longest=longest)
            return SolvedSubproblem.of(visits, backwards(visits, solver(free.pomdp).value_mdp))

        prices = np.append(each, 0.0) if each.ndim else each.reshape(1)
        return cls(entry, steps, longest, prices, ByPolicy(policies, presence))

    def prepare(self, policy: Policy) -> None:
        """Compute now the data about the people of a policy."""
        policy.with_robot(self)

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Return the action of going to the best person, or of staying, in every team."""
        return to_the_best(team, *self.worth(team))

    def worth(self, team: TeamState) -> tuple[NDArray[np.int64], Floats, Floats]:
        """Return each robot's action towards each person and the value of going there, both (N, M, K), and of staying.

        The value of staying has the shape (N, M).
        """
        shape = *team.location.shape, team.x.shape[1]
        found = np.zeros(shape, dtype=np.int64), np.full(shape, -np.inf), np.zeros(team.location.shape)
        for step, teams, own in team.by_step(len(self.price) - 1):
            for array, part in zip(found, self._worth(step, own), strict=True):
                array[teams] = part
        return found

    def _worth(self, step: int, team: TeamState) -> tuple[NDArray[np.int64], Floats, Floats]:
        """Return what `worth` does for teams in the same step."""
        steps, kind = team.travel.steps_from(team.location), team.fleet.kinds.of_robot
        action = np.zeros(steps.shape, dtype=np.int64)
        going, holding = np.full(steps.shape, -np.inf), np.zeros(team.location.shape)
        if steps.max(initial=0) > self.longest:
            raise ValueError(
                f"a way of {steps.max()} steps: this policy was made for at most {self.longest}; "
                "expected the team's travel in Priority.of"
            )
        if not team.active.any():
            return action, going, holding
        price, values = self.price[step], team.of_each(self._asks[step])
        arriving, q = values[:, :, : self.longest], values[:, :, self.longest :]
        # People who are not active score minus infinity.
        gain = np.full(q.shape, -np.inf)
        np.subtract(q[:, :, 1:] + price, q[:, :, :1], out=gain[:, :, 1:], where=team.active[:, :, None])
        lowest: Floats = np.zeros((1, 1, 1))  # what coming to a person to act costs at least, more than the best robot
        if q.shape[2] > 2:
            gain[:, :, 2:] += outlook(team, q.shape[2] - 1, partial(self._value_away, step))[:, :, 1:]
            extra = team.extra_costs(q.shape[2] - 1)[..., 1:]
            each = gain[:, None, :, 2:] - extra
            action = np.where(team.active[:, None], first_best(each) + 1, 0)[:, kind]
            going, lowest = each.max(axis=3)[:, kind], extra.min(axis=3)[:, kind]
        e, _, k = away = np.nonzero(team.active[:, None] & (steps > 0))
        going[away] = arriving[e, k, steps[away] - 1] + price - q[e, k, 0]
        going[away] -= np.broadcast_to(lowest, going.shape)[away]
        with_them = np.nonzero(team.location != BASE)
        at = team.location[with_them]
        more = team.fleet.extra[with_them[1], NOTHING_DONE]
        holding[with_them] = np.where(team.active[with_them[0], at], gain[with_them[0], at, 1] - more, 0.0)
        return action, going - team.to(), holding

    def beside(self, team: TeamState, actions: int) -> Floats:
        """Return what the first R robot actions are worth beside each person, as in `outlook`."""
        found = np.zeros((*team.x.shape, actions))
        for step, teams, own in team.by_step(len(self.price) - 1):
            found[teams] = outlook(own, actions, partial(self._value_away, step))
        return found

    @cached_property
    def _asks(self) -> tuple[Ask, ...]:
        """The question about people at each step; one object each, as a live team caches answers by the question."""
        return tuple(partial(self._values, step) for step in range(len(self.price)))

    def solved(self, policy: Policy, /) -> SolvedSubproblem:
        """Return the solved problem of the people of a policy for an enumerated task."""
        return self.known[policy]

    def _value_away(self, step: int, policy: Policy, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the values of people, shape (m,), with the robot away."""
        return np.asarray(policy.with_robot(self).q_values(step, AWAY, x, belief).max(axis=1))

    def _values(self, step: int, policy: Policy, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the values of an arrival in 1, 2, ... steps, followed by the Q-values with the robot present."""
        solved = policy.with_robot(self)
        arriving = [solved.q_values(step, HERE + far, x, belief)[:, :1] for far in range(1, 1 + self.longest)]
        return np.concatenate([*arriving, solved.q_values(step, HERE, x, belief)], axis=1)
