"""A team policy of our own: be where the robot's presence is worth most.

Algorithm 1 scores a suggestion to a person as if the way to them were to be paid for this suggestion alone, and
as if they were always within reach afterwards. Here each person's problem knows whether the robot is with them
(`assist.team.subproblem`), so that coming is worth what can be said later without coming again, staying silently has
a worth of its own, and a way that takes time is looked at to its end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..person.pomdp import Policy
from ..person.qmdp import qmdp
from .state import NOBODY, TeamAction, TeamState
from .subproblem import HERE, Visits
from .travel import Travel
from .wide import Around, WidePolicy

PRICE = 0.15
"""What a step of the robot's attention will be worth to others: this share of the cheapest action's cost."""


def coming(travel: Travel) -> tuple[float, int, int]:
    """Give what coming costs on average, how many steps it takes, and how many from the farthest place."""
    way = ~np.eye(len(travel.distance), dtype=bool)[:, :-1]
    entry = travel.c_move * float(travel.distance[:, :-1][way].mean())
    return entry, round(float(travel.steps[:, :-1][way].mean())), int(travel.steps.max())


@dataclass(frozen=True)
class Priority:
    """Go where the robot's presence is worth most.

    For each person, what they get with the robot there, less what they get without it in this step, is what its
    presence is worth: saying something where it is, holding its place silently, or arriving after the way and going on
    from there; less what the way costs. The largest worth is acted on.

    Attributes
    ----------
    visits : tuple of Visits
        For each model, the problem with a robot that comes and goes.
    policies : tuple of Policy
        Their policies.
    states : tuple of int arrays, shape (P, n)
        Their states, by the robot's position and the task's state.
    price : float
        What a step of the robot's attention will be worth to others. It counts from the next step on, since what
        others need in this one is seen.
    """

    visits: tuple[Visits, ...]
    policies: tuple[Policy, ...]
    states: tuple[NDArray[np.int64], ...]
    price: float
    uses_belief = True

    @classmethod
    def of(cls, policies: Sequence[Policy], travel: Travel, price: float | None = None) -> Priority:
        """Work the policy out for people, each by themselves, and the way between them.

        Where places are not equally far, coming back counts as far as it is on average.

        Parameters
        ----------
        policies : sequence of Policy
        travel : Travel
        price : float, optional
            What a step of the robot's attention will be worth to others, in cost units. Values from 0.1 to 0.2 of the
            cheapest action's cost were about equally good for teams of 2 to 100.
        """
        if price is None:
            tasks = [policy.pomdp.model.choices for policy in policies]
            price = PRICE * min(float(task.costs[task.applicable].min()) for task in tasks)
        entry, steps, longest = coming(travel)
        visits = [Visits.of(policy.pomdp, entry, steps, longest=longest) for policy in policies]
        solved = [qmdp(each.at_price(price)) for each in visits]
        states = tuple(np.stack([each.states(0, position) for position in range(2 + longest)]) for each in visits)
        return cls(tuple(visits), tuple(solved), states, price)

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Choose the person with whom to be, in every team."""
        robot, going, holding = self.worth(team)
        teams = np.arange(len(team.x))
        best = going.argmax(axis=1)
        return team.act(np.where(going[teams, best] > np.maximum(holding, 0), best, NOBODY), robot)

    def worth(self, team: TeamState) -> tuple[NDArray[np.int64], Floats, Floats]:
        """Give each person's robot action, what going to them is worth, both (N, K), and what holding on is, (N,)."""
        robot, holding = np.zeros(team.x.size, dtype=np.int64), np.zeros(len(team.x))
        going = np.full(team.x.size, -np.inf)
        steps = team.travel.steps[team.location][:, :-1].ravel()
        if HERE + steps.max(initial=0) >= len(self.states[0]):
            raise ValueError(
                f"a way of {steps.max()} steps: this policy was made for at most {len(self.states[0]) - 1 - HERE}; "
                "expected the team's travel in Priority.of"
            )
        for group, rows in team.groups():
            x, belief = team.known_of(rows)
            states, policy = self.states[group], self.policies[group]
            q = policy.q_values(states[HERE][x], belief)
            q[:, 1:] += self.price
            gain = q - q[:, :1]
            robot[rows] = gain[:, 2:].argmax(axis=1) + 1 if gain.shape[1] > 2 else 0
            worth = gain[:, 2:].max(axis=1, initial=-np.inf)
            far = np.flatnonzero(steps[rows] > 0)
            if len(far):
                at = states[HERE + steps[rows[far]], x[far]]
                worth[far] = policy.q_values(at, belief[far])[:, 0] + self.price - q[far, 0]
            going[rows] = worth
            e, k = np.divmod(rows, team.x.shape[1])
            with_them = np.flatnonzero(team.location[e] == k)
            holding[e[with_them]] = gain[with_them, 1]
        shape = team.x.shape
        return robot.reshape(shape), going.reshape(shape) - team.to(), holding


@dataclass(frozen=True)
class WidePriority:
    """The same on tasks of any size: what presence is worth is looked up in a region, and one step ahead of it.

    Attributes
    ----------
    entry : float
        What coming costs.
    entry_steps, longest : int
        How many steps it takes, and how many at most.
    price : float
        As in `Priority`.
    """

    entry: float
    entry_steps: int
    longest: int
    price: float
    uses_belief = True

    @classmethod
    def of(
        cls,
        policies: Sequence[WidePolicy],
        travel: Travel,
        price: float | None = None,
        *,
        progress: Callable[[int, int], None] | None = None,
    ) -> WidePriority:
        """Work it out for people, each by themselves; arguments as in `Priority.of`.

        Parameters
        ----------
        progress : callable, optional
            Called with how many people's problems have been solved, and of how many.
        """
        if price is None:
            price = PRICE * min(min(policy.ground.known.task.costs, default=1) for policy in policies)
        made = cls(*coming(travel), price)
        for done, policy in enumerate(policies):
            if progress is not None:
                progress(done, len(policies))
            policy.visited(made.entry, made.entry_steps, made.longest, price)
        return made

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Choose the person with whom to be, in every team."""
        visits, policies, states = [], [], []
        for around in team.policies:
            if not isinstance(around, Around):
                raise TypeError(f"{type(around).__name__}: this policy is for people on a task of any size (`Around`)")
            one, policy = around.visits(self.entry, self.entry_steps, self.longest, self.price)
            visits.append(one)
            policies.append(policy)
            states.append(np.stack([one.states(0, position) for position in range(one.layout.positions)]))
        return Priority(tuple(visits), tuple(policies), tuple(states), self.price)(team)
