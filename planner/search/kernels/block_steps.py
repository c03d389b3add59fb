"""Compiled steps of the searches on one block of states: new states forward, smaller distances backward.

Kernels process one block, so that limits are checked between calls. Those that push stop when the output may not hold
the successors of one more state, and return the position reached. A *kind* is the place of a cost among the distinct
costs of a task. Distances and costs have the same unsigned type. Several threads may share the distances.
"""

from __future__ import annotations

import numpy as np

from ...system.jit import njit
from .ranked_successors import after, applicable, start_cursor
from .state_sets import ask_for, close_one, fetch_min, fetch_or, is_closed, number_of, prefetch

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


@njit(nogil=True, error_model="numpy")
def relax_moves(operators, decoder, states, closed, kinds, costs, distance, block, start, d, out, through):
    """Relax the predecessors of the ranked states of distance `d`: push those whose distance decreases.

    `closed` is a bitmap from `close`, or empty. States are closed in it as they are settled, so that most
    predecessors need no lookup. `kinds` are those of the moves, and `through` receives those of the pushed
    predecessors. Return `stop`, such that `block[start:stop]` has been processed, and the number of these predecessors.
    """
    cursor, moves = start_cursor(operators, decoder), np.empty(operators.tree.most, dtype=np.int64)
    pending = np.empty(PENDING + operators.tree.most, dtype=np.int64)
    by = np.empty(len(pending), dtype=np.int64)
    numbers = np.empty(len(pending), dtype=np.int64)
    i, filled = start, 0
    while i < len(block):
        waiting, begun = 0, i
        while i < len(block) and waiting <= min(PENDING, len(out) - filled - operators.tree.most):
            rank = block[i]
            i += 1
            if distance[number_of(states, rank)] != d:
                continue  # it has been reached on a cheaper way since it was pushed
            close_one(closed, rank)
            for place in range(applicable(operators, decoder, rank, cursor, moves)):
                move = moves[place]
                target = after(operators, cursor.words, move, rank)
                if target >= 0:
                    if len(closed):
                        prefetch(closed, target >> 6)
                    pending[waiting], by[waiting] = target, kinds[move]
                    waiting += 1
        if i == begun:
            break
        asked = 0
        for j in range(waiting):  # without a branch, which the processor could not predict
            open_, pending[asked], by[asked] = not is_closed(closed, pending[j]), pending[j], by[j]
            asked += open_
        for j in range(asked):
            ask_for(states, pending[j])
        for j in range(asked):
            numbers[j] = number_of(states, pending[j])
            if numbers[j] >= 0:
                prefetch(distance, numbers[j])
        for j in range(asked):
            number, value = numbers[j], d + costs[by[j]]
            if number >= 0 and value < distance[number] and value < fetch_min(distance, number, value):
                out[filled], through[filled] = pending[j], by[j]
                filled += 1
    return i, filled


@njit(nogil=True, error_model="numpy")
def relax_stored(into, sources, kinds, costs, distance, block, start, d, out, through):
    """Relax the stored transitions into the states of distance `d`, as `relax_moves` does with moves."""
    i, filled = start, 0
    while i < len(block) and filled + into[block[i] + 1] - into[block[i]] <= len(out):
        state = block[i]
        i += 1
        if distance[state] != d:
            continue
        for row in range(into[state], into[state + 1]):
            kind = np.int64(kinds[row]) if len(kinds) else 0
            value, source = d + costs[kind], sources[row]
            if value < distance[source] and value < fetch_min(distance, source, value):
                out[filled], through[filled] = source, kind
                filled += 1
    return i, filled


@njit(nogil=True, error_model="numpy")
def by_kind(out, through, begin, ordered):
    """Sort pushed states by kind: those of kind `k` are `ordered[begin[k]:begin[k + 1]]`.

    `begin` must be zero, with two entries more than there are kinds.
    """
    for kind in through:
        begin[kind + 2] += 1
    for kind in range(2, len(begin)):
        begin[kind] += begin[kind - 1]
    for i in range(len(out)):
        ordered[begin[through[i] + 1]] = out[i]
        begin[through[i] + 1] += 1


@njit(nogil=True, error_model="numpy")
def transpose(counts, targets, kinds, number, into, sources, source_kinds):
    """Sort transitions by target: those into state `s` are `into[s]:into[s + 1]`.

    States are given by former numbers, and get new ones: state `i` gets `number[i]`. `into` must be zero, with two
    entries more than there are states.
    """
    for row in range(len(targets)):
        targets[row] = number[targets[row]]
        into[targets[row] + 2] += 1
    for state in range(2, len(into)):
        into[state] += into[state - 1]
    row = 0
    for state in range(len(counts)):
        for _ in range(counts[state]):
            place = into[targets[row] + 1]
            into[targets[row] + 1] += 1
            sources[place] = number[state]
            if len(kinds):
                source_kinds[place] = kinds[row]
            row += 1
