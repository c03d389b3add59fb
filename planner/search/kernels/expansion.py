"""Compiled expansion of a block of ranked states: new successors and predecessors."""

from __future__ import annotations

import numpy as np

from ...system.jit import njit
from .atomics import exchange_free, fetch_min, fetch_or, prefetch
from .ranked_states import ask_for, find_slot, first_slot, number_of
from .ranked_successors import after, applicable, start_cursor

PENDING = 256
"""Successors that are collected before they are looked up, so that memory is prefetched. More hides more latency, and
needs more cache.
"""


@njit(nogil=True, error_model="numpy")
def expand_block(tests, decoder, closed, block, start, out, filled):
    """Push the successors that are not closed, and close them.

    Several threads may share a bitmap. Exactly one of them pushes each new successor. The words of many successors are
    prefetched before the first one is read, since memory latency is high.

    Returns
    -------
    stop : int
        `block[start:stop]` has been expanded.
    filled : int
        `out[:filled]` is in use.
    transitions : int
        Number of transitions of the expanded states.
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
def expand_block_hashed(tests, decoder, block, start, keys, room, out, filled):
    """Push the successors that are not in a hash table, at most `room`, and insert them.

    The return values are those of `expand_block`. Several threads may share a table.
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
                elif before != target:  # another thread has taken the slot
                    slot = find_slot(keys, target)
    return i, filled, transitions


@njit(nogil=True, error_model="numpy")
def expand_block_back(tests, decoder, states, distance, d, block, start, out, filled):
    """Push the predecessors that are states of larger distance than `d`, and set their distance to `d`.

    The return values are those of `expand_block`. Several threads may share the distances. It is used for sets of
    states without a bitmap, and if memory does not suffice for a second bitmap.
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
def fill_transitions(tests, decoder, states, block, number, offsets, actions, targets):
    """Write the transitions of the states of a block, which are numbered from `number`."""
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
