"""The part of a large task that matters to one person's problem.

A task of millions of states, or one that can only be asked on demand, has no room for what a solver keeps of each
state. But from the initial state hardly any of them are met: a `Region` holds the states that people and
advice most likely lead to, and breaks off at the others, the frontier. There the problem has bounds that follow
from the cost-to-go alone (`Region.problem`), so that what a solver proves of the region holds of the whole task:

- above: every action lowers h* by at most its cost, so that from h* on no less is paid than if each step cost as
  little, and each unit of h* was put off as long, as any action allows;
- below: someone who is given an optimal suggestion in every step follows it with at least a chance that grows with
  theta, and theta grows with every suggestion; otherwise the worst happens.

The robot is taken to know h*, not people's misconceptions of it (`knowledge="exact"`).
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo, Table

from ..people.belief import Grid
from ..people.choices import WAIT, Choices
from ..people.human import Floats, HumanModel, Mixture, Population, choice
from .pomdp import AssistPOMDP, Frontier, Suggestions

BATCH = {"sweep": 500, "on-demand": 20}  # states that are looked at together, between two looks at the clock
ADVISED = 0.9  # the weight of an action that an adviser would have people take
LEVELS = 10_000  # largest h* for which the bound below is worked out level by level
SWEEPS = 200
BLOCK = 1_000_000
SURVEYED = 10_000_000  # states of a table of which all choices are looked at for that bound


@dataclass(frozen=True)
class Region:
    """Some states of a task with their choices, and the states around them.

    Attributes
    ----------
    known : CostToGo
        The task's cost-to-go, which names states by numbers of its own.
    choices : Choices
        Of the region's states; those on the frontier have none.
    states : int array, shape (n,)
        The number of each state in `known`.
    frontier : int array, shape (m,)
        Which of the region's states are on the frontier.
    """

    known: CostToGo
    choices: Choices
    states: NDArray[np.int64]
    frontier: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        known: CostToGo,
        *,
        start: int | None = None,
        states: int = 20_000,
        population: Population | Mixture | None = None,
        time_limit: float | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> Region:
        """Collect the states that are met most likely.

        Parameters
        ----------
        known : CostToGo
        start : int, optional
            From which state on, as `known` numbers it; from the initial one unless given.
        states : int
            How many to look beyond at the most; the frontier comes on top.
        population : Population or Mixture, optional
            Of whom the person is one.
        time_limit : float, optional
            Stop collecting after so many seconds.
        progress : callable, optional
            Called with how many states have been looked at since the last call.
        """
        start = known.initial if start is None else start
        growth = _Growth(known, Grid.regular(population or Population()).beta, start)
        begun = time.monotonic()
        while growth.expanded < states and (time_limit is None or time.monotonic() - begun < time_limit):
            done = growth.step(min(BATCH[known.method], states - growth.expanded))
            if not done:
                break
            if progress is not None:
                progress(done)
        return growth.region()

    def local(self, states: NDArray[np.int64]) -> NDArray[np.int64]:
        """Give the region's numbers, shape (N,), of states as `known` numbers them; -1 outside."""
        order = np.argsort(self.states)
        at = np.minimum(np.searchsorted(self.states, states, sorter=order), len(order) - 1)
        return np.where(self.states[order[at]] == states, order[at], -1)

    def problem(
        self,
        *,
        grid: Grid | None = None,
        population: Population | Mixture | None = None,
        eta: float = 0.2,
        lapse: float = 1e-3,
        utility_scale: float = 1.0,
        gamma: float = 0.99,
        c_suggest: float = 1.0,
        suggestions: Suggestions = "optimal",
    ) -> AssistPOMDP:
        """Set up the problem of assisting one person within the region; arguments as in `AssistPOMDP.of`."""
        grid = grid or Grid.regular(population or Population())
        model = HumanModel.exact(self.choices, eta=eta, lapse=lapse, utility_scale=utility_scale)
        lower, upper = self._bounds(grid, model, gamma, c_suggest)
        return AssistPOMDP.of(
            model, grid=grid, population=population, gamma=gamma, c_suggest=c_suggest, suggestions=suggestions,
            frontier=Frontier(self.frontier, lower, upper),
        )  # fmt: skip

    def _bounds(self, grid: Grid, model: HumanModel, gamma: float, c_suggest: float) -> tuple[Floats, Floats]:
        """Bound the value on the frontier: shapes (m, T) and (m,)."""
        costs = np.unique(np.append(self.known.task.costs, 1))  # standing still costs 1
        cheap, dear = float(costs[0]), float(costs[-1])
        h = self.choices.h[self.frontier]
        # K (1 - gamma^(h / dear)) with K = cheap / (1 - gamma) is at most c + gamma times its value after any action
        # of cost c, and so, by induction, at most what is paid.
        upper = -cheap * -np.expm1(h / dear * np.log(gamma)) / (1 - gamma)
        floor = -(dear + c_suggest) / (1 - gamma)
        lower = np.full((len(h), len(grid.theta)), floor)
        survey = _Survey.of(self.known, self.choices)
        if survey.highest <= LEVELS:
            levels = _advised(survey, costs, floor, grid, model, gamma, c_suggest)
            reached = np.isfinite(h)
            lower[reached] = levels[h[reached].astype(np.int64)]
        lower[np.isinf(h)] = -dear / (1 - gamma)  # in a dead end the robot is silent
        return lower, upper


