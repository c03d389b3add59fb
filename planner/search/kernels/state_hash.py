"""A hash table of packed states, compiled."""

from __future__ import annotations

import numpy as np

from ...system.jit import njit
from .atomics import prefetch

AHEAD = 256
"""States that are looked up at a time: the memory of all is asked for before the first is compared."""


NUMBER = 40
"""Bits of a state's number in its slot; the other bits are some of its hash, so that few others are compared."""


@njit(nogil=True, error_model="numpy")
def hash_of(state):
    """Mix the words of a state."""
    mixed = np.uint64(0)
    for w in range(len(state)):
        mixed = (mixed ^ state[w]) * np.uint64(0x9E3779B97F4A7C15)  # as in `reached.first_slot`, word by word
        mixed ^= mixed >> np.uint64(32)
    return mixed * np.uint64(0xD6E8FEB86659FD93)


@njit(nogil=True, error_model="numpy")
def place_of(slots, mixed):
    """Give the slot from which a state is looked for."""
    return np.int64(mixed >> np.uint64(20) & np.uint64(len(slots) - 1))


@njit(nogil=True, error_model="numpy")
def entry_of(mixed, number):
    """Give what a slot has of a state."""
    return mixed >> np.uint64(NUMBER) << np.uint64(NUMBER) | np.uint64(number + 1)


@njit(nogil=True, error_model="numpy")
def find(slots, states, state, mixed):
    """Find the slot in which a state stands, or the free one (0) where it belongs."""
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
    """Give the number of each state of a block; those that are new are written to `states[held:]`, which has room.

    Returns
    -------
    int
        How many states are held now.
    """
    mixed = np.empty(AHEAD, dtype=np.uint64)
    for start in range(0, len(block), AHEAD):
        count = min(AHEAD, len(block) - start)
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
    """Give the number of each state of a block, -1 where it is not held."""
    for i in range(len(block)):
        entry = slots[find(slots, states, block[i], hash_of(block[i]))]
        numbers[i] = np.int64(entry & np.uint64((1 << NUMBER) - 1)) - 1


@njit(nogil=True, error_model="numpy")
def fill_slots(slots, states, first, stop):
    """Put `states[first:stop]`, which are distinct, into the slots, which have room."""
    for number in range(first, stop):
        mixed = hash_of(states[number])
        at = place_of(slots, mixed)
        while slots[at] != 0:
            at = (at + 1) & (len(slots) - 1)
        slots[at] = entry_of(mixed, number)
