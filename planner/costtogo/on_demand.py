"""Cost-to-go of single states, computed when it is requested.

This is for tasks that are too large to enumerate. `OnDemand` numbers states in the order in which they are first
requested. It runs Fast Downward's A* for states whose cost-to-go is unknown, several at a time. All results are kept in
memory, and optionally in a `Cache` on disk. An optimal plan determines the cost-to-go of every state on it, so that one
search serves many states. If one canonical state of each orbit was swept (`orbits`), the results are looked up there,
and no search is run.

If the task has actions of cost zero, Fast Downward is given combined costs of cost and number of actions. It then finds
optimal plans with the fewest actions, which determine the optimal choices (`cost_to_go.optimal_choices`). As a cheaper
plan with very many actions more would be overlooked, a second search, with the plain costs, confirms the cost.
"""

from __future__ import annotations

import copy
import errno
import hashlib
import math
import os
import sqlite3
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..grounding import fast_downward
from ..grounding.task import Task, derived, plan_cost
from ..search.kernels import packed_successors
from ..search.kernels.packed_successors import PackedOperators
from ..search.sorted_space import Successors
from ..search.state_registry import StateRegistry
from ..search.state_space import UNREACHED, Packing, Transitions, holds, joined, state_numbers
from ..search.successor_generator import Expanded, expanded, packed_operators
from ..system.arrays import Ints, Words
from ..system.errors import UnsuitedError
from ..system.limits import NO_LIMITS, LimitError, Limits, processors, require_limits
from ..system.processes import on_threads
from .astar import OVERFLOW, UNIT, astar, counted, fastest_search, priced
from .cost_to_go import Plan, State, optimal_plan
from .load import AnyTask, task_of

if TYPE_CHECKING:
    from .orbit_table import OrbitTable


