"""Compiled loops of the sweep.

Kernels work on one block of indices, so that limits are checked between calls. Those that push stop where the
output may not hold the successors of one more state, and say how far they came. The walk through the tests is
written out in each kernel that applies moves, since what is done with a move is its innermost loop. `coding`
explains indices, `Decoder` and `Tests`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from .successors import Ints, Words


class Decoder(NamedTuple):
    """Tables that give the packed state of an index (a namedtuple: numba takes it apart).

    The digits of an index fall into chunks, the lowest first. A packed state is the sum, modulo 2**64, of
    one row for each chunk.

    Attributes
    ----------
    radix : uint64 array, shape (chunks,)
        Values of each chunk.
    first : int64 array, shape (chunks,)
        The row of each chunk's value 0.
    rows : uint64 array, shape (rows, words)
    """

    radix: Words
    first: Ints
    rows: Words


class Tests(NamedTuple):
    """The moves of a task as a trie of tests, in depth-first order.

    Attributes
    ----------
    word : int64 array, shape (tests,)
    mask, value : uint64 arrays, shape (tests,)
        A test holds in a packed state `s` where `s[word] & mask == value`.
    skip : int64 array, shape (tests,)
        The test to go on with after a failed one: the next that is not below it.
    first : int64 array, shape (tests + 1,)
        Moves `first[t]:first[t + 1]` can be applied where `t` and all tests above it hold.
    delta : int64 array, shape (moves,)
        What a move adds to the index.
    action : int32 array, shape (moves,)
    most : int
        No more moves than this can be applied in one state.
    """

    word: Ints
    mask: Words
    value: Words
    skip: Ints
    first: Ints
    delta: Ints
    action: NDArray[np.int32]
    most: int


@intrinsic
def _fetch_and(typing: Any, array: Any, place: Any, keep: Any) -> Any:  # noqa: ARG001
    """`array[place] &= keep` as one atomic step; gives the word before."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.atomic_rmw("and", builder.gep(data, [arguments[1]]), arguments[2], "monotonic")

    return types.uint64(array, types.int64, types.uint64), code


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
def decode_all(decoder, indices, states):
    """Write the packed state of each index into a row of `states`."""
    for i in range(len(indices)):
        decode(decoder, indices[i], states[i])


@njit(cache=True, nogil=True, error_model="numpy")
def clear_bits(open_bits, indices):
    """Clear the bits of indices."""
    for i in range(len(indices)):
        open_bits[indices[i] >> 6] &= ~(np.uint64(1) << np.uint64(indices[i] & 63))


@njit(cache=True, nogil=True, error_model="numpy")
def spread(tests, decoder, block, start, open_bits, out, filled):
    """Push the successors that are still open, and close them.

    Several threads may work on one bitmap: which of them pushes a successor is left open, but one does.

    Returns
    -------
    stop : int
        `block[start:stop]` is done.
    filled : int
        `out[:filled]` is in use.
    transitions : int
    """
    words = np.empty(decoder.rows.shape[1], dtype=np.uint64)
    transitions = 0
    for i in range(start, len(block)):
        if filled + tests.most > len(out):
            return i, filled, transitions
        index = block[i]
        decode(decoder, index, words)
        t = 0
        while t < len(tests.word):
            if words[tests.word[t]] & tests.mask[t] != tests.value[t]:
                t = tests.skip[t]
                continue
            for move in range(tests.first[t], tests.first[t + 1]):
                transitions += 1
                target = index + tests.delta[move]
                bit = np.uint64(1) << np.uint64(target & 63)
                if open_bits[target >> 6] & bit and _fetch_and(open_bits, target >> 6, ~bit) & bit:
                    out[filled] = target
                    filled += 1
            t += 1
    return len(block), filled, transitions


@njit(cache=True, nogil=True, error_model="numpy")
def find_slot(keys, index):
    """Find where an index stands in a hash table, or the free place (-1) where it belongs."""
    mask = np.uint64(len(keys) - 1)
    mixed = np.uint64(index) * np.uint64(0x9E3779B97F4A7C15)  # Fibonacci hashing (Knuth, vol. 3, 6.4)
    at = (mixed ^ (mixed >> np.uint64(32))) & mask
    while keys[at] != index and keys[at] != -1:
        at = (at + np.uint64(1)) & mask
    return np.int64(at)


