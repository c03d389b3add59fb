"""Compiled loops of the sweep.

Kernels work on one block of indices, so that limits are checked between calls. Those that push stop where the
output may not hold the successors of one more state, and say how far they came. `coding` explains indices,
`Decoder` and `Tests`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...states.successors import Ints, Words
from ...system.jit import njit
from .atomics import exchange_free, fetch_min, fetch_or, lowest_bit, prefetch
from .ranked_states import ask_for, find_slot, first_slot, number_of

PENDING = 256
"""Successors that are collected before they are looked up."""


class Decoder(NamedTuple):
    """Tables that give the packed state of an index (a namedtuple: numba takes it apart).

    The digits of an index fall into chunks, the lowest first. A packed state is the sum, modulo 2**64, of
    one row for each chunk. Then come steps, each for a variable that the others determine: a field of the sum, modulo
    the invariants' prime, tells its value, and that tells a row to be added.

    Attributes
    ----------
    radix : uint64 array, shape (chunks,)
        Values of each chunk.
    first : int64 array, shape (chunks,)
        The row of each chunk's value 0.
    rows : uint64 array, shape (rows, words)
        The words of `successors.Packing` come first.
    steps : int64 array, shape (steps, 3)
        The word and the shift of each step's field, and the row of its value 0.
    told : int32 array, shape (steps, prime)
        The value that each sum tells; 0 where no value has that sum, which is so in no reachable state.
    """

    radix: Words
    first: Ints
    rows: Words
    steps: Ints
    told: NDArray[np.int32]


class Candidates(NamedTuple):
    """The sets of moves that rows leave, and what is to be tested of them.

    Attributes
    ----------
    sets : uint64 array, shape (rows, words)
        Bit `m & 63` of word `m >> 6` tells whether the values that a row stands for allow the move `m`.
    begin : int64 array, shape (moves + 1,)
        Tests `begin[m]:begin[m + 1]` are those of move `m`.
    word : int64 array, shape (tests,)
    mask, value : uint64 arrays, shape (tests,)
        A test holds in a packed state `s` where `s[word] & mask == value`.
    """

    sets: Words
    begin: Ints
    word: Ints
    mask: Words
    value: Words


class Tests(NamedTuple):
    """The moves of a task: the candidates of each row, or a trie of tests in depth-first order; the other is empty.

    Attributes
    ----------
    candidates : Candidates
    word : int64 array, shape (tests,)
    mask, value : uint64 arrays, shape (tests,)
        A test holds in a packed state `s` where `s[word] & mask == value`.
    skip : int64 array, shape (tests,)
        The test to go on with after a failed one: the next that is not below it. If negative, a *switch* (a test that
        never holds): `jump[(s[word] >> shift & field) - skip - 1]` is the test to go on with.
    shift, field : uint64 arrays, shape (tests,)
    jump : int64 array
    first : int64 array, shape (tests + 1,)
        Moves `first[t]:first[t + 1]` can be applied where `t` and all tests above it hold.
    delta : int64 array, shape (moves,)
        What a move adds to the index, but for its lookups.
    looks : int64 array, shape (moves + 1,)
        Lookups `looks[m]:looks[m + 1]` are those of move `m`.
    lookups : int64 array, shape (lookups, 5)
        Of each: the word and the shift of a cluster's value, how many entries of the table each value has, the
        entry of value 0, and what to multiply the entry with before adding it to the index.
    table : int32 array
        By how much a cluster's value changes; `NOWHERE` where the move leads to none.
    action : int32 array, shape (moves,)
    cost : int64 array, shape (moves,)
    most : int
        No more moves than this can be applied in one state.
    """

    candidates: Candidates
    word: Ints
    mask: Words
    value: Words
    skip: Ints
    shift: Words
    field: Words
    jump: Ints
    first: Ints
    delta: Ints
    looks: Ints
    lookups: Ints
    table: NDArray[np.int32]
    action: NDArray[np.int32]
    cost: Ints
    most: int


NOWHERE = -(1 << 31)
"""In a table of changes: the move leads to no value of the cluster."""

CLUSTER = (1 << 21) - 1
"""Fields of a packed state that hold a cluster's value, or a sum that tells one, have 21 bits."""

PRIME = 8191
"""Sums that tell the value of a variable are taken modulo this prime."""


@njit(nogil=True, error_model="numpy")
def decode(decoder, index, words):
    """Write the packed state of an index into `words`."""
    rest = np.uint64(index)
    words[:] = 0
    for chunk in range(len(decoder.radix)):
        above = rest // decoder.radix[chunk]
        row = decoder.first[chunk] + np.int64(rest - above * decoder.radix[chunk])
        for w in range(len(words)):
            words[w] += decoder.rows[row, w]
        rest = above
    for step in range(len(decoder.steps)):
        total = words[decoder.steps[step, 0]] >> np.uint64(decoder.steps[step, 1]) & np.uint64(CLUSTER)
        row = decoder.steps[step, 2] + decoder.told[step, total % np.uint64(PRIME)]
        for w in range(len(words)):
            words[w] += decoder.rows[row, w]


