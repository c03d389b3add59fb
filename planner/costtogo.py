"""Exact cost-to-go: what the cheapest way from a state to the goal costs.

`cost_to_go` computes h* of every state of a `StateSpace` by a backward search from the goal states
(Dijkstra 1959, with all states of one distance settled at once). `astar` asks Fast Downward for a single
state, which is also how tables are checked: `verify` compares a sample with Fast Downward's own A*.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from . import fast_downward
from .fast_downward import NO_LIMITS, LimitError, Limits
from .statespace import StateSpace
from .task import Task

UNREACHED = np.iinfo(np.int64).max


class MismatchError(AssertionError):
    """A cost-to-go that differs from Fast Downward's."""


@dataclass(frozen=True)
class CostToGo:
    """The exact cost-to-go of every state of a state space.

    Attributes
    ----------
    space : StateSpace
    distance : unsigned integer array, shape (n,)
        h* in the task's cost units, in the smallest type that holds it; the type's largest value marks
        a dead end.
    """

    space: StateSpace
    distance: NDArray[np.unsignedinteger]

    def __post_init__(self) -> None:
        self.distance.flags.writeable = False

    @property
    def dead_end(self) -> NDArray[np.bool_]:
        """Which states have no way to the goal, shape (n,)."""
        return self.distance == np.iinfo(self.distance.dtype).max

    @cached_property
    def h(self) -> NDArray[np.float64]:
        """h* of every state, shape (n,), infinite at dead ends."""
        return np.where(self.dead_end, np.inf, self.distance)

    def __getitem__(self, state: int) -> float:
        """h* of one state, infinite at a dead end."""
        return float(self.h[state])

    def optimal_choices(self) -> NDArray[np.bool_]:
        """Tell of each choice, shape (m,), whether a cheapest way to the goal can begin with it."""
        h = self.h
        return np.isfinite(h[self.space.sources]) & (self.space.costs + h[self.space.targets] == h[self.space.sources])

    def optimal_plan(self, state: int = 0) -> list[str] | None:
        """Read an optimal plan off the table; None from a dead end."""
        space, h = self.space, self.h
        if not np.isfinite(h[state]):
            return None
        # Actions of cost zero can lead in circles, so this is a depth-first search, not a mere descent.
        plan: list[str] = []
        seen = {state}
        trail = [(state, int(space.offsets[state]))]
        while not space.goal[trail[-1][0]]:
            x, row = trail.pop()
            for choice in range(row, int(space.offsets[x + 1])):
                y = int(space.targets[choice])
                if y not in seen and space.costs[choice] + h[y] == h[x]:
                    seen.add(y)
                    plan.append(space.task.actions[space.actions[choice]])
                    trail += [(x, choice + 1), (y, int(space.offsets[y]))]
                    break
            else:
                plan.pop()
        return plan


def cost_to_go(space: StateSpace, *, deadline: float | None = None) -> CostToGo:
    """Compute h* of every state.

    Raises
    ------
    LimitError
        The deadline, a time on `time.monotonic()`'s clock, has passed.
    """
    by_target = np.argsort(space.targets, kind="stable")
    into = np.concatenate([[0], np.cumsum(np.bincount(space.targets, minlength=len(space)))])
    sources, costs = space.sources[by_target], space.costs[by_target]

    distance = np.full(len(space), UNREACHED, dtype=np.int64)
    settled = np.zeros(len(space), dtype=bool)
    distance[space.goal] = 0
    waiting = {0: [np.flatnonzero(space.goal)]}  # states by tentative distance
    while waiting:
        if deadline is not None and time.monotonic() > deadline:
            raise LimitError("out of time in the backward search")
        d = min(waiting)
        frontier = np.unique(np.concatenate(waiting.pop(d)))
        frontier = frontier[~settled[frontier] & (distance[frontier] == d)]
        settled[frontier] = True
        counts = into[frontier + 1] - into[frontier]
        rows = np.repeat(into[frontier] - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts) + np.arange(
            counts.sum()
        )
        reached, through = sources[rows], d + costs[rows]
        better = through < distance[reached]
        reached, through = reached[better], through[better]
        np.minimum.at(distance, reached, through)
        for value in np.unique(through):
            waiting.setdefault(int(value), []).append(reached[through == value])

    finite = distance != UNREACHED
    largest = int(distance[finite].max(initial=0))
    dtype: type[np.unsignedinteger] = next(t for t in (np.uint16, np.uint32, np.uint64) if largest < np.iinfo(t).max)
    compact = np.full(len(space), np.iinfo(dtype).max, dtype=dtype)
    compact[finite] = distance[finite]
    return CostToGo(space, compact)


def astar(
    task: Task, state: tuple[int, ...] | None = None, *, search: str | None = None, limits: Limits = NO_LIMITS
) -> tuple[float, list[str] | None]:
    """Ask Fast Downward's A* for h* of one state and an optimal plan from it.

    Parameters
    ----------
    task : Task
    state : tuple of int, shape (variables,), optional
        A reachable state; the initial one unless given.

    Returns
    -------
    h : float
        Infinite where Fast Downward proves that there is no plan.
    plan : list of str or None

    Raises
    ------
    LimitError
        Out of time or memory: nothing is known about the state.
    """
    if state is not None:  # Fast Downward wants derived variables at their defaults, and derives them itself
        state = tuple(
            value if variable.axiom_layer < 0 else default
            for value, default, variable in zip(state, task.initial, task.variables, strict=True)
        )
    plan = fast_downward.optimal_plan(task.sas, state, search=search, limits=limits)
    return (float("inf"), None) if plan is None else (float(task.plan_cost(plan)), plan)


def verify(
    table: CostToGo, count: int, rng: np.random.Generator, *, seconds: float | None = None, limits: Limits = NO_LIMITS
) -> int:
    """Compare a random sample of a table with Fast Downward's A*, the initial state first.

    Parameters
    ----------
    table : CostToGo
    count : int
        States to compare (all, where there are fewer).
    rng : numpy.random.Generator
    seconds : float, optional
        Stop after this time; the state in hand is finished.
    limits : Limits
        Of each single search; where one reaches them, no further state is compared.

    Returns
    -------
    int
        How many states were compared, all of them equal.

    Raises
    ------
    MismatchError
        A state whose values differ.
    """
    space = table.space
    others = rng.permutation(np.arange(1, len(space)))[: max(0, count - 1)]
    start = time.monotonic()
    done = 0
    for state in [space.initial, *map(int, others)][:count]:
        if seconds is not None and done and time.monotonic() - start > seconds:
            break
        try:
            expected, _ = astar(space.task, space.values(state), limits=limits)
        except LimitError:
            break
        if expected != table[state]:
            raise MismatchError(
                f"cost-to-go of state {state} is {table[state]:g}, but Fast Downward's A* says {expected:g} "
                f"({', '.join(space.facts(state))})"
            )
        done += 1
    return done
