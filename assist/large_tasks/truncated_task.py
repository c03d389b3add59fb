"""The part of a large task that matters to one person's problem.

A task of millions of states, or one that can only be asked on demand, has no room for what a solver keeps of each
state. But from the initial state hardly any of them are met: a `TruncatedTask` holds the states that people and
advice most likely lead to, and breaks off at the others, the frontier. There the problem has bounds that follow
from the cost-to-go alone (`TruncatedTask.problem`), so that what a solver proves of the region holds of the whole task:

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
from numpy.typing import ArrayLike, NDArray

from planner import CostToGo, Table, Transitions, optimal_choices
from planner.system.arrays import outline

from ..people.belief import Grid
from ..people.choices import Choices, keys_of
from ..people.decision import Floats, choice
from ..people.human import Human, HumanModel, Mixture, Population
from ..person.pomdp import AssistPOMDP, LeafBounds, Suggestions, check_costs

BATCH = {"sweep": 500, "on-demand": 20}  # states that are looked at together, between two looks at the clock
ADVISED = 0.9  # the weight of an action that an adviser would have people take
LEVELS = 10_000  # largest h* for which the bound below is worked out level by level
SWEEPS = 200
BLOCK = 1_000_000
SURVEYED = 10_000_000  # states of a table of which all choices are looked at for that bound


@dataclass(frozen=True)
class TruncatedTask:
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

    __repr__ = outline

    @classmethod
    def of(
        cls,
        known: CostToGo,
        *,
        start: int | None = None,
        states: int = 20_000,
        population: Population | Mixture | None = None,
        human: Human | None = None,
        time_limit: float | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> TruncatedTask:
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
        human : Human, optional
            The person, where it is known what they are mistaken about: the region is where that leads them.
        time_limit : float, optional
            Stop collecting after so many seconds.
        progress : callable, optional
            Called with how many states have been looked at since the last call.
        """
        start = known.initial if start is None else start
        growth = _Growth(known, Grid.regular(population or Population()).beta, start, human)
        begun = time.monotonic()
        while growth.expanded < states and (time_limit is None or time.monotonic() - begun < time_limit):
            done = growth.step(min(BATCH["on-demand" if known.searches else "sweep"], states - growth.expanded))
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
        check_costs(gamma, c_suggest=c_suggest)
        grid = grid or Grid.regular(population or Population())
        model = HumanModel.exact(self.choices, eta=eta, lapse=lapse, utility_scale=utility_scale)
        return AssistPOMDP.of(
            model, grid=grid, population=population, gamma=gamma, c_suggest=c_suggest, suggestions=suggestions,
            frontier=self.bounds(grid, model, gamma, c_suggest),
        )  # fmt: skip

    def bounds_of_anybody(self, gamma: float, thetas: int) -> LeafBounds:
        """Bound the value on the frontier, for so many values of theta, whatever the person is mistaken about.

        Above: `never_erring`. Below: the robot says nothing, and no step costs more than the dearest.
        """
        costs = np.append(self.known.task.costs, 1)  # standing still costs 1
        upper = never_erring(self.choices.h[self.frontier], costs, gamma)
        floor = -float(costs.max()) / (1 - gamma)
        return LeafBounds(self.frontier, np.full((len(upper), thetas), floor), upper, floor)

    def bounds(self, grid: Grid, model: HumanModel, gamma: float, c_suggest: float) -> LeafBounds:
        """Bound the value on the frontier of somebody who is not mistaken, or of whom that is not known.

        Above: `never_erring`. Below: `_advised` for states that have a way to the goal. In dead ends the robot can be
        silent for ever, and no step costs more than `dear`.
        """
        costs = np.unique(np.append(self.known.task.costs, 1))  # standing still costs 1
        dear = float(costs[-1])
        h = self.choices.h[self.frontier]
        anybody = self.bounds_of_anybody(gamma, len(grid.theta))
        floor = -(dear + c_suggest) / (1 - gamma)
        lower = np.full((len(h), len(grid.theta)), floor)
        survey = _Survey.of(self.known, self.choices)
        if survey.highest <= LEVELS:
            levels = _advised(survey, costs, floor, grid, model, gamma, c_suggest)
            reached = np.isfinite(h)
            lower[reached] = levels[h[reached].astype(np.int64)]
        lower[np.isinf(h)] = -dear / (1 - gamma)  # in a dead end the robot is silent
        return LeafBounds(self.frontier, lower, anybody.upper, anybody.floor)


