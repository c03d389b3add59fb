"""The exact cost-to-go by symmetry reduction: a search over one canonical state of each orbit.

The search replaces every successor by the canonical state of its orbit before looking it up. Symmetries preserve costs
and the goal, so that all states of an orbit have the same cost-to-go. The reduced task has one state per orbit. The
cost-to-go of any state is that of its canonical state.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Task
from ..search.automorphisms import Forms, canonical, symmetries
from ..search.search_space import distances, explore
from ..search.state_registry import RegistryIndex, RegistrySpace
from ..search.state_space import EXACT, UNREACHED, Packing, StateSpace, as_floats, compact, is_dead_end
from ..system.arrays import Words, outline
from ..system.limits import Budget, LimitError, processors
from ..system.progress import Progress
from .table import Table, require_sweepable

AT_ONCE = 300_000_000
"""Facts permuted between two checks of the deadline."""


@dataclass(frozen=True)
class OrbitTable:
    """Exact cost-to-go of all reachable states of a task, by orbits."""

    index: RegistryIndex
    distance: NDArray[np.unsignedinteger]
    """h* of each orbit, a multiple of the task's `unit`; the type's largest value marks dead ends."""
    lengths: NDArray[np.int64] | None
    """Least number of actions of an optimal plan from each orbit; None if all actions have positive costs."""
    order: int
    """Order of the symmetry group."""
    transition_count: int
    """Number of applicable ground actions, summed over the canonical states."""

    __repr__ = outline

    def __len__(self) -> int:
        return len(self.distance)

    def whole(self, states: Words) -> NDArray[np.float64]:
        """Return h* of packed states, shape (n, words), as multiples of the task's `unit`.

        It is infinite at dead ends, and NaN where the orbit is unknown.
        """
        rows = self.index.rows(states)
        return np.where(rows >= 0, as_floats(self.distance[rows]), np.nan)

    def table(self, task: Task) -> Table:
        """Return a table of the canonical states; its transitions lead to canonical states."""
        return Table(StateSpace(task, len(self), 0, self.transition_count, self.index), self.distance)

    def plan_lengths(self, task: Task, states: Words) -> NDArray[np.int64]:
        """Return the least number of actions of an optimal plan from packed states; `UNREACHED` at dead ends.

        The unknown orbit of a state raises a `KeyError`.
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
    reserved_bytes: Callable[[], float] = float,
    effort: int = 100_000_000_000,
) -> OrbitTable:
    """Compute the cost-to-go of all reachable states of a task, from one canonical state of each orbit.

    The parameters are those of `sweep`, and three more. `states` is a known lower bound on the number of reachable
    states: if there are too few symmetries for `max_orbits` orbits, no search is started. `effort` limits the work of
    canonicalisation, in facts permuted by symmetries; the default takes some minutes of one processor. A `LimitError`
    says that there are no symmetries or too many orbits, or that time or memory is exhausted.
    """
    require_sweepable(task)
    budget = Budget.within(max_orbits, memory_limit_mb, deadline, stop, reserved_bytes)
    looking, forming = budget.during("symmetries were looked for"), budget.during("orbits were listed")
    group = symmetries(task, check=lambda: looking(0))
    if group is None:
        raise LimitError("no symmetries")
    if group.order * max_orbits < states:
        raise LimitError(f"more than {max_orbits} orbits of {group.order} symmetries")

    def report(doing: str, done: int, total: int | None) -> None:
        if progress is not None:
            progress("orbits" if doing == "states" else doing, done, total)

    forms = Forms.of(group, Packing.of(task))
    permuted = len(forms.word) * len(forms.permutations)  # facts that are permuted to canonicalise one state
    most, part = effort // permuted, AT_ONCE // permuted + 1

    def form(states: Words) -> None:
        for begin in range(0, len(states), part):
            forming(0)
            canonical(forms, states[begin : begin + part])

    threads, space = threads or processors(), RegistrySpace(task, budget, form)
    if explore(space, budget, threads, report, most) is None:
        raise LimitError(f"{most} transitions or more between orbits of {group.order} symmetries")
    free = min(task.costs) == 0
    # Every action adds 1 to a multiple that exceeds the length of any optimal plan, which visits no orbit twice.
    long = len(space) + 1
    prices, largest = ([cost * long + 1 for cost in space.costs.tolist()], EXACT * long) if free else (None, EXACT)
    distance, lengths = distances(space, task.goal, budget, threads, report, prices, min(largest, 1 << 63)), None
    if free:
        dead = is_dead_end(distance)
        price = distance.astype(np.int64)
        lengths = np.where(dead, UNREACHED, price % long)
        distance = compact(np.where(dead, UNREACHED, price // long))
    return OrbitTable(replace(space.index, forms=forms), distance, lengths, group.order, space.transitions)
