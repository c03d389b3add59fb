"""Cost-to-go of single states, asked for as they are met.

For tasks that are too large to enumerate. `OnDemand` numbers the states that it is asked about in the order
in which it meets them, asks Fast Downward's A* for the cost-to-go of those that it does not know, several
at a time, and remembers every answer: in memory, and in a `Cache` on disk that outlives the process. An
optimal plan labels all states on it, so that one search answers for many. Where one state of each orbit under the
task's symmetries could be swept (`orbits`), the answers are looked up there, and nobody is asked.

Where a task has actions that cost nothing, what is asked for is the cheapest plan with the fewest actions, which says
which choices are optimal (`costtogo.optimal_choices`): Fast Downward is given prices that count both.
"""

from __future__ import annotations

import copy
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..grounding.task import Task
from ..search.distances import UNREACHED
from ..search.kernels.packed_successors import PackedOperators
from ..search.state_registry import StateRegistry
from ..search.successor_generator import expanded, packed_operators
from ..states.packing import Ints, Packing, Words, holds
from ..states.state_space import state_numbers
from ..states.successors import Successors, Transitions
from ..system.limits import NO_LIMITS, LimitError, Limits
from ..system.machine import processors
from .astar import LARGEST, UNIT, astar, counted, fastest_search, priced
from .cache import Cache
from .cost_to_go import optimal_choices
from .orbits import OrbitTable


