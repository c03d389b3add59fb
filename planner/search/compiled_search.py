"""The compiled search through all states of a task of any size: ranked if the task allows it, else with a registry."""

from __future__ import annotations

import math
from contextlib import suppress

from ..grounding.task import Task
from ..system.errors import UnsuitedError
from ..system.limits import Budget, LimitError, MemoryLimitError
from ..system.progress import Progress
from .invariants import Mutexes
from .kernels.ranked_successors import RankedOperators
from .numbering import LOOKING, MANY, TOO_MUCH_MEMORY, SweepOptions, moves_and_groups
from .ranked_index import RankedSpace
from .search_space import SearchSpace, explore
from .state_ranking import StateRanking
from .state_registry import RegistrySpace
from .successor_generator import ranked_operators
from .transition_normal_form import TNFOperator


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
            most = options.most_by_layer(task, len(moves), math.inf if coding is None else coding.size)
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
    except UnsuitedError as error:
        space = registry()
        assert space is not None
        return space, f"swept without a ranking, which takes some ten times as long as with one: {error}"


def _plain(task: Task, budget: Budget) -> tuple[list[TNFOperator], StateRanking | None]:
    """Return the moves of a task, and its ranking by single variables if 62 bits suffice."""
    moves, groups = moves_and_groups(task, budget)
    try:
        return moves, StateRanking.of(task, groups, moves, budget.during(LOOKING))
    except (MemoryLimitError, MemoryError):
        raise UnsuitedError(TOO_MUCH_MEMORY) from None


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
            why = TOO_MUCH_MEMORY
        except LimitError:
            budget.during(LOOKING)(0)
            why = "looking for a ranking took too long"
    if coding is None:
        raise UnsuitedError(why)
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
        raise UnsuitedError("its ranking takes too much memory") from None
