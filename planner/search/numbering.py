"""When states are numbered by rank, and when by layer; `state_space` states the rule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..grounding.task import Task
from ..system.limits import Budget, MemoryLimitError
from .digits import LOOKING, MANY, Digits, UnrankedError, moves_and_groups
from .sorted_space import MOST_STATES, TooLargeError


@dataclass(frozen=True)
class SweepOptions:
    """Options of how a sweep numbers the states. They affect its time and memory, but not the table.

    Attributes
    ----------
    small_states : int
        Number of states up to which the readable search is used; the compiled search gives the same numbers.
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

    small_states: int = MOST_STATES
    small_bitmap: int = 1 << 29
    transitions_per_pair: int = 4
    most_transitions: int = 1 << 22
    ranks_per_transition: int = 1 << 14
    ranking_share: float = 0.25

    def most_by_layer(self, task: Task, moves: int, ranks: float) -> float:
        """Return the number of transitions from which a task with so many moves and ranks is not numbered by layer."""
        if ranks <= self.small_bitmap:
            return 0
        if ranks > MANY:
            return min(self.transitions_per_pair * moves * sum(task.sizes), self.most_transitions)
        return ranks // self.ranks_per_transition


def strides(task: Task, transitions: int, budget: Budget, options: SweepOptions) -> Sequence[int] | None:
    """Return the factors of the variables in the ranks by which states are numbered; None if they are by layer.

    `transitions` is the number of all transitions. If only a dense ranking decides, this raises a `TooLargeError`.
    """
    try:
        moves, groups = moves_and_groups(task, budget)
        digits = Digits.of(task, groups, moves, budget.during(LOOKING))
    except (UnrankedError, MemoryLimitError, MemoryError):
        return None
    if transitions < options.most_by_layer(task, len(moves), digits.size):
        return None
    if digits.size > MANY:
        raise TooLargeError
    return digits.stride
