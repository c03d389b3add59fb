"""Ranking of states: states as integers, on which a move is an addition.

A *rank* is a mixed-radix number whose digits belong to clusters of variables. A digit is the position of the variables'
values in the list of their possible joint values. Variables that the others determine are left out. There are two
rankings. In `StateRanking.of`, every variable is a cluster of its own. It leaves out consequences of groups of facts
of which exactly one always holds. A move then adds a constant to the rank. If this gives very many ranks,
`StateRanking.dense` is tried. It leaves out variables that any linear invariant determines (`invariants`), and
uses clusters of variables with few joint values (`variable_clusters`). A move then adds an entry of a table, which
depends on the cluster's digit.

A state is unranked by adding up table entries. Its applicable moves are found by intersecting one set per entry
(`candidates`), or by a decision tree (`trees_of`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..grounding.task import Fact, Task
from ..system.arrays import Ints, Words
from ..system.limits import Check, unchecked
from .invariants import Determined, Mutexes, determined
from .kernels.ranked_successors import FIELD_BITS, FIELDS, NOWHERE, PRIME, UnrankingTables, decode_all
from .numbering import Digits, Sum, TNFOperator
from .state_space import Packing
from .variable_clusters import Cluster, clusters


@dataclass(frozen=True)
class Change:
    """The change of a state's rank by a move."""

    constant: int
    """Change of the rank that is the same in all states."""
    lookups: tuple[tuple[int, NDArray[np.int32]], ...]
    """Clusters whose change depends on their value: the cluster's number, and the change of its digit for each of its
    values. The change is `NOWHERE` where the move has no successor.
    """


