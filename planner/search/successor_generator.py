"""The successor generator: a decision tree of tests that finds the applicable operators, laid out as arrays.

Facts that many operators need are tested once, the most frequent first. A failed test skips the tests below it. Where
many values of one variable are tested, a *switch* branches on the variable's value. Without switches, sweeps of most
tasks take up to 1.35 times as long, even of those that need no tree: the compiled loops around it change.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Fact, Task
from ..system.arrays import Ints, Words
from ..system.limits import Check, unchecked
from .kernels import packed_successors
from .kernels.packed_successors import DecisionTree, PackedOperators, Rules
from .kernels.ranked_successors import ApplicableSets, RankedOperators
from .numbering import TNFOperator
from .state_ranking import StateRanking
from .state_space import Packing, Rule, axiom_stages, grouped, possible_operators


class _DecisionTreeBuilder:
    """Builder of the arrays of a decision tree."""

    def __init__(self, packing: Packing, check: Check) -> None:
        self.packing, self.check = packing, check
        self.tests: list[list[int]] = []  # columns: word, mask, value, skip, shift, field, and operators before
        self.jump: list[int] = []
        self.order: list[int] = []

    def test(self, word: int, mask: int, value: int, shift: int = 0, field: int = 0) -> int:
        """Append a test, and return its position. The target of a failed test is set later."""
        self.tests.append([word, mask, value, 0, shift, field, len(self.order)])
        return len(self.tests) - 1

    def skip_from(self, tests: Sequence[int]) -> None:
        """Set where the given tests continue if they fail: after the last test that has been appended so far."""
        for test in tests:
            self.tests[test][3] = len(self.tests)

    def root(self, group: Sequence[tuple[frozenset[Fact], int]]) -> int:
        """Append the tests of a whole group. Return a bound on the operators that apply at once."""
        always = self.test(0, 0, 0)
        most = self.build(group)
        self.skip_from([always])
        return most

    def build(self, group: Sequence[tuple[frozenset[Fact], int]]) -> int:
        """Append tests for the remaining facts of each operator. Return a bound on the operators that apply at once."""
        self.order.extend(number for facts, number in group if not facts)
        left = {place: pair for place, pair in enumerate(group) if pair[0]}
        most: Counter[int] = Counter()  # by variable, since its values exclude each other
        having: dict[Fact, list[int]] = {}
        for place, (facts, _) in left.items():
            for fact in facts:
                having.setdefault(fact, []).append(place)
        counts = {fact: len(places) for fact, places in having.items()}
        values: dict[int, list[int]] = {}
        for v, value in having:
            values.setdefault(v, []).append(value)

        def taken(fact: Fact) -> list[tuple[frozenset[Fact], int]]:
            """Remove and return the operators that need a fact."""
            inside = [left.pop(place) for place in having[fact] if place in left]
            for facts, _ in inside:
                for other in facts:
                    counts[other] -= 1
            return inside

        while left:
            self.check(0)
            best = max(counts, key=lambda fact: (counts[fact], -fact[0], -fact[1]))
            v = best[0]
            present = sorted(value for value in values[v] if counts[v, value])
            if len(present) <= 3:  # for more values, a switch is faster than a test of each
                most[v] = max(most[v], self.below(taken(best)))
                continue
            packing = self.packing
            field = (1 << int(packing.bits[v])) - 1
            switch = self.test(int(packing.word[v]), 0, 1, int(packing.shift[v]), field)
            begin = len(self.jump)
            self.tests[switch][3] = -1 - begin
            self.jump.extend([-1] * (field + 1))
            ends = []
            for value in present:
                self.jump[begin + value] = len(self.tests)
                inside = [(facts - {(v, value)}, number) for facts, number in taken((v, value))]
                most[v] = max(most[v], self.below(inside))
                ends.append(self.test(0, 0, 1))  # the tests of one value end by leaving the switch
            self.skip_from(ends)
            for value in range(field + 1):
                if self.jump[begin + value] < 0:
                    self.jump[begin + value] = len(self.tests)
        return sum(not facts for facts, _ in group) + most.total()

    def below(self, inside: Sequence[tuple[frozenset[Fact], int]]) -> int:
        """Append a test of the common facts of some operators, and below it the tests of their other facts."""
        shared = frozenset.intersection(*(facts for facts, _ in inside))
        masks, values = self.packing.condition(sorted(shared))
        words = np.flatnonzero(masks) if shared else [0]
        tests = [self.test(int(w), int(masks[w]), int(values[w])) for w in words]
        most = self.build([(facts - shared, number) for facts, number in inside])
        self.skip_from(tests)
        return most

    def tree(self, operators: Ints, most: int) -> DecisionTree:
        """Return the tree of all tests, whose rows are the given operators."""
        types: Any = (np.int64, np.uint64, np.uint64, np.int64, np.uint64, np.uint64, np.int64)
        rows: Any = zip(*self.tests, [0] * 6 + [len(self.order)], strict=True)
        *tests, first = (np.array(column, kind) for column, kind in zip(rows, types, strict=True))
        word, mask, value, skip, shift, field = (column[:-1] for column in tests)
        jump = np.array(self.jump, np.int64)
        return DecisionTree(word, mask, value, skip, shift, field, jump, first, operators, most)


class _ChangeTables:
    """Tables of the changes of ranks: for each cluster, a row per value and a column per distinct change."""

    def __init__(self, coding: StateRanking, check: Check) -> None:
        self.coding, self.check = coding, check
        self.columns: dict[int, dict[bytes, tuple[int, NDArray[np.int32]]]] = {}  # numbered, by cluster and hash
        self.size = 0

    def add(self, move: TNFOperator) -> tuple[int, list[tuple[int, int]]] | None:
        """Return the constant change of a move, and cluster and column of each lookup; None if it never applies."""
        self.check(8 * self.size)
        change = self.coding.change(move)
        if change is None:
            return None
        wanted = []
        for cluster, column in change.lookups:
            known = self.columns.setdefault(cluster, {})
            key = hashlib.blake2b(column.data, digest_size=16).digest()
            if key not in known:
                known[key] = len(known), column
                self.size += len(column)
            wanted.append((cluster, known[key][0]))
        return change.constant, wanted

    def laid_out(self) -> tuple[NDArray[np.int32], dict[int, int]]:
        """Return the concatenated tables, and the offset of each cluster's table."""
        self.check(8 * self.size)
        table, begin, at = np.empty(self.size, dtype=np.int32), {}, 0
        for cluster, known in self.columns.items():
            columns = [column for _, column in known.values()]
            begin[cluster] = at
            at += len(columns) * len(columns[0])
            np.stack(columns, axis=1, out=table[begin[cluster] : at].reshape(-1, len(columns)))
        return table, begin


