"""A truncated task: the part of a large task that is relevant to one person's problem.

A solver cannot keep vectors for the states of a task with millions of states, or of a task whose states are solved on
demand. But few of them are likely to be visited. A `TruncatedTask` holds the most likely states and ends at the others,
the frontier. There its problem has bounds that follow from the cost-to-go alone (`closed_problem`). So the
bounds of a solver on the truncated task hold for the whole task:

- Upper bound: every action lowers h* by at most its cost. So the discounted cost from h* on is at least that of the
  cheapest steps, delayed as long as the most expensive action allows (`never_erring`).
- Lower bound: a person who receives an optimal suggestion in every step follows it with a probability that grows with
  theta, and theta grows with every such suggestion. Otherwise the worst case is assumed (`advised`).

The robot knows h* and not people's misconceptions (`knowledge="exact"`).

Several goals. The person pursues one of G goals, and the robot knows its probability only.

Claim. At a frontier state, under a belief in goal, beta and theta, the mean of the goals' upper bounds is an upper
bound on the value of every policy. The mean of their lower bounds is a lower bound on the optimal value.

Proof. A robot that knows the goal can ignore it, so that no policy is better than its mean value. `never_erring`
bounds that value for each goal. The lower bound of each goal is one for a robot that never acts again. That is the same
policy for all goals, so that its value is the mean of its values for each.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from planner import CostToGo
from planner.system.arrays import outline

from ..people.belief import Grid
from ..people.choices import WAIT, Choices
from ..people.decision import Bools, Floats, Ints
from ..people.goals import Goals, each_of, first_of, joined, optimal_for_each
from ..people.human import Human
from ..people.memory_on_demand import memory_of
from ..people.ranges import Population
from ..people.trust_rules import EquationSeven, constant
from .assumptions import Assumptions
from .frontier_bounds import CostLevels, Survey, advised, never_erring, never_erring_with_help
from .leaf_bounds import LeafBounds
from .likely_states import Growth
from .robots import EXECUTION, NOTHING_DONE, OfRobots
from .state_cache import NONE, Part, StateCache

BATCH = {"sweep": 500, "on-demand": 20}  # states that are expanded together, between two looks at the clock


@dataclass(frozen=True)
class TruncatedTask:
    """Some states of a task with their choices, and the frontier around them.

    Attributes
    ----------
    known : CostToGo or Goals
        Cost-to-go of the task, or of each goal.
    choices : Choices
        Choices in the n states of the truncated task; frontier states have none.
    states : int array, shape (n,)
        Number of each state in `known`.
    frontier : int array, shape (m,)
        The frontier states, without those in which all goals are reached.
    acting : int array, shape (m,), or None
        As in `LeafBounds`, in a task for a robot that executes actions (`for_robot`). None in others.
    """

    known: CostToGo | Goals
    choices: Choices
    states: Ints
    frontier: Ints
    acting: Ints | None = None

    __repr__ = outline

    @classmethod
    def of(
        cls,
        known: CostToGo | Goals,
        *,
        start: int | None = None,
        states: int = 20_000,
        population: Population | None = None,
        human: Human | None = None,
        among: CostToGo | Goals | None = None,
        time_limit: float | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> TruncatedTask:
        """Collect the states that are most likely to be visited.

        The expansion is best-first by the probability of the best path, with choices averaged over beta. An optimal
        choice counts with a weight of 0.9, since the robot may suggest it. Probabilities of goals are their prior ones.

        Parameters
        ----------
        known : CostToGo or Goals
        start : int, optional
            First state, by its number in `known`; by default the initial state.
        states : int
            Largest number of expanded states; the frontier is additional.
        population : Population, optional
            Population of the person.
        human : Human, optional
            The person, if their misconceptions are known. The probabilities then follow these.
        among : CostToGo or Goals, optional
            The goals of which `known` is one, if the robot may suggest what is optimal for any of them; by default
            `known` alone.
        time_limit : float, optional
            Seconds after which the expansion stops.
        progress : callable, optional
            Called with the number of states that were expanded since the last call.
        """
        start = first_of(known).initial if start is None else start
        seen = StateCache(known)
        growth = Growth(seen, Grid.regular(population or Population()).beta, start, human)
        begun, batch = time.monotonic(), BATCH["on-demand" if first_of(known).searches else "sweep"]
        while len(growth.expanded) < states and (time_limit is None or time.monotonic() - begun < time_limit):
            done = growth.step(min(batch, states - len(growth.expanded)))
            if not done:
                break
            if progress is not None:
                progress(done)
        part = seen.every()
        found = cls._of_part(known, part)
        if among is None or among is known:
            return found
        offered, rows = np.zeros_like(found.choices.optimal), part.rows
        best = optimal_for_each(among, part.states, rows._replace(targets=part.states[rows.targets])).any(axis=1)
        offered[found.choices.applicable & (found.choices.actions != WAIT)] = best
        return replace(found, choices=replace(found.choices, offered=offered))

    @classmethod
    def around(
        cls, seen: StateCache, states: Ints, *, then: Ints = NONE, ahead: bool = False,
        advice_is_optimal: bool = True,
    ) -> TruncatedTask:  # fmt: skip
        """Return a truncated task of the given states, with their successors as the frontier.

        Parameters
        ----------
        seen : StateCache
            The task, with what is known of it.
        states : int array, shape (N,)
            Their numbers. They are the first states, in this order, and a state may occur twice.
        then : int array, shape (M,)
            Successor states that are expanded as well, so that they are not on the frontier.
        ahead : bool
            Whether all successors after a suggestion are expanded, too.
        advice_is_optimal : bool
            Whether only optimal actions are suggested, or all.
        """
        return cls._of_part(seen.known, seen.around(states, then, ahead=ahead, advice_is_optimal=advice_is_optimal))

    @classmethod
    def _of_part(cls, known: CostToGo | Goals, part: Part) -> TruncatedTask:
        """Return the truncated task of a part; its frontier is that of the part where not all goals are reached."""
        choices, frontier = memory_of(known).with_terms(joined(known, part.each), part.states), part.frontier
        return cls(known, choices, part.states, frontier[~choices.goal[frontier]])

    def for_robot(self, robot: OfRobots) -> TruncatedTask:
        """Return the task with rows in which a person acts after this robot has executed an action at the frontier.

        The person acts in the same step, and the choices beyond the frontier are unknown. So two rows stand for all
        frontier states of the same cost-to-go: one with a single choice, at no cost, and one at the frontier to which
        it leads. Bounds there are divided by gamma, since they are for the step before. Their number in `states` is -1.
        """
        if not robot.execute or self.acting is not None or not len(self.frontier):
            return self
        _, example, level = np.unique(self.choices.h[self.frontier], return_index=True, return_inverse=True)
        begin, count = len(self.states), len(example)
        acts, ends = begin + np.arange(count), begin + count + np.arange(count)
        rows = np.concatenate([np.arange(begin), *2 * [self.frontier[example]]])
        applicable, targets = self.choices.applicable[rows], self.choices.targets[rows]
        targets[begin:] = np.arange(begin, len(rows))[:, None]
        applicable[acts, 0], targets[acts, 0] = True, ends
        return replace(
            self, choices=self.choices.of_rows(rows, applicable=applicable, targets=targets),
            states=np.append(self.states, np.full(2 * count, -1)), frontier=np.append(self.frontier, ends),
            acting=np.append(acts[level], ends),
        )  # fmt: skip

    @property
    def _after_executions(self) -> Bools:
        """Which frontier states stand for those to which executions lead, shape (m,)."""
        return np.zeros(len(self.frontier), dtype=bool) if self.acting is None else self.acting == self.frontier

    @property
    def inside(self) -> Ints:
        """The rows of the states that are not on the frontier, in the ascending order of states."""
        inside = np.setdiff1d(np.flatnonzero(self.states >= 0), self.frontier)
        return inside[np.argsort(self.states[inside])]

    @cached_property
    def _order(self) -> Ints:
        """The rows in the ascending order of states."""
        return np.argsort(self.states)

    def local(self, states: Ints) -> Ints:
        """Return the rows, shape (N,), of states that are numbered as in `known`; -1 outside the truncated task."""
        order = self._order
        at = np.minimum(np.searchsorted(self.states, states, sorter=order), len(order) - 1)
        return np.where((self.states[order[at]] == states) & (states >= 0), order[at], -1)

    def bounds_of_anybody(self, assumed: Assumptions) -> LeafBounds:
        """Return bounds at the frontier that hold for every person, whatever is assumed of them.

        The upper bound is `never_erring`, or `never_erring_with_help`. The lower bound is for a robot that does
        nothing, with the largest cost in every step.
        """
        gamma, nothing = assumed.gamma, assumed.robot.costs[NOTHING_DONE]
        known, h, after = first_of(self.known), self.choices.goals.h[:, self.frontier].T, self._after_executions
        actions, step = known.task.action_costs, CostLevels.of(known).step
        most = float(actions.max(initial=1.0))  # a wait costs 1
        lower = self._unless_reached(-(most + nothing) / (1 - gamma), len(assumed.grid.theta))
        if self.acting is None:
            upper = never_erring(h, actions, gamma)
        else:
            upper, acts = never_erring_with_help(h, actions, gamma, assumed.robot.costs[EXECUTION], step)
            upper[after], lower[after] = acts[after] / gamma, lower[after] / gamma
        return LeafBounds(self.frontier, lower, upper[:, :, None], -most / (1 - gamma), acting=self.acting)

    def _unless_reached(self, value: float, thetas: int) -> Floats:
        """Return a value at the frontier for each goal and theta, shape (m, G, T); 0 where the goal is reached."""
        reached = self.choices.goals.goal[:, self.frontier].T
        return np.where(reached[:, :, None], 0.0, np.full(thetas, value))

    def bounds(self, assumed: Assumptions) -> LeafBounds:
        """Return bounds at the frontier for a person without misconceptions, or whose misconceptions are unknown.

        The upper bound is `never_erring`, for each goal that the person may pursue: a robot that knows the goal is
        not worse. The lower bound is `advised` for states from which a goal is reachable. If the goal is one of
        several, the robot does nothing, as that policy does not depend on the goal. In a dead end the robot may never
        act again, and no step costs more than the most expensive choice. With an h* above 10,000 levels of cost the
        lower bound is that of the worst case, because computing every level would take too long. The worst case is also
        assumed for a trust rule that is neither equation 7 nor constant.
        """
        gamma, trust, thetas = assumed.gamma, assumed.trust, len(assumed.grid.theta)
        nothing, suggestion, _ = assumed.robot.costs
        levels = CostLevels.of(first_of(self.known))
        dear, several = float(levels.costs[-1]), self.choices.goals.distinguished
        anybody = self.bounds_of_anybody(assumed)
        floor = -(dear + (nothing if several else max(nothing, suggestion))) / (1 - gamma)
        by_equation = trust is None or isinstance(trust, EquationSeven)
        if isinstance(trust, EquationSeven):
            assumed = replace(assumed, eta=trust.eta, utility_scale=trust.utility_scale)
        if trust == constant() or several:
            assumed, by_equation = replace(assumed, eta=0.0), True
        lower, goals = self._unless_reached(floor, thetas), self.choices.goals
        for number, (known, own) in enumerate(zip(each_of(self.known), goals.h, strict=True)):
            survey, at = Survey.of(known, own), np.flatnonzero(~goals.goal[number, self.frontier])
            h = own[self.frontier[at]]
            if survey.highest <= 10_000 and by_equation:
                value = advised(survey, levels, floor, assumed, suggests=not several)
                reached = np.isfinite(h)
                lower[at[reached], number] = value[np.rint(h[reached] / levels.step).astype(np.int64)]
            lower[at[np.isinf(h)], number] = -(dear + nothing) / (1 - gamma)  # in a dead end the robot does nothing
        after = self._after_executions
        lower[after] = anybody.lower[after]
        return replace(anybody, lower=lower)
