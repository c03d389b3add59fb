"""A truncated task: the part of a large task that is relevant to one person's problem.

A solver cannot keep vectors for the states of a task with millions of states, or of a task whose states are solved on
demand. But few of them are likely to be visited. A `TruncatedTask` holds the most likely states and ends at the others,
the frontier. There its problem has bounds that follow from the cost-to-go alone (`closed_problem`). So the
bounds of a solver on the truncated task hold for the whole task:

- Upper bound: every action lowers h* by at most its cost. So the discounted cost from h* on is at least that of the
  cheapest steps, delayed as long as the most expensive action allows (`never_erring`).
- Lower bound: a person who receives an optimal suggestion in every step follows it with a probability that grows with
  theta, and theta grows with every such suggestion. Otherwise the worst case is assumed (`_advised`).

The robot knows h* and not people's misconceptions (`knowledge="exact"`).

Several goals. The person pursues one of G goals, and the robot knows its probability only.

Claim: at a frontier state, under a belief in goal, beta and theta, the mean of the goals' upper bounds is an upper
bound on the value of every policy. The mean of their lower bounds is a lower bound on the optimal value.

Proof: A robot that knows the goal can ignore it, so that no policy is better than its mean value. `never_erring`
bounds that value for each goal. The lower bound of each goal is one for a robot that never acts again. That is the same
policy for all goals, so that its value is the mean of its values for each.
"""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import CostToGo, Table, Transitions
from planner.system.arrays import outline

from ..people.belief import Grid
from ..people.choices import WAIT, Choices
from ..people.decision import Floats, choice
from ..people.goals import Goals, costs_to_go, each_of, first_of, goals_reached, joined, optimal_for_each
from ..people.human import Human
from ..people.memory_on_demand import Remembering
from ..people.misconception import Misconception
from ..people.ranges import Population
from ..people.slots import padded
from ..people.state_keys import keys_of
from ..people.trust_rules import EquationSeven, constant
from .assumptions import Assumptions
from .leaf_bounds import LeafBounds
from .robots import NOTHING_DONE, SUGGESTION

