"""Clusters: sets of variables with few possible joint values.

A *projection* considers some variables only. It is explored from the initial state, with every move that changes one of
them. The result contains all their joint values in reachable states, and possibly more. Proof: it contains those of the
initial state and is closed under the projected moves. Mutexes reduce it: a value cannot hold where a move is applied if
it is mutex with a fact that the move needs outside of the projection. `clusters` merges variables as long as this
reduces the product of the numbers of joint values.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, count

import numpy as np
from numpy.typing import NDArray

from ..system.arrays import Ints, Words
from ..system.jit import njit
from ..system.limits import Check, unchecked
from .invariants import Mutexes
from .kernels.state_sets import entry_of, fill_slots, find, hash_of

MOST_VALUES = 1 << 16
"""Largest number of joint values of a cluster. Larger gives fewer ranks, but larger tables."""

STEPS_PER_CHECK = 1 << 24
"""Comparisons of values between two checks of the limits."""


@dataclass(frozen=True)
class Cluster:
    """Variables and their possible joint values."""

    variables: tuple[int, ...]
    values: Ints
    """Joint values in lexicographic order, shape (n, variables)."""

    def __len__(self) -> int:
        return len(self.values)


class Projections:
    """The moves of a task as arrays, from which projections are extracted."""

    def __init__(self, mutexes: Mutexes, initial: Sequence[int], check: Check) -> None:
        first, moves = mutexes.first, mutexes.moves
        self.sizes = np.diff(first)
        self.initial = np.asarray(initial, dtype=np.int64)
        self.work = 0  # moves that were applied to projected values
        words = (int(self.sizes.max(initial=1)) + 63) // 64
        self.in_use = 8 * len(moves) * len(self.sizes) * (1 + words) + 2 * mutexes.barred.size
        self.check = check
        check(self.in_use)
        self.after = np.full((len(moves), len(self.sizes)), -1, dtype=np.int64)
        # Bit `value` of `allowed[move, variable]`: whether the variable may have the value where the move is applied.
        self.allowed = np.zeros((len(moves), len(self.sizes), words), dtype=np.uint64)
        may = ~mutexes.barred & mutexes.together.diagonal()
        for m, move in enumerate(moves):
            for v, value in move.after.items():
                self.after[m, v] = value
            for v, value in move.facts.items():
                own = may[m, first[v] : first[v + 1]]
                own[:] = np.arange(len(own)) == value
        for v, size in enumerate(self.sizes):
            check(self.in_use)
            for value in range(size):
                bit = may[:, first[v] + value].astype(np.uint64) << np.uint64(value & 63)
                self.allowed[:, v, value >> 6] |= bit

    def explore(self, variables: Sequence[int], most: int) -> Ints | None:
        """Return the joint values of variables, shape (n, variables); None if there are more than `most`."""
        columns = list(variables)
        touching: NDArray[np.bool_] = np.any(self.after[:, columns] >= 0, axis=1)
        after = self.after[touching][:, columns]
        allowed = self.allowed[touching][:, columns]
        self.check(self.in_use + 3 * (after.nbytes + allowed.nbytes))
        # The work of extracting the projection and of sorting its rows, in the same unit.
        self.work += 2 * len(touching) + 300 * (after.size + allowed.size)
        if len(after):
            table = np.concatenate([after.view(np.uint64), allowed.reshape(len(after), -1)], axis=1)
            order = np.lexsort(table.T)
            kept = order[np.insert((np.diff(table[order], axis=0) != 0).any(axis=1), 0, True)]
            after, allowed = after[kept], allowed[kept]
        # The first variable is the most significant, so that keys are ordered like values.
        factors = np.ones(len(columns), dtype=np.int64)
        factors[:-1] = np.cumprod(self.sizes[columns[:0:-1]])[::-1]
        keys = self._explored(np.ascontiguousarray(after), np.ascontiguousarray(allowed), columns, factors, most)
        self.work += len(after) * (len(keys) or most)
        if len(keys) == 0:
            return None
        self.check(self.in_use + 8 * len(keys) * (4 + 2 * len(columns)))
        return np.sort(keys)[:, None] // factors % self.sizes[columns]

    def _explored(self, after: Ints, allowed: Words, columns: list[int], factors: Ints, most: int) -> Ints:
        """Return the reachable keys (values times factors) of a projection; empty if there are more than `most`."""
        sizes = self.sizes[columns]
        slots, queue = np.zeros(1 << 10, dtype=np.uint64), np.empty((1 << 9, 1), dtype=np.uint64)
        queue[0] = self.initial[columns] @ factors
        fill_slots(slots, queue, 1)
        done, seen = 0, 1
        step = STEPS_PER_CHECK // (after.size + 1) + 1
        while done < seen:
            if seen == len(queue):
                slots = np.zeros(2 * len(slots), dtype=np.uint64)
                fill_slots(slots, queue, seen)
                queue = np.concatenate([queue, np.empty_like(queue)])
            self.check(self.in_use + 2 * (after.nbytes + allowed.nbytes) + 2 * (slots.nbytes + queue.nbytes))
            stop = min(seen, done + step)
            done, seen = _explore(after, allowed, factors, sizes, slots, queue, done, stop, seen, most)
            if seen > most:
                return np.empty(0, dtype=np.int64)
        return queue[:seen, 0].astype(np.int64)


def clusters(
    mutexes: Mutexes,
    initial: Sequence[int],
    variables: Sequence[int],
    *,
    alone: bool = False,
    check: Check = unchecked,
) -> list[Cluster]:
    """Return the variables merged into clusters; with `alone`, each variable is a cluster of its own.

    `check` is called with the bytes of the moves and of the explored values.
    """
    # Limit on the moves that are applied to projected values, about five seconds of work. Then clusters are no longer
    # merged.
    most_work = 1 << 31
    projections = Projections(mutexes, initial, check)
    found: dict[int, Cluster] = {}
    for number, v in enumerate(variables):
        values = projections.explore([v], MOST_VALUES)
        assert values is not None
        found[number] = Cluster((v,), values)
    if alone:
        return list(found.values())
    linked = _links(mutexes, projections)
    gains: dict[tuple[int, int], float] = {}
    varying = [n for n, cluster in found.items() if len(cluster) > 1]  # merging with a constant gains nothing
    pairs = list(combinations(varying, 2))
    for number in count(len(found)):
        for a, b in pairs:
            worthwhile = projections.work < most_work and linked[np.ix_(found[a].variables, found[b].variables)].any()
            merged = _merged(projections, found[a], found[b]) if worthwhile else None
            if merged is not None:
                gains[a, b] = math.log(len(found[a]) * len(found[b]) / len(merged))
        if not gains:
            break
        best = max(gains, key=lambda pair: (gains[pair], -pair[0], -pair[1]))
        gains = {pair: gain for pair, gain in gains.items() if not set(pair) & set(best)}
        # It is explored again, since storing the values of all pairs would take much memory.
        merged = _merged(projections, found.pop(best[0]), found.pop(best[1]))
        assert merged is not None
        found[number] = merged
        projections.in_use += merged.values.nbytes
        varying = [n for n in varying if n in found]
        pairs = [(other, number) for other in varying if len(merged) > 1]
        varying += [number] * (len(merged) > 1)
    return list(found.values())


def _links(mutexes: Mutexes, projections: Projections) -> NDArray[np.bool_]:
    """Return whether pairs of variables, shape (variables, variables), share a mutex or are changed together."""
    first = mutexes.first
    projections.check(projections.in_use + 3 * mutexes.together.nbytes)
    held = mutexes.together.diagonal()
    apart = ~mutexes.together & held & held[:, None]
    linked = np.logical_or.reduceat(np.logical_or.reduceat(apart, first[:-1], axis=0), first[:-1], axis=1)
    for changed in projections.after >= 0:
        at = np.flatnonzero(changed)
        linked[np.ix_(at, at)] = True
    return linked


def _merged(projections: Projections, a: Cluster, b: Cluster) -> Cluster | None:
    """Return two clusters merged; None if there are too many joint values, or no fewer than in their product."""
    variables = tuple(sorted(a.variables + b.variables))
    if math.prod(int(projections.sizes[v]) for v in variables) >= 1 << 62:
        return None
    values = projections.explore(variables, min(MOST_VALUES, len(a) * len(b) - 1))
    return None if values is None else Cluster(variables, values)


@njit(nogil=True)
def _explore(after, allowed, factors, sizes, slots, queue, begin, stop, seen, most):
    """Append the successors of `queue[begin:stop]` to the queue, which has `seen` entries, and to the hash table.

    Return the number of expanded entries, less than `stop` if the queue is full, and the number of all entries:
    `most + 1` if there are more than `most`.
    """
    width = len(factors)
    values, new = np.empty(width, dtype=np.int64), np.empty(1, dtype=np.uint64)
    for done in range(begin, stop):
        key = np.int64(queue[done, 0])
        for j in range(width):
            values[j] = key // factors[j] % sizes[j]
        for m in range(len(after)):
            target = key
            for j in range(width):
                if allowed[m, j, values[j] >> 6] >> np.uint64(values[j] & 63) & np.uint64(1) == 0:
                    target = -1
                    break
                if after[m, j] >= 0:
                    target += (after[m, j] - values[j]) * factors[j]
            if target < 0:
                continue
            new[0] = target
            mixed = hash_of(new)
            slot = find(slots, queue, new, mixed)
            if slots[slot] != 0:
                continue
            if seen == most:
                return done, most + 1
            if seen == len(queue):
                return done, seen
            slots[slot] = entry_of(mixed, seen)
            queue[seen, 0] = target
            seen += 1
    return stop, seen
