"""Compiled expansion of a block of ranked states: new successors and predecessors."""

from __future__ import annotations

import numpy as np

from ...system.jit import njit
from .atomics import fetch_or, prefetch
from .rank_set import number_of
from .ranked_successors import after, applicable, start_cursor

PENDING = 256
"""Successors that are collected before they are looked up, so that memory is prefetched. More hides more latency, and
needs more cache.
"""


@njit(nogil=True, error_model="numpy")
def expand_block(operators, decoder, closed, block, start, out):
    """Push the successors that are not closed, and close them.

    Several threads may share a bitmap. Exactly one of them pushes each new successor. The words of many successors are
    prefetched before the first one is read, since memory latency is high.

    Return `stop`, such that `block[start:stop]` has been expanded, the number of entries of `out` in use, and the
    number of transitions of the expanded states.
    """
    cursor, moves = start_cursor(operators, decoder), np.empty(operators.tree.most, dtype=np.int64)
    pending = np.empty(PENDING + operators.tree.most, dtype=np.int64)
    transitions = filled = 0
    i = start
    while i < len(block):
        waiting, begun = 0, i
        while i < len(block) and waiting <= min(PENDING, len(out) - filled - operators.tree.most):
            rank = block[i]
            for place in range(applicable(operators, decoder, rank, cursor, moves)):
                move = moves[place]
                transitions += 1
                target = after(operators, cursor.words, move, rank)
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
def fill_transitions(operators, decoder, states, block, counts, actions, targets):
    """Write the transitions of the states of a block, and how many each has; return the number of all."""
    cursor, moves = start_cursor(operators, decoder), np.empty(operators.tree.most, dtype=np.int64)
    row = 0
    for i in range(len(block)):
        rank = block[i]
        begin = row
        for place in range(applicable(operators, decoder, rank, cursor, moves)):
            action = operators.action[moves[place]]
            at = row
            while at > begin and actions[at - 1] > action:
                actions[at], targets[at] = actions[at - 1], targets[at - 1]
                at -= 1
            actions[at] = action
            targets[at] = number_of(states, after(operators, cursor.words, moves[place], rank))
            row += 1
        counts[i] = row - begin
    return row