@njit(cache=True, nogil=True, error_model="numpy")
def insert_all(keys, indices):
    """Put distinct indices into a hash table that has room for them."""
    for i in range(len(indices)):
        keys[find_slot(keys, indices[i])] = indices[i]


@njit(cache=True, nogil=True, error_model="numpy")
def spread_hashed(tests, decoder, block, start, keys, room, out, filled):
    """Push the successors that are not in a hash table yet, at most `room`, and put them there.

    Returns as `spread` does.
    """
    words = np.empty(decoder.rows.shape[1], dtype=np.uint64)
    transitions = 0
    most = min(len(out), filled + room)
    for i in range(start, len(block)):
        if filled + tests.most > most:
            return i, filled, transitions
        index = block[i]
        decode(decoder, index, words)
        t = 0
        while t < len(tests.word):
            if words[tests.word[t]] & tests.mask[t] != tests.value[t]:
                t = tests.skip[t]
                continue
            for move in range(tests.first[t], tests.first[t + 1]):
                transitions += 1
                target = index + tests.delta[move]
                slot = find_slot(keys, target)
                if keys[slot] == -1:
                    keys[slot] = target
                    out[filled] = target
                    filled += 1
            t += 1
    return len(block), filled, transitions


class States(NamedTuple):
    """The set of reachable indices: as a bitmap, or as a sorted list and a hash table.

    Attributes
    ----------
    bits : uint64 array, shape (8 * blocks,)
        The bitmap; empty where the others are used.
    ranks : int64 array, shape (blocks + 1,)
        How many states come before each 512 bits of it.
    members : int64 array, shape (n,)
        The indices in ascending order; empty where the bitmap is used.
    keys, numbers : int64 arrays
        The hash table from an index (or -1) to its place among the members.
    """

    bits: Words
    ranks: Ints
    members: Ints
    keys: Ints
    numbers: Ints


@njit(cache=True, nogil=True, error_model="numpy")
def count_ones(word):
    """Count the bits of a word (the compiler has an instruction for this pattern)."""
    word -= (word >> np.uint64(1)) & np.uint64(0x5555555555555555)
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@njit(cache=True, nogil=True, error_model="numpy")
def fill_ranks(bits, ranks):
    """Fill in the ranks of a bitmap."""
    total = 0
    for block in range(len(ranks) - 1):
        ranks[block] = total
        for word in range(8 * block, 8 * block + 8):
            total += count_ones(bits[word])
    ranks[-1] = total


@njit(cache=True, nogil=True, error_model="numpy")
def number_of(states, index):
    """Give the number of the state with an index, or -1."""
    if len(states.bits) == 0:
        slot = find_slot(states.keys, index)
        return states.numbers[slot] if states.keys[slot] == index else np.int64(-1)
    word = index >> 6
    bit = np.uint64(1) << np.uint64(index & 63)
    if states.bits[word] & bit == 0:
        return np.int64(-1)
    number = states.ranks[word >> 3] + count_ones(states.bits[word] & (bit - np.uint64(1)))
    for before in range(word & ~7, word):
        number += count_ones(states.bits[before])
    return number


@njit(cache=True, nogil=True, error_model="numpy")
def numbers_of(states, indices, out):
    """Write the number of each index to `out`, -1 where there is no such state."""
    for i in range(len(indices)):
        out[i] = number_of(states, indices[i]) if indices[i] >= 0 else -1