@dataclass(frozen=True)
class StateRanking:
    """A ranking of the reachable states."""

    packing: Packing
    sizes: Ints
    """Number of values of each variable."""
    clusters: tuple[Cluster, ...]
    """Clusters, which partition the variables."""
    stride: Ints
    """Factor of each cluster's digit in the rank; 0 for clusters that are left out."""
    size: int
    """Upper bound on all ranks, exclusive."""
    field: dict[int, tuple[int, int]]
    """Word and shift of the value of each cluster whose changes are looked up."""
    decoder: UnrankingTables
    families: Sequence[Sequence[int]]
    """The clusters that each table of the decoder covers: first those of its chunks, then those of its steps."""
    implied: dict[Fact, Sum]
    """Facts of variables that are left out, as sums over facts of the digits."""

    @classmethod
    def of(
        cls, task: Task, groups: Sequence[frozenset[Fact]], moves: Sequence[TNFOperator], check: Check = unchecked
    ) -> StateRanking | None:
        """Return the ranking by single variables, without those that the groups imply; None if 62 bits are too few."""
        plain = Digits.of(task, groups, moves, check)
        if plain.size >= 1 << 62:
            return None
        sizes, sums, digits = task.sizes, plain.implied, plain.variables
        packing = Packing.of(task)
        own = tuple(Cluster((v,), np.arange(n)[:, None]) for v, n in enumerate(sizes))
        constant, parts = _parts(packing, sizes, sums)
        chunks, stride = _chunks(own, digits), _strides(own, digits)
        decoder = _decoder([[parts[v] for v in chunk] for chunk in chunks], constant, [], [])
        return cls(packing, np.array(sizes, dtype=np.int64), own, stride, plain.size, {}, decoder, chunks, sums)

    @classmethod
    def dense(cls, task: Task, mutexes: Mutexes, check: Check = unchecked) -> StateRanking | None:
        """Return the ranking by clusters without the variables that invariants determine; None if there is none.

        It is a ranking for the moves in `mutexes`. There is none if 62 bits do not suffice for the ranks, or if the
        sums do not fit their fields.
        """
        sizes = task.sizes
        left_out = determined(task, mutexes.moves, check)
        implied = {d.variable for d in left_out}
        merged = clusters(mutexes, task.initial, [v for v in range(len(sizes)) if v not in implied], check=check)
        left_out, merged = _joined(left_out, merged, mutexes.first, check)
        uses = Counter(v for move in mutexes.moves for v in move.facts)
        merged.sort(key=lambda c: (sum(uses[v] for v in c.variables), c.variables))
        size = math.prod(map(len, merged))
        if size >= 1 << 62:
            return None
        own = (*merged, *clusters(mutexes, task.initial, [d.variable for d in left_out], alone=True, check=check))
        if (sum(len(c) > 1 for c in own) + 1) * PRIME >= 1 << FIELD_BITS:
            return None  # the sums that determine variables would not fit their fields
        packing = Packing.of(task)
        varying = {v for move in mutexes.moves for v in move.after}
        changed = [number for number, cluster in enumerate(own) if not varying.isdisjoint(cluster.variables)]
        sparse = [n for n in changed if len(own[n]) < math.prod(sizes[v] for v in own[n].variables)]
        field = {number: _field(packing.words, place) for place, number in enumerate(sparse)}
        digits = range(len(merged))
        chunks, stride = _chunks(own, digits), _strides(own, digits)
        decoder = _dense_decoder(packing, sizes, own, chunks, left_out, field, check)
        families = (*chunks, *([number] for number in range(len(merged), len(own))))
        return cls(packing, np.array(sizes, dtype=np.int64), own, stride, size, field, decoder, families, {})

    def change(self, move: TNFOperator) -> Change | None:
        """Return the change of the rank by a move; None if the move is never applicable."""
        constant = 0
        lookups = []
        for number in sorted({self._cluster_of[v] for v in move.after}):
            cluster = self.clusters[number]
            after = [move.after.get(v) for v in cluster.variables]
            if number not in self.field:
                # The cluster has all joint values, and the move fixes the old values, so the change is constant.
                steps = [self._step(cluster, place) for place in range(len(cluster.variables))]
                constant += int(self.stride[number]) * sum(
                    step * (value - move.facts[v])
                    for v, value, step in zip(cluster.variables, after, steps, strict=True)
                    if value is not None
                )
                continue
            holds = np.ones(len(cluster), dtype=bool)
            target = cluster.values.copy()
            for place, (v, value) in enumerate(zip(cluster.variables, after, strict=True)):
                if v in move.facts:
                    holds &= cluster.values[:, place] == move.facts[v]
                if value is not None:
                    target[:, place] = value
            found = self._places(number, target)
            changes = np.where(holds & (found >= 0), found - np.arange(len(cluster)), NOWHERE)
            possible = changes[holds]
            if not (possible > NOWHERE).any():
                return None
            if (possible == possible[0]).all():
                constant += int(self.stride[number] * possible[0])
            else:
                lookups.append((number, changes.astype(np.int32)))
        return Change(constant, tuple(lookups))

    @cached_property
    def _cluster_of(self) -> dict[int, int]:
        """Number of each variable's cluster."""
        return {v: number for number, cluster in enumerate(self.clusters) for v in cluster.variables}

    def _step(self, cluster: Cluster, place: int) -> int:
        """Return the factor of the variable at a place of a cluster in the cluster's mixed-radix digit.

        The cluster must have all joint values of its variables.
        """
        return math.prod(int(self.sizes[v]) for v in cluster.variables[place + 1 :])

    def _places(self, number: int, values: Ints) -> Ints:
        """Return the digits of a cluster for values of shape (n, variables); -1 for impossible values.

        Rows are compared as mixed-radix numbers. If these would exceed 62 bits, the leading columns are replaced by
        their position among those of the cluster. A cluster of many variables that determine each other has few rows.
        """
        cluster = self.clusters[number]
        own, wanted = np.zeros(len(cluster), dtype=np.int64), np.zeros(len(values), dtype=np.int64)
        known, span = np.ones(len(values), dtype=bool), 1
        for place, v in enumerate(cluster.variables):
            size = int(self.sizes[v])
            if span * size >= 1 << 62:
                leading = np.unique(own)
                at = np.minimum(np.searchsorted(leading, wanted), len(leading) - 1)
                known &= leading[at] == wanted
                own, wanted, span = np.searchsorted(leading, own), at, len(leading)
            own, wanted = own * size + cluster.values[:, place], wanted * size + values[:, place]
            span *= size
        at = np.minimum(np.searchsorted(own, wanted), len(own) - 1)
        return np.where(known & (own[at] == wanted), at, -1)

    def matching(self, facts: Sequence[Fact], most: int) -> Ints | None:
        """Return the ranks whose digits agree with the facts; None if there are more than `most`."""
        wanted = dict(facts)
        digits: list[Ints] = []
        for number, cluster in enumerate(self.clusters):
            if self.stride[number]:
                holds = np.ones(len(cluster), dtype=bool)
                for place, v in enumerate(cluster.variables):
                    if v in wanted:
                        holds &= cluster.values[:, place] == wanted[v]
                digits.append(np.flatnonzero(holds) * self.stride[number])
        if math.prod(map(len, digits)) > most:
            return None
        ranks = np.zeros(1, dtype=np.int64)
        for own in digits:
            ranks = np.add.outer(own, ranks).reshape(-1)
        return ranks

    def encode(self, values: ArrayLike) -> Ints:
        """Return the ranks of states with values of shape (n, variables); -1 for states without a rank."""
        encoded = 1 << 11  # states that are ranked at a time, so that intermediate arrays fit the cache
        array = np.asarray(values, dtype=np.int64).reshape(-1, len(self.sizes))
        if len(array) > encoded:
            return np.concatenate([self.encode(array[at : at + encoded]) for at in range(0, len(array), encoded)])
        legal = np.all((array >= 0) & (array < self.sizes), axis=1)
        legal_values = np.where(legal[:, None], array, 0)
        ranks = np.zeros(len(array), dtype=np.int64)
        for number, cluster in enumerate(self.clusters):
            places = self._places(number, legal_values[:, list(cluster.variables)])
            legal &= places >= 0
            ranks += np.maximum(places, 0) * self.stride[number]
        consistent = (self.decode(ranks) == np.where(legal[:, None], array, -1)).all(axis=1)
        return np.where(consistent, ranks, -1)

    def decode(self, ranks: Ints) -> Ints:
        """Return the values, shape (n, variables), of ranks, shape (n,)."""
        words = np.empty((len(ranks), self.decoder.rows.shape[1]), dtype=np.uint64)
        decode_all(self.decoder, ranks, words)
        return self.packing.unpack(words)