def ranked_operators(
    moves: Sequence[TNFOperator], coding: StateRanking, costs: Sequence[int], check: Check = unchecked
) -> RankedOperators:
    """Return the layout of moves. They are found by sets of candidates if these are small, else by a decision tree.

    With the tree alone, the sweep of `kitting/ladder-4x8` or `depot/six-items` takes 1.2 to 1.35 times as long.

    `costs` are the costs of the actions.
    """
    tables = _ChangeTables(coding, check)
    changes = [tables.add(move) for move in moves]
    possible = [number for number, change in enumerate(changes) if change is not None]
    table, begin = tables.laid_out()
    builder = _DecisionTreeBuilder(coding.packing, lambda needed: check(table.nbytes + needed))
    chosen = candidates([moves[number] for number in possible], coding, builder.check)
    if chosen is None:
        chosen = NO_CANDIDATES
        most = builder.root([(frozenset(moves[number].facts.items()), number) for number in possible])
    else:
        builder.order = possible
        most = int(np.bitwise_count(chosen.sets).sum(axis=1).max(initial=1))
    looks = [0]
    wanted: list[tuple[int, int]] = []
    constants: list[int] = []
    for number in builder.order:
        change = changes[number]
        assert change is not None
        constants.append(change[0])
        wanted += change[1]
        looks.append(len(wanted))
    lookups = [
        (*coding.field[cluster], len(tables.columns[cluster]), begin[cluster] + kind, int(coding.stride[cluster]))
        for cluster, kind in wanted
    ]
    ordered = [moves[number] for number in builder.order]
    return RankedOperators(
        chosen,
        builder.tree(np.arange(len(builder.order)), most),
        np.array(constants, np.int64),
        np.array(looks, np.int64),
        np.array(lookups, np.int64).reshape(-1, 5),
        table,
        np.array([move.action for move in ordered], np.int32),
        np.array([costs[move.action] for move in ordered], np.int64),
    )