def never_erring(h: Floats, costs: ArrayLike, gamma: float) -> Floats:
    """Bound from above what anybody gets from states on, whatever person and robot do, shape (N,).

    Let every choice cost between `cheap` and `dear`, standing still among them, and
    F(h) = K (1 - gamma^(h / dear)) with K = cheap / (1 - gamma). A choice of cost c leads to h' >= h - c, and

        c + gamma F(h') - F(h) >= c - cheap + K gamma^(h / dear) (1 - gamma^(1 - c / dear)) >= 0

    so that, F being 0 at goals, no less than F(h) is paid; in dead ends no less than K. Nothing is said of the person:
    it holds for anybody, known or not. Where actions are free, cheap is 0 and so is the bound: nothing keeps people
    from going round for nothing.

    Parameters
    ----------
    h : float array, shape (N,)
        Exact cost-to-go.
    costs : array
        Of the task's actions.
    gamma : float
    """
    prices = np.append(np.asarray(costs, dtype=np.float64), 1.0)  # standing still costs 1
    return np.asarray(prices.min() * np.expm1(h / prices.max() * np.log(gamma)) / (1 - gamma))


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

    Shape (highest + 1, T). The bound holds for each beta, whichever optimal choices are suggested:

    - An optimal choice has the least perceived cost, so that alone it is made with a chance p of 1 / A or more among A
      choices; what `follows` gives for 1 / A rises with p. Lapses are counted as not following.
    - An optimal choice of cost c leads from h to h - c and raises V by c: theta moves as `low` and `weight` say.
    - Whoever does not follow pays `dear` at most, and goes to the worst level that one action can reach: up to
      h + rise, or, where that is not known, to where the worst happens in every step. This is never better than
      following, so that a chance of following that is too small makes the bound lower.
    - All levels start from the worst there is, `floor`, and one sweep turns bounds into bounds: they hold after any
      number of sweeps. Level 0 is 0 if actions cost something; else there may be states from which the rest is free.
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


def expected(human: Human, known: CostToGo, states: NDArray[np.int64], h: Floats) -> Floats:
    """Give what a person takes for the cost-to-go of states, shape (N,), of which h is the exact one.

    Where they are mistaken about single actions, that is the exact one, too: not in the same way about a state's.
    """
    ends = np.zeros((len(states), 1), dtype=np.int64)
    nowhere = Choices(
        h, known.is_goal(states), ends > 0, ends, ends, np.zeros(ends.shape), ends > 0, (), key=keys_of(known, states)
    )
    mine = human.expects(nowhere)
    return mine if mine.ndim == 1 else h


class _Growth:
    """A region while it grows: the state that is met most likely comes next."""

    def __init__(self, known: CostToGo, betas: Floats, start: int, human: Human | None) -> None:
        self.known, self.betas, self.human = known, betas, human
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
        best = q == q.min(axis=1, keepdims=True)
        if self.human is not None:
            q[source, slot] = self.cost[actions] + expected(self.human, self.known, targets, after)
        alone = np.mean([choice(q, applicable, beta) for beta in self.betas], axis=0)
        weight = np.array(list(batch.values()))[source] * np.where(best, ADVISED, alone)[source, slot]
        local = self._meet(targets, weight)
        for at, begin, end in zip(batch, offsets[:-1], offsets[1:], strict=True):
            self.rows[at] = actions[begin:end], local[begin:end]
        self.expanded += len(batch)
        return len(batch)

    def region(self) -> TruncatedTask:
        """Arrange what has been collected."""
        none = np.empty(0, dtype=np.int64)
        looked = np.array([row is not None for row in self.rows])
        counts = np.array([0 if row is None else len(row[0]) for row in self.rows])
        offsets = np.concatenate([[0], np.cumsum(counts)])
        actions, targets = (
            np.concatenate([none, *(row[part] for row in self.rows if row is not None)]) for part in range(2)
        )
        goal, h, states = np.array(self.goal), np.array(self.h), np.array(self.states)
        rows = Transitions(offsets, actions, targets)
        optimal = optimal_choices(self.known, states, Transitions(offsets, actions, states[targets]))
        task = self.known.task
        choices = Choices.arranged(
            h, goal, rows, optimal, names=task.actions, prices=task.costs, known=looked,
            key=keys_of(self.known, states),
        )  # fmt: skip
        return TruncatedTask(self.known, choices, states, np.flatnonzero(~looked & ~goal))