def _joined(
    left_out: Sequence[Determined], merged: Sequence[Cluster], first: Ints, check: Check
) -> tuple[list[Determined], list[Cluster]]:
    """Add variables that a single cluster determines to this cluster; return the other variables and all clusters."""
    whole = list(merged)
    left = []
    for own in left_out:
        check(2 * sum(cluster.values.nbytes for cluster in whole))
        weights = np.split(own.weights, first[1:-1])
        others = [v for v, w in enumerate(weights) if v != own.variable and (w != w[0]).any()]
        having = {n for n, cluster in enumerate(whole) for v in others if v in cluster.variables}
        if len(having) != 1 or not set(others) <= set(whole[min(having)].variables):
            left.append(own)
            continue
        number = min(having)
        cluster = whole[number]
        inside = {*cluster.variables, own.variable}
        rest = own.total - sum(int(w[0]) for v, w in enumerate(weights) if v not in inside)
        sums = own.weights[first[list(cluster.variables)] + cluster.values].sum(axis=1)
        value_of = np.full(PRIME, -1, dtype=np.int64)
        value_of[weights[own.variable]] = np.arange(len(weights[own.variable]))
        values = value_of[(rest - sums) % PRIME]
        rows = np.column_stack([cluster.values, values])[values >= 0]  # the others are impossible
        whole[number] = Cluster((*cluster.variables, own.variable), rows)
    return left, whole


def _strides(clusters: Sequence[Cluster], digits: Sequence[int]) -> Ints:
    """Return the factor of each cluster's digit in the rank; 0 for clusters without a digit."""
    stride = np.zeros(len(clusters), dtype=np.int64)
    step = 1
    for number in digits:
        stride[number] = step if len(clusters[number]) > 1 else 0
        step *= len(clusters[number])
    return stride


def _chunks(clusters: Sequence[Cluster], digits: Sequence[int]) -> list[list[int]]:
    """Return the digits of a rank in chunks, the lowest first. The tables of a chunk are combined into one."""
    largest = 1 << 11  # entries in one table; larger tables need fewer additions, but should fit the cache together
    chunks: list[list[int]] = [[]]
    for number in digits:
        if chunks[-1] and math.prod(len(clusters[n]) for n in (*chunks[-1], number)) > largest:
            chunks.append([])
        chunks[-1].append(number)
    return chunks


