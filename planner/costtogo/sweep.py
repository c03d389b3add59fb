"""The sweep: all reachable states of a task and their exact cost-to-go, fast and in little memory.

`sweep` computes a `Table` in three steps: it constructs a ranking of the states (`ranking`), finds the reachable states
and their distances (`forward_search`, `backward_search`), and numbers the states as `states.state_space` says.

Tasks with derived variables, with ranks beyond 62 bits, or with operators that split into very many moves use a slower
method: a registry of packed states, with all transitions in memory.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..grounding.task import Task
from ..pddl.formulas import LARGEST_COST
from ..search.backward_search import distances
from ..search.forward_search import explore
from ..search.kernels.ranked_successors import RankedOperators
from ..search.ranked_index import RankedSpace
from ..search.ranking.mutexes import Mutexes
from ..search.ranking.state_ranking import MANY, StateRanking
from ..search.ranking.transition_normal_form import TNFOperator, exactly_one, split_operators
from ..search.search_space import SearchSpace
from ..search.state_registry import RegistrySpace
from ..search.successor_generator import ranked_operators
from ..states.state_space import StateSpace
from ..system.limits import Budget, CostLimitError, LimitError, MemoryLimitError
from ..system.machine import processors
from ..system.progress import Progress, Wanted, shows_progress
from .load import task_of
from .table import Table

if TYPE_CHECKING:
    from .load import AnyTask

LOOKING = "a ranking was looked for"
"""Phase in messages about limits: the construction of a ranking."""


@dataclass(frozen=True)
class SweepOptions:
    """Options of how a sweep numbers the states. They affect its time and memory, but not the table.

    Attributes
    ----------
    small_bitmap : int
        Number of ranks up to which nothing else than the ranked search is tried. The bitmap of so many takes 64 MB.
    transitions_per_pair, most_transitions : int
        Transitions that are enumerated before a denser ranking is sought: so many per pair of a move and a fact, as the
        time for seeking it grows with their number, but at most `most_transitions`.
    ranks_per_transition : int
        If a bitmap would be larger, one transition for so many ranks is enumerated first, in case that the bitmap would
        be sparse.
    ranking_share : float
        Share of the remaining time for the search of a denser ranking. After that, the best ranking so far is used, if
        any.
    """

    small_bitmap: int = 1 << 29
    transitions_per_pair: int = 4
    most_transitions: int = 1 << 22
    ranks_per_transition: int = 1 << 14
    ranking_share: float = 0.25


@shows_progress
def sweep(
    task: AnyTask,
    *,
    max_states: int | None = None,
    memory_limit_mb: float | None = None,
    deadline: float | None = None,
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

    def registry(most: float = math.inf) -> SearchSpace | None:
        return explore(RegistrySpace(task, budget), budget, threads, progress, most)

    try:
        space: SearchSpace | None = None
        moves, coding = _plain(task, budget)
        if coding is None or coding.size > options.small_bitmap:
            size = math.inf if coding is None else coding.size
            most = size // options.ranks_per_transition
            if size > MANY:
                pairs = len(moves) * sum(task.sizes)
                most = min(options.transitions_per_pair * pairs, options.most_transitions)
            with suppress(MemoryLimitError, MemoryError):  # a ranked search may need less memory
                space = registry(most)
        if space is None:
            moves, dense = _denser(task, coding, moves, budget, options.ranking_share)
            if dense.size > MANY:
                with suppress(MemoryLimitError, MemoryError):
                    space = registry(dense.size // options.ranks_per_transition)
        if space is None:
            space = explore(_ranked(task, dense, moves, budget), budget, threads, progress)
        assert space is not None
        return space, None
    except UnrankedError as error:
        space = registry()
        assert space is not None
        return space, f"swept without a ranking, which takes some ten times as long as with one: {error}"


class UnrankedError(Exception):
    """A task has no ranking; the message says why."""


def _plain(task: Task, budget: Budget) -> tuple[list[TNFOperator], StateRanking | None]:
    """Return the moves of a task, and its ranking by single variables if 62 bits suffice."""
    if any(variable.axiom_layer >= 0 for variable in task.variables):
        raise UnrankedError("it has derived variables")
    try:
        moves = split_operators(task, budget.during("operators were split"))
        if moves is None:
            raise UnrankedError("its operators split into very many moves")
        groups, moves = exactly_one(task, moves, budget.during(LOOKING))
        return moves, StateRanking.of(task, groups, moves, budget.during(LOOKING))
    except (MemoryLimitError, MemoryError):
        raise UnrankedError("looking for a ranking took too much memory") from None


def _denser(
    task: Task, coding: StateRanking | None, moves: list[TNFOperator], budget: Budget, share: float
) -> tuple[list[TNFOperator], StateRanking]:
    """Return the moves and a ranking with at most as many ranks, a better one if the given one has too many."""
    why = "its states take more than 62 bits each"
    if coding is None or coding.size > MANY:
        part = budget.part(share)
        try:
            mutexes = Mutexes.of(task, moves, part.during(LOOKING))
            if mutexes is not None:
                part = part.beside(mutexes.together.nbytes + mutexes.barred.nbytes)
                found = StateRanking.dense(task, mutexes, part.during(LOOKING))
                if found is not None and (coding is None or found.size < coding.size):
                    return mutexes.moves, found
        except (MemoryLimitError, MemoryError):
            why = "looking for a ranking took too much memory"
        except LimitError:
            budget.during(LOOKING)(0)
            why = "looking for a ranking took too long"
    if coding is None:
        raise UnrankedError(why)
    return moves, coding


def _ranked(task: Task, coding: StateRanking, moves: list[TNFOperator], budget: Budget) -> RankedSpace:
    """Return the space of the ranked states, with the layout of the operators in both directions."""
    left = budget.beside(coding.decoder.rows.nbytes)  # these tables are in use throughout the search
    both: list[RankedOperators] = []
    try:
        for own in (moves, [move.inverse() for move in moves]):
            both.append(ranked_operators(own, coding, task.costs, left.during("operators were laid out")))
            left = left.beside(both[-1].table.nbytes + both[-1].candidates.sets.nbytes)
        return RankedSpace(coding, both[0], both[1], left, task.initial)
    except (MemoryLimitError, MemoryError):
        raise UnrankedError("its ranking takes too much memory") from None
