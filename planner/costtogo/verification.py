"""Verification of a cost-to-go table, against Fast Downward's A* and against its own successors."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..grounding.fast_downward import FastDownwardError
from ..grounding.task import steps_along, successors
from ..system.errors import MismatchError
from ..system.limits import NO_LIMITS, LimitError, Limits
from ..system.processes import on_threads
from .astar import astar
from .cost_to_go import CostToGo
from .table import Table


def verify(
    table: Table,
    count: int,
    rng: np.random.Generator,
    *,
    seconds: float | None = None,
    limits: Limits = NO_LIMITS,
    jobs: int = 1,
    known: Mapping[int, float] | None = None,
    progress: Callable[[int], None] | None = None,
) -> int:
    """Compare a random sample of a table's states, the initial state first, with Fast Downward's A*.

    States whose search reaches its limits, or fails, are skipped.

    Parameters
    ----------
    table : Table
    count : int
        States to compare (all, where there are fewer).
    rng : numpy.random.Generator
    seconds : float, optional
        Time after which the comparison stops and running searches are ended.
    limits : Limits
        Limits of each search.
    jobs : int
        Number of states that are compared in parallel.
    known : mapping of int to float, optional
        Results of A* that are known already, by state.
    progress : callable, optional
        Called with the number of states compared so far.

    Returns
    -------
    int
        Number of states compared; all values were equal.

    Raises
    ------
    MismatchError
        The values of a state differ.
    """
    space, said, start, compared = table.space, known or {}, time.monotonic(), 0
    over, counting = threading.Event(), threading.Lock()

    def asked(state: int) -> float | None:
        if state in said:
            return said[state]
        own = limits.ended_by(over)
        if seconds is not None:
            left = seconds - (time.monotonic() - start)
            own = replace(own, seconds=left if limits.seconds is None else min(left, limits.seconds))
            if left <= 0:
                return None
        if over.is_set():
            return None
        try:
            return astar(space.task, space.values([state])[0].tolist(), limits=own)[0]
        except (LimitError, FastDownwardError):
            return None

    def compare(state: int) -> None:
        nonlocal compared
        expected = asked(state)
        if expected is None:
            return
        if expected != table[state]:
            raise mismatch(table, state, expected)
        with counting:
            compared += 1
            if progress is not None:
                progress(compared)

    on_threads(compare, sample(len(table), table.initial, count, rng), jobs, over)
    return compared


def check_successors(table: Table, count: int, rng: np.random.Generator, *, seconds: float | None = None) -> int:
    """Check the Bellman equation of a table in a random sample of states, the initial state first.

    In a goal state h* must be 0. In any other state it must be the minimum over actions of the cost plus h* of the
    successor. Successors are computed from the operators of the grounded task, independently of the sweep. The check
    also covers states that are too far from the goal for A*.

    At most `count` states are checked, none after so many `seconds`; their number is returned. A generator in the same
    state yields the sample of `verify`. If the equation fails, or a successor is no state of the table, this raises a
    `MismatchError`.
    """
    space, task, states = table.space, table.task, sample(len(table), table.initial, count, rng)
    start = time.monotonic()
    for done, state in enumerate(states):
        if seconds is not None and done and time.monotonic() - start > seconds:
            return done
        values = space.values([state])[0].tolist()
        if all(values[variable] == value for variable, value in task.goal):
            least = np.zeros(1)
        else:
            after = successors(task, values)
            targets = np.array(list(after.values()), dtype=np.int64).reshape(len(after), len(values))
            try:
                least = np.array([task.costs[action] for action in after]) + table.whole(space.numbers(targets))
            except KeyError as error:
                raise MismatchError(f"state {state} leads to {error}, which is no state of the table") from error
        expected = float(least.min(initial=np.inf))
        if table.whole([state])[0] != expected:
            raise mismatch(table, state, task.in_unit(expected), "its successors say")
    return len(states)


def check_plan(known: CostToGo, plan: Sequence[str]) -> int:
    """Check h* along a plan from the initial state: it must be the cost of the rest of the plan. Return the states.

    The states follow from the operators of the grounded task, independently of the sweep. This raises a
    `MismatchError`.
    """
    task = known.task
    values, costs = steps_along(task, plan)
    rest = np.append(np.cumsum(costs[::-1], dtype=np.int64)[::-1], 0)
    try:
        found = known.whole(known.numbers(np.array(values, dtype=np.int64)))
    except KeyError as error:
        raise MismatchError(f"the plan leads to {error}, which is no state of the table") from error
    for step, (h, cost) in enumerate(zip(found.tolist(), rest.tolist(), strict=True)):
        if h != cost:
            after, others = task.in_unit(h), task.in_unit(cost)
            raise MismatchError(
                f"cost-to-go after step {step} of the plan is {after:g}, but its other steps cost {others:g}"
            )
    return len(values)


def sample(states: int, initial: int, count: int, rng: np.random.Generator) -> list[int]:
    """Return a random sample of `count` distinct states, the initial state first; all states if there are no more."""
    count = max(0, count - 1)
    if count >= states - 1:
        return [initial, *(state for state in range(states) if state != initial)]
    drawn: dict[int, None] = {}
    while len(drawn) < count:  # a permutation of all states would take more memory than the table
        drawn.update((int(s), None) for s in rng.integers(states, size=count) if s != initial)
    return [initial, *list(drawn)[:count]]


def mismatch(table: Table, state: int, expected: float, who: str = "Fast Downward's A* says") -> MismatchError:
    """Return the error for a state whose value differs from another result."""
    return MismatchError(
        f"cost-to-go of state {state} is {table[state]:g}, but {who} {expected:g} "
        f"({', '.join(table.space.facts(state))})"
    )
