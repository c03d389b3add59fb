"""A team policy of our own: be where the robot's presence is worth most.

Algorithm 1 scores a suggestion to a person as if the way to them were to be paid for this suggestion alone, and
as if they were always within reach afterwards. Here each person's problem knows whether the robot is with them
(`assist.team.attention_subproblem`), so that coming is worth what can be said later without coming again, staying
silently has a worth of its own, and a way that takes time is looked at to its end. What the robot's attention is worth
to others is one price at all steps, or one for each, as a bound on the team has them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..people.decision import Floats
from ..person.pomdp import Policy
from ..person.qmdp import QMDP, qmdp
from .attention_subproblem import HERE, AttentionSubproblem, backwards
from .policy_on_part import is_for_one_step, is_on_part, on_parts
from .state import BASE, NOBODY, Ask, ByPolicy, TeamAction, TeamState
from .travel import Travel

PRICE = 0.15
"""What a step of the robot's attention will be worth to others: this share of the cheapest action's cost."""


def coming(travel: Travel) -> tuple[float, int, int]:
    """Give what coming costs on average, how many steps it takes, and how many from the farthest place."""
    way = ~np.eye(len(travel.distance), dtype=bool)[:, :-1]
    entry = travel.c_move * float(travel.distance[:, :-1][way].mean())
    return entry, round(float(travel.steps[:, :-1][way].mean())), int(travel.steps.max())


@dataclass(frozen=True, eq=False)
class SolvedSubproblem:
    """One person's problem with a robot that comes and goes, solved.

    Attributes
    ----------
    visits : AttentionSubproblem
    policy : QMDP
        Its policy.
    states : int array, shape (W + 1, P, n)
        Its states, by the step, the robot's position and the state of the person's own problem; -1 where that cannot be
        reached at that step.
    """

    visits: AttentionSubproblem
    policy: QMDP
    states: NDArray[np.int64]

    @classmethod
    def of(cls, visits: AttentionSubproblem, policy: QMDP) -> SolvedSubproblem:
        """Number the states."""
        steps, positions = range(len(visits.layout.layers)), range(visits.layout.positions)
        return cls(visits, policy, np.array([[visits.states(t, position) for position in positions] for t in steps]))


@dataclass(frozen=True, eq=False)
class Priority:
    """Go where the robot's presence is worth most.

    For each person, what they get with the robot there, less what they get without it in this step, is what its
    presence is worth: saying something where it is, holding its place silently, or arriving after the way and going on
    from there; less what the way costs. The largest worth is acted on. On tasks that are not looked at whole
    (`PolicyOnPart`) what follows is looked up in a region, one step ahead of it.

    Attributes
    ----------
    entry : float
        What coming costs.
    entry_steps, longest : int
        How many steps it takes, and how many at most.
    price : float array, shape (W + 1,)
        What each step of the robot's attention is worth to others, the last also at any later one. It counts from the
        next step on, since what others need in this one is seen.
    known : ByPolicy of SolvedSubproblem
        For people on tasks that are looked at whole.
    """

    entry: float
    entry_steps: int
    longest: int
    price: Floats
    known: ByPolicy[SolvedSubproblem]
    uses_belief = True

    @classmethod
    def of(
        cls,
        policies: Sequence[Policy],
        travel: Travel,
        price: ArrayLike | None = None,
    ) -> Priority:
        """Make the policy for people, each by themselves, and the way between them.

        What it takes to help each of them is worked out when they are first met, or by `prepare`. Where places are not
        equally far, coming back counts as far as it is on average.

        Parameters
        ----------
        policies : sequence of Policy
        travel : Travel
        price : float or float array, shape (W,), optional
            What a step of the robot's attention is worth to others, in cost units: at every step, where values from
            0.1 to 0.2 of the cheapest action's cost were about equally good for teams of 2 to 100; or at each of the
            steps from 0 on, and then nothing, for people on tasks that are looked at whole who all begin at step 0.
            The policy then knows the states that can be reached by each step, and refuses a person in another one.

        Raises
        ------
        ValueError
            Prices of several steps for tasks that are not looked at whole.
        """
        on_part = on_parts(policies)
        whole = [policy for policy in policies if not is_on_part(policy)]
        if price is None:
            tasks = [policy.pomdp.model.choices for policy in whole]
            cheapest = [float(task.costs[task.applicable].min()) for task in tasks]
            price = PRICE * min(cheapest + [min(policy.known.task.costs, default=1) for policy in on_part])
        entry, steps, longest = coming(travel)
        each = np.asarray(price, dtype=float)
        if each.ndim and on_part:
            raise ValueError(f"prices of {each.size} steps: expected one price where tasks are not looked at whole")

        def presence(policy: Policy) -> SolvedSubproblem:
            free = AttentionSubproblem.of(policy.pomdp, entry, steps, longest=longest)
            if not each.ndim:
                return SolvedSubproblem.of(free, qmdp(free.at_price(float(each))))
            visits = AttentionSubproblem.of(policy.pomdp, entry, steps, each, longest=longest)
            return SolvedSubproblem.of(visits, backwards(visits, qmdp(free.pomdp).value_mdp))

        prices = np.append(each, 0.0) if each.ndim else each.reshape(1)
        return cls(entry, steps, longest, prices, ByPolicy(whole, presence))

    def with_policies(self, policies: Sequence[Policy], travel: Travel) -> Priority:
        """Return the same team policy, at the same prices, for other policies of the people by themselves."""
        return Priority.of(policies, travel, self.price[:-1] if len(self.price) > 1 else self.price[0])

    def prepare(self, policy: Policy) -> None:
        """Work out now what it takes to help the people of a policy."""
        if is_on_part(policy):
            policy.prepare_visits(self.entry, self.entry_steps, self.longest, float(self.price[0]))
        else:
            self.presence(policy)

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Choose the person with whom to be, in every team."""
        robot, going, holding = self.worth(team)
        teams = np.arange(len(team.x))
        best = going.argmax(axis=1)
        return team.act(np.where(going[teams, best] > np.maximum(holding, 0), best, NOBODY), robot)

    def worth(self, team: TeamState) -> tuple[NDArray[np.int64], Floats, Floats]:
        """Give each person's robot action, what going to them is worth, both (N, K), and what holding on is, (N,)."""
        robot, going, holding = np.zeros_like(team.x), np.full(team.x.shape, -np.inf), np.zeros(len(team.x))
        steps = team.travel.steps[team.location][:, :-1]
        if steps.max(initial=0) > self.longest:
            raise ValueError(
                f"a way of {steps.max()} steps: this policy was made for at most {self.longest}; "
                "expected the team's travel in Priority.of"
            )
        if not team.active.any():
            return robot, going, holding
        step = min(team.step, len(self.price) - 1)  # all later ones are alike
        price, values = self.price[step], team.of_each(self._asks[step])
        arriving, q = values[:, :, : self.longest], values[:, :, self.longest :]
        # Nothing is worth infinitely little to those who are not there.
        gain = np.full(q.shape, -np.inf)
        np.subtract(q[:, :, 1:] + price, q[:, :, :1], out=gain[:, :, 1:], where=team.active[:, :, None])
        if q.shape[2] > 2:
            robot = np.where(team.active, gain[:, :, 2:].argmax(axis=2) + 1, 0)
            going = gain[:, :, 2:].max(axis=2)
        e, k = np.nonzero(team.active & (steps > 0))
        going[e, k] = arriving[e, k, steps[e, k] - 1] + price - q[e, k, 0]
        with_them = np.flatnonzero(team.location != BASE)
        with_them = with_them[team.active[with_them, team.location[with_them]]]
        holding[with_them] = gain[with_them, team.location[with_them], 1]
        return robot, going - team.to(), holding

    @cached_property
    def _asks(self) -> tuple[Ask, ...]:
        """What is asked about people, by the step: one object each, as a live team keeps answers by what was asked."""
        return tuple(partial(self._values, step) for step in range(len(self.price)))

    def presence(self, policy: Policy) -> SolvedSubproblem:
        """Give the problem of the people of a policy with a robot that comes and goes."""
        if is_for_one_step(policy):
            return SolvedSubproblem.of(*policy.visits(self.entry, self.entry_steps, self.longest, float(self.price[0])))
        return self.known[policy]

    def _values(self, step: int, policy: Policy, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give what it is worth that the robot is on its way, by how long, then what each of its actions is there."""
        solved = self.presence(policy)
        states = solved.states[step][:, x]
        if (states < 0).any():
            raise ValueError(
                f"somebody is at step {step} where nobody can be so soon: with prices of steps all begin at step 0"
            )
        arriving = [solved.policy.q_values(states[HERE + steps], belief)[:, :1] for steps in range(1, 1 + self.longest)]
        return np.concatenate([*arriving, solved.policy.q_values(states[HERE], belief)], axis=1)
