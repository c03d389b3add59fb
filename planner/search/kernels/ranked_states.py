"""Compiled set of reachable ranks, as a bitmap or a hash table, and the number of each state.

The number of a state is the position of its rank among the ranks of all reachable states.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...states.packing import Ints, Words
from ...system.jit import njit
from .atomics import fetch_or, prefetch

AHEAD = 16
"""Distance in entries between prefetching an entry and using it."""


@njit(nogil=True, error_model="numpy")
def set_bits(bits, indices):
    """Set the bits of the given ranks."""
    for i in range(len(indices)):
        bits[indices[i] >> 6] |= np.uint64(1) << np.uint64(indices[i] & 63)


@njit(nogil=True, error_model="numpy")
def first_slot(keys, index):
    """Return the slot of a hash table at which the probe for a rank begins."""
    mixed = np.uint64(index) * np.uint64(0x9E3779B97F4A7C15)  # Fibonacci hashing (Knuth, vol. 3, 6.4)
    return np.int64((mixed ^ (mixed >> np.uint64(32))) & np.uint64(len(keys) - 1))


@njit(nogil=True, error_model="numpy")
def find_slot(keys, index):
    """Return the slot of a rank in a hash table, or the free slot (-1) where it belongs."""
    at = first_slot(keys, index)
    while keys[at] != index and keys[at] != -1:
        at = (at + 1) & (len(keys) - 1)
    return at


@njit(nogil=True, error_model="numpy")
def insert_all(keys, indices):
    """Insert distinct ranks into a hash table that has room for them."""
    for i in range(len(indices)):
        if i + AHEAD < len(indices):
            prefetch(keys, first_slot(keys, indices[i + AHEAD]))
        keys[find_slot(keys, indices[i])] = indices[i]


@njit(nogil=True, error_model="numpy")
def number_members(keys, members, start, numbers):
    """Write the number of each member, from `start` on, into the slot of the member."""
    for i in range(len(members)):
        if i + AHEAD < len(members):
            prefetch(keys, first_slot(keys, members[i + AHEAD]))
        numbers[find_slot(keys, members[i])] = start + i


class RankSet(NamedTuple):
    """The set of reachable ranks: a bitmap, or a sorted list with a hash table.

    Attributes
    ----------
    bits : uint64 array, shape (8 * blocks,)
        The bitmap; empty if the list is used.
    ranks : int64 array, shape (blocks + 1,)
        Number of states before each block of 512 bits.
    members : int64 array, shape (n,)
        The ranks in ascending order; empty if the bitmap is used.
    keys, numbers : int64 arrays
        Hash table from a rank (or -1) to its position among the members.
    """

    bits: Words
    ranks: Ints
    members: Ints
    keys: Ints
    numbers: Ints


@njit(nogil=True, error_model="numpy")
def count_ones(word):
    """Return the number of set bits of a word (compilers have an instruction for this pattern)."""
    word -= (word >> np.uint64(1)) & np.uint64(0x5555555555555555)
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@njit(nogil=True, error_model="numpy")
def fill_ranks(bits, ranks):
    """Compute the `ranks` of a bitmap."""
    total = 0
    for block in range(len(ranks) - 1):
        ranks[block] = total
        for word in range(8 * block, 8 * block + 8):
            total += count_ones(bits[word])
    ranks[-1] = total


@njit(nogil=True, error_model="numpy")
def ask_for(states, index):
    """Prefetch the memory that `number_of` reads for a rank."""
    if len(states.bits):
        prefetch(states.bits, index >> 6)
        prefetch(states.ranks, index >> 9)
    else:
        slot = first_slot(states.keys, index)
        prefetch(states.keys, slot)
        prefetch(states.numbers, slot)


@njit(nogil=True, error_model="numpy")
def number_of(states, index):
    """Return the number of the state with a rank; -1 if there is none."""
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


@njit(nogil=True, error_model="numpy")
def numbers_of(states, indices, out):
    """Write the number of each rank to `out`; -1 where there is no such state."""
    for i in range(len(indices)):
        out[i] = number_of(states, indices[i]) if indices[i] >= 0 else -1


@njit(nogil=True, error_model="numpy")
def select(states, numbers, out):
    """Write the rank of each numbered state to `out`."""
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


@njit(nogil=True, error_model="numpy")
def list_members(states, start, out):
    """Write the next ranks in ascending order to `out`, from position `start` on.

    Returns
    -------
    stop : int
        Number of words of the bitmap, or of members, that have been processed.
    filled : int
    """
    filled = 0
    if len(states.bits) == 0:
        filled = min(len(out), len(states.members) - start)
        for i in range(filled):  # an assignment to a slice takes two seconds to compile
            out[i] = states.members[start + i]
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


@njit(nogil=True, error_model="numpy")
def label(states, distance, d, block):
    """Set the distance of all states of a block to `d`."""
    for i in range(len(block)):
        if i + AHEAD < len(block):
            ask_for(states, block[i + AHEAD])
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
def is_closed(closed, index):
    """Return whether a rank is closed; without a bitmap, none is."""
    return len(closed) != 0 and closed[index >> 6] & (np.uint64(1) << np.uint64(index & 63)) != 0


@njit(nogil=True, error_model="numpy")
def close_one(closed, index):
    """Close a rank if there is a bitmap; thread-safe."""
    if len(closed):
        fetch_or(closed, index >> 6, np.uint64(1) << np.uint64(index & 63))