@njit(cache=True, nogil=True, error_model="numpy")
def select(states, numbers, out):
    """Write the index of each numbered state to `out`."""
    for i in range(len(numbers)):
        if len(states.bits) == 0:
            out[i] = states.members[numbers[i]]
            continue
        low, high = 0, len(states.ranks) - 1  # the state is in block low or after, and before block high
        while high - low > 1:
            middle = (low + high) >> 1
            if states.ranks[middle] <= numbers[i]:
                low = middle
            else:
                high = middle
        left = numbers[i] - states.ranks[low]
        word = 8 * low
        while left >= count_ones(states.bits[word]):
            left -= count_ones(states.bits[word])
            word += 1
        rest = states.bits[word]
        for _ in range(left):
            rest &= rest - np.uint64(1)
        out[i] = 64 * word + count_ones((rest & (~rest + np.uint64(1))) - np.uint64(1))


@njit(cache=True, nogil=True, error_model="numpy")
def list_members(states, start, out):
    """Write the next indices in ascending order to `out`, beginning after a bitmap's first `start` words.

    Returns
    -------
    stop : int
        Words seen; where the states are listed, members seen.
    filled : int
    """
    filled = 0
    if len(states.bits) == 0:
        filled = min(len(out), len(states.members) - start)
        out[:filled] = states.members[start : start + filled]
        return start + filled, filled
    for word in range(start, len(states.bits)):
        rest = states.bits[word]
        if rest == 0:
            continue
        if filled + 64 > len(out):
            return word, filled
        while rest != 0:
            lowest = rest & (~rest + np.uint64(1))
            out[filled] = 64 * word + count_ones(lowest - np.uint64(1))
            filled += 1
            rest ^= lowest
    return len(states.bits), filled


@njit(cache=True, nogil=True, error_model="numpy")
def mark(decoder, block, masks, values, marks):
    """Write to `marks` in which states of a block a condition holds."""
    words = np.empty(decoder.rows.shape[1], dtype=np.uint64)
    for i in range(len(block)):
        decode(decoder, block[i], words)
        met = True
        for w in range(len(words)):
            met &= words[w] & masks[w] == values[w]
        marks[i] = met


@njit(cache=True, nogil=True, error_model="numpy")
def label(states, distance, d, block):
    """Set the distance of all states of a block."""
    for i in range(len(block)):
        distance[number_of(states, block[i])] = d


@njit(cache=True, nogil=True, error_model="numpy")
def relax(tests, decoder, states, block, start, d, through, distance, out, filled):
    """Push the predecessors whose distance falls to `through` by way of the states of distance `d`.

    Returns
    -------
    stop : int
        `block[start:stop]` is done.
    filled : int
    """
    words = np.empty(decoder.rows.shape[1], dtype=np.uint64)
    for i in range(start, len(block)):
        if filled + tests.most > len(out):
            return i, filled
        index = block[i]
        if distance[number_of(states, index)] != d:
            continue  # it has been reached on a cheaper way since it was pushed
        decode(decoder, index, words)
        t = 0
        while t < len(tests.word):
            if words[tests.word[t]] & tests.mask[t] != tests.value[t]:
                t = tests.skip[t]
                continue
            for move in range(tests.first[t], tests.first[t + 1]):
                target = index + tests.delta[move]
                number = number_of(states, target)
                if number >= 0 and through < distance[number]:
                    distance[number] = through
                    out[filled] = target
                    filled += 1
            t += 1
    return len(block), filled


@njit(cache=True, nogil=True, error_model="numpy")
def fill_transitions(tests, decoder, states, block, number, offsets, actions, targets):
    """Write the rows of the transitions of the states of a block, numbered from `number`."""
    words = np.empty(decoder.rows.shape[1], dtype=np.uint64)
    row = offsets[number]
    for i in range(len(block)):
        index = block[i]
        decode(decoder, index, words)
        begin = row
        t = 0
        while t < len(tests.word):
            if words[tests.word[t]] & tests.mask[t] != tests.value[t]:
                t = tests.skip[t]
                continue
            for move in range(tests.first[t], tests.first[t + 1]):
                action = tests.action[move]
                at = row
                while at > begin and actions[at - 1] > action:
                    actions[at], targets[at] = actions[at - 1], targets[at - 1]
                    at -= 1
                actions[at] = action
                targets[at] = number_of(states, index + tests.delta[move])
                row += 1
            t += 1
        offsets[number + i + 1] = row