@dataclass(frozen=True)
class _Survey:
    """What holds everywhere in a task.

    Attributes
    ----------
    highest : int
        Largest finite h*; of those that are known, if not all are.
    actions : int
        Largest number of choices in a state.
    rise : float
        How much one action can raise h*; infinite where it may lead to a dead end or that is not known.
    """

    highest: int
    actions: int
    rise: float

    @classmethod
    def of(cls, known: CostToGo, choices: Choices) -> _Survey:
        """Look at all choices of a table, and be careful where that is too much."""
        if not isinstance(known, Table):
            return cls(int(choices.h[np.isfinite(choices.h)].max(initial=0)), len(known.task.actions), np.inf)
        h = known.lookup(slice(None))
        finite = np.isfinite(h)
        highest = int(h[finite].max(initial=0))
        if len(known) > SURVEYED:
            return cls(highest, len(known.task.actions), float(highest) if finite.all() else np.inf)
        rows = known.space.transitions
        counts = np.diff(rows.offsets)
        rise = 0.0
        for begin in range(0, len(known), BLOCK):
            block = slice(begin, begin + BLOCK)
            targets = rows.targets[rows.offsets[begin] : rows.offsets[min(begin + BLOCK, len(known))]]
            with np.errstate(invalid="ignore"):  # from one dead end to another nothing rises
                change = h[targets] - np.repeat(h[block], counts[block])
            rise = max(rise, float(np.nan_to_num(change, nan=0.0, posinf=np.inf).max(initial=0.0)))
        return cls(highest, max(1, int(counts.max(initial=1))), rise)


def _advised(
    survey: _Survey, costs: NDArray[np.int64], floor: float, grid: Grid, model: HumanModel, gamma: float,
    c_suggest: float,
) -> Floats:  # fmt: skip
    """Bound from below, for each h* and theta, what someone gets who is always given an optimal suggestion.

    Shape (highest + 1, T). Among A choices an optimal one has a chance of 1 / A or more, whatever beta is. Who does
    not follow goes to the worst level that one action can reach. All levels start from the worst there is and
    rise with each sweep, so that they are bounds after any number of sweeps.
    """
    highest = survey.highest
    value = np.full((highest + 1, len(grid.theta)), floor)
    if costs[0] > 0:
        value[0] = 0.0
    p = 1 / survey.actions
    total = grid.theta * p + (1 - grid.theta) * (1 - p)
    follows = (1 - model.lapse) * np.divide(grid.theta * p, total, out=np.full_like(total, p), where=total > 0)
    low, weight = grid.shares(np.minimum(grid.theta + model.eta * costs[:, None] / model.utility_scale, 1.0))
    for _ in range(SWEEPS):
        before = value.copy()
        for h in range(1 if costs[0] > 0 else 0, highest + 1):
            worst = np.full(len(grid.theta), floor)
            if np.isfinite(survey.rise):
                worst = value[: min(h + int(survey.rise), highest) + 1].min(axis=0)
            outcomes = []
            for c, at, up in zip(costs, low, weight, strict=True):
                if c <= h:
                    right = (1 - up) * value[h - c, at] + up * value[h - c, at + 1]
                    wrong = (1 - up) * worst[at] + up * worst[at + 1]
                    outcomes.append(follows * (gamma * right - c) + (1 - follows) * (gamma * wrong - costs[-1]))
            if outcomes:
                value[h] = np.maximum(value[h], np.min(outcomes, axis=0) - c_suggest)
        if (value - before).max() < 1e-6:
            break
    return value