def _parts(packing: Packing, sizes: Sequence[int], sums: dict[Fact, Sum]) -> tuple[Words, dict[int, Words]]:
    """Return the constant part of packed states, and the contribution of each value of each variable."""
    parts = {v: np.zeros((sizes[v], packing.words), dtype=np.uint64) for v in range(len(sizes))}
    constant = np.zeros(packing.words, dtype=np.uint64)
    wrap = (1 << 64) - 1
    for u, size in enumerate(sizes):
        word, shift = int(packing.word[u]), int(packing.shift[u])
        for value in range(size):
            start, terms = sums.get((u, value), (0, {(u, value): 1}))
            constant[word] = (int(constant[word]) + (start * value << shift)) & wrap
            for (v, digit), times in terms.items():
                parts[v][digit, word] = (int(parts[v][digit, word]) + (times * value << shift)) & wrap
    return constant, parts


def _dense_decoder(
    packing: Packing,
    sizes: Sequence[int],
    clusters: Sequence[Cluster],
    chunks: Sequence[Sequence[int]],
    left_out: Sequence[Determined],
    field: dict[int, tuple[int, int]],
    check: Check,
) -> UnrankingTables:
    """Return the unranking tables of the dense ranking, with the sums that determine the variables left out.

    The last clusters are those of these variables, in the order of the steps.
    """
    first, digits = np.concatenate([[0], np.cumsum(sizes)]), len(clusters) - len(left_out)
    sums_from = packing.words + -(-len(field) // FIELDS)
    words = sums_from + -(-len(left_out) // FIELDS)
    in_use = 3 * 8 * words * sum(map(len, clusters)) + sum(cluster.values.nbytes for cluster in clusters)
    parts = []
    for cluster in clusters:
        check(in_use)
        part = np.zeros((len(cluster), words), dtype=np.uint64)
        for place, v in enumerate(cluster.variables):
            part[:, packing.word[v]] |= cluster.values[:, place].astype(np.uint64) << np.uint64(packing.shift[v])
        parts.append(part)
    for number, (word, shift) in field.items():
        parts[number][:, word] += np.arange(len(clusters[number]), dtype=np.uint64) << np.uint64(shift)
    constant = np.zeros(words, dtype=np.uint64)
    value_of = np.zeros((len(left_out), PRIME), dtype=np.int32)
    steps = []
    for step, own in enumerate(left_out):
        (word, shift), rest = _field(sums_from, step), own.total
        for number, cluster in enumerate(clusters):
            check(in_use)
            weights = own.weights[first[list(cluster.variables)] + cluster.values].sum(axis=1) % PRIME
            if number == digits + step:
                value_of[step, weights] = np.arange(len(cluster))
            elif number < digits + step and len(cluster) > 1:
                parts[number][:, word] += (-weights % PRIME).astype(np.uint64) << np.uint64(shift)
            else:  # a constant, which needs no room in the field: a variable of a later step has equal weights
                assert (weights == weights[0]).all()
                rest -= int(weights[0])
        constant[word] += np.uint64(rest % PRIME << shift)
        steps.append(((word, shift), parts[digits + step]))
    return _decoder([[parts[n] for n in chunk] for chunk in chunks], constant, steps, value_of)


def _field(first: int, place: int) -> tuple[int, int]:
    """Return the word and the shift of a field, where the fields begin in the word `first`."""
    return first + place // FIELDS, FIELD_BITS * (place % FIELDS)


def _decoder(
    chunks: Sequence[Sequence[Words]],
    constant: Words,
    steps: Sequence[tuple[tuple[int, int], Words]],
    value_of: ArrayLike,
) -> UnrankingTables:
    """Return the unranking tables from the parts of each chunk of digits, a constant, and the steps."""
    radix: list[int] = []
    first: list[int] = []
    tables: list[Words] = []
    for number, chunk in enumerate(chunks):
        table = constant[None] if number == 0 else np.zeros((1, len(constant)), dtype=np.uint64)
        for part in chunk:  # the first digit varies fastest
            table = (part[:, None] + table[None]).reshape(-1, len(constant))
        radix.append(len(table))
        first.append(sum(radix[:-1]))
        tables.append(table)
    at = sum(radix)
    fields = np.empty((len(steps), 3), dtype=np.int64)
    for row, ((word, shift), part) in zip(fields, steps, strict=True):
        row[:] = word, shift, at
        tables.append(part)
        at += len(part)
    return UnrankingTables(
        np.array(radix, np.uint64),
        np.array(first, np.int64),
        np.concatenate(tables),
        fields,
        np.asarray(value_of, dtype=np.int32).reshape(len(steps), PRIME),
    )