class Cursor(NamedTuple):
    """The state of the index at hand, and what it shares with others whose upper digits are the same.

    Attributes
    ----------
    words, sets : uint64 arrays
        The packed state, and the moves that are left.
    upper_words, upper_sets : uint64 arrays
        What the upper digits contribute to them.
    upper : uint64 array, shape (1,)
        The upper digits.
    """

    words: Words
    sets: Words
    upper_words: Words
    upper_sets: Words
    upper: Words


@njit(nogil=True, error_model="numpy")
def start_cursor(tests, decoder):
    """Give a cursor, at no index."""
    width, sets = decoder.rows.shape[1], tests.candidates.sets.shape[1]
    cursor = Cursor(
        np.empty(width, dtype=np.uint64),
        np.empty(sets, dtype=np.uint64),
        np.empty(width, dtype=np.uint64),
        np.empty(sets, dtype=np.uint64),
        np.empty(1, dtype=np.uint64),
    )
    cursor.upper[0] = ~np.uint64(0)
    return cursor


@njit(nogil=True, error_model="numpy")
def applicable(tests, decoder, index, cursor, moves):
    """List the moves that can be applied in the state of an index, and leave that state in `cursor.words`."""
    words, sets = cursor.words, cursor.sets
    above = np.uint64(index) // decoder.radix[0]
    if above != cursor.upper[0]:  # blocks come in ascending order: the upper digits change seldom
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
                cursor.upper_sets[w] &= tests.candidates.sets[row, w]
            rest = higher
    row = decoder.first[0] + np.int64(np.uint64(index) - above * decoder.radix[0])
    for w in range(len(words)):
        words[w] = cursor.upper_words[w] + decoder.rows[row, w]
    for w in range(len(sets)):
        sets[w] = cursor.upper_sets[w] & tests.candidates.sets[row, w]
    for step in range(len(decoder.steps)):
        total = words[decoder.steps[step, 0]] >> np.uint64(decoder.steps[step, 1]) & np.uint64(CLUSTER)
        row = decoder.steps[step, 2] + decoder.told[step, total % np.uint64(PRIME)]
        for w in range(len(words)):
            words[w] += decoder.rows[row, w]
        for w in range(len(sets)):
            sets[w] &= tests.candidates.sets[row, w]
    count = 0
    for w in range(len(sets)):
        left = sets[w]
        while left:
            move = np.int64(w << 6) + lowest_bit(left)
            left &= left - np.uint64(1)
            holds = True
            for test in range(tests.candidates.begin[move], tests.candidates.begin[move + 1]):
                mask, value = tests.candidates.mask[test], tests.candidates.value[test]
                holds &= words[tests.candidates.word[test]] & mask == value
            if holds:
                moves[count] = move
                count += 1
    t = np.int64(0)
    while t < len(tests.word):
        word = words[tests.word[t]]
        if word & tests.mask[t] == tests.value[t]:
            for move in range(tests.first[t], tests.first[t + 1]):
                moves[count] = move
                count += 1
            t += 1
            continue
        target = tests.skip[t]
        if target < 0:
            target = tests.jump[np.int64(word >> tests.shift[t] & tests.field[t]) - target - 1]
        t = target
    return count


@njit(nogil=True, error_model="numpy")
def after(tests, words, move, index):
    """Give the index that a move leads to, negative if there is none."""
    target = index + tests.delta[move]
    for look in range(tests.looks[move], tests.looks[move + 1]):
        value = words[tests.lookups[look, 0]] >> np.uint64(tests.lookups[look, 1]) & np.uint64(CLUSTER)
        change = tests.table[tests.lookups[look, 3] + np.int64(value) * tests.lookups[look, 2]]
        if change == NOWHERE:
            return np.int64(-1)
        target += tests.lookups[look, 4] * change
    return target


@njit(nogil=True, error_model="numpy")
def decode_all(decoder, indices, states):
    """Write the packed state of each index into a row of `states`."""
    for i in range(len(indices)):
        decode(decoder, indices[i], states[i])