def trees_of(
    groups: Sequence[Sequence[frozenset[Fact]]], packing: Packing, check: Check = unchecked
) -> tuple[DecisionTree, Ints]:
    """Return the decision trees of several groups, concatenated and numbered consecutively, and where each begins.

    A group is the consistent preconditions of some operators.
    """
    builder, most, begin, number = _DecisionTreeBuilder(packing, check), 0, [0], 0
    for conditions in groups:
        most = max(most, builder.root([(facts, number + place) for place, facts in enumerate(conditions)]))
        begin.append(len(builder.tests))
        number += len(conditions)
    return builder.tree(np.array(builder.order, np.int64), max(1, most)), np.array(begin, np.int64)


TRANSITIONS_AT_A_TIME = 1 << 15
"""Approximate number of transitions of a block that is expanded at once. It bounds the memory of a block."""


Expanded = tuple[NDArray[np.int32], NDArray[np.int32], Words]
"""Number of actions of each state, the actions, and the packed successors."""


def packed_operators(task: Task, packing: Packing, check: Check = unchecked) -> PackedOperators:
    """Return the transition function of a task in the layout of the compiled code."""
    # Estimated bytes per rule (a condition and its effects) during construction, besides its words. Used to check
    # memory.
    bytes_per_rule = 500
    rules = len(task.axioms) + sum(1 + len({effect.conditions for effect in o.effects}) for o in task.operators)
    in_use = (bytes_per_rule + 32 * packing.words) * rules
    check(in_use)

    def still(_needed: float) -> None:
        check(in_use)

    order = possible_operators(task)
    conditions = [frozenset(task.operators[number].preconditions) for number in order]
    stages = list(axiom_stages(task, packing))
    return PackedOperators(
        trees_of([conditions], packing, still)[0],
        np.array([task.operators[number].action for number in order], dtype=np.int64),
        _rules([grouped(task.operators[n].effects, packing) for n in order], packing, still),
        _rules([rules for rules, _ in stages], packing, still),
        np.array([again for _, again in stages], dtype=bool),
    )


def _rules(groups: Sequence[Sequence[Rule]], packing: Packing, check: Check) -> Rules:
    """Return the layout of rules, group by group."""
    writes = [0]
    written: list[tuple[int, int, int]] = []
    for group in groups:
        check(0)
        for _, (_, _, cleared, assigned) in group:
            written += [(int(w), int(~cleared[w]), int(assigned[w])) for w in np.flatnonzero(cleared)]
            writes.append(len(written))
    tree, begin = trees_of([[frozenset(facts) for facts, _ in group] for group in groups], packing, check)
    return Rules(tree, begin, np.array(writes), *_columns(written))


def _columns(rows: Sequence[tuple[int, int, int]]) -> tuple[Ints, Words, Words]:
    """Return the columns of rows that consist of a word's number and two words."""
    number, first, second = zip(*rows, strict=True) if rows else ((), (), ())
    return np.array(number, np.int64), np.array(first, np.uint64), np.array(second, np.uint64)


