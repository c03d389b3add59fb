"""The sweep: a table of all reachable states of a task and their exact cost-to-go, fast and in little memory.

The rest of the project uses the interface `CostToGo`: the cost-to-go of some states, and their transitions. Two classes
implement it. A `Table`, which `sweep` computes, contains h* of every state of a `StateSpace`. `OnDemand` computes h* of
single states with Fast Downward.

`sweep` takes three steps: it constructs a ranking of the states (`state_ranking`), finds the reachable states and their
distances (`search_space`), and numbers the states as `search.state_space` says.

Tasks with derived variables, with ranks beyond 62 bits, or with operators that split into very many moves use a slower
method: a registry of packed states, with all transitions in memory.

In a file, a table is an uncompressed `.npz` archive of numpy, which `numpy.load` can read as well; `docs/commands.md`
describes the arrays. It is written block by block. Tables of a billion states exceed the memory, and often only some
states are needed: `open_table` maps the file into memory, and reads only the parts that are accessed.
"""

from __future__ import annotations

import io
import math
import threading
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from tokenize import TokenError
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.lib import format as npy
from numpy.typing import ArrayLike, NDArray

from ..grounding.task import Task, in_unit, pddl_fact
from ..pddl.formulas import LARGEST_COST
from ..search.numbering import SweepOptions, strides
from ..search.search_space import SearchSpace, distances, explore
from ..search.sorted_space import SortedSpace
from ..search.state_space import (
    UNREACHED,
    Packing,
    StateSpace,
    Transitions,
    as_floats,
    is_dead_end,
    plan_lengths,
    state_numbers,
)
from ..system.arrays import Ints, Words, outline
from ..system.errors import InputFileError, UnsuitedError
from ..system.files import atomic
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


@dataclass(frozen=True)
class SavedTable:
    """A cost-to-go table in a file.

    Attributes
    ----------
    packing : Packing
    states : uint64 array, shape (n, words)
    distance : unsigned integer array, shape (n,)
        h* of each state, a multiple of `unit`; the type's largest value marks dead ends.
    initial : int
        Number of the initial state.
    facts : text array, shape (variables, values)
        Meaning of each value of each variable: `(on a b)`, `(not (on a b))`, or `<none of those>`; empty for values
        that the variable does not have.
    unit : Fraction
        Cost in the file's unit that a distance of 1 stands for.
    """

    packing: Packing
    states: Words
    distance: NDArray[np.unsignedinteger]
    initial: int
    facts: NDArray[np.str_]
    unit: Fraction

    __repr__ = outline

    def __len__(self) -> int:
        return len(self.distance)

    def lookup(self, states: ArrayLike) -> NDArray[np.float64]:
        """Return h* of states in the file's unit of cost, shape (N,); infinite at dead ends."""
        return in_unit(as_floats(self.distance[state_numbers(states, len(self))]), self.unit)

    def values(self, states: ArrayLike) -> Ints:
        """Return the values, shape (N, variables), of states, shape (N,)."""
        return self.packing.unpack(self.states[state_numbers(states, len(self))])


def save_table(file: str | Path, table: Table) -> None:
    """Save a cost-to-go table as `.npz`, atomically.

    Parameters
    ----------
    table : Table
    file : path
    """
    task = table.task
    packing = Packing.of(task)
    width = max(len(variable.facts) for variable in task.variables)
    arrays = {
        "cost_to_go": table.distance,
        "initial": np.asanyarray(table.initial),
        "unit": np.array([task.unit.numerator, task.unit.denominator], dtype=np.int64),
        "word": packing.word,
        "shift": packing.shift,
        "bits": packing.bits,
        "facts": np.array([[*map(pddl_fact, v.facts), *[""] * (width - len(v.facts))] for v in task.variables]),
    }
    with atomic(Path(file)) as path, path.open("wb") as stream, zipfile.ZipFile(stream, "w") as archive:
        with archive.open("states.npy", "w", force_zip64=True) as target:
            shape = {"descr": npy.dtype_to_descr(np.dtype(np.uint64)), "fortran_order": False}
            npy.write_array_header_1_0(target, {**shape, "shape": (len(table), packing.words)})
            block = 1 << 16  # states that are written at a time; it bounds the memory for unpacked states
            for start in range(0, len(table), block):
                rows = np.arange(start, min(start + block, len(table)))
                target.write(packing.pack(table.values(rows)).tobytes())
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as target:
                npy.write_array(target, array, allow_pickle=False)