@njit(nogil=True, error_model="numpy")
def spread(tests, decoder, closed, block, start, out, filled):
    """Push the successors that are not closed yet, and close them.

    Several threads may work on one bitmap: which of them pushes a successor is left open, but one does. The words of
    many successors are asked for before the first is looked at, since the memory takes long to answer.

    Returns
    -------
    stop : int
        `block[start:stop]` is done.
    filled : int
        `out[:filled]` is in use.
    transitions : int
    """
    cursor, moves = start_cursor(tests, decoder), np.empty(tests.most, dtype=np.int64)
    pending = np.empty(PENDING + tests.most, dtype=np.int64)
    transitions = 0
    i = start
    while i < len(block):
        waiting, begun = 0, i
        while i < len(block) and waiting <= min(PENDING, len(out) - filled - tests.most):
            index = block[i]
            for place in range(applicable(tests, decoder, index, cursor, moves)):
                move = moves[place]
                transitions += 1
                target = after(tests, cursor.words, move, index)
                if target >= 0:
                    prefetch(closed, target >> 6)
                    pending[waiting] = target
                    waiting += 1
            i += 1
        if i == begun:
            break
        for target in pending[:waiting]:
            bit = np.uint64(1) << np.uint64(target & 63)
            if not closed[target >> 6] & bit and not fetch_or(closed, target >> 6, bit) & bit:
                out[filled] = target
                filled += 1
    return i, filled, transitions


@njit(nogil=True, error_model="numpy")
def spread_hashed(tests, decoder, block, start, keys, room, out, filled):
    """Push the successors that are not in a hash table yet, at most `room`, and put them there.

    Returns as `spread` does. Several threads may work on one table.
    """
    cursor, moves = start_cursor(tests, decoder), np.empty(tests.most, dtype=np.int64)
    pending = np.empty(PENDING + tests.most, dtype=np.int64)
    transitions = 0
    most = min(len(out), filled + room)
    i = start
    while i < len(block):
        waiting, begun = 0, i
        while i < len(block) and waiting <= min(PENDING, most - filled - tests.most):
            index = block[i]
            for place in range(applicable(tests, decoder, index, cursor, moves)):
                move = moves[place]
                transitions += 1
                target = after(tests, cursor.words, move, index)
                if target >= 0:
                    prefetch(keys, first_slot(keys, target))
                    pending[waiting] = target
                    waiting += 1
            i += 1
        if i == begun:
            break
        for target in pending[:waiting]:
            slot = find_slot(keys, target)
            while keys[slot] == -1:
                before = exchange_free(keys, slot, target)
                if before == -1:
                    out[filled] = target
                    filled += 1
                elif before != target:  # another thread took the place
                    slot = find_slot(keys, target)
    return i, filled, transitions


@njit(nogil=True, error_model="numpy")
def spread_back(tests, decoder, states, distance, d, block, start, out, filled):
    """Push the predecessors that are states and have no distance yet, and give them the distance `d`.

    Returns as `spread` does. Several threads may work on one array of distances. For sets of states without a bitmap,
    and where the memory is short of one for `spread`.
    """
    cursor, moves = start_cursor(tests, decoder), np.empty(tests.most, dtype=np.int64)
    pending = np.empty(PENDING + tests.most, dtype=np.int64)
    numbers = np.empty(len(pending), dtype=np.int64)
    transitions = 0
    i = start
    while i < len(block):
        waiting, begun = 0, i
        while i < len(block) and waiting <= min(PENDING, len(out) - filled - tests.most):
            index = block[i]
            for place in range(applicable(tests, decoder, index, cursor, moves)):
                move = moves[place]
                transitions += 1
                target = after(tests, cursor.words, move, index)
                if target >= 0:
                    ask_for(states, target)
                    pending[waiting] = target
                    waiting += 1
            i += 1
        if i == begun:
            break
        for j in range(waiting):
            numbers[j] = number_of(states, pending[j])
            if numbers[j] >= 0:
                prefetch(distance, numbers[j])
        for j in range(waiting):
            if numbers[j] >= 0 and distance[numbers[j]] > d and fetch_min(distance, numbers[j], d) > d:
                out[filled] = pending[j]
                filled += 1
    return i, filled, transitions


@njit(nogil=True, error_model="numpy")
def mark(decoder, block, masks, values, marks):
    """Write to `marks` in which states of a block a condition holds."""
    words = np.empty(decoder.rows.shape[1], dtype=np.uint64)
    for i in range(len(block)):
        decode(decoder, block[i], words)
        met = True
        for w in range(len(masks)):
            met &= words[w] & masks[w] == values[w]
        marks[i] = met


@njit(nogil=True, error_model="numpy")
def fill_transitions(tests, decoder, states, block, number, offsets, actions, targets):
    """Write the rows of the transitions of the states of a block, numbered from `number`."""
    cursor, moves = start_cursor(tests, decoder), np.empty(tests.most, dtype=np.int64)
    row = offsets[number]
    for i in range(len(block)):
        index = block[i]
        begin = row
        for place in range(applicable(tests, decoder, index, cursor, moves)):
            action = tests.action[moves[place]]
            at = row
            while at > begin and actions[at - 1] > action:
                actions[at], targets[at] = actions[at - 1], targets[at - 1]
                at -= 1
            actions[at] = action
            targets[at] = number_of(states, after(tests, cursor.words, moves[place], index))
            row += 1
        offsets[number + i + 1] = row