def expanded(operators: PackedOperators, states: Words) -> Iterator[Expanded]:
    """Expand states, shape (n, words): yield the numbers of their actions, the actions and the successors, in parts."""
    stop = 0
    room = TRANSITIONS_AT_A_TIME + operators.tree.most
    while stop < len(states):
        counts = np.empty(len(states) - stop, dtype=np.int32)
        actions, after = np.empty(room, dtype=np.int32), np.empty((room, states.shape[1]), dtype=np.uint64)
        start = stop
        stop, filled = packed_successors.expand(operators, states, start, counts, actions, after)
        yield counts[: stop - start], actions[:filled], after[:filled]


NO_CANDIDATES = ApplicableSets(np.empty((0, 0), np.uint64), np.zeros(1, np.int64), *_columns([]))


def candidates(
    moves: Sequence[TNFOperator], coding: StateRanking, check: Check = unchecked, *, max_bytes: int = 2 << 20
) -> ApplicableSets | None:
    """Return the sets of moves that are compatible with each row of the unranking tables; None above `max_bytes`."""
    if not moves:
        return NO_CANDIDATES
    decoder, words = coding.decoder, -(-len(moves) // 64)
    if 8 * words * len(decoder.rows) > max_bytes:
        return None
    check(len(moves) * (2 * len(decoder.rows) + int(coding.sizes.sum())))
    allowed, uncovered = _allowed(moves, coding)
    tables = []
    for family in coding.families:
        table = np.ones((1, len(moves)), dtype=bool)
        for number in family:  # the first digit varies fastest, as in the decoder's rows
            cluster = coding.clusters[number]
            own = np.ones((len(cluster), len(moves)), dtype=bool)
            for v, values in zip(cluster.variables, cluster.values.T, strict=True):
                own &= allowed[v][values]
            table = (own[:, None] & table[None]).reshape(-1, len(moves))
        tables.append(table)
    sets = np.concatenate(tables)
    assert len(sets) == len(decoder.rows)
    packed = np.packbits(np.pad(sets, ((0, 0), (0, 64 * words - len(moves)))), axis=1, bitorder="little")
    tests: list[tuple[int, int, int]] = []
    begin = [0]
    for facts in uncovered:
        masks, values = coding.packing.condition(facts)
        tests += [(int(word), int(masks[word]), int(values[word])) for word in np.flatnonzero(masks)]
        begin.append(len(tests))
    return ApplicableSets(packed.view("<u8").astype(np.uint64), np.array(begin, np.int64), *_columns(tests))


def _allowed(moves: Sequence[TNFOperator], coding: StateRanking) -> tuple[list[NDArray[np.bool_]], list[list[Fact]]]:
    """Return the values of each variable, shape (n, moves), that moves allow, and the facts that these do not cover."""
    digits = {v for family in coding.families for number in family for v in coding.clusters[number].variables}
    needed: list[tuple[int, int, int]] = []  # variable, value, move
    excluded: list[tuple[int, int, int]] = []
    uncovered: list[list[Fact]] = []
    for number, move in enumerate(moves):
        uncovered.append([])
        for fact in move.facts.items():
            constant, terms = coding.implied.get(fact, (0, {fact: 1}))
            if fact[0] in digits or (constant == 0 and list(terms.values()) == [1]):
                needed.extend((v, value, number) for v, value in terms)
            elif constant == 1 and all(times == -1 for times in terms.values()):
                excluded.extend((v, value, number) for v, value in terms)
            else:
                uncovered[-1].append(fact)
    allowed = [np.ones((size, len(moves)), dtype=bool) for size in coding.sizes.tolist()]
    for v, value, number in needed:
        own = allowed[v][:, number]
        own[:value] = False
        own[value + 1 :] = False
    for v, value, number in excluded:
        allowed[v][value, number] = False
    return allowed, uncovered