def cache_folder() -> Path:
    """Return the folder of the persistent cache: `kitassist` in the user's cache folder."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "kitassist"


class Cache:
    """A file with the cost-to-go of a task's states, in the combined costs of `priced`.

    An infinite cost is stored as -1. The file name is a digest of the grounded task, Fast Downward's version and
    `FORMAT`. A change of any starts a new file. A file that cannot be used raises an `OSError`.

    Parameters
    ----------
    task : Task
    folder : path, optional
        Folder of the file; `cache_folder()` by default.
    """

    FORMAT = 2
    """Version of the packing of states and of the search, part of the digest."""

    def __init__(self, task: Task, folder: str | Path | None = None) -> None:
        contents = f"{self.FORMAT}\n{fast_downward.version()}\n{priced(task)[0].sas}"
        digest = hashlib.sha256(contents.encode()).hexdigest()
        folder = cache_folder() if folder is None else Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        self.file = folder / f"{digest}.sqlite"

    def read(self) -> dict[bytes, float]:
        """Return all stored costs, by the bytes of the packed state."""
        rows = self._executed("SELECT state, cost FROM cost")
        return {state: float("inf") if cost == -1 else float(cost) for state, cost in rows}

    def write(self, costs: dict[bytes, float]) -> None:
        """Store costs atomically: all of them or, if the process is killed, none."""
        rows = [(state, -1 if np.isinf(cost) else int(cost)) for state, cost in costs.items()]
        self._executed("INSERT OR REPLACE INTO cost VALUES (?, ?)", rows)

    def _executed(self, statement: str, inserted: Sequence[tuple[bytes, int]] | None = None) -> list[tuple[bytes, int]]:
        """Return the rows that a statement selects, or insert rows; a damaged file is replaced by an empty one."""
        try:
            with closing(sqlite3.connect(self.file, timeout=60)) as connection, connection:
                connection.execute(
                    "CREATE TABLE IF NOT EXISTS cost (state BLOB PRIMARY KEY, cost INTEGER NOT NULL) WITHOUT ROWID"
                )
                if inserted is None:
                    return connection.execute(statement).fetchall()
                connection.executemany(statement, inserted)
                return []
        except sqlite3.OperationalError as error:
            raise OSError(errno.EIO, str(error), str(self.file)) from None
        except sqlite3.DatabaseError as error:
            if error.sqlite_errorcode not in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
                raise
            self.file.unlink(missing_ok=True)
        return self._executed(statement, inserted)


FEW_TESTS = 1 << 28
"""Tests of conditions that are done with numpy, in about a second, before compiled code takes over."""


class OnDemand:
    """Cost-to-go of a task that is too large to enumerate.

    States are numbered in the order of their first use, from the initial state, 0. The object grows with the states
    that are requested, and may be used from any thread.

    Parameters
    ----------
    task : Task, or whatever `load` takes
    cache : Cache, optional
        Stores results on disk; by default they are kept in memory only.
    jobs : int, optional
        Number of parallel searches; by default one per processor.
    limits : Limits
        Time and memory of each single search.
    reason : str, optional
        The reason why the task is not enumerated.
    orbits : OrbitTable, optional
        Cost-to-go of one canonical state of each orbit.
    """

    method: Literal["sweep", "on-demand"] = "on-demand"

    def __repr__(self) -> str:
        return f"<OnDemand of {self.task.instance.problem.stem}: {len(self):,} states met>"

    def __init__(
        self,
        task: AnyTask,
        *,
        cache: Cache | None = None,
        jobs: int | None = None,
        limits: Limits = NO_LIMITS,
        reason: str | None = None,
        orbits: OrbitTable | None = None,
    ) -> None:
        require_limits(limits)
        self.task = task = task_of(task)
        self.orbits = orbits
        self._priced, self._unit = priced(task)
        self.reason = reason
        self.packing = Packing.of(task)
        self._goal = self.packing.condition(task.goal)
        self._cache = cache
        self._known = cache.read() if cache else {}
        self._jobs = jobs or processors()
        self._limits = limits
        self._search: str | None = None
        self._met, self._tests = StateRegistry(self.packing.words, few=True), 0
        self.initial = int(self._meet(self.packing.pack([derived(task, task.initial)]))[0])

    def __len__(self) -> int:
        """Return the number of states that have been numbered."""
        return len(self._met)

    @cached_property
    def _operators(self) -> PackedOperators:
        return packed_operators(self.task, self.packing) if self.orbits is None else self.orbits.index.operators

    @cached_property
    def _successors(self) -> Successors | None:
        """The transition function in numpy; None if the task is too large for it, or orbits have a compiled one."""
        try:
            return Successors.of(self.task, self.packing) if self.orbits is None else None
        except UnsuitedError:
            return None

    def _expanded(self, rows: Words) -> Iterator[Expanded]:
        """Yield the numbers of actions of states, shape (n, words), the actions and the successors, in parts."""
        own = self._successors if self._tests <= FEW_TESTS else None
        if own is None:
            yield from expanded(self._operators, rows)
        else:
            self._tests += len(rows) * own.mask.size + 50_000  # what a call takes in any case
            yield own.expanded(rows)

    @cached_property
    def _counting(self) -> OnDemand:
        """The same task with combined costs, whose optimal plans have the fewest actions."""
        other = OnDemand(self.task, jobs=self._jobs, limits=self._limits)
        other._priced, other._unit = counted(self.task), UNIT
        return other

    @property
    def searches(self) -> bool:
        """Whether `lookup` runs searches. It is False with orbits, where searches are rare."""
        return self.orbits is None

    def _meet(self, states: Words) -> Ints:
        return self._met.numbers(states).astype(np.int64)

    def numbers(self, values: ArrayLike) -> NDArray[np.int64]:
        """Return the numbers, shape (N,), of states with the given values, shape (N, variables).

        The states must be reachable, which is not checked.
        """
        array = np.asarray(values)
        sizes = np.array(self.task.sizes)
        whole = not array.size or array.dtype.kind in "iu"
        if not whole or array.ndim != 2 or array.shape[1] != len(sizes) or not ((array >= 0) & (array < sizes)).all():
            raise ValueError(f"expected values of shape (N, {len(sizes)}), each one of its variable's values")
        states = self.packing.pack(array)
        if self.task.axioms and self._successors is not None:
            self._successors.derive(states)
        elif self.task.axioms:
            packed_successors.derive(self._operators.axioms, self._operators.again, states)
        return self._meet(states)

    def values(self, states: ArrayLike) -> NDArray[np.int64]:
        """Return the values, shape (N, variables), of states, shape (N,)."""
        return self.packing.unpack(self._rows(states))

    def _rows(self, states: ArrayLike) -> Words:
        return self._met.states(np.atleast_1d(state_numbers(states, len(self))))

    def is_goal(self, states: ArrayLike) -> NDArray[np.bool_]:
        """Return whether each state is a goal state, shape (N,)."""
        return holds(self._rows(states), *self._goal)

    def choices(self, states: ArrayLike) -> Transitions:
        """Return the transitions of states, shape (N,), as compressed rows; their successors are numbered."""
        parts = self._expanded(self._rows(states))
        return joined((counts, actions, self._meet(after)) for counts, actions, after in parts)

    def lookup(self, states: ArrayLike, progress: Callable[[int], None] | None = None) -> NDArray[np.float64]:
        """Return h* of states in the file's unit, shape (N,), infinite at dead ends.

        Unknown states are solved by Fast Downward.

        Parameters
        ----------
        states : int array, shape (N,)
        progress : callable, optional
            Called with the number of states solved since the last call.

        Raises
        ------
        LimitError
            A search reached its limits. The results of the other searches are kept.
        """
        return self.task.in_unit(self.whole(states, progress))

    def whole(self, states: ArrayLike, progress: Callable[[int], None] | None = None) -> NDArray[np.float64]:
        """Return h* of states as multiples of the task's `unit`, whole numbers; otherwise as `lookup`."""
        rows = self._rows(states)
        if self.orbits is not None:
            h = self.orbits.whole(rows)
            if not np.isnan(h).any():
                if progress is not None:
                    progress(len(h))
                return h
        keys = [row.tobytes() for row in rows]
        missing = list(dict.fromkeys(key for key in keys if key not in self._known))
        if progress is not None:
            progress(len(keys) - len(missing))
        if missing:
            self._ask(missing, progress)
        return self._costs(np.array([self._known[key] for key in keys], dtype=np.float64))

    def under(self, limits: Limits, reason: str | None, orbits: OrbitTable | None = None) -> OnDemand:
        """Return a copy with the same results and numbered states, but other limits and another reason."""
        other = copy.copy(self)
        other._limits, other.reason, other.orbits = limits, reason, orbits or self.orbits
        return other

    def known(self, states: ArrayLike) -> NDArray[np.float64]:
        """Return h* of states in the file's unit, shape (N,), where it is known without a search; NaN elsewhere."""
        rows = self._rows(states)
        h = self._costs(np.array([self._known.get(row.tobytes(), np.nan) for row in rows], dtype=np.float64))
        whole = h if self.orbits is None else np.where(np.isnan(h), self.orbits.whole(rows), h)
        return self.task.in_unit(whole)

    def _costs(self, prices: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(np.isfinite(prices), np.floor(prices / self._unit), prices)

    def plan_lengths(self, states: ArrayLike) -> NDArray[np.int64]:
        """Return the least number of actions of an optimal plan from each state, shape (N,); `UNREACHED` at dead ends.

        If the costs of actions differ and none is zero, this runs additional searches.

        Raises
        ------
        LimitError
            As from `lookup`.
        """
        rows = self._rows(states)
        if self.orbits is not None:
            with suppress(KeyError):
                return self.orbits.plan_lengths(self.task, rows)
        if self._unit == 1 and len(set(self.task.costs)) > 1:
            counting = self._counting.under(self._limits, None)
            return counting.plan_lengths(counting.numbers(self.values(states)))
        h = self.whole(states)
        finite, found = np.isfinite(h), np.full(len(rows), UNREACHED)
        if self._unit == 1:
            found[finite] = h[finite] / max(self.task.costs, default=1)
        else:
            prices = np.array([self._known[row.tobytes()] for row in rows], dtype=np.float64)
            found[finite] = prices[finite] % self._unit
        return found

    def state(self, number: int | None = None) -> State:
        """Return a state, by default the initial one: its facts, h*, and a picture in a notebook."""
        number = self.initial if number is None else number
        return State(self.task, number, tuple(self.values([number])[0].tolist()), float(self.lookup([number])[0]))

    def optimal_plan(self, state: int | None = None) -> Plan | None:
        """Return an optimal plan from a state (default: the initial state); None from a dead end."""
        at = self.initial if state is None else state
        found = self._optimal_plan(at)
        return None if found is None else Plan(found, self.task, self.values([at])[0].tolist())

    def _optimal_plan(self, at: int) -> list[str] | None:
        if self.orbits is not None:
            return optimal_plan(self, at)
        row = self._rows([at])
        plan = astar(self._priced, self._values(row), search=self._search, limits=self._limits)[1]
        cheaper = self._cheaper(row, plan, self._limits)
        if cheaper is not None:
            return cheaper
        with suppress(LimitError):  # the plan is too long to be remembered
            self._remember(self._labels(row, plan))
        return plan

    def _values(self, row: Words) -> tuple[int, ...]:
        return tuple(self.packing.unpack(row)[0].tolist())

    def _cheaper(self, row: Words, plan: Sequence[str] | None, limits: Limits) -> list[str] | None:
        """Return an optimal plan from a state if the given plan, of least combined cost, is not optimal; else None.

        A plan that costs less has at least `UNIT` actions more. A search without combined costs decides whether there
        is one, unless the task has too few states for so long a plan without cycles.
        """
        if plan is None or self._unit == 1:
            return None
        cost = plan_cost(self.task, plan, self._values(row))
        if cost == 0 or math.prod(self.task.sizes) <= len(plan) + UNIT:
            return None
        other = astar(self.task, self._values(row), search=self._search, limits=limits)[1]
        assert other is not None  # the given plan is one
        return other if plan_cost(self.task, other, self._values(row)) < cost else None

    def _ask(self, missing: Sequence[bytes], progress: Callable[[int], None] | None) -> None:
        if self._search is None:
            chosen = fastest_search(self._priced, limits=self._limits)
            self._search = chosen.search
            if chosen.solved:
                with suppress(LimitError):  # the plan is too long; a state nearer to the goal may still be solvable
                    self._remember(self._labelled(self._rows([self.initial]), chosen.plan, self._limits))

        over = threading.Event()
        limits = self._limits.ended_by(over)

        remembering = threading.Lock()

        def search(key: bytes) -> LimitError | None:
            """Remember the cost-to-go of one state. Return the limit that prevented it, if any."""
            try:
                if key not in self._known:  # no plan that was found meanwhile visits it
                    found = self._searched(key, limits)
                    with remembering:
                        self._remember(found)
            except LimitError as error:
                return error
            if progress is not None:
                with remembering:
                    progress(1)
            return None

        ended = on_threads(search, missing, self._jobs, over)
        failure = next((error for error in ended if error is not None), None)
        if failure is not None:
            unknown = sum(key not in self._known for key in missing)
            raise LimitError(f"{unknown} of {len(missing)} states are not known: {failure}")

    def _searched(self, key: bytes, limits: Limits) -> dict[bytes, float]:
        """Return the combined cost-to-go of the states on a plan that A* finds from one state."""
        if limits.stop is not None and limits.stop.is_set():
            raise LimitError("stopped")
        row = np.frombuffer(key, dtype=np.uint64).reshape(1, -1)
        if holds(row, *self._goal)[0]:
            return {key: 0.0}
        plan = astar(self._priced, self._values(row), search=self._search, limits=limits)[1]
        return self._labelled(row, plan, limits)

    def _remember(self, found: dict[bytes, float]) -> None:
        self._known |= found
        if self._cache and found:
            self._cache.write(found)

    def _labelled(self, row: Words, plan: Sequence[str] | None, limits: Limits) -> dict[bytes, float]:
        """Return `_labels` of a plan of least combined cost, after checking that no plan costs less."""
        found = self._labels(row, plan)
        if self._cheaper(row, plan, limits) is not None:
            raise LimitError(
                f"the optimal plan has more than {UNIT} actions: where actions cost nothing, at most {UNIT - 1} "
                "actions can be told apart"
            )
        return found

    def _labels(self, row: Words, plan: Sequence[str] | None) -> dict[bytes, float]:
        """Return the combined cost-to-go of every state on an optimal plan; None stands for a dead end."""
        if plan is None:
            return {row.tobytes(): np.inf}
        price = float(plan_cost(self._priced, plan, self._values(row)))
        if self._unit > 1 and (len(plan) >= UNIT or price >= OVERFLOW):
            cost = (price - len(plan)) / self._unit
            raise LimitError(
                f"a plan of {len(plan)} actions and cost {cost:.0f}: where actions cost nothing, "
                f"at most {UNIT - 1} actions and a cost below {OVERFLOW // UNIT} can be told apart"
            )
        found = {row.tobytes(): price}
        for action in plan:
            _, actions, after = next(self._expanded(row))
            applicable = [self.task.actions[number] for number in actions.tolist()]
            slot = applicable.index(action)
            row = after[[slot]]
            price -= self._priced.costs[actions[slot]]
            found[row.tobytes()] = price
        return found