class OnDemand:
    """The cost-to-go of a task that is too large to enumerate.

    States are numbered as they are met; the initial state is 0. The object grows with what it is asked, and any thread
    may ask.

    Parameters
    ----------
    task : Task
    cache : Cache, optional
        Where answers are kept; nowhere but in memory unless given.
    jobs : int, optional
        Searches that run at a time; one per processor unless given.
    limits : Limits
        Time and memory of each single search.
    reason : str, optional
        Why the task is not enumerated.
    orbits : Orbits, optional
        The cost-to-go of one state of each orbit under the task's symmetries.
    """

    method: Literal["sweep", "on-demand"] = "on-demand"

    def __init__(
        self,
        task: Task,
        *,
        cache: Cache | None = None,
        jobs: int | None = None,
        limits: Limits = NO_LIMITS,
        reason: str | None = None,
        orbits: OrbitTable | None = None,
    ) -> None:
        self.task = task
        self.orbits = orbits
        self._priced, self._unit = priced(task)
        self.reason = reason
        self.packing = Packing.of(task)
        self._successors = Successors(task, self.packing)
        self._goal = self.packing.condition(task.goal)
        self._cache = cache
        self._known = cache.read() if cache else {}
        self._jobs = jobs or processors()
        self._limits = limits
        self._search: str | None = None
        self._met = StateRegistry(self.packing.words)
        self.initial = int(self._meet(self._successors.derive(self.packing.pack([task.initial])))[0])

    def __len__(self) -> int:
        """Count the states that have been met."""
        return len(self._met)

    @cached_property
    def _book(self) -> PackedOperators:
        return packed_operators(self.task, self.packing) if self.orbits is None else self.orbits.index.found.book

    @cached_property
    def _counting(self) -> OnDemand:
        """The same task, asked for the cheapest plans with the fewest actions."""
        other = OnDemand(self.task, jobs=self._jobs, limits=self._limits)
        other._priced, other._unit = counted(self.task), UNIT
        return other

    @property
    def searches(self) -> bool:
        """Whether looking a state up may take a search of its own."""
        return self.orbits is None

    def _meet(self, states: Words) -> Ints:
        return self._met.numbers(states).astype(np.int64)

    def numbers(self, values: ArrayLike) -> NDArray[np.int64]:
        """Give the numbers, shape (N,), of states with values of shape (N, variables).

        Whether a state can be reached is not checked, and has to be so.
        """
        array = np.asarray(values)
        sizes = np.array([len(variable.facts) for variable in self.task.variables])
        whole = not array.size or array.dtype.kind in "iu"
        if not whole or array.ndim != 2 or array.shape[1] != len(sizes) or not ((array >= 0) & (array < sizes)).all():
            raise ValueError(f"expected values of shape (N, {len(sizes)}), each one of its variable's values")
        return self._meet(self._successors.derive(self.packing.pack(array.astype(np.int64, copy=False))))

    def values(self, states: ArrayLike) -> NDArray[np.int64]:
        """Give the values, shape (N, variables), of states of shape (N,)."""
        return self.packing.unpack(self._rows(states))

    def _rows(self, states: ArrayLike) -> Words:
        return self._met.states(np.atleast_1d(state_numbers(states, len(self))))

    def is_goal(self, states: ArrayLike) -> NDArray[np.bool_]:
        """Tell of states, shape (N,), which are goal states."""
        return holds(self._rows(states), *self._goal)

    def choices(self, states: ArrayLike) -> Transitions:
        """Give the choices of states, shape (N,), as compressed rows; the states they lead to are met."""
        none = np.empty(0, dtype=np.int32)
        parts = [(none, none, np.empty((0, self.packing.words), dtype=np.uint64))]
        parts += expanded(self._book, self._rows(states))
        counts, actions, after = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        return Transitions(np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]), actions, self._meet(after))

    def lookup(self, states: ArrayLike, progress: Callable[[int], None] | None = None) -> NDArray[np.float64]:
        """Give h* of states, shape (N,), infinite at dead ends; ask Fast Downward for those not known.

        Parameters
        ----------
        states : int array, shape (N,)
        progress : callable, optional
            Called with how many states have been answered since the last call.

        Raises
        ------
        LimitError
            A search reached its limits. What the others found is kept, and nothing is said of that state.
        """
        rows = self._rows(states)
        if self.orbits is not None:
            h = self.orbits.lookup(rows)
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
        """Give this, with what it knows and the states that it has met, under other limits and for another reason."""
        other = copy.copy(self)
        other._limits, other.reason, other.orbits = limits, reason, orbits or self.orbits
        return other

    def known(self, states: ArrayLike) -> NDArray[np.float64]:
        """Give h* of states, shape (N,), as far as it is known without a search; NaN elsewhere."""
        rows = self._rows(states)
        h = self._costs(np.array([self._known.get(row.tobytes(), np.nan) for row in rows], dtype=np.float64))
        return h if self.orbits is None else np.where(np.isnan(h), self.orbits.lookup(rows), h)

    def _costs(self, prices: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(np.isfinite(prices), np.floor(prices / self._unit), prices)

    def plan_lengths(self, states: ArrayLike) -> NDArray[np.int64]:
        """Give how many actions the shortest of the cheapest plans from states has, shape (N,); `UNREACHED` if none.

        Where actions differ in costs, and none is free, this takes searches of its own.

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
        h = self.lookup(states)
        finite, found = np.isfinite(h), np.full(len(rows), UNREACHED)
        if self._unit == 1:
            found[finite] = h[finite] / max(self.task.costs, default=1)
        else:
            prices = np.array([self._known[row.tobytes()] for row in rows], dtype=np.float64)
            found[finite] = prices[finite] % self._unit
        return found

    def optimal_plan(self, state: int | None = None) -> list[str] | None:
        """Find an optimal plan from a state (the initial one unless given); None from a dead end."""
        at = self.initial if state is None else state
        if self.orbits is not None:
            return self._descent(at)
        values = self.values([at])[0]
        return astar(self._priced, tuple(values.tolist()), limits=self._limits)[1]

    def _descent(self, state: int) -> list[str] | None:
        """Follow optimal choices from a state to the goal."""
        if not np.isfinite(self.lookup([state])[0]):
            return None
        plan = []
        while not self.is_goal([state])[0]:
            rows = self.choices([state])
            best = int(optimal_choices(self, [state], rows).argmax())
            plan.append(self.task.actions[rows.actions[best]])
            state = int(rows.targets[best])
        return plan

    def _ask(self, missing: Sequence[bytes], progress: Callable[[int], None] | None) -> None:
        if self._search is None:
            chosen = fastest_search(self._priced, limits=self._limits)
            self._search = chosen.search
            if chosen.solved:
                with suppress(LimitError):  # of a plan too long to be told: a state nearer to the goal may be asked for
                    self._remember(self._labels(self._rows([self.initial]), chosen.plan))

        over = threading.Event()
        limits = self._limits.ended_by(over)

        def search(key: bytes) -> dict[bytes, float]:
            if key in self._known:  # a plan that was found meanwhile leads through it
                return {}
            if limits.stop is not None and limits.stop.is_set():
                raise LimitError("stopped")
            row = np.frombuffer(key, dtype=np.uint64).reshape(1, -1)
            if holds(row, *self._goal)[0]:
                return {key: 0.0}
            values = tuple(self.packing.unpack(row)[0].tolist())
            return self._labels(row, astar(self._priced, values, search=self._search, limits=limits)[1])

        failure: LimitError | None = None
        with ThreadPoolExecutor(self._jobs) as pool:
            try:
                for future in as_completed([pool.submit(search, key) for key in missing]):
                    try:
                        found = future.result()
                    except LimitError as error:
                        failure = error
                        continue
                    self._remember(found)
                    if progress is not None:
                        progress(1)
            except BaseException:  # Ctrl-C as well
                over.set()
                pool.shutdown(cancel_futures=True)
                raise
        if failure is not None:
            unknown = sum(key not in self._known for key in missing)
            raise LimitError(f"{unknown} of {len(missing)} states are not known: {failure}")

    def _remember(self, found: dict[bytes, float]) -> None:
        self._known |= found
        if self._cache and found:
            self._cache.write(found)

    def _labels(self, row: Words, plan: Sequence[str] | None) -> dict[bytes, float]:
        """Give the price of what is to come in every state on an optimal plan; None is that of a dead end."""
        if plan is None:
            return {row.tobytes(): np.inf}
        price = float(self._priced.plan_cost(plan))
        if self._unit > 1 and (len(plan) >= UNIT or price >= LARGEST):
            raise LimitError(
                f"a plan of {len(plan)} actions and cost {self.task.plan_cost(plan)}: where actions cost nothing, "
                f"at most {UNIT - 1} actions and a cost below {LARGEST // UNIT} can be told apart"
            )
        found = {row.tobytes(): price}
        for action in plan:
            row = self._successors.follow(row, self.task.action_index[action])
            price -= self._priced.costs[self.task.action_index[action]]
            found[row.tobytes()] = price
        return found
