"""Comparisons of a cost-to-go table with others: with Fast Downward's A*, and with itself."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..grounding import semantics
from ..grounding.task import Task
from ..system.errors import MismatchError
from ..system.limits import NO_LIMITS, LimitError, Limits
from .astar import astar
from .table import Table


def verify(
    table: Table,
    count: int,
    rng: np.random.Generator,
    *,
    seconds: float | None = None,
    limits: Limits = NO_LIMITS,
    jobs: int = 1,
    searches: Sequence[str | None] = (None,),
    known: Mapping[int, float] | None = None,
    progress: Callable[[int], None] | None = None,
) -> int:
    """Compare a random sample of a table with Fast Downward's A*, the initial state first.

    A state whose search reaches its limits is left out.

    Parameters
    ----------
    table : Table
    count : int
        States to compare (all, where there are fewer).
    rng : numpy.random.Generator
    seconds : float, optional
        Stop after this time; searches that are under way then are ended.
    limits : Limits
        Of each single search.
    jobs : int
        States at a time.
    searches : sequence of str or None
        Configurations as `astar` takes them; all search from a state at the same time, and the first answer counts.
    known : mapping of int to float, optional
        What A* has said of states already.
    progress : callable, optional
        Called with how many states have been compared.

    Returns
    -------
    int
        How many states were compared, all of them equal.

    Raises
    ------
    MismatchError
        A state whose values differ.
    """
    space, states = table.space, sample(len(table), table.initial, count, rng)
    said, compared = known or {}, 0
    start, over = time.monotonic(), threading.Event()

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
            return _first(space.task, space.values([state])[0].tolist(), searches, own)
        except LimitError:
            return None

    with ThreadPoolExecutor(jobs) as pool:
        # One at a time without a thread: where no memory is left for its beginning, Python waits for it for ever.
        each = pool.map if jobs > 1 else map
        try:
            for state, expected in zip(states, each(asked, states), strict=True):
                if expected is None:
                    continue
                if expected != table[state]:
                    raise mismatch(table, state, expected)
                compared += 1
                if progress is not None:
                    progress(compared)
        finally:
            over.set()
    return compared


def _first(task: Task, state: Sequence[int], searches: Sequence[str | None], limits: Limits) -> float:
    """Give what the first of several searches says of a state."""
    if len(searches) == 1:
        return astar(task, state, search=searches[0], limits=limits)[0]
    done = threading.Event()
    with ThreadPoolExecutor(len(searches)) as pool:
        try:
            own = limits.ended_by(done)
            for each in as_completed([pool.submit(astar, task, state, search=one, limits=own) for one in searches]):
                with suppress(LimitError):
                    return each.result()[0]
        finally:
            done.set()
    raise LimitError("no search was done in time")


def check_successors(table: Table, count: int, rng: np.random.Generator, *, seconds: float | None = None) -> int:
    """Compare a random sample of a table with the values of what comes after, the initial state first.

    In a goal state the cost-to-go is 0, in any other the least sum of an action's cost and the cost-to-go after it.
    What comes after is computed from the operators of the grounded task, not by what made the table. Of states that
    are too far from the goal for A* this can be told as well.

    Parameters
    ----------
    table : Table
    count : int
        States to compare (all, where there are fewer); those that `verify` takes with the same generator.
    rng : numpy.random.Generator
    seconds : float, optional
        No further state is compared after this time.

    Returns
    -------
    int
        How many states were compared, all of them equal.

    Raises
    ------
    MismatchError
        A state whose values differ, or that leads to something that is no state of the table.
    """
    space, task, states = table.space, table.task, sample(len(table), table.initial, count, rng)
    start = time.monotonic()
    for done, state in enumerate(states):
        if seconds is not None and done and time.monotonic() - start > seconds:
            return done
        values = space.values([state])[0].tolist()
        if all(values[variable] == value for variable, value in task.goal):
            expected = 0.0
        else:
            after = semantics.successors(task, values)
            targets = np.array([target for _, target in after], dtype=np.int64).reshape(len(after), len(values))
            try:
                least = np.array([cost for cost, _ in after]) + table.lookup(space.numbers(targets))
            except KeyError as error:
                raise MismatchError(f"state {state} leads to {error}, which is no state of the table") from error
            expected = float(least.min(initial=np.inf))
        if table[state] != expected:
            raise mismatch(table, state, expected, "its successors say")
    return len(states)


def sample(states: int, initial: int, count: int, rng: np.random.Generator) -> list[int]:
    """Draw numbers of states to compare, the initial one first; all of them where there are fewer."""
    count = max(0, count - 1)
    if count >= states - 1:
        return [initial, *(state for state in range(states) if state != initial)]
    drawn: dict[int, None] = {}
    while len(drawn) < count:  # a permutation of all states would take more memory than the table
        drawn.update((int(s), None) for s in rng.integers(states, size=count) if s != initial)
    return [initial, *list(drawn)[:count]]


def mismatch(table: Table, state: int, expected: float, who: str = "Fast Downward's A* says") -> MismatchError:
    """Return what is raised where a table differs from what another says of a state."""
    return MismatchError(
        f"cost-to-go of state {state} is {table[state]:g}, but {who} {expected:g} "
        f"({', '.join(table.space.facts(state))})"
    )