class _Growth:
    """A region while it grows: the state that is met most likely comes next."""

    def __init__(self, known: CostToGo, betas: Floats, start: int) -> None:
        self.known, self.betas = known, betas
        self.cost = np.array(known.task.costs, dtype=float)
        self.number: dict[int, int] = {}
        self.states: list[int] = []
        self.h: list[float] = []
        self.goal: list[bool] = []
        self.rows: list[tuple[NDArray[np.int64], NDArray[np.int64]] | None] = []
        self.queue: list[tuple[float, int]] = []
        self.expanded = 0
        self._meet(np.array([start]), np.array([1.0]))

    def _meet(self, states: NDArray[np.int64], weights: Floats) -> NDArray[np.int64]:
        """Give the region's numbers of states, and queue them."""
        new = np.array(list(dict.fromkeys(int(s) for s in states if int(s) not in self.number)), dtype=np.int64)
        if len(new):
            for state, h, goal in zip(new.tolist(), self.known.lookup(new), self.known.is_goal(new), strict=True):
                self.number[state] = len(self.states)
                self.states.append(state)
                self.h.append(float(h))
                self.goal.append(bool(goal))
                self.rows.append(None)
        local = np.array([self.number[int(state)] for state in states], dtype=np.int64)
        for at, weight in zip(local.tolist(), weights.tolist(), strict=True):
            if self.rows[at] is None and not self.goal[at]:
                heapq.heappush(self.queue, (-weight, at))
        return local

    def step(self, most: int) -> int:
        """Look at the choices of up to so many states; return how many there were."""
        batch: dict[int, float] = {}
        while self.queue and len(batch) < most:
            weight, at = heapq.heappop(self.queue)
            if self.rows[at] is None and at not in batch:
                batch[at] = -weight
        if not batch:
            return 0
        rows = self.known.choices(np.array([self.states[at] for at in batch]))
        targets = np.asarray(rows.targets, dtype=np.int64)
        actions = np.asarray(rows.actions, dtype=np.int64)
        offsets = np.asarray(rows.offsets, dtype=np.int64)
        counts = np.diff(offsets)
        source = np.repeat(np.arange(len(batch)), counts)
        slot = np.arange(len(targets)) - offsets[source]
        after = self.known.lookup(targets)
        q = np.full((len(batch), max(1, int(counts.max(initial=0)))), np.inf)
        applicable = np.zeros(q.shape, dtype=bool)
        q[source, slot] = self.cost[actions] + after
        applicable[source, slot] = True
        alone = np.mean([choice(q, applicable, beta) for beta in self.betas], axis=0)
        best = q == q.min(axis=1, keepdims=True)
        weight = np.array(list(batch.values()))[source] * np.where(best, ADVISED, alone)[source, slot]
        local = self._meet(targets, weight)
        for at, begin, end in zip(batch, offsets[:-1], offsets[1:], strict=True):
            self.rows[at] = actions[begin:end], local[begin:end]
        self.expanded += len(batch)
        return len(batch)

    def region(self) -> Region:
        """Arrange what has been collected."""
        n = len(self.states)
        counts = np.array([0 if row is None else len(row[0]) for row in self.rows])
        looked = np.array([row is not None for row in self.rows])
        goal, h = np.array(self.goal), np.array(self.h)
        shape = (n, max(1, int(counts.max(initial=0))))
        source = np.repeat(np.arange(n), counts)
        slot = np.arange(len(source)) - np.repeat(np.cumsum(counts) - counts, counts)
        actions, targets = np.full(shape, WAIT, dtype=np.int64), np.repeat(np.arange(n)[:, None], shape[1], axis=1)
        actions[source, slot] = np.concatenate(
            [row[0] for row in self.rows if row is not None] or [np.empty(0, dtype=np.int64)]
        )
        targets[source, slot] = np.concatenate(
            [row[1] for row in self.rows if row is not None] or [np.empty(0, dtype=np.int64)]
        )
        applicable, costs = np.zeros(shape, dtype=bool), np.zeros(shape)
        applicable[source, slot] = True
        costs[source, slot] = self.cost[actions[source, slot]]
        # Of actions that are free and lower nothing, a chain might never end: others are suggested where there are.
        optimal = applicable & (costs + h[targets] == h[:, None]) & np.isfinite(h)[:, None]
        paid = optimal & (costs > 0)
        optimal = np.where(paid.any(axis=1, keepdims=True), paid, optimal)
        stuck = looked & (counts == 0) & ~goal
        applicable[stuck, 0], costs[stuck, 0] = True, 1.0
        choices = Choices(h, goal, applicable, actions, targets, costs, optimal, self.known.task.actions, 0)
        return Region(self.known, choices, np.array(self.states), np.flatnonzero(~looked & ~goal))
