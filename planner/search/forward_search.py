"""The reachable states of any task as a list, and their exact cost-to-go: for what has no index.

Tasks with derived variables, with operators that split into very many moves, or whose indices take too many bits have
none: packed states are numbered as they are found, forward from the initial state, and what every action leads to is
kept until the search back from the goal is done. Blocks are expanded on several threads; their states are numbered in
order, so that numbers do not depend on how many there are.
"""

from __future__ import annotations

import heapq
import math
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..costtogo.table import UNREACHED, compact
from ..grounding.fast_downward import LimitError
from ..grounding.task import Effect, Fact, Task
from ..states.successors import Ints, Packing, Successors, Transitions, Words, can_hold, holds
from ..system.limits import Budget
from ..system.progress_reports import Progress
from .kernels import packed_successors, relaxation
from .kernels.packed_successors import Rulebook, Rules
from .successor_generator import trie_of, tries_of

STATES_AT_A_TIME = 1 << 12
"""States that are expanded at a time."""

FULL = 0.7
"""Share of the slots that may be taken."""

MOST = np.iinfo(np.int32).max
"""So many states can be numbered."""

Masks = tuple[Words, Words, Words, Words]
"""Mask and bits of what a rule needs, then the bits that it clears and those that it sets."""

Rule = tuple[Sequence[Fact], Masks]
"""Facts that it needs, and the masks."""

Expanded = tuple[NDArray[np.int32], NDArray[np.int32], Words]
"""How many actions each of some states has, which, and what they lead to."""

Form = Callable[[Words], None]
"""What puts in the place of states, shape (n, words), others that do for them."""


def as_they_are(_states: Words) -> None:
    """Leave states in their place."""


def rulebook(task: Task, packing: Packing) -> Rulebook:
    """Lay out a task's transition function."""
    successors = Successors(task, packing)
    possible = [n for n, operator in enumerate(task.operators) if can_hold(operator.preconditions)]
    order = sorted(possible, key=lambda number: (task.operators[number].action, number))
    conditions = [frozenset(task.operators[number].preconditions) for number in order]
    stages = list(_axioms(task, packing, successors))
    return Rulebook(
        trie_of(conditions, packing),
        np.array([task.operators[number].action for number in order], dtype=np.int64),
        _rules([_grouped(task.operators[number].effects, successors.effects[number]) for number in order], packing),
        _rules([rules for rules, _ in stages], packing),
        np.array([again for _, again in stages], dtype=bool),
    )


def _grouped(effects: Sequence[Effect], masks: Sequence[Masks]) -> list[Rule]:
    """Give the conditions of effects beside the masks that `Successors` has of them."""
    conditions = dict.fromkeys(effect.conditions for effect in effects if can_hold(effect.conditions))
    return list(zip(conditions, masks, strict=True))


def _axioms(task: Task, packing: Packing, successors: Successors) -> Iterator[tuple[list[Rule], bool]]:
    """List the stages of a task's axioms: what derived variables are by default, then layer by layer."""
    if successors.layers:
        nothing = np.zeros(packing.words, dtype=np.uint64)
        yield [((), (nothing, nothing, *successors.defaults))], False
    layers = sorted({variable.axiom_layer for variable in task.variables} - {-1})
    for layer, masks in zip(layers, successors.layers, strict=True):
        own = [axiom for axiom in task.axioms if task.variables[axiom.variable].axiom_layer == layer]
        yield from _stages(_grouped(own, masks))


def _stages(layer: Sequence[Rule]) -> Iterator[tuple[list[Rule], bool]]:
    """Order a layer of axioms: what one needs comes before; tell of each stage whether it has circles."""
    left = list(layer)
    while left:
        open_ = np.bitwise_or.reduce([cleared for _, (_, _, cleared, _) in left])
        later = [bool((masks[0] & open_).any()) for _, masks in left]
        if all(later):
            yield left, True
            return
        yield [rule for rule, waits in zip(left, later, strict=True) if not waits], False
        left = [rule for rule, waits in zip(left, later, strict=True) if waits]


