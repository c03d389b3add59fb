"""States as numbers on which a move is an addition.

Variables that follow from the others are left out: of a group of facts of which exactly one holds for ever,
each is one minus the sum of the others. The remaining variables are the digits of a mixed-radix number, the
*index* of a state. A move adds a constant to it, and a state is decoded by adding up table entries. Which moves
can be applied in a state is found by a trie of tests, laid out flat: a failed test skips what is below it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .kernels import Decoder, Tests, decode_all
from .moves import Move
from .successors import Ints, Packing, Words
from .task import Fact, Task

CHUNK = 1 << 11
"""Most entries in one of the tables that decode an index: all of them together should fit the cache."""


@dataclass(frozen=True)
class Coding:
    """Reachable states as indices.

    Attributes
    ----------
    packing : Packing
        Of all variables into 64-bit words.
    sizes : int64 array, shape (variables,)
        Values of each variable.
    stride : int64 array, shape (variables,)
        What one more in a variable's value adds to the index; 0 for the variables left out.
    size : int
        Every index is below this.
    decoder : Decoder
    """

    packing: Packing
    sizes: Ints
    stride: Ints
    size: int
    decoder: Decoder

    @classmethod
    def of(cls, task: Task, groups: Sequence[frozenset[Fact]], moves: Sequence[Move]) -> Coding | None:
        """Find the variables that the others imply, and number the states; None if 63 bits do not do."""
        sizes = [len(variable.facts) for variable in task.variables]
        sums = _implied(sizes, groups)
        # Blocks of states come in ascending order: what is tested most often should change least often.
        uses = Counter(v for move in moves for v in move.facts)
        digits = sorted((v for v in range(len(sizes)) if (v, 0) not in sums), key=lambda v: (uses[v], v))
        size = math.prod(sizes[v] for v in digits)
        if size >= 1 << 62:
            return None
        stride = np.zeros(len(sizes), dtype=np.int64)
        packing = Packing.of(task)
        chunks: list[list[int]] = [[]]
        step = 1
        for v in digits:
            stride[v] = step
            step *= sizes[v]
            if math.prod(sizes[u] for u in (*chunks[-1], v)) > CHUNK and chunks[-1]:
                chunks.append([])
            chunks[-1].append(v)
        decoder = _decoder(packing, sizes, chunks, sums)
        return cls(packing, np.array(sizes, dtype=np.int64), stride, size, decoder)

    def delta(self, move: Move) -> int:
        """What a move adds to the index."""
        return sum(int(self.stride[v]) * (value - move.facts[v]) for v, value in move.after.items())

    def matching(self, facts: Sequence[Fact], most: int) -> Ints | None:
        """List the indices with some facts about their digits; None if there are more than `most`."""
        wanted = dict(facts)
        free = [v for v in np.flatnonzero(self.stride) if int(v) not in wanted]
        if math.prod(int(self.sizes[v]) for v in free) > most:
            return None
        index = np.array([sum(int(self.stride[v]) * value for v, value in wanted.items())], dtype=np.int64)
        for v in free:
            index = np.add.outer(np.arange(self.sizes[v]) * self.stride[v], index).reshape(-1)
        return index

    def encode(self, values: ArrayLike) -> Ints:
        """Give the indices of states with values of shape (n, variables); -1 where they fit no index."""
        array = np.asarray(values, dtype=np.int64).reshape(-1, len(self.sizes))
        legal = np.all((array >= 0) & (array < self.sizes), axis=1)
        index = np.where(legal, array @ self.stride, 0)
        consistent = (self.decode(index) == np.where(legal[:, None], array, -1)).all(axis=1)
        return np.where(consistent, index, -1)

    def decode(self, index: Ints) -> Ints:
        """Give the values, shape (n, variables), of indices, shape (n,)."""
        words = np.empty((len(index), self.packing.words), dtype=np.uint64)
        decode_all(self.decoder, index, words)
        return self.packing.unpack(words)


Sum = tuple[int, dict[Fact, int]]
"""A constant and coefficients: the number of facts that hold among some, each counted so many times."""


def _implied(sizes: Sequence[int], groups: Iterable[frozenset[Fact]]) -> dict[Fact, Sum]:
    """Choose variables to leave out, and express each of their facts by those of the remaining variables.

    A fact is 1 where it holds and 0 elsewhere. A variable takes a group for each of its values but one, so
    small variables are tried first.
    """
    sums: dict[Fact, Sum] = {}
    needed: set[int] = set()  # variables that a chosen one is expressed by
    by_fact: dict[Fact, list[frozenset[Fact]]] = {}
    for group in groups:
        variables = Counter(v for v, _ in group)
        for fact in group:
            if variables[fact[0]] == 1:
                by_fact.setdefault(fact, []).append(group)
    for variable in sorted(range(len(sizes)), key=lambda v: (sizes[v], v)):
        if variable in needed:
            continue
        own: dict[Fact, Sum] = {}
        price: dict[Fact, int] = {}  # variables that would be needed in addition
        for fact in ((variable, value) for value in range(sizes[variable])):
            for group in by_fact.get(fact, ()):
                candidate = _one_minus([sums.get(f, (0, {f: 1})) for f in group - {fact}])
                more = len({v for v, _ in candidate[1]} - needed)
                if more < price.get(fact, len(sizes)):
                    own[fact], price[fact] = candidate, more
        if len(own) < sizes[variable] - 1:
            continue
        if len(own) == sizes[variable]:  # one of them is too many
            del own[max(price, key=lambda fact: (price[fact], fact))]
        rest = next(value for value in range(sizes[variable]) if (variable, value) not in own)
        own[variable, rest] = _one_minus(list(own.values()))
        sums.update(own)
        needed.update(v for _, terms in own.values() for v, _ in terms)
    return sums


def _one_minus(sums: Sequence[Sum]) -> Sum:
    """One minus the sum of sums."""
    terms: Counter[Fact] = Counter()
    for _, own in sums:
        terms.subtract(own)
    return 1 - sum(constant for constant, _ in sums), {fact: n for fact, n in terms.items() if n}


def _decoder(packing: Packing, sizes: Sequence[int], chunks: Sequence[Sequence[int]], sums: dict[Fact, Sum]) -> Decoder:
    """Tabulate what each chunk of digits contributes to the packed state."""
    parts = {v: np.zeros((sizes[v], packing.words), dtype=np.uint64) for chunk in chunks for v in chunk}
    constant = np.zeros(packing.words, dtype=np.uint64)
    wrap = (1 << 64) - 1
    for u, size in enumerate(sizes):
        word, shift = int(packing.word[u]), int(packing.shift[u])
        for value in range(size):
            start, terms = sums.get((u, value), (0, {(u, value): 1}))
            constant[word] = (int(constant[word]) + (start * value << shift)) & wrap
            for (v, digit), times in terms.items():
                parts[v][digit, word] = (int(parts[v][digit, word]) + (times * value << shift)) & wrap
    radix: list[int] = []
    first: list[int] = []
    tables: list[Words] = []
    for number, chunk in enumerate(chunks):
        table = constant[None] if number == 0 else np.zeros((1, packing.words), dtype=np.uint64)
        for v in chunk:  # the digit of the first variable runs fastest
            table = (parts[v][:, None] + table[None]).reshape(-1, packing.words)
        radix.append(len(table))
        first.append(sum(radix[:-1]))
        tables.append(table)
    return Decoder(np.array(radix, np.uint64), np.array(first, np.int64), np.concatenate(tables))


def build_tests(moves: Sequence[Move], coding: Coding) -> Tests:
    """Arrange moves so that facts that many of them share are tested once, the most frequent first."""
    word, mask, value, skip, first = [0], [0], [0], [0], [0]  # test 0 always holds
    order: list[Move] = []

    def build(group: list[tuple[frozenset[Fact], Move]]) -> int:
        """Add tests for the facts that are left of each move; give how many moves can apply at once."""
        order.extend(move for facts, move in group if not facts)
        first.append(len(order))
        left = {number: pair for number, pair in enumerate(group) if pair[0]}
        most: Counter[int] = Counter()  # by variable: its values exclude each other
        having: dict[Fact, list[int]] = {}
        for number, (facts, _) in left.items():
            for fact in facts:
                having.setdefault(fact, []).append(number)
        counts = {fact: len(numbers) for fact, numbers in having.items()}
        while left:
            best = max(counts, key=lambda fact: (counts[fact], -fact[0], -fact[1]))
            inside = [left.pop(number) for number in having[best] if number in left]
            for facts, _ in inside:
                for fact in facts:
                    counts[fact] -= 1
            shared = frozenset.intersection(*(facts for facts, _ in inside))
            masks, values = coding.packing.condition(sorted(shared))
            added = np.flatnonzero(masks)
            start = len(word)
            for w in added:
                word.append(int(w))
                mask.append(int(masks[w]))
                value.append(int(values[w]))
            skip.extend([0] * len(added))
            first.extend([len(order)] * (len(added) - 1))
            below = build([(facts - shared, move) for facts, move in inside])
            most[best[0]] = max(most[best[0]], below)
            skip[start : start + len(added)] = [len(word)] * len(added)
        return sum(not facts for facts, _ in group) + most.total()

    most = build([(frozenset(move.facts.items()), move) for move in moves])
    skip[0] = len(word)
    return Tests(
        np.array(word, np.int64),
        np.array(mask, np.uint64),
        np.array(value, np.uint64),
        np.array(skip, np.int64),
        np.array(first, np.int64),
        np.array([coding.delta(move) for move in order], np.int64),
        np.array([move.action for move in order], np.int32),
        most,
    )
