"""Clusters: variables that together take few of the values that each can take.

A *projection* looks at some variables only. Exploring it from the initial state, with every move that changes one of
them, gives all values that they can take together, and perhaps some more: a superset that is closed under the task's
moves, which makes it a theorem. Mutexes sharpen it: what is mutex with something that a move needs outside of the
projection cannot hold where the move is applied. `clusters` merges variables as long as that lowers the product of
the numbers of values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...states.packing import Ints
from ...system.jit import njit
from ..kernels.ranked_states import find_slot
from .mutexes import Mutexes

MOST_VALUES = 1 << 16
"""Joint values of one cluster at most."""

MOST_WORK = 1 << 31
"""Moves that are tried on projected values, some five seconds' worth, before clusters stay as they are."""


@dataclass(frozen=True)
class Cluster:
    """Variables and the values that they can take together.

    Attributes
    ----------
    variables : tuple of int
    values : int64 array, shape (n, variables)
        In ascending order, the first variable first.
    """

    variables: tuple[int, ...]
    values: Ints

    def __len__(self) -> int:
        return len(self.values)

    def joined(self, variable: int, values: Ints) -> Cluster:
        """Give the cluster with one more variable, of which it tells the values, shape (n,); none where negative."""
        table = np.column_stack([self.values, values])[values >= 0]
        return Cluster((*self.variables, variable), table)


class Projections:
    """The moves of a task as arrays from which projections are cut."""

    def __init__(self, mutexes: Mutexes, initial: Sequence[int]) -> None:
        first, moves = mutexes.first, mutexes.moves
        self.sizes = np.diff(first)
        self.initial = np.asarray(initial, dtype=np.int64)
        self.work = 0  # moves that have been tried on projected values
        self.after = np.full((len(moves), len(self.sizes)), -1, dtype=np.int64)
        words = (int(self.sizes.max(initial=1)) + 63) // 64
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
            for value in range(size):
                bit = may[:, first[v] + value].astype(np.uint64) << np.uint64(value & 63)
                self.allowed[:, v, value >> 6] |= bit

    def explore(self, variables: Sequence[int], most: int) -> Ints | None:
        """Give the values that variables can take together, shape (n, variables); None if more than `most`."""
        columns = list(variables)
        touching: NDArray[np.bool_] = np.any(self.after[:, columns] >= 0, axis=1)
        after = self.after[touching][:, columns]
        allowed = self.allowed[touching][:, columns]
        # To cut the projection, and to sort its rows, in the same measure.
        self.work += 2 * len(touching) + 300 * (after.size + allowed.size)
        if len(after):
            table = np.concatenate([after.view(np.uint64), allowed.reshape(len(after), -1)], axis=1)
            order = np.lexsort(table.T)
            kept = order[np.insert((np.diff(table[order], axis=0) != 0).any(axis=1), 0, True)]
            after, allowed = after[kept], allowed[kept]
        # The first variable counts most, so that the order of the numbers is that of the values.
        factors = np.ones(len(columns), dtype=np.int64)
        factors[:-1] = np.cumprod(self.sizes[columns[:0:-1]])[::-1]
        keys = _explore(
            np.ascontiguousarray(after), np.ascontiguousarray(allowed), self.initial[columns], factors,
            self.sizes[columns], most,
        )  # fmt: skip
        self.work += len(after) * (len(keys) or most)
        if len(keys) == 0:
            return None
        return np.sort(keys)[:, None] // factors % self.sizes[columns]


def clusters(
    mutexes: Mutexes,
    initial: Sequence[int],
    variables: Sequence[int],
    *,
    alone: bool = False,
    check: Callable[[], None] = lambda: None,
) -> list[Cluster]:
    """Merge some of the variables into clusters; unless `alone`, one that is left is a cluster of its own.

    `check` is called again and again, and may raise `LimitError`.
    """
    projections = Projections(mutexes, initial)
    found: dict[int, Cluster] = {}
    for number, v in enumerate(variables):
        values = projections.explore([v], MOST_VALUES)
        assert values is not None
        found[number] = Cluster((v,), values)
    if alone:
        return list(found.values())
    number = len(found)
    linked = _links(mutexes, projections)
    gains: dict[tuple[int, int], tuple[float, Cluster | None]] = {}
    while True:
        varying = [n for n, cluster in found.items() if len(cluster) > 1]  # merging with a constant gains nothing
        for a in varying:
            for b in varying:
                if a < b and (a, b) not in gains:
                    check()
                    worthwhile = projections.work < MOST_WORK
                    gains[a, b] = _merged(projections, found[a], found[b], linked) if worthwhile else (0.0, None)
        best = max(gains, key=lambda pair: (gains[pair][0], -pair[0], -pair[1]), default=None)
        if best is None or gains[best][0] <= 0:
            break
        merged = gains[best][1]
        assert merged is not None
        gains = {pair: value for pair, value in gains.items() if not set(pair) & set(best)}
        for old in best:
            del found[old]
        found[number] = merged
        number += 1
    return list(found.values())


def _links(mutexes: Mutexes, projections: Projections) -> Ints:
    """Tell of pairs of variables, shape (variables, variables), whether they share a mutex or are changed together."""
    first = mutexes.first
    held = mutexes.together.diagonal()
    apart = ~mutexes.together & held & held[:, None]
    shared = np.add.reduceat(np.add.reduceat(apart, first[:-1], axis=0, dtype=np.int64), first[:-1], axis=1)
    changed = (projections.after >= 0).astype(np.int64)
    return shared + changed.T @ changed


def _merged(projections: Projections, a: Cluster, b: Cluster, linked: Ints) -> tuple[float, Cluster | None]:
    """Say by how much merging two clusters shrinks the product of their sizes, as a logarithm, and merge them."""
    if not linked[np.ix_(a.variables, b.variables)].any():
        return 0.0, None
    variables = tuple(sorted(a.variables + b.variables))
    if math.prod(int(projections.sizes[v]) for v in variables) >= 1 << 62:
        return 0.0, None
    product = len(a) * len(b)
    values = projections.explore(variables, min(MOST_VALUES, product - 1))
    if values is None:
        return 0.0, None
    return math.log(product / len(values)), Cluster(variables, values)


@njit()
def _explore(after, allowed, initial, factors, sizes, most):
    """List the keys (values times factors) that can be reached in a projection; none if they are more than `most`."""
    width = len(factors)
    keys = np.full(1 << 10, -1, dtype=np.int64)
    queue = np.empty(most + 1, dtype=np.int64)
    queue[0] = (initial * factors).sum()
    keys[find_slot(keys, queue[0])] = queue[0]
    values = np.empty(width, dtype=np.int64)
    seen, done = 1, 0
    while done < seen:
        key = queue[done]
        done += 1
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
            slot = find_slot(keys, target)
            if keys[slot] == target:
                continue
            if seen == most:
                return np.empty(0, dtype=np.int64)
            keys[slot] = target
            queue[seen] = target
            seen += 1
            if 2 * seen > len(keys):
                keys = np.full(2 * len(keys), -1, dtype=np.int64)
                for i in range(seen):
                    keys[find_slot(keys, queue[i])] = queue[i]
    return queue[:seen].copy()