BATCH = {"sweep": 500, "on-demand": 20}  # states that are expanded together, between two looks at the clock
SURVEYED = 10_000_000  # states of a table up to which `_Survey` scans all transitions, to limit its time


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
    """

    known: CostToGo | Goals
    choices: Choices
    states: NDArray[np.int64]
    frontier: NDArray[np.int64]

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
        among: Goals | None = None,
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
        among : Goals, optional
            The goals of which `known` is one, if the robot may suggest what is optimal for any of them.
        time_limit : float, optional
            Seconds after which the expansion stops.
        progress : callable, optional
            Called with the number of states that were expanded since the last call.
        """
        start = first_of(known).initial if start is None else start
        growth = _Growth(known, Grid.regular(population or Population()).beta, start, human)
        begun, batch = time.monotonic(), BATCH["on-demand" if first_of(known).searches else "sweep"]
        while growth.expanded < states and (time_limit is None or time.monotonic() - begun < time_limit):
            done = growth.step(min(batch, states - growth.expanded))
            if not done:
                break
            if progress is not None:
                progress(done)
        return growth.region(among)

    @classmethod
    def joined(
        cls, known: CostToGo | Goals, each: Sequence[Choices], states: NDArray[np.int64], cut: NDArray[np.int64]
    ) -> TruncatedTask:
        """Return a truncated task with the choices of each goal in some states, shape (m,).

        `cut` are the indices of states without known choices. They are the frontier, except where all goals are
        reached.
        """
        choices = joined(known, each)
        if isinstance(known, Remembering):
            choices = known.with_terms(choices, states)
        return cls(known, choices, states, cut[~choices.goal[cut]])

    @property
    def inside(self) -> NDArray[np.int64]:
        """The rows of the states that are not on the frontier, in the ascending order of states."""
        inside = np.setdiff1d(np.arange(len(self.states)), self.frontier)
        return inside[np.argsort(self.states[inside])]

    def local(self, states: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the rows, shape (N,), of states that are numbered as in `known`; -1 outside the truncated task."""
        order = np.argsort(self.states)
        at = np.minimum(np.searchsorted(self.states, states, sorter=order), len(order) - 1)
        return np.where(self.states[order[at]] == states, order[at], -1)

    def bounds_of_anybody(self, assumed: Assumptions) -> LeafBounds:
        """Return bounds at the frontier that hold for every person, whatever is assumed of them.

        The upper bound is `never_erring`. The lower bound is for a robot that does nothing, with the largest cost in
        every step.
        """
        gamma, nothing = assumed.gamma, assumed.robot.costs[NOTHING_DONE]
        costs = np.append(first_of(self.known).task.action_costs, 1.0)  # a wait costs 1
        upper = never_erring(self.choices.goals.h[:, self.frontier].T, costs, gamma)
        most = float(costs.max())
        lower = self._unless_reached(-(most + nothing) / (1 - gamma), len(assumed.grid.theta))
        return LeafBounds(self.frontier, lower, upper[:, :, None], -most / (1 - gamma))

    def _unless_reached(self, value: float, thetas: int) -> Floats:
        """Return a value at the frontier for each goal and theta, shape (m, G, T); 0 where the goal is reached."""
        reached = self.choices.goals.goal[:, self.frontier].T
        return np.where(reached[:, :, None], 0.0, np.full(thetas, value))

    def bounds(self, assumed: Assumptions) -> LeafBounds:
        """Return bounds at the frontier for a person without misconceptions, or whose misconceptions are unknown.

        The upper bound is `never_erring`, for each goal that the person may pursue: a robot that knows the goal is
        not worse. The lower bound is `_advised` for states from which a goal is reachable. If the goal is one of
        several, the robot does nothing, as that policy does not depend on the goal. In a dead end the robot may never
        act again, and no step costs more than the most expensive choice. With an h* above 10,000 levels of cost the
        lower bound is that of the worst case, because computing every level would take too long. The worst case is also
        assumed for a trust rule that is neither equation 7 nor constant.
        """
        gamma, trust, thetas = assumed.gamma, assumed.trust, len(assumed.grid.theta)
        nothing, suggestion, _ = assumed.robot.costs
        levels = CostLevels.of(first_of(self.known))
        dear, several = float(levels.prices[-1]), len(self.choices.goals) > 1
        anybody = self.bounds_of_anybody(assumed)
        floor = -(dear + (nothing if several else max(nothing, suggestion))) / (1 - gamma)
        by_equation = trust is None or isinstance(trust, EquationSeven)
        if isinstance(trust, EquationSeven):
            assumed = replace(assumed, eta=trust.eta, utility_scale=trust.utility_scale)
        if trust == constant() or several:
            assumed, by_equation = replace(assumed, eta=0.0), True
        lower, goals = self._unless_reached(floor, thetas), self.choices.goals
        for number, (known, own) in enumerate(zip(each_of(self.known), goals.h, strict=True)):
            survey, at = _Survey.of(known, own), np.flatnonzero(~goals.goal[number, self.frontier])
            h = own[self.frontier[at]]
            if survey.highest <= 10_000 and by_equation:
                value = _advised(survey, levels, floor, assumed, suggests=not several)
                reached = np.isfinite(h)
                lower[at[reached], number] = value[np.rint(h[reached] / levels.step).astype(np.int64)]
            lower[at[np.isinf(h)], number] = -(dear + nothing) / (1 - gamma)  # in a dead end the robot does nothing
        return LeafBounds(self.frontier, lower, anybody.upper, anybody.floor)


def never_erring(h: Floats, costs: ArrayLike, gamma: float) -> Floats:
    """Return an upper bound on the value of states for any person and any robot, shape (N,).

    Assumptions: every choice, including a wait, costs between `cheap` and `dear`; the robot executes no action of the
    task. Let K = cheap / (1 - gamma) and F(h) = K (1 - gamma^(h / dear)).

    Claim: from a state with cost-to-go h, every sequence of choices has a discounted cost of at least F(h). So -F(h) is
    an upper bound on the value, for every person.

    Proof: A choice of cost c leads to h' >= h - c, and F increases. As K - gamma K = cheap,

        c + gamma F(h') - F(h) >= c - cheap + K gamma^(h / dear) (1 - gamma^(1 - c / dear)) >= 0,

    because cheap <= c <= dear. By induction over n, the discounted cost of the first n steps is at least F(h) - gamma^n
    F(h_n), where h_n is the cost-to-go after them. F is bounded and 0 at goals, so that the claim follows as n grows.
    In a dead end h is infinite, and F = K.

    If some action is free, then cheap = 0 and the bound is 0, since people may repeat free actions without end.

    Parameters
    ----------
    h : float array, shape (N,)
        Exact cost-to-go.
    costs : array
        Costs of the task's actions.
    gamma : float
    """
    prices = np.append(costs, 1.0)  # a wait costs 1
    return np.asarray(prices.min() * np.expm1(h / prices.max() * np.log(gamma)) / (1 - gamma))


@dataclass(frozen=True)
class CostLevels:
    """The different costs of a task's choices as whole numbers of levels, so that h* can index an array.

    Attributes
    ----------
    step : float
        Cost of one level, in cost units: all costs of actions are multiples of it.
    steps : int array, shape (C,)
        Levels of each cost, ascending. A wait, which costs 1, is rounded up.
    prices : float array, shape (C,)
        These costs, in cost units.
    """

    step: float
    steps: NDArray[np.int64]
    prices: Floats

    @classmethod
    def of(cls, known: CostToGo) -> CostLevels:
        """Return the levels of a task's costs."""
        task = known.task
        whole = math.gcd(*task.costs) or 1
        steps = np.unique([*(cost // whole for cost in task.costs), math.ceil(1 / (whole * task.unit))])
        return cls(task.in_unit(float(whole)), steps, task.in_unit(steps * float(whole)))


@dataclass(frozen=True)
class _Survey:
    """Quantities of a task that hold in all of its states.

    Attributes
    ----------
    highest : int
        Levels of the largest finite h*, among the known states if not all are known.
    actions : int
        Largest number of choices in a state.
    rise : float
        Levels of the largest increase of h* by one action; infinite if an action may lead to a dead end, or if it is
        unknown.
    """

    highest: int
    actions: int
    rise: float

    @classmethod
    def of(cls, known: CostToGo, own: Floats, *, rows_at_a_time: int = 1_000_000) -> _Survey:
        """Scan all transitions of a table, in blocks to save memory; use safe values where that is too expensive.

        `own` is the cost-to-go of the truncated task's states.
        """
        step = CostLevels.of(known).step
        if not isinstance(known, Table):
            return cls(round(own[np.isfinite(own)].max(initial=0) / step), len(known.task.actions), np.inf)
        h = known.lookup(slice(None))
        finite = np.isfinite(h)
        highest = round(h[finite].max(initial=0) / step)
        if len(known) > SURVEYED:
            return cls(highest, len(known.task.actions), float(highest) if finite.all() else np.inf)
        rows = known.space.transitions
        counts = np.diff(rows.offsets)
        rise = 0.0
        for begin in range(0, len(known), rows_at_a_time):
            block = slice(begin, begin + rows_at_a_time)
            targets = rows.targets[rows.offsets[begin] : rows.offsets[min(begin + rows_at_a_time, len(known))]]
            with np.errstate(invalid="ignore"):  # a difference between two dead ends is no increase
                change = h[targets] - np.repeat(h[block], counts[block])
            rise = max(rise, float(np.nan_to_num(change, posinf=np.inf).max(initial=0.0)))
        return cls(highest, int(counts.max(initial=1)), float(np.rint(rise / step)))


def _advised(survey: _Survey, levels: CostLevels, floor: float, assumed: Assumptions, *, suggests: bool) -> Floats:
    """Return a lower bound on the value for each level of h* and each theta, shape (highest + 1, T).

    If the robot `suggests` nothing, step 1 has p in place of the probability of following, and
    theta does not move.

    Assumptions: the person chooses by equation 5 with the exact cost-to-go; theta lies on the grid and follows equation
    7. The robot suggests an optimal choice in every step.

    Claim: for each beta, whichever optimal choices are suggested, the value of this policy is at least the returned
    number. So the optimal value is.

    Proof: Let L(h, theta) be a lower bound for all states with cost-to-go h, and A the largest number of choices in a
    state.

    1. An optimal choice has the least perceived cost. So its probability without a suggestion is p >= 1 / A. The
       probability of following, `follows`, increases with p; its value at p = 1 / A is a lower bound. Lapses count as
       not following.
    2. An optimal choice of cost c leads from h to h - c and raises V by c. Hence `low` and `weight` describe the trust
       update.
    3. A person who does not follow pays at most `dear` and reaches at worst the lowest L up to level h + rise, or
       `floor` if the rise is unknown. This is at most the value of following. So replacing the probability of following
       by a lower bound lowers the mean.
    4. By 1 to 3, the minimum over c of the mean of both outcomes, minus the robot's cost, is again a lower bound. So
       every sweep maps lower bounds to lower bounds. They start at `floor`, the value of the largest cost in every
       step. Hence the bounds hold after any number of sweeps. Level 0 is 0 if all actions have a cost; otherwise a
       state with h* = 0 need not be a goal.

    At most 200 sweeps are done; they end earlier if no bound rises by 1e-6 cost units.
    """
    highest, grid, gamma = survey.highest, assumed.grid, assumed.gamma
    value = np.full((highest + 1, len(grid.theta)), floor)
    costs, charge = levels.prices, assumed.robot.costs[SUGGESTION if suggests else NOTHING_DONE]
    if costs[0] > 0:
        value[0] = 0.0
    p = 1 / survey.actions
    theta = grid.theta if suggests else np.full_like(grid.theta, 0.5)  # at 0.5 a suggestion changes nothing
    total = theta * p + (1 - theta) * (1 - p)
    follows = (1 - assumed.lapse) * np.divide(theta * p, total, out=np.full_like(total, p), where=total > 0)
    low, weight = grid.shares(grid.theta + assumed.eta * costs[:, None] / assumed.utility_scale)
    for _ in range(200):
        before = value.copy()
        for h in range(highest + 1):
            worst = np.full(len(grid.theta), floor)
            if np.isfinite(survey.rise):
                worst = value[: min(h + int(survey.rise), highest) + 1].min(axis=0)
            outcomes = []
            for level, c, at, up in zip(levels.steps, costs, low, weight, strict=True):
                if level <= h:
                    right = (1 - up) * value[h - level, at] + up * value[h - level, at + 1]
                    wrong = (1 - up) * worst[at] + up * worst[at + 1]
                    outcomes.append(follows * (gamma * right - c) + (1 - follows) * (gamma * wrong - costs[-1]))
            if outcomes:
                value[h] = np.maximum(value[h], np.min(outcomes, axis=0) - charge)
        if (value - before).max() < 1e-6:
            break
    return value


def perceived_of_states(human: Human, known: CostToGo, states: NDArray[np.int64], h: Floats) -> Floats:
    """Return what a person takes for the cost-to-go of states, shape (N,), where `h` is the exact cost-to-go.

    It is the exact one for misconceptions about actions, which do not define a perceived cost-to-go of a state.
    """
    if not isinstance(human.h, Misconception) or human.h.noise == "action":
        return h
    return human.h.of_states(h, known.is_goal(states), keys_of(known, states))


class _Growth:
    """The best-first expansion of a truncated task.

    The probability of a path is a vector: that of the goal and of the person's choices, for each goal.
    """

    def __init__(self, known: CostToGo | Goals, betas: Floats, start: int, human: Human | None) -> None:
        self.known, self.betas, self.human = known, betas, human
        self.each, self.first = each_of(known), first_of(known)
        self.cost = self.first.task.action_costs
        self.number: dict[int, int] = {}
        self.states: list[int] = []
        self.h: list[Floats] = []
        self.goal: list[NDArray[np.bool_]] = []
        self.rows: list[tuple[NDArray[np.integer], NDArray[np.integer]] | None] = []
        self.queue: list[tuple[float, int, int]] = []  # the last number is that of the path
        self.paths: list[Floats] = []
        self.expanded = 0
        shares = np.array(list(known.prior.values()) if isinstance(known, Goals) else [1.0])
        self.possible = shares > 0
        self._add(np.array([start]), shares[None])

    def _add(self, states: NDArray[np.int64], weights: Floats) -> NDArray[np.int64]:
        """Add states and paths to them, of probability `weights`, shape (N, G); return the states' indices."""
        numbers, place = states.tolist(), self.number
        new = np.array([state for state in dict.fromkeys(numbers) if state not in place], dtype=np.int64)
        if len(new):
            place |= zip(new.tolist(), range(len(self.states), len(self.states) + len(new)), strict=True)
            self.states.extend(new.tolist())
            self.h.extend(costs_to_go(self.known, new))
            self.goal.extend(goals_reached(self.known, new))
            self.rows.extend([None] * len(new))
        local = np.array([place[number] for number in numbers], dtype=np.int64)
        unexpanded = np.flatnonzero([self.rows[at] is None for at in local.tolist()])
        here = local[unexpanded].tolist()
        open_goals = ~np.array([self.goal[at] for at in here], dtype=bool).reshape(len(here), len(self.possible))
        going = weights[unexpanded] * open_goals
        sizes, goes_on = going.sum(axis=1).tolist(), (self.possible & open_goals).any(axis=1).tolist()
        for at, path, size, further in zip(here, going, sizes, goes_on, strict=True):
            if further:
                heapq.heappush(self.queue, (-size, at, len(self.paths)))
                self.paths.append(path)
        return local

    def step(self, most: int) -> int:
        """Expand the most likely states, at most `most` of them; return their number."""
        batch: dict[int, Floats] = {}
        while self.queue and len(batch) < most:
            _, at, path = heapq.heappop(self.queue)
            if self.rows[at] is None and at not in batch:
                batch[at] = self.paths[path]
        if not batch:
            return 0
        rows = self.first.choices(np.array([self.states[at] for at in batch]))
        targets = np.asarray(rows.targets, dtype=np.int64)
        actions, offsets = rows.actions, rows.offsets
        counts = np.diff(offsets)
        source = np.repeat(np.arange(len(batch)), counts)
        slot = np.arange(len(targets)) - offsets[source]
        weight = np.array(list(batch.values()))[source]
        applicable = np.zeros((len(batch), int(counts.max(initial=1))), dtype=bool)
        applicable[source, slot] = True
        for number, (known, after) in enumerate(zip(self.each, costs_to_go(self.known, targets).T, strict=True)):
            q = np.full(applicable.shape, np.inf)
            q[source, slot] = self.cost[actions] + after
            best = q == q.min(axis=1, keepdims=True)
            if self.human is not None:
                q[source, slot] = self.cost[actions] + perceived_of_states(self.human, known, targets, after)
            alone = np.mean([choice(q, applicable, beta) for beta in self.betas], axis=0)
            # An optimal choice is likely, since the robot may suggest it.
            weight[:, number] *= np.where(best, 0.9, alone)[source, slot]
        local = self._add(targets, weight)
        for at, begin, end in zip(batch, offsets[:-1], offsets[1:], strict=True):
            self.rows[at] = actions[begin:end], local[begin:end]
        self.expanded += len(batch)
        return len(batch)

    def region(self, among: Goals | None) -> TruncatedTask:
        """Return the truncated task of the expanded states."""
        none = np.empty(0, dtype=np.int64)
        expanded = np.array([row is not None for row in self.rows])
        counts = np.array([0 if row is None else len(row[0]) for row in self.rows])
        offsets = np.concatenate([[0], np.cumsum(counts)])
        actions, targets = (
            np.concatenate([none, *(row[part] for row in self.rows if row is not None)]) for part in range(2)
        )
        goal, h, states = np.array(self.goal), np.array(self.h), np.array(self.states)
        rows, there = Transitions(offsets, actions, targets), Transitions(offsets, actions, states[targets])
        optimal, key = optimal_for_each(self.known, states, there), keys_of(self.first, states)
        each = []
        for number, (own, reached) in enumerate(zip(h.T, goal.T, strict=True)):
            slots = padded(self.first, rows, optimal[:, number], ~reached & expanded)
            each.append(Choices(own.copy(), reached.copy(), *slots, self.first.task.actions, key=key))
        found = TruncatedTask.joined(self.known, each, states, np.flatnonzero(~expanded))
        if among is None:
            return found
        offered = np.zeros_like(found.choices.optimal)
        offered[found.choices.applicable & (found.choices.actions != WAIT)] = optimal_for_each(
            among, states, there
        ).any(axis=1)
        return replace(found, choices=replace(found.choices, offered=offered))
