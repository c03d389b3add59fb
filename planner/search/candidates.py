"""Which moves can be applied, by the digits of an index.

Each row of the decoder's tables stands for values of some variables, and excludes the moves that need others. The sets
of moves that rows leave, as bits, are intersected while an index is decoded. What a move needs of variables that follow
from several digits is tested afterwards. The sets take a bit for each row and move: where they do not fit a core's
cache, the tests of `trie` are used instead.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Fact
from .kernels.ranked_successors import Candidates
from .ranking.state_ranking import Coding
from .ranking.transition_normal_form import Move

LARGEST = 1 << 21
"""Bytes that the sets of moves may take."""

NO_CANDIDATES = Candidates(
    np.empty((0, 0), np.uint64),
    np.zeros(1, np.int64),
    np.empty(0, np.int64),
    np.empty(0, np.uint64),
    np.empty(0, np.uint64),
)


def candidates(moves: Sequence[Move], coding: Coding) -> Candidates | None:
    """Tabulate the sets of moves that each row of a coding's decoder leaves; None if they are too large."""
    if not moves:
        return NO_CANDIDATES
    decoder, words = coding.decoder, -(-len(moves) // 64)
    if 8 * words * len(decoder.rows) > LARGEST:
        return None
    allowed, untold = _allowed(moves, coding)
    tables = []
    for family in _families(coding):
        table = np.ones((1, len(moves)), dtype=bool)
        for number in family:  # the first digit runs fastest, as in the decoder's rows
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
    for facts in untold:
        masks, values = coding.packing.condition(facts)
        tests += [(int(word), int(masks[word]), int(values[word])) for word in np.flatnonzero(masks)]
        begin.append(len(tests))
    word, mask, value = zip(*tests, strict=True) if tests else ((), (), ())
    return Candidates(
        packed.view("<u8").astype(np.uint64),
        np.array(begin, np.int64),
        np.array(word, np.int64),
        np.array(mask, np.uint64),
        np.array(value, np.uint64),
    )


def _families(coding: Coding) -> list[list[int]]:
    """Name the clusters that each of the decoder's tables stands for: of chunks of digits, then of steps."""
    digits = iter(sorted(np.flatnonzero(coding.stride).tolist(), key=lambda number: int(coding.stride[number])))
    families = []
    for radix in coding.decoder.radix.tolist():
        family: list[int] = []
        while math.prod(len(coding.clusters[number]) for number in family) < radix:
            family.append(next(digits))
        families.append(family)
    steps = len(coding.decoder.steps)
    return [*families, *([number] for number in range(len(coding.clusters) - steps, len(coding.clusters)))]


def _allowed(moves: Sequence[Move], coding: Coding) -> tuple[list[NDArray[np.bool_]], list[list[Fact]]]:
    """Tell which values of each variable, shape (n, moves), moves allow, and which facts of each are told by none."""
    digits = {v for family in _families(coding) for number in family for v in coding.clusters[number].variables}
    needed: list[tuple[int, int, int]] = []  # variable, value, move
    excluded: list[tuple[int, int, int]] = []
    untold: list[list[Fact]] = []
    for number, move in enumerate(moves):
        untold.append([])
        for fact in move.facts.items():
            constant, terms = coding.implied.get(fact, (0, {fact: 1}))
            if fact[0] in digits or (constant == 0 and list(terms.values()) == [1]):
                needed.extend((v, value, number) for v, value in terms)
            elif constant == 1 and all(times == -1 for times in terms.values()):
                excluded.extend((v, value, number) for v, value in terms)
            else:
                untold[-1].append(fact)
    allowed = [np.ones((size, len(moves)), dtype=bool) for size in coding.sizes.tolist()]
    for v, value, number in needed:
        own = allowed[v][:, number]
        own[:value] = False
        own[value + 1 :] = False
    for v, value, number in excluded:
        allowed[v][value, number] = False
    return allowed, untold
