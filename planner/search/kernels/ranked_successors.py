"""Compiled unranking, from the rank of a state to its packed form, and the successor generator on ranks.

`state_ranking` explains ranks and `UnrankingTables`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...system.arrays import Ints, Words
from ...system.jit import njit
from .packed_successors import DecisionTree, matching
from .state_sets import lowest_bit


class UnrankingTables(NamedTuple):
    """Tables for unranking, as a named tuple, which numba supports.

    The digits of a rank are grouped into chunks, the lowest first. A packed state is the sum, modulo 2**64, of one row
    per chunk. Then follow steps, one for each variable that the others determine. A field of the sum, modulo the prime
    of the invariants, determines the variable's value, whose row is added.
    """

    radix: Words
    """Number of values of each chunk."""
    first: Ints
    """Row of value 0 of each chunk."""
    rows: Words
    """Contributions to the words; those of `Packing` are first."""
    steps: Ints
    """The word and the shift of each step's field, and the row of its value 0."""
    value_of: NDArray[np.int32]
    """Value for each step and sum; 0 for sums that belong to no value, which do not occur in reachable states."""


NOWHERE = -(1 << 31)
"""Entry of a table of changes for a move without a successor in the cluster."""


FIELDS = 3
"""Number of fields in a word of a packed state, each of which holds the value of a cluster or a sum."""


FIELD_BITS = 64 // FIELDS
FIELD_MASK = (1 << FIELD_BITS) - 1
"""The bits of a field, 21 of them, once it has been shifted down."""


PRIME = 8191
"""Prime modulus of the sums that determine variables. Larger distinguishes more values, and needs wider fields and
tables.
"""


@njit(nogil=True, error_model="numpy", inner=True)
def decode(decoder, rank, words):
    """Write the packed state of a rank into `words`."""
    rest = np.uint64(rank)
    words[:] = 0
    for chunk in range(len(decoder.radix)):
        above = rest // decoder.radix[chunk]
        row = decoder.first[chunk] + np.int64(rest - above * decoder.radix[chunk])
        for w in range(len(words)):
            words[w] += decoder.rows[row, w]
        rest = above
    for step in range(len(decoder.steps)):
        total = words[decoder.steps[step, 0]] >> np.uint64(decoder.steps[step, 1]) & np.uint64(FIELD_MASK)
        row = decoder.steps[step, 2] + decoder.value_of[step, total % np.uint64(PRIME)]
        for w in range(len(words)):
            words[w] += decoder.rows[row, w]


@njit(nogil=True, error_model="numpy")
def decode_all(decoder, ranks, states):
    """Write the packed state of each rank into a row of `states`."""
    for i in range(len(ranks)):
        decode(decoder, ranks[i], states[i])


@njit(nogil=True, error_model="numpy")
def mark(decoder, ranks, masks, values, marks):
    """Write to `marks` whether a condition holds in the state of each rank."""
    words = np.empty(decoder.rows.shape[1], dtype=np.uint64)
    for i in range(len(ranks)):
        decode(decoder, ranks[i], words)
        met = True
        for w in range(len(masks)):
            met &= words[w] & masks[w] == values[w]
        marks[i] = met


class ApplicableSets(NamedTuple):
    """The sets of moves that are compatible with each row of the unranking tables, and the remaining tests.

    A test holds in a packed state `s` where `s[word] & mask == value`.
    """

    sets: Words
    """Bit `m & 63` of word `m >> 6` of each row is set if the values of the row allow the move `m`."""
    begin: Ints
    """Tests `begin[m]:begin[m + 1]` are those of move `m`."""
    word: Ints
    mask: Words
    value: Words


class RankedOperators(NamedTuple):
    """The moves of a task, found by candidate sets or by a decision tree; the other one is empty."""

    candidates: ApplicableSets
    tree: DecisionTree
    """Its operators are the moves; `tree.most` bounds the number that apply in one state, by sets as well."""
    delta: Ints
    """Constant part of the change of the rank by each move."""
    looks: Ints
    """Lookups `looks[m]:looks[m + 1]` are those of move `m`."""
    lookups: Ints
    """Columns: the word and the shift of a cluster's value, the number of table entries per value, the entry of value
    0, and the factor of the entry in the change of the rank.
    """
    table: NDArray[np.int32]
    """Changes of clusters' values; `NOWHERE` where the move has no successor."""
    action: NDArray[np.int32]
    cost: Ints


