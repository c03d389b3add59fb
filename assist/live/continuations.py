"""The optimal continuations from a state: all ways to the goal that cost no more than h*.

They form an acyclic graph whose edges are the optimal choices. If the task has actions of cost zero, only the cheapest
ways with the fewest actions count, as in `planner.optimal_choices`. So a person who makes any optimal choice in each
state follows one of these ways.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import CostToGo, optimal_choices

from ..people.choices import STAND_STILL, WAIT, Choices
from ..people.decision import Floats

Ints = NDArray[np.int64]


class Edges(NamedTuple):
    """The choices in N states, shape (m,) each: position of the state, action, successor, cost, and whether optimal."""

    source: Ints
    action: Ints
    target: Ints
    cost: Floats
    optimal: NDArray[np.bool_]


def edges(known: Choices | CostToGo, states: ArrayLike) -> Edges:
    """Return the choices in some states, shape (N,), in the order of the states and of their slots."""
    at = np.asarray(states, dtype=np.int64).reshape(-1)
    if isinstance(known, Choices):
        source, slot = np.nonzero(known.applicable[at])
        row = at[source]
        return Edges(
            source, known.actions[row, slot], known.targets[row, slot], known.costs[row, slot],
            known.optimal[row, slot] & ~known.goal[row],
        )  # fmt: skip
    rows = known.choices(at)
    source = np.repeat(np.arange(len(at)), np.diff(rows.offsets))
    cost = known.task.action_costs[rows.actions]
    goal = np.asarray(known.is_goal(at))[source]
    optimal = optimal_choices(known, at, rows) & ~goal
    actions = known.task.first_of_name[rows.actions].astype(np.int64)
    return Edges(source, actions, rows.targets.astype(np.int64), cost, optimal)


def cost_to_go(known: Choices | CostToGo, states: ArrayLike) -> Floats:
    """Return h* of some states, shape (N,), in cost units; infinite in dead ends."""
    if isinstance(known, Choices):
        return known.h[np.asarray(states, dtype=np.int64)]
    return np.asarray(known.lookup(states), dtype=float)


def action_name(known: Choices | CostToGo, action: int) -> str:
    """Return a ground action in PDDL notation."""
    if action == WAIT:
        return STAND_STILL
    return known.names[action] if isinstance(known, Choices) else known.task.actions[action]


def costs_are_one(known: Choices | CostToGo) -> bool:
    """Return whether every action of the task costs 1, so that cost and number of actions are the same."""
    if isinstance(known, Choices):
        return bool((known.costs[known.applicable] == 1).all())
    return bool((known.task.action_costs == 1).all())


@dataclass(frozen=True, eq=False)
class OptimalContinuations:
    """The graph of all optimal continuations from a state.

    Attributes
    ----------
    states : int array, shape (n,)
        The states of the graph; the first one is the state from which it begins.
    depth : int array, shape (n,)
        Least number of steps from there.
    source, action, target : int arrays, shape (m,)
        Edges: positions of both states in `states`, and the ground action. The edges of a state are consecutive.
    level : int array, shape (n,)
        Largest number of steps to a goal state within the graph.
    """

    states: Ints
    depth: Ints
    source: Ints
    action: Ints
    target: Ints
    level: Ints

    @classmethod
    def of(cls, known: Choices | CostToGo, state: int, largest: int) -> OptimalContinuations | None:
        """Return the graph of a state with finite h*; None if it has more than `largest` states.

        Parameters
        ----------
        known : Choices or CostToGo
        state : int
        largest : int
        """
        position, states, depth = {state: 0}, [state], [0]
        source, action, target = [], [], []
        front = [0]
        while front:
            found = edges(known, [states[one] for one in front])
            best = np.flatnonzero(found.optimal)
            before, front = front, []
            for at, act, to in zip(
                found.source[best].tolist(), found.action[best].tolist(), found.target[best].tolist(), strict=True
            ):
                if to not in position:
                    position[to] = len(states)
                    front.append(len(states))
                    states.append(to)
                    depth.append(depth[before[at]] + 1)
                source.append(before[at])
                action.append(act)
                target.append(position[to])
            if len(states) > largest:
                return None
        of_states, depths, sources, acts, targets = (
            np.array(column, dtype=np.int64) for column in (states, depth, source, action, target)
        )
        return cls(of_states, depths, sources, acts, targets, _levels(len(states), sources, targets))

    def counts(self, actions: Ints, *, most: bool = False) -> NDArray[np.int32]:
        """Return the least, or the largest, number of times that actions occur in a continuation from each state.

        Parameters
        ----------
        actions : int array, shape (W,)
        most : bool
            Whether the largest numbers are returned.

        Returns
        -------
        int array, shape (n, W)
        """
        better = np.maximum if most else np.minimum
        counts = np.full((len(self.states), len(actions)), -1 if most else np.iinfo(np.int32).max, dtype=np.int32)
        counts[self.level == 0] = 0
        of_edge = self.level[self.source]
        order = np.argsort(of_edge, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(of_edge[order])) + 1):
            through = counts[self.target[rows]] + (self.action[rows][:, None] == actions)
            better.at(counts, self.source[rows], through)
        return counts

    def earliest(self, actions: Ints) -> Ints:
        """Return after how many steps each action can first occur, shape (W,); -1 for actions of no continuation."""
        first = np.full(len(actions), -1)
        for number, action in enumerate(actions):
            where = self.source[self.action == action]
            if len(where):
                first[number] = self.depth[where].min()
        return first

    def with_action(self, action: int) -> list[int]:
        """Return a continuation in which an action occurs as early as possible, as ground actions."""
        where = np.flatnonzero(self.action == action)
        edge = int(where[self.depth[self.source[where]].argmin()])
        before, at = list[int](), int(self.source[edge])
        while at:  # back along states that are one step less deep, which are on a shortest path
            into = np.flatnonzero((self.target == at) & (self.depth[self.source] == self.depth[at] - 1))
            before.append(int(self.action[into[0]]))
            at = int(self.source[into[0]])
        return [*reversed(before), action, *self._onward(int(self.target[edge]))]

    def with_fewest(self, action: int) -> list[int]:
        """Return a continuation in which an action occurs as rarely as possible, as ground actions."""
        return self._onward(0, action)

    def _onward(self, at: int, avoided: int | None = None) -> list[int]:
        done = []
        counts = self.counts(np.array([] if avoided is None else [avoided], dtype=np.int64)).sum(axis=1)
        while self.level[at]:
            out = np.flatnonzero(self.source == at)
            through = counts[self.target[out]] + (self.action[out] == avoided)
            edge = out[through.argmin()]
            done.append(int(self.action[edge]))
            at = int(self.target[edge])
        return done


def _levels(states: int, source: Ints, target: Ints) -> Ints:
    """Return the largest number of steps from each state to a state without edges, shape (n,)."""
    left = np.bincount(source, minlength=states)
    level = np.full(states, -1, dtype=np.int64)
    front, number = left == 0, 0
    while front.any():
        level[front] = number
        number += 1
        left -= np.bincount(source[front[target]], minlength=states)
        front = (left == 0) & (level < 0)
    return level


def one_continuation(known: Choices | CostToGo, state: int) -> list[str]:
    """Return one optimal continuation from a state with finite h*, in PDDL notation."""
    if not isinstance(known, Choices):
        return list(known.optimal_plan(state) or ())
    plan = []
    while not known.goal[state]:
        slot = int(known.optimal[state].argmax())
        plan.append(known.name(state, slot))
        state = int(known.targets[state, slot])
    return plan