def open_table(file: str | Path) -> SavedTable:
    """Open a table that `save_table` has written; only the parts that are accessed are read.

    Parameters
    ----------
    file : path

    Raises
    ------
    InputFileError
        The file is not such a table, is truncated, or contains arrays that do not match.
    """
    file = Path(file)
    try:
        with zipfile.ZipFile(file) as archive, file.open("rb") as stream:
            members = archive.infolist()
            arrays = {member.filename.removesuffix(".npy"): _mapped(file, stream, member) for member in members}
        return _table(arrays)
    except (zipfile.BadZipFile, NotImplementedError, TokenError, TypeError, KeyError, ValueError, IndexError) as error:
        raise InputFileError.of(file, None, f"no table of costs-to-go ({error})") from None


def _table(arrays: Mapping[str, NDArray[Any]]) -> SavedTable:
    """Return the table of the given arrays after checking their types and shapes.

    The entries of single states are not checked.
    """
    states, distance, facts = arrays["states"], arrays["cost_to_go"], arrays["facts"]
    for name, kinds, dimensions in (
        ("states", "u", 2),
        ("cost_to_go", "u", 1),
        ("facts", "U", 2),
        ("initial", "iu", 0),
        ("unit", "i", 1),
    ):
        array = arrays[name]
        if array.dtype.kind not in kinds or array.ndim != dimensions:
            raise ValueError(f"{name} is of the kind {array.dtype} and has {array.ndim} dimensions")
    packing, initial = Packing.of_sizes((facts != "").sum(axis=1).tolist()), int(arrays["initial"])
    if states.dtype != np.uint64 or states.shape != (len(distance), packing.words) or not 0 <= initial < len(distance):
        raise ValueError(
            f"states, {states.dtype} {states.shape}, are not those of {len(distance)} costs-to-go and of the facts"
        )
    unit = arrays["unit"].tolist()
    if len(unit) != 2 or min(unit) <= 0:
        raise ValueError(f"unit is {unit}; expected a numerator and a denominator")
    for name in ("word", "shift", "bits"):
        if not np.array_equal(arrays[name], getattr(packing, name)):
            raise ValueError(f"{name} is not where this version puts the variables")
    return SavedTable(packing, states, distance, initial, facts, Fraction(*unit))


def _mapped(file: Path, stream: io.BufferedReader, member: zipfile.ZipInfo) -> NDArray[Any]:
    """Return an array of an archive, memory-mapped."""
    local_header = 30  # bytes of a file's local header in a ZIP archive, before the file name
    if member.header_offset < 0:
        raise ValueError(f"{member.filename} begins before the file")
    stream.seek(member.header_offset)
    header = stream.read(local_header)
    # The file name and an extra field follow; the last two numbers of the header are their lengths.
    lengths = np.frombuffer(header[-4:], dtype="<u2")
    stream.seek(member.header_offset + local_header + int(lengths.sum()))
    if npy.read_magic(stream) != (1, 0):
        raise ValueError(f"{member.filename} is written in another way")
    shape, fortran_order, dtype = npy.read_array_header_1_0(stream)
    if not shape or 0 in shape:
        return np.fromfile(stream, dtype=dtype, count=1 if not shape else 0).reshape(shape)
    order: Literal["C", "F"] = "F" if fortran_order else "C"
    return np.memmap(file, dtype=dtype, mode="r", offset=stream.tell(), shape=shape, order=order)
