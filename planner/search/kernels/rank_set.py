"""Compiled set of reachable ranks, as a bitmap, and the number of each state.

The number of a state is the position of its rank among the ranks of all reachable states.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ...states.packing import Ints, Words
from ...system.jit import njit
from .atomics import fetch_or, lowest_bit, prefetch


class RankSet(NamedTuple):
    """The set of reachable ranks: a bitmap in blocks of 512 bits, and in pages of 128 blocks."""

    bits: Words
    before: Ints
    """Number of states before each page; the last entry is the number of all states."""
    within: npt.NDArray[np.uint16]
    """Number of states before each block in its page; undefined in pages without states."""


@njit(nogil=True, error_model="numpy")
def count_ones(word):
    """Return the number of set bits of a word (compilers have an instruction for this pattern)."""
    word -= (word >> np.uint64(1)) & np.uint64(0x5555555555555555)
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@njit(nogil=True, error_model="numpy")
def count_states(bits, before, within):
    """Compute `before` and `within` of a bitmap."""
    total = 0
    for page in range(len(before) - 1):
        before[page] = total
        first, end = page << 7, min(len(within), (page + 1) << 7)
        any_bits = np.uint64(0)
        for word in range(8 * first, 8 * end):
            any_bits |= bits[word]
        if any_bits == 0:
            continue  # `within` stays untouched, so that it takes no memory where there are no states
        for block in range(first, end):
            within[block] = total - before[page]
            for word in range(8 * block, 8 * block + 8):
                total += count_ones(bits[word])
    before[-1] = total


@njit(nogil=True, error_model="numpy")
def ask_for(states, rank):
    """Prefetch the memory that `number_of` reads for a rank."""
    prefetch(states.bits, rank >> 6)
    prefetch(states.within, rank >> 9)


@njit(nogil=True, error_model="numpy")
def number_of(states, rank):
    """Return the number of the state with a rank; -1 if there is none."""
    word = rank >> 6
    bit = np.uint64(1) << np.uint64(rank & 63)
    if states.bits[word] & bit == 0:
        return np.int64(-1)
    number = states.before[word >> 10] + np.int64(states.within[word >> 3])
    number += count_ones(states.bits[word] & (bit - np.uint64(1)))
    for earlier in range(word & ~7, word):
        number += count_ones(states.bits[earlier])
    return number


@njit(nogil=True, error_model="numpy")
def numbers_of(states, ranks, out):
    """Write the number of each rank to `out`; -1 where there is no such state."""
    for i in range(len(ranks)):
        out[i] = number_of(states, ranks[i]) if ranks[i] >= 0 else -1


@njit(nogil=True, error_model="numpy")
def select(states, numbers, out):
    """Write the rank of each numbered state to `out`."""
    for i in range(len(numbers)):
        low, high = 0, len(states.before) - 1  # the state is in page low or after, and before page high
        while high - low > 1:
            middle = (low + high) >> 1
            if states.before[middle] <= numbers[i]:
                low = middle
            else:
                high = middle
        left = numbers[i] - states.before[low]
        low, high = low << 7, min(len(states.within), (low + 1) << 7)  # the same for blocks
        while high - low > 1:
            middle = (low + high) >> 1
            if states.within[middle] <= left:
                low = middle
            else:
                high = middle
        left -= np.int64(states.within[low])
        word = 8 * low
        while left >= count_ones(states.bits[word]):
            left -= count_ones(states.bits[word])
            word += 1
        rest = states.bits[word]
        for _ in range(left):
            rest &= rest - np.uint64(1)
        out[i] = 64 * word + lowest_bit(rest)


@njit(nogil=True, error_model="numpy")
def list_members(states, start, out):
    """Write the next ranks in ascending order to `out`, from the word `start` of the bitmap on.

    Return the number of words that have been processed, and that of the ranks.
    """
    filled, word = 0, start
    while word < len(states.bits):
        if word & 1023 == 0 and states.before[word >> 10] == states.before[(word >> 10) + 1]:
            word += 1024  # a page without states
            continue
        rest = states.bits[word]
        if rest != 0 and filled + 64 > len(out):
            return word, filled
        while rest != 0:
            out[filled] = 64 * word + lowest_bit(rest)
            filled += 1
            rest &= rest - np.uint64(1)
        word += 1
    return len(states.bits), filled


@njit(nogil=True, error_model="numpy")
def label(states, distance, d, block):
    """Set the distance of all states of a block to `d`."""
    ahead = 16  # distance in entries between prefetching an entry and using it
    for i in range(len(block)):
        if i + ahead < len(block):
            ask_for(states, block[i + ahead])
        distance[number_of(states, block[i])] = d


@njit(nogil=True, error_model="numpy")
def close(states, distance, unreached, closed):
    """Fill a bitmap of the ranks that no search needs to visit: those of no state, or of a state with a distance."""
    number = 0
    for word in range(len(states.bits)):
        rest = states.bits[word]
        left = ~rest
        while rest != 0:
            lowest = rest & (~rest + np.uint64(1))
            if distance[number] != unreached:
                left |= lowest
            number += 1
            rest ^= lowest
        closed[word] = left


@njit(nogil=True, error_model="numpy")
def is_closed(closed, rank):
    """Return whether a rank is closed; without a bitmap, none is."""
    return len(closed) != 0 and closed[rank >> 6] & (np.uint64(1) << np.uint64(rank & 63)) != 0


@njit(nogil=True, error_model="numpy")
def close_one(closed, rank):
    """Close a rank if there is a bitmap; thread-safe."""
    if len(closed):
        fetch_or(closed, rank >> 6, np.uint64(1) << np.uint64(rank & 63))
