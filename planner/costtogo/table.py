"""The sweep: a table of all reachable states of a task and their exact cost-to-go, fast and in little memory.

The rest of the project uses the interface `CostToGo`: the cost-to-go of some states, and their transitions. Two classes
implement it. A `Table`, which `sweep` computes, contains h* of every state of a `StateSpace`. `OnDemand` computes h* of
single states with Fast Downward.

`sweep` takes three steps: it constructs a ranking of the states (`state_ranking`), finds the reachable states and their
distances (`search_space`), and numbers the states as `search.state_space` says.

Tasks with derived variables, with ranks beyond 62 bits, or with operators that split into very many moves use a slower
method: a registry of packed states, with all transitions in memory.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..grounding.task import Task
from ..pddl.formulas import LARGEST_COST
from ..search.numbering import SweepOptions, strides
from ..search.search_space import SearchSpace, distances, explore
from ..search.sorted_space import SortedSpace
from ..search.state_space import UNREACHED, StateSpace, Transitions, as_floats, is_dead_end, plan_lengths, state_numbers
from ..system.arrays import Ints
from ..system.errors import UnsuitedError
from ..system.limits import Budget, CostLimitError, Deadline, LimitError, MemoryLimitError, processors
from ..system.progress import Progress, Wanted, shows_progress
from ..system.results import Result
from .cost_to_go import Plan, State, optimal_choices, optimal_plan
from .load import task_of

if TYPE_CHECKING:
    from .load import AnyTask


@dataclass(frozen=True, eq=False, repr=False)
class Table(Result):
    """The exact cost-to-go of every state of a state space.

    Attributes
    ----------
    space : StateSpace
    distance : unsigned integer array, shape (n,)
        h* as a multiple of the task's `unit`, in the smallest type that can represent it. The type's largest value
        marks dead ends.
    note : str or None
        Remark on how the table was computed, such as the reason for a slower method; None if there is none.
    """

    space: StateSpace
    distance: NDArray[np.unsignedinteger]
    note: str | None = None

    def __post_init__(self) -> None:
        self.distance.flags.writeable = False

    def __len__(self) -> int:
        return len(self.space)

    def __repr__(self) -> str:
        cost, dead = self[self.initial], int(self.dead_end.sum())
        first = "no way to the goal" if cost == math.inf else f"cost {cost:g}"
        return f"<Table of {self.task.name}: {len(self):,} states, {first} from the initial one, {dead:,} dead ends>"

    def __eq__(self, other: object) -> bool:
        """Whether both have the same costs of the same task, whose states are numbered in one way."""
        return isinstance(other, Table) and self.task == other.task and np.array_equal(self.h, other.h)

    def records(self) -> list[dict[str, Any]]:
        """Return one row: the task, its states, the cost of the initial one, dead ends, and the largest h*."""
        largest = float(self.h[~self.dead_end].max(initial=0.0))
        return [{
            "task": self.task.name, "states": len(self), "cost": self[self.initial],
            "dead ends": int(self.dead_end.sum()), "largest h*": largest,
        }]  # fmt: skip

    @property
    def method(self) -> Literal["sweep", "on-demand"]:
        """Method that computed the table."""
        return "sweep"

    @property
    def searches(self) -> bool:
        """Whether `lookup` may run a search: always False."""
        return False

    @property
    def task(self) -> Task:
        """The task."""
        return self.space.task

    @property
    def initial(self) -> int:
        """Number of the initial state."""
        return self.space.initial

    @property
    def dead_end(self) -> NDArray[np.bool_]:
        """Whether each state is a dead end, shape (n,)."""
        return is_dead_end(self.distance)

    @cached_property
    def h(self) -> NDArray[np.float64]:
        """h* of every state, shape (n,); infinite at dead ends."""
        return self.lookup(slice(None))

    def __getitem__(self, state: int) -> float:
        """Return h* of one state; infinite at a dead end."""
        return float(self.lookup([state])[0])

    def state(self, number: int | None = None) -> State:
        """Return a state, by default the initial one: its facts, h*, and a picture in a notebook.

        Raises
        ------
        IndexError
            It is not the number of a state.
        """
        number = self.initial if number is None else number
        return State(self.task, number, tuple(self.values([number])[0].tolist()), self[number])

    def lookup(self, states: ArrayLike | slice) -> NDArray[np.float64]:
        """Return h* of states in the file's unit of cost, shape (N,); infinite at dead ends.

        Raises
        ------
        IndexError
            One of them is not the number of a state.
        """
        return self.task.in_unit(self.whole(states))

    def whole(self, states: ArrayLike | slice) -> NDArray[np.float64]:
        """Return h* of states as multiples of the task's `unit`, shape (N,); infinite at dead ends.

        These are whole numbers, so that sums of them are exact. An `IndexError` says as in `lookup`.
        """
        return as_floats(self.distance[states if isinstance(states, slice) else state_numbers(states, len(self))])

    def choices(self, states: ArrayLike) -> Transitions:
        """Return the transitions of states, shape (N,), as compressed rows."""
        return self.space.choices(states)

    def is_goal(self, states: ArrayLike) -> NDArray[np.bool_]:
        """Return whether each state is a goal state, shape (N,)."""
        values = self.values(states)
        variables, wanted = np.array(self.task.goal, dtype=np.int64).reshape(len(self.task.goal), 2).T
        return (values[:, variables] == wanted).all(axis=1)

    def values(self, states: ArrayLike) -> Ints:
        """Return the values, shape (N, variables), of states, shape (N,)."""
        return self.space.values(states)

    def numbers(self, values: ArrayLike) -> Ints:
        """Return the numbers, shape (N,), of states with the given values, shape (N, variables)."""
        return self.space.numbers(values)

    def plan_lengths(self, states: ArrayLike) -> Ints:
        """Return the least number of actions of an optimal plan, shape (N,); `UNREACHED` at dead ends.

        The search visits only states on optimal plans from the given states.
        """
        wanted = state_numbers(states, len(self))
        costs = np.asarray(self.task.costs)
        seen = np.zeros(len(self), dtype=bool)
        layer = np.unique(wanted[np.isfinite(self.whole(wanted))])
        edges = [np.empty((2, 0), dtype=np.int64)]
        while len(layer):
            seen[layer] = True
            rows = self.space.transitions if len(layer) == len(self) else self.choices(layer)
            sources = np.repeat(layer, np.diff(rows.offsets))
            cheapest = costs[rows.actions] + self.whole(rows.targets) == self.whole(sources)
            edges.append(np.stack([rows.targets, sources])[:, cheapest])
            layer = np.unique(rows.targets[cheapest & ~seen[rows.targets]])
        result, known = np.full(len(wanted), UNREACHED), seen[wanted]
        if known.any():
            place = np.cumsum(seen) - 1
            targets, sources = place[np.hstack(edges)]
            lengths = plan_lengths(targets, sources, self.is_goal(np.flatnonzero(seen)))
            result[known] = lengths[place[wanted[known]]]
        return result

    def optimal_choices(self) -> NDArray[np.bool_]:
        """Return whether each transition of all states, shape (m,), is optimal (`cost_to_go.optimal_choices`)."""
        return optimal_choices(self, np.arange(len(self)), self.space.transitions)

    def optimal_plan(self, state: int | None = None) -> Plan | None:
        """Return an optimal plan, read off the table; None from a dead end.

        If actions of cost zero exist, the plan has the fewest actions among the optimal plans.
        """
        return optimal_plan(self, self.initial if state is None else state)


@shows_progress
def sweep(
    task: AnyTask,
    *,
    max_states: int | None = None,
    memory_limit_mb: float | None = None,
    deadline: float | None = None,
    time_limit: float | None = None,
    threads: int | None = None,
    stop: threading.Event | None = None,
    progress: Wanted = None,
    reserved_bytes: Callable[[], float] = float,
    options: SweepOptions | None = None,
) -> Table:
    """Enumerate the reachable states of a task, and compute the exact cost-to-go of all of them.

    Parameters
    ----------
    task : Task, or whatever `load` takes
    max_states : int, optional
        Largest number of states; unlimited by default.
    memory_limit_mb : float, optional
        Memory of the sweep in MB, in addition to what the process uses already; by default, the available memory.
    deadline : float, optional
        Time on the clock of `time.monotonic()`.
    time_limit : float, optional
        Seconds after which the sweep ends with a `LimitError`; a part of a table would be of no use.
    threads : int, optional
        Number of threads; by default one per processor. The result does not depend on it.
    stop : threading.Event, optional
        The sweep ends with a `LimitError` once this is set.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes. The stages are "states", with the number
        of states found, and "cost-to-go", with the number of states whose cost-to-go is known.
    reserved_bytes : callable, optional
        Returns the number of bytes that are currently reserved for another computation.
    options : SweepOptions, optional

    Raises
    ------
    LimitError
        A limit is reached, or a cost is larger than `LARGEST_COST`.
    """
    assert callable(progress)
    task = task_of(task)
    require_sweepable(task)
    ends = Deadline.after(time_limit).at
    deadline = ends if deadline is None else min(deadline, ends)
    budget = Budget.within(max_states, memory_limit_mb, deadline, stop, reserved_bytes)
    threads = threads or processors()
    space, note = explored(task, budget, threads, progress, options or SweepOptions())
    distance = distances(space, task.goal, budget, threads, progress)
    found = StateSpace(task, len(distance), space.initial, space.transitions, space.index, budget.check_memory)
    return Table(found, distance, note)


def require_sweepable(task: Task) -> None:
    """Check that all values of numbers are known, and that no cost is larger than `LARGEST_COST`."""
    if task.beyond:
        raise LimitError(f"{task.instance}: not all states are known, since a number has no proven bound")
    if (largest := max(task.costs, default=0)) > LARGEST_COST:
        raise CostLimitError(f"{task.instance}: a cost of {largest} is too large; expected at most {LARGEST_COST}")


def explored(
    task: Task, budget: Budget, threads: int, progress: Progress, options: SweepOptions
) -> tuple[SearchSpace, str | None]:
    """Return the space of all reachable states, and a note.

    The note is None, or says why a slower search without a ranking was used.
    """
    if (space := _small(task, budget, progress, options)) is not None:
        return space, None
    from ..search import ranked_index  # the compiler takes longer to import than a small task to solve

    return ranked_index.explored(task, budget, threads, progress, options)


def _small(task: Task, budget: Budget, progress: Progress, options: SweepOptions) -> SortedSpace | None:
    """Return the space of a task by the readable search; None if the task is not small."""
    if not options.small_states:
        return None
    try:
        space = SortedSpace(task, budget, options.small_states)
        explore(space, budget, 1, progress)
        stride = strides(task, space.transitions, budget, options)
    except (UnsuitedError, MemoryLimitError, MemoryError):
        return None
    if stride is not None:
        space.by_rank(stride)
    return space
