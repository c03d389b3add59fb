"""Compiled sets of states that number their members: a hash table of packed states, and a bitmap of ranks.

In the bitmap, the number of a state is the position of its rank among the ranks of all reachable states. Several
threads may apply an atomic operation to the same entry of an array. Each receives the entry before its own operation.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...system.arrays import Ints, Words
from ...system.jit import intrinsic, njit


@intrinsic
def fetch_or(typing: Any, array: Any, place: Any, bits: Any) -> Any:  # noqa: ARG001
    """Execute `array[place] |= bits` atomically; return the previous word."""
    from numba import types  # here and below, since these functions run when others are compiled

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.atomic_rmw("or", builder.gep(data, [arguments[1]]), arguments[2], "monotonic")

    return types.uint64(array, types.int64, types.uint64), code


@intrinsic
def fetch_min(typing: Any, array: Any, place: Any, value: Any) -> Any:  # noqa: ARG001
    """Execute `array[place] = min(array[place], value)` atomically; return the previous entry."""
    from numba import types

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        pointer = builder.gep(data, [arguments[1]])
        value = context.cast(builder, arguments[2], signature.args[2], signature.args[0].dtype)
        return builder.atomic_rmw("umin", pointer, value, "monotonic")

    return array.dtype(array, types.int64, value), code


@intrinsic
def prefetch(typing: Any, array: Any, place: Any) -> Any:  # noqa: ARG001
    """Start to load an entry into the cache, without waiting."""
    from llvmlite import ir
    from numba import types
    from numba.core import cgutils

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        pointer = builder.bitcast(builder.gep(data, [arguments[1]]), cgutils.voidptr_t)
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t, number, number, number])
        prefetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(prefetch, [pointer, number(0), number(3), number(1)])
        return context.get_dummy_value()

    return types.void(array, types.int64), code


@intrinsic
def lowest_bit(typing: Any, word: Any) -> Any:  # noqa: ARG001
    """Return the position of the lowest set bit of a nonzero word."""
    from llvmlite import ir
    from numba import types

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.uint64), code


NUMBER = 40
"""Bits of a state's number in its slot. The other 24 bits hold a part of its hash, which avoids most comparisons."""


@njit(nogil=True, error_model="numpy", inner=True)
def hash_of(state):
    """Return the hash of a state's words."""
    mixed = np.uint64(0)
    for w in range(len(state)):
        mixed = (mixed ^ state[w]) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(32)
    return mixed * np.uint64(0xD6E8FEB86659FD93)


@njit(nogil=True, error_model="numpy", inner=True)
def place_of(slots, mixed):
    """Return the slot at which the probe for a state begins."""
    return np.int64(mixed >> np.uint64(20) & np.uint64(len(slots) - 1))


@njit(nogil=True, error_model="numpy", inner=True)
def entry_of(mixed, number):
    """Return the slot entry of a state: a part of its hash, and its number plus one."""
    return mixed >> np.uint64(NUMBER) << np.uint64(NUMBER) | np.uint64(number + 1)


@njit(nogil=True, error_model="numpy", inner=True)
def find(slots, states, state, mixed):
    """Return the slot of a state, or the free slot (0) where it belongs."""
    at = place_of(slots, mixed)
    while slots[at] != 0:
        if (slots[at] ^ mixed) >> np.uint64(NUMBER) == 0:
            number = np.int64(slots[at] & np.uint64((1 << NUMBER) - 1)) - 1
            same = True
            for w in range(len(state)):
                same &= states[number, w] == state[w]
            if same:
                return at
        at = (at + 1) & (len(slots) - 1)
    return at


@njit(nogil=True, error_model="numpy")
def insert(slots, states, held, block, numbers):
    """Write the number of each state of a block; new states are appended to `states[held:]`, which has room.

    Return the number of states in the table afterwards.
    """
    # States that are looked up at a time; the memory of all of them is prefetched before the first comparison.
    ahead = 256
    mixed = np.empty(ahead, dtype=np.uint64)
    for start in range(0, len(block), ahead):
        count = min(ahead, len(block) - start)
        for j in range(count):
            mixed[j] = hash_of(block[start + j])
            prefetch(slots, place_of(slots, mixed[j]))
        for j in range(count):
            entry = slots[place_of(slots, mixed[j])]
            if entry != 0:
                number = np.int64(entry & np.uint64((1 << NUMBER) - 1)) - 1
                prefetch(states, number * states.shape[1])
        for j in range(count):
            state = block[start + j]
            at = find(slots, states, state, mixed[j])
            if slots[at] == 0:
                for w in range(len(state)):
                    states[held, w] = state[w]
                slots[at] = entry_of(mixed[j], held)
                held += 1
            numbers[start + j] = np.int64(slots[at] & np.uint64((1 << NUMBER) - 1)) - 1
    return held


@njit(nogil=True, error_model="numpy")
def look_up(slots, states, block, numbers):
    """Write the number of each state of a block; -1 for unknown states."""
    for i in range(len(block)):
        entry = slots[find(slots, states, block[i], hash_of(block[i]))]
        numbers[i] = np.int64(entry & np.uint64((1 << NUMBER) - 1)) - 1


@njit(nogil=True, error_model="numpy")
def fill_slots(slots, states, stop):
    """Insert the distinct states `states[:stop]` into the slots, which have room."""
    for number in range(stop):
        mixed = hash_of(states[number])
        at = place_of(slots, mixed)
        while slots[at] != 0:
            at = (at + 1) & (len(slots) - 1)
        slots[at] = entry_of(mixed, number)


@njit(nogil=True, error_model="numpy")
def renumber(slots, number):
    """Give state `i` in the slots the number `number[i]`."""
    own = np.uint64((1 << NUMBER) - 1)
    for at in range(len(slots)):
        if slots[at] != 0:
            slots[at] = slots[at] & ~own | np.uint64(number[np.int64(slots[at] & own) - 1] + 1)


class RankSet(NamedTuple):
    """The set of reachable ranks: a bitmap in blocks of 512 bits, and in pages of 128 blocks."""

    bits: Words
    before: Ints
    """Number of states before each page; the last entry is the number of all states."""
    within: npt.NDArray[np.uint16]
    """Number of states before each block in its page; undefined in pages without states."""


@njit(nogil=True, error_model="numpy", inner=True)
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


@njit(nogil=True, error_model="numpy", inner=True)
def ask_for(states, rank):
    """Prefetch the memory that `number_of` reads for a rank."""
    prefetch(states.bits, rank >> 6)
    prefetch(states.within, rank >> 9)


@njit(nogil=True, error_model="numpy", inner=True)
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


@njit(nogil=True, error_model="numpy", inner=True)
def is_closed(closed, rank):
    """Return whether a rank is closed; without a bitmap, none is."""
    return len(closed) != 0 and closed[rank >> 6] & (np.uint64(1) << np.uint64(rank & 63)) != 0


@njit(nogil=True, error_model="numpy", inner=True)
def close_one(closed, rank):
    """Close a rank if there is a bitmap; thread-safe."""
    if len(closed):
        fetch_or(closed, rank >> 6, np.uint64(1) << np.uint64(rank & 63))
