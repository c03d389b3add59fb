"""Lower bounds on one person's problem: for each state, the returns of plans as alpha vectors (compiled code)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.decision import Floats
from .belief_hulls import NONE, dot

FEW_VECTORS = 32  # length up to which the vector list of a state is not pruned; pruning takes time, long lists too


class AlphaVectors(NamedTuple):
    """Alpha vectors, as one linked list per state.

    A vector that no longer is best anywhere leaves its list, so that the search does not evaluate it. It stays stored
    (`state`), because the plans of other vectors refer to it.
    """

    vector: Floats
    witness: Floats  # belief for which the vector was computed
    action: NDArray[np.int32]
    state: NDArray[np.int32]  # -1: unused entry
    after: NDArray[np.int32]
    head: NDArray[np.int32]
    live: NDArray[np.int64]  # length of each state's list
    limit: NDArray[np.int64]  # length at which the list is pruned
    space: NDArray[np.int64]  # number of entries that have ever been used, and the first unused one among them


def empty_vectors(states: int, size: int, capacity: int) -> AlphaVectors:
    """Return empty vector lists; each vector has `size` entries."""
    return AlphaVectors(
        vector=np.empty((capacity, size)),
        witness=np.empty((capacity, size)),
        action=np.zeros(capacity, dtype=np.int32),
        state=np.full(capacity, NONE, dtype=np.int32),
        after=np.full(capacity, NONE, dtype=np.int32),
        head=np.full(states, NONE, dtype=np.int32),
        live=np.zeros(states, dtype=np.int64),
        limit=np.full(states, FEW_VECTORS),
        space=np.array([0, NONE]),
    )


# Whole-array forms (a[:] = b, (a <= b).all(), a / b) take several times as long to compile. Each calling function would
# include numba's code for broadcasting and its error messages.
@njit(inner=True)
def copied(a, b):
    """Copy b into a."""
    for i in range(len(a)):
        a[i] = b[i]


@njit(inner=True)
def _dominated(a, b):
    """Return whether a <= b in all entries."""
    for i in range(len(a)):  # noqa: SIM110  numba has no generator expressions
        if not a[i] <= b[i]:
            return False
    return True


@njit()
def lower(x, belief, vectors):
    """Return the lower bound at an unnormalised belief, and the vector that attains it."""
    best, at = -np.inf, NONE
    i = vectors.head[x]
    while i >= 0:
        value = dot(vectors.vector[i], belief)
        if value > best:
            best, at = value, i
        i = vectors.after[i]
    return best, at


@njit(inner=True)
def add_vector(x, action, vector, belief, vectors):
    """Add an alpha vector, computed for a belief, to a state, and remove the vectors that it dominates pointwise."""
    after, head, space, live = vectors.after, vectors.head, vectors.space, vectors.live
    before, i = NONE, head[x]
    while i >= 0:
        following = after[i]
        if _dominated(vectors.vector[i], vector):
            if before >= 0:
                after[before] = following
            else:
                head[x] = following
            after[i], vectors.state[i], space[1] = space[1], NONE, i
            live[x] -= 1
        else:
            before = i
        i = following
    i = space[1]
    if i >= 0:
        space[1] = after[i]
    else:
        i = space[0]
        space[0] += 1
    copied(vectors.vector[i], vector)
    copied(vectors.witness[i], belief)
    vectors.action[i], vectors.state[i] = action, x
    after[i], head[x] = head[x], i
    live[x] += 1
    if live[x] > vectors.limit[x]:
        _prune(x, vectors)
        vectors.limit[x] = max(FEW_VECTORS, 2 * live[x])


@njit(inner=True)
def _prune(x, vectors):
    """Keep only those vectors of a state's list that are best at a witness belief of one of them."""
    after, head = vectors.after, vectors.head
    useful = np.zeros(vectors.live[x], dtype=np.bool_)
    i = head[x]
    while i >= 0:
        best, at = -np.inf, 0
        k, j = 0, head[x]
        while j >= 0:
            value = dot(vectors.vector[j], vectors.witness[i])
            if value > best:
                best, at = value, k
            k, j = k + 1, after[j]
        useful[at] = True
        i = after[i]
    before, k, i, kept = NONE, 0, head[x], 0
    while i >= 0:
        following = after[i]
        if useful[k]:
            before = i
            kept += 1
        elif before >= 0:
            after[before] = following
        else:
            head[x] = following
        k, i = k + 1, following
    vectors.live[x] = kept


@njit()
def add_vectors(value, action, belief, vectors):
    """Add one vector to each state."""
    for x in range(len(value)):
        add_vector(x, action[x], value[x], belief, vectors)
