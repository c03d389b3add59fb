"""Compiled hash table of packed states."""

from __future__ import annotations

import numpy as np

from ...system.jit import njit
from .atomics import prefetch

NUMBER = 40
"""Bits of a state's number in its slot. The other 24 bits hold a part of its hash, which avoids most comparisons."""


@njit(nogil=True, error_model="numpy")
def hash_of(state):
    """Return the hash of a state's words."""
    mixed = np.uint64(0)
    for w in range(len(state)):
        mixed = (mixed ^ state[w]) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(32)
    return mixed * np.uint64(0xD6E8FEB86659FD93)


@njit(nogil=True, error_model="numpy")
def place_of(slots, mixed):
    """Return the slot at which the probe for a state begins."""
    return np.int64(mixed >> np.uint64(20) & np.uint64(len(slots) - 1))


@njit(nogil=True, error_model="numpy")
def entry_of(mixed, number):
    """Return the slot entry of a state: a part of its hash, and its number plus one."""
    return mixed >> np.uint64(NUMBER) << np.uint64(NUMBER) | np.uint64(number + 1)


@njit(nogil=True, error_model="numpy")
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
def fill_slots(slots, states, first, stop):
    """Insert the distinct states `states[first:stop]` into the slots, which have room."""
    for number in range(first, stop):
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
