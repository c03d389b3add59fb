"""The states of a task that a person is most likely to visit, found by a best-first expansion."""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo, Transitions

from ..people.choices import Choices
from ..people.decision import Floats, choice
from ..people.goals import Goals, costs_to_go, each_of, first_of, goals_reached, optimal_for_each, prior_of
from ..people.human import Human
from ..people.misconception import Misconception
from ..people.slots import padded
from ..people.state_keys import keys_of


def perceived_of_states(human: Human, known: CostToGo, states: NDArray[np.int64], h: Floats) -> Floats:
    """Return what a person takes for the cost-to-go of states, shape (N,), where `h` is the exact cost-to-go.

    It is the exact one for misconceptions about actions, which do not define a perceived cost-to-go of a state.
    """
    if not isinstance(human.h, Misconception) or human.h.noise == "action":
        return h
    return human.h.of_states(h, known.is_goal(states), keys_of(known, states))


class Grown(NamedTuple):
    """Expanded states and their successors.

    Attributes
    ----------
    each : list of Choices
        The choices of each goal; successors that were not expanded have none.
    states : int array, shape (n,)
        Number of each state in the task.
    cut : int array
        Indices of states that were not expanded.
    rows : Transitions
        Of the n states, with targets that are numbered as in the task.
    """

    each: list[Choices]
    states: NDArray[np.int64]
    cut: NDArray[np.int64]
    rows: Transitions


class Growth:
    """The best-first expansion of a task by the probability of the best path.

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
        shares = np.array(list(prior_of(known).values()))
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

    def found(self) -> Grown:
        """Return the expanded states and their successors."""
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
        return Grown(each, states, np.flatnonzero(~expanded), there)
