"""Which moves can be applied in a state: a trie of tests, laid out flat.

Facts that many moves need are tested once, the most frequent first, and a failed test skips what is below it. Where
many values of one variable are tested, a *switch* goes to those of the value at hand.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from ..grounding.task import Fact
from ..states.successors import Ints, Packing, Words
from .candidates import NO_CANDIDATES, candidates
from .kernels.packed_successors import Trie
from .kernels.ranked_successors import Tests
from .ranking.state_ranking import Coding
from .ranking.transition_normal_form import Move

FEW = 3
"""Values of a variable that are tested one after the other; more are a switch."""


class _Trie:
    """Tests as they are laid out."""

    def __init__(self, packing: Packing) -> None:
        self.packing = packing
        self.word: list[int] = []
        self.mask: list[int] = []
        self.value: list[int] = []
        self.skip: list[int] = []
        self.shift: list[int] = []
        self.field: list[int] = []
        self.first: list[int] = []
        self.jump: list[int] = []
        self.order: list[int] = []

    def test(self, word: int, mask: int, value: int, shift: int = 0, field: int = 0) -> int:
        """Add a test; where it leads if it fails is filled in later."""
        self.first.append(len(self.order))
        for column, entry in zip(
            (self.word, self.mask, self.value, self.skip, self.shift, self.field),
            (word, mask, value, 0, shift, field),
            strict=True,
        ):
            column.append(entry)
        return len(self.word) - 1

    def build(self, group: Sequence[tuple[frozenset[Fact], int]]) -> int:
        """Add tests for the facts that are left of each move; give how many moves can apply at once."""
        self.order.extend(number for facts, number in group if not facts)
        left = {place: pair for place, pair in enumerate(group) if pair[0]}
        most: Counter[int] = Counter()  # by variable: its values exclude each other
        having: dict[Fact, list[int]] = {}
        for place, (facts, _) in left.items():
            for fact in facts:
                having.setdefault(fact, []).append(place)
        counts = {fact: len(places) for fact, places in having.items()}
        values: dict[int, list[int]] = {}
        for v, value in having:
            values.setdefault(v, []).append(value)

        def taken(fact: Fact) -> list[tuple[frozenset[Fact], int]]:
            """Take the moves out that need a fact."""
            inside = [left.pop(place) for place in having[fact] if place in left]
            for facts, _ in inside:
                for other in facts:
                    counts[other] -= 1
            return inside

        while left:
            best = max(counts, key=lambda fact: (counts[fact], -fact[0], -fact[1]))
            v = best[0]
            present = sorted(value for value in values[v] if counts[v, value])
            if len(present) <= FEW:
                most[v] = max(most[v], self.below(taken(best)))
                continue
            packing = self.packing
            field = (1 << int(packing.bits[v])) - 1
            switch = self.test(int(packing.word[v]), 0, 1, int(packing.shift[v]), field)
            begin = len(self.jump)
            self.skip[switch] = -1 - begin
            self.jump.extend([-1] * (field + 1))
            ends = []
            for value in present:
                self.jump[begin + value] = len(self.word)
                inside = [(facts - {(v, value)}, number) for facts, number in taken((v, value))]
                most[v] = max(most[v], self.below(inside))
                ends.append(self.test(0, 0, 1))  # where a value's tests end, all end
            for end in ends:
                self.skip[end] = len(self.word)
            for value in range(field + 1):
                if self.jump[begin + value] < 0:
                    self.jump[begin + value] = len(self.word)
        return sum(not facts for facts, _ in group) + most.total()

    def below(self, inside: Sequence[tuple[frozenset[Fact], int]]) -> int:
        """Test what some moves have in common, and below it what is left of each."""
        shared = frozenset.intersection(*(facts for facts, _ in inside))
        masks, values = self.packing.condition(sorted(shared))
        words = np.flatnonzero(masks) if shared else [0]
        tests = [self.test(int(w), int(masks[w]), int(values[w])) for w in words]
        most = self.build([(facts - shared, number) for facts, number in inside])
        for test in tests:
            self.skip[test] = len(self.word)
        return most

    def arrays(self) -> tuple[Ints, Words, Words, Ints, Words, Words, Ints, Ints]:
        """Give the tests as both kinds of layout begin: `word` to `first`."""
        return (
            np.array(self.word, np.int64),
            np.array(self.mask, np.uint64),
            np.array(self.value, np.uint64),
            np.array(self.skip, np.int64),
            np.array(self.shift, np.uint64),
            np.array(self.field, np.uint64),
            np.array(self.jump, np.int64),
            np.array(self.first, np.int64),
        )


def build_tests(moves: Sequence[Move], coding: Coding, costs: Sequence[int]) -> Tests:
    """Arrange moves: by sets of candidates where these are small, else by a trie. `costs` are those of the actions."""
    changes = [coding.change(move) for move in moves]
    possible = [number for number, change in enumerate(changes) if change is not None]
    trie = _Trie(coding.packing)
    chosen = candidates([moves[number] for number in possible], coding)
    if chosen is None:
        chosen = NO_CANDIDATES
        trie.test(0, 0, 0)  # it always holds
        most = trie.build([(frozenset(moves[number].facts.items()), number) for number in possible])
        trie.skip[0] = len(trie.word)
    else:
        trie.order = possible
        most = int(np.bitwise_count(chosen.sets).sum(axis=1).max(initial=1))
    trie.first.append(len(trie.order))

    # Tables of changes, one for each cluster: a row for each of its values, an entry for each kind of change.
    kinds: dict[int, dict[bytes, int]] = {}
    entries: dict[int, list[Ints]] = {}
    looks = [0]
    wanted: list[tuple[int, int]] = []
    constants: list[int] = []
    for number in trie.order:
        change = changes[number]
        assert change is not None
        constants.append(change.constant)
        for cluster, column in change.lookups:
            own = kinds.setdefault(cluster, {})
            key = column.tobytes()
            if key not in own:
                own[key] = len(own)
                entries.setdefault(cluster, []).append(column)
            wanted.append((cluster, own[key]))
        looks.append(len(wanted))
    begin: dict[int, int] = {}
    tables: list[Ints] = [np.empty(0, dtype=np.int64)]
    for cluster, columns in entries.items():
        begin[cluster] = sum(map(len, tables))
        tables.append(np.stack(columns, axis=1).reshape(-1))
    lookups = [
        (*coding.field[cluster], len(entries[cluster]), begin[cluster] + kind, int(coding.stride[cluster]))
        for cluster, kind in wanted
    ]
    ordered = [moves[number] for number in trie.order]
    return Tests(
        chosen,
        *trie.arrays(),
        np.array(constants, np.int64),
        np.array(looks, np.int64),
        np.array(lookups, np.int64).reshape(-1, 5),
        np.concatenate(tables).astype(np.int32),
        np.array([move.action for move in ordered], np.int32),
        np.array([costs[move.action] for move in ordered], np.int64),
        most,
    )


def trie_of(conditions: Sequence[frozenset[Fact]], packing: Packing) -> Trie:
    """Arrange operators by their preconditions, which do not contradict themselves."""
    return tries_of([conditions], packing)[0]


def tries_of(groups: Sequence[Sequence[frozenset[Fact]]], packing: Packing) -> tuple[Trie, Ints]:
    """Arrange several groups one after the other, numbered through; tell where each begins, and where all end."""
    trie, most, begin, number = _Trie(packing), 0, [0], 0
    for conditions in groups:
        root = trie.test(0, 0, 0)  # it always holds
        most = max(most, trie.build([(facts, number + place) for place, facts in enumerate(conditions)]))
        trie.skip[root] = len(trie.word)
        begin.append(len(trie.word))
        number += len(conditions)
    trie.first.append(len(trie.order))
    return Trie(*trie.arrays(), np.array(trie.order, np.int64), max(1, most)), np.array(begin, np.int64)
