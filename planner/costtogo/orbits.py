"""The exact cost-to-go of all states of a task with many symmetries, from one state of each orbit.

The search does with canonical states what it does elsewhere with states: every successor is replaced by the canonical
state of its orbit before it is looked for. What is left is a task of as many states as there are orbits,
with the same cost-to-go. That of any state is looked up by its form.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Task
from ..search.bucket_dijkstra import settled
from ..search.distances import UNREACHED, compact
from ..search.forward_search import enumerated
from ..search.orbit_index import OrbitIndex
from ..search.symmetry.automorphisms import symmetries
from ..search.symmetry.canonical_states import Forms, canonical
from ..states.packing import Packing, Words
from ..states.state_space import StateSpace
from ..system.arrays import outline
from ..system.limits import Budget, LimitError
from ..system.machine import processors
from ..system.progress_reports import Progress
from .table import Table

EFFORT = 100_000_000_000
"""Facts that may be moved by a symmetry, one at a time, on the way to forms: some minutes of a processor."""

AT_ONCE = 300_000_000
"""So many of them between two looks at the time."""

LONG = 1 << 31
"""More actions than any plan has that a search of orbits finds: it comes to none of them twice."""


@dataclass(frozen=True)
class OrbitTable:
    """The cost-to-go of all states that a task can reach.

    Attributes
    ----------
    index : OrbitIndex
        The orbits that have been found.
    distance : unsigned integer array, shape (orbits,)
        h*, the type's largest value for dead ends.
    lengths : int64 array, shape (orbits,), or None
        Actions of the shortest of the cheapest plans, where some actions cost nothing.
    order : int
        How many symmetries there are.
    transition_count : int
        Ground actions applicable in a state, added up over one state of each orbit.
    """

    index: OrbitIndex
    distance: NDArray[np.unsignedinteger]
    lengths: NDArray[np.int64] | None
    order: int
    transition_count: int

    __repr__ = outline

    def __len__(self) -> int:
        return len(self.distance)

    def lookup(self, states: Words) -> NDArray[np.float64]:
        """Give h* of packed states, shape (n, words): infinite at dead ends, NaN where nothing has been found."""
        rows = self.index.rows(states)
        distance = self.distance[rows]
        h = np.where(distance == np.iinfo(distance.dtype).max, np.inf, distance)
        return np.where(rows >= 0, h, np.nan)

    @property
    def described(self) -> str:
        """Say how many there are."""
        return f"{len(self):,} orbits of {self.order:,} symmetries"

    def table(self, task: Task) -> Table:
        """Give the cost-to-go of one state of each orbit; what leads to a state leads to that of its orbit there."""
        return Table(StateSpace(task, len(self), 0, self.transition_count, self.index), self.distance)

    def plan_lengths(self, task: Task, states: Words) -> NDArray[np.int64]:
        """Give the actions of the shortest of the cheapest plans from packed states; `UNREACHED` if there are none.

        Raises
        ------
        KeyError
            Nothing has been found of one of them.
        """
        rows = self.index.rows(states)
        if (rows < 0).any():
            raise KeyError(int(np.argmax(rows < 0)))
        return self.table(task).plan_lengths(rows) if self.lengths is None else np.asarray(self.lengths[rows])


def orbits(
    task: Task,
    *,
    max_orbits: int,
    states: int = 0,
    memory_limit_mb: float | None = None,
    deadline: float | None = None,
    threads: int | None = None,
    stop: threading.Event | None = None,
    progress: Progress | None = None,
    lent: Callable[[], float] = float,
) -> OrbitTable:
    """Find the cost-to-go of all states that a task can reach, from one state of each orbit.

    Parameters
    ----------
    task : Task
    max_orbits : int
        The largest number of orbits.
    states : int
        The task is known to have so many states or more. Where it has not enough symmetries to have no more orbits
        than allowed, none are listed.
    memory_limit_mb, deadline, threads, stop, lent
        As in `sweep`.
    progress : callable, optional
        As in `sweep`; it counts "orbits".

    Raises
    ------
    LimitError
        There are more orbits than allowed, or no symmetries, or there is no time or memory left.
    """
    budget = Budget.within(max_orbits, memory_limit_mb, deadline, stop, lent)
    looking, forming = budget.during("symmetries were looked for"), budget.during("orbits were listed")
    group = symmetries(task, check=lambda: looking(0))
    if group is None:
        raise LimitError("no symmetries")
    if group.order * max_orbits < states:
        raise LimitError(f"more than {max_orbits} orbits of {group.order} symmetries")

    def told(doing: str, done: int, total: int | None) -> None:
        if progress is not None:
            progress("orbits" if doing == "states" else doing, done, total)

    forms = Forms.of(group, Packing.of(task))
    effort = len(forms.word) * len(forms.moves)
    most, part = EFFORT // effort, AT_ONCE // effort + 1

    def form(states: Words) -> None:
        for begin in range(0, len(states), part):
            forming(0)
            canonical(forms, states[begin : begin + part])

    listing = enumerated(task, budget, threads or processors(), told, most, form)
    if listing is None:
        raise LimitError(f"{most} transitions or more between orbits of {group.order} symmetries")
    free = min(task.costs) == 0
    prices = replace(task, costs=tuple(cost * LONG + 1 for cost in task.costs)) if free else task
    distance, lengths = settled(prices, listing, budget, told), None
    if free:
        dead = distance == np.iinfo(distance.dtype).max
        price = distance.astype(np.int64)
        lengths = np.where(dead, UNREACHED, price % LONG)
        distance = compact(np.where(dead, UNREACHED, price // LONG))
    return OrbitTable(OrbitIndex(forms, listing.found), distance, lengths, group.order, len(listing.targets))