class Cursor(NamedTuple):
    """The state of the current rank, and the part that it shares with ranks of the same upper digits."""

    words: Words
    """The packed state."""
    sets: Words
    """The set of compatible moves."""
    upper_words: Words
    upper_sets: Words
    upper: Words
    """The upper digits, in one entry; `upper_words` and `upper_sets` are their contributions."""


@njit(nogil=True, error_model="numpy", inner=True)
def start_cursor(operators, decoder):
    """Return a cursor without a rank."""
    width, sets = decoder.rows.shape[1], operators.candidates.sets.shape[1]
    cursor = Cursor(
        np.empty(width, dtype=np.uint64),
        np.empty(sets, dtype=np.uint64),
        np.empty(width, dtype=np.uint64),
        np.empty(sets, dtype=np.uint64),
        np.empty(1, dtype=np.uint64),
    )
    cursor.upper[0] = ~np.uint64(0)
    return cursor


@njit(nogil=True, error_model="numpy", inner=True)
def applicable(operators, decoder, rank, cursor, moves):
    """Write the moves that are applicable in the state of a rank; leave that state in `cursor.words`."""
    words, sets = cursor.words, cursor.sets
    above = np.uint64(rank) // decoder.radix[0]
    if above != cursor.upper[0]:  # blocks are sorted, so the upper digits change rarely
        cursor.upper[0] = above
        for w in range(len(words)):
            cursor.upper_words[w] = 0
        for w in range(len(sets)):
            cursor.upper_sets[w] = ~np.uint64(0)
        rest = above
        for chunk in range(1, len(decoder.radix)):
            higher = rest // decoder.radix[chunk]
            row = decoder.first[chunk] + np.int64(rest - higher * decoder.radix[chunk])
            for w in range(len(words)):
                cursor.upper_words[w] += decoder.rows[row, w]
            for w in range(len(sets)):
                cursor.upper_sets[w] &= operators.candidates.sets[row, w]
            rest = higher
    row = decoder.first[0] + np.int64(np.uint64(rank) - above * decoder.radix[0])
    for w in range(len(words)):
        words[w] = cursor.upper_words[w] + decoder.rows[row, w]
    for w in range(len(sets)):
        sets[w] = cursor.upper_sets[w] & operators.candidates.sets[row, w]
    for step in range(len(decoder.steps)):
        total = words[decoder.steps[step, 0]] >> np.uint64(decoder.steps[step, 1]) & np.uint64(FIELD_MASK)
        row = decoder.steps[step, 2] + decoder.value_of[step, total % np.uint64(PRIME)]
        for w in range(len(words)):
            words[w] += decoder.rows[row, w]
        for w in range(len(sets)):
            sets[w] &= operators.candidates.sets[row, w]
    count = matching(operators.tree, 0, len(operators.tree.word), words, moves)
    for w in range(len(sets)):
        left = sets[w]
        while left:
            move = np.int64(w << 6) + lowest_bit(left)
            left &= left - np.uint64(1)
            holds = True
            for test in range(operators.candidates.begin[move], operators.candidates.begin[move + 1]):
                mask, value = operators.candidates.mask[test], operators.candidates.value[test]
                holds &= words[operators.candidates.word[test]] & mask == value
            if holds:
                moves[count] = move
                count += 1
    return count


@njit(nogil=True, error_model="numpy", inner=True)
def after(operators, words, move, rank):
    """Return the rank after a move; negative if there is no successor."""
    target = rank + operators.delta[move]
    for look in range(operators.looks[move], operators.looks[move + 1]):
        value = words[operators.lookups[look, 0]] >> np.uint64(operators.lookups[look, 1]) & np.uint64(FIELD_MASK)
        change = operators.table[operators.lookups[look, 3] + np.int64(value) * operators.lookups[look, 2]]
        if change == NOWHERE:
            return np.int64(-1)
        target += operators.lookups[look, 4] * change
    return target
