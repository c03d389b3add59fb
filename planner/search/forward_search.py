"""The reachable states of any task as a list, and their exact cost-to-go: for what has no index.

Tasks with derived variables, with operators that split into very many moves, or whose indices take too many bits have
none: packed states are numbered as they are found, forward from the initial state, and what every action leads to is
kept until the search back from the goal is done. Blocks are expanded on several threads; their states are numbered in
order, so that numbers do not depend on how many there are.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Task
from ..states.packing import Packing, Words
from ..system.limits import Budget
from ..system.progress_reports import Progress
from .kernels import packed_successors
from .state_registry import Found, Numbered, _Growing
from .successor_generator import STATES_AT_A_TIME, Expanded, expanded, rulebook

Form = Callable[[Words], None]
"""What puts in the place of states, shape (n, words), others that do for them."""


def as_they_are(_states: Words) -> None:
    """Leave states in their place."""


@dataclass(frozen=True)
class Listing:
    """What the search forward has found.

    Attributes
    ----------
    found : Found
    counts : int32 array, shape (n,)
        Transitions of each state.
    targets : int32 array, shape (transitions,)
        What they lead to, in the order of the states.
    kinds : unsigned integer array, shape (transitions,)
        Which of the task's different costs each has; empty where all cost the same.
    """

    found: Found
    counts: NDArray[np.int32]
    targets: NDArray[np.int32]
    kinds: NDArray[np.unsignedinteger]


class _Forward:
    """The search forward, breadth first: the states that have been found so far."""

    def __init__(self, task: Task, form: Form = as_they_are) -> None:
        self.packing = Packing.of(task)
        self.book = rulebook(task, self.packing)
        self.form = form
        self.met = Numbered(self.packing.words)
        initial = self.packing.pack([task.initial])
        packed_successors.derive(self.book.axioms, self.book.again, initial)
        form(initial)
        self.met.numbers(initial)

    def parts(self, threads: int) -> Generator[tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]]:
        """Expand all states in order, some at a time: how many actions each has, which, and what they lead to."""
        waiting: deque[Future[list[Expanded]]] = deque()
        done = given = 0
        with ThreadPoolExecutor(threads) as pool:
            try:
                while done < len(self.met):
                    while given < len(self.met) and len(waiting) <= threads:
                        block = self.met.states(slice(given, min(given + STATES_AT_A_TIME, len(self.met))))
                        waiting.append(pool.submit(self._expanded, block))
                        given += len(block)
                    for counts, actions, after in waiting.popleft().result():
                        done += len(counts)
                        yield counts, actions, self.met.numbers(after)
            finally:
                for future in waiting:
                    future.cancel()

    def _expanded(self, states: Words) -> list[Expanded]:
        parts = list(expanded(self.book, states))
        for _, _, after in parts:
            self.form(after)
        return parts

    def check(self, budget: Budget, per_state: int, others: int) -> None:
        """Check the limits; given are bytes that are in use beside a state's words, for each of them and in all."""
        budget.check_states(len(self.met))
        budget.check_time(len(self.met))
        budget.check_memory(self.met.slots.nbytes + (8 * self.packing.words + per_state) * len(self.met) + others)


def counted(task: Task, budget: Budget, threads: int, progress: Progress) -> int:
    """Count the states that a task can reach; what they lead to is not kept."""
    search = _Forward(task)
    with closing(search.parts(threads)) as parts:
        for _ in parts:
            progress("states", len(search.met), None)
            search.check(budget, 0, 0)
    return len(search.met)


def enumerated(
    task: Task,
    budget: Budget,
    threads: int,
    progress: Progress,
    most: float = math.inf,
    form: Form = as_they_are,
) -> Listing | None:
    """Find the states that a task can reach, breadth first; None if they have `most` transitions or more.

    `form` puts in the place of states others that do for them, before they are looked for.
    """
    costs, kind_of = np.unique(task.costs, return_inverse=True)
    search, targets = _Forward(task, form), _Growing(np.int32)
    counts, kinds = _Growing(np.int32), _Growing(np.uint16 if len(costs) <= 1 << 16 else np.uint32)
    done = transitions = 0
    with closing(search.parts(threads)) as parts:
        for part_counts, actions, numbers in parts:
            counts.append(done, part_counts)
            targets.append(transitions, numbers)
            if len(costs) > 1:
                kinds.append(transitions, kind_of[actions])
            done, transitions = done + len(part_counts), transitions + len(numbers)
            if transitions >= most:
                return None
            search.check(budget, 24, (8 + 4 * (len(costs) > 1)) * transitions)
            progress("states", len(search.met), None)
    found = Found(search.packing, search.book, search.met.trimmed(), search.met.slots)
    kept = transitions if len(costs) > 1 else 0
    return Listing(found, counts.trimmed(done), targets.trimmed(transitions), kinds.trimmed(kept))