def _rules(groups: Sequence[Sequence[Rule]], packing: Packing) -> Rules:
    """Lay out rules, group by group."""
    writes = [0]
    written: list[tuple[int, int, int]] = []
    for group in groups:
        for _, (_, _, cleared, assigned) in group:
            written += [(int(w), int(~cleared[w]), int(assigned[w])) for w in np.flatnonzero(cleared)]
            writes.append(len(written))
    trie, begin = tries_of([[frozenset(facts) for facts, _ in group] for group in groups], packing)
    return Rules(trie, begin, np.array(writes), *_columns(written))


def _columns(rows: Sequence[tuple[int, int, int]]) -> tuple[Ints, Words, Words]:
    """Give the columns of rows of a word's number and two words."""
    number, first, second = zip(*rows, strict=True) if rows else ((), (), ())
    return np.array(number, np.int64), np.array(first, np.uint64), np.array(second, np.uint64)


@dataclass(frozen=True)
class Found:
    """The states that have been found, in the order in which they were.

    Attributes
    ----------
    packing : Packing
    book : Rulebook
    states : uint64 array, shape (n, words)
    slots : uint64 array
        The hash table from a state to its number.
    """

    packing: Packing
    book: Rulebook
    states: Words
    slots: Words

    def numbers(self, values: Ints) -> Ints:
        """Give the states with values of shape (n, variables), -1 where there is none."""
        sizes = np.left_shift(1, self.packing.bits)
        legal = np.all((values >= 0) & (values < sizes), axis=1)
        numbers = np.empty(len(values), dtype=np.int64)
        packed_successors.look_up(
            self.slots, self.states, self.packing.pack(np.where(legal[:, None], values, 0)), numbers
        )
        return np.where(legal, numbers, -1)

    def values(self, numbers: Ints) -> Ints:
        """Give the values, shape (n, variables), of states of shape (n,)."""
        return self.packing.unpack(self.states[numbers])

    def where(self, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        """Tell of every state, shape (states,), whether facts hold."""
        return holds(self.states, *self.packing.condition(facts))

    def transitions(self, states: int, transitions: int) -> Transitions:
        """Build the choices of all states; the arguments are how many there are of both."""
        rows = Transitions(
            np.zeros(states + 1, dtype=np.int64),
            np.empty(transitions, dtype=np.int32),
            np.empty(transitions, dtype=np.int32),
        )
        first = row = 0
        for counts, actions, after in expanded(self.book, self.states):
            rows.actions[row : row + len(actions)] = actions
            packed_successors.look_up(self.slots, self.states, after, rows.targets[row : row + len(actions)])
            rows.offsets[first + 1 : first + 1 + len(counts)] = row + np.cumsum(counts)
            first, row = first + len(counts), row + len(actions)
        return rows


def expanded(book: Rulebook, states: Words) -> Iterator[Expanded]:
    """Expand states, shape (n, words): how many actions each has, which, and what they lead to, in parts."""
    stop = 0
    room = 8 * STATES_AT_A_TIME + book.trie.most
    while stop < len(states):
        counts = np.empty(len(states) - stop, dtype=np.int32)
        actions, after = np.empty(room, dtype=np.int32), np.empty((room, states.shape[1]), dtype=np.uint64)
        start = stop
        stop, filled = packed_successors.expand(book, states, start, counts, actions, after)
        yield counts[: stop - start], actions[:filled], after[:filled]


class _Growing:
    """Rows that are appended to; the memory grows by a third at a time, without a second copy where the system can."""

    def __init__(self, dtype: Any, *width: int) -> None:
        self.rows = np.zeros((1 << 12, *width), dtype=dtype)

    def make_room(self, rows: int) -> None:
        """Have at least so many rows; views of the old ones must not be in use any more."""
        if rows > len(self.rows):
            self.rows.resize((max(rows, len(self.rows) * 4 // 3), *self.rows.shape[1:]), refcheck=False)

    def append(self, rows: int, more: NDArray[Any]) -> None:
        """Write what comes after so many rows."""
        self.make_room(rows + len(more))
        self.rows[rows : rows + len(more)] = more

    def trimmed(self, rows: int) -> NDArray[Any]:
        """Give the rows, of which so many are in use."""
        self.rows.resize((rows, *self.rows.shape[1:]), refcheck=False)
        return self.rows


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


class Numbered:
    """States that are numbered as they are met, in the order in which they are. Any thread may ask.

    Parameters
    ----------
    words : int
        Of a packed state.
    """

    def __init__(self, words: int) -> None:
        self._states = _Growing(np.uint64, words)
        self.slots = np.zeros(1 << 14, dtype=np.uint64)
        self._held = 0
        self._lock = threading.Lock()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _lock=threading.Lock())

    def __len__(self) -> int:
        return self._held

    def numbers(self, states: Words) -> NDArray[np.int32]:
        """Give the numbers of states, shape (n, words); those that are new get the next ones."""
        with self._lock:
            most = self._held + len(states)
            self._states.make_room(most)
            if most > FULL * len(self.slots):
                self.slots = np.zeros(1 << int(most / FULL * 2).bit_length(), dtype=np.uint64)
                packed_successors.fill_slots(self.slots, self._states.rows, 0, self._held)
            numbers = np.empty(len(states), dtype=np.int32)
            self._held = packed_successors.insert(self.slots, self._states.rows, self._held, states, numbers)
        if self._held > MOST:
            raise LimitError(f"more than {MOST} states without an index")
        return numbers

    def states(self, numbers: Ints | slice) -> Words:
        """Give a copy of the states, shape (n, words), of some numbers."""
        with self._lock:  # the rows move as they grow
            return self._states.rows[numbers].copy()

    def trimmed(self) -> Words:
        """Give all states; no more can be met."""
        return self._states.trimmed(self._held)


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


def settled(task: Task, listing: Listing, budget: Budget, progress: Progress) -> NDArray[np.unsignedinteger]:
    """Find the distance of all states from the goal, in the order of the distances (Dial 1969).

    The type's largest value marks dead ends.
    """
    states = len(listing.counts)
    progress("cost-to-go", 0, None)
    into = np.zeros(states + 2, dtype=np.int64)
    sources, kinds = np.empty_like(listing.targets), np.empty_like(listing.kinds)
    packed_successors.turn_round(listing.counts, listing.targets, listing.kinds, into, sources, kinds)
    costs = np.unique(task.costs).astype(np.int64) if task.costs else np.zeros(1, dtype=np.int64)
    distance = np.full(states, UNREACHED, dtype=np.int64)
    goal = np.flatnonzero(listing.found.where(task.goal))
    distance[goal] = 0
    room = max(16 * STATES_AT_A_TIME, int(np.diff(into[:-1]).max(initial=1)))
    waiting = {0: [goal]}
    order = [0]
    while order:
        d = order[0]
        if d not in waiting:
            heapq.heappop(order)
            continue
        for block in waiting.pop(d):
            stop = 0
            while stop < len(block):
                budget.check_time(states)
                out, through = np.empty(room, dtype=np.int64), np.empty(room, dtype=np.int64)
                stop, filled = packed_successors.relax_stored(
                    into, sources, kinds, costs, distance, block, stop, d, out, through
                )
                begin, ordered = np.zeros(len(costs) + 2, dtype=np.int64), np.empty(filled, dtype=np.int64)
                relaxation.by_kind(out[:filled], through[:filled], begin, ordered)
                for kind in np.flatnonzero(np.diff(begin[:-1])).tolist():
                    value = d + int(costs[kind])
                    if value not in waiting:
                        waiting[value] = []
                        if value != d:
                            heapq.heappush(order, value)
                    waiting[value].append(ordered[begin[kind] : begin[kind + 1]])
    return compact(distance)
