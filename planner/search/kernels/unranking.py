"""From the rank of a state to its packed form, compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...states.packing import Ints, Words
from ...system.jit import njit


class UnrankingTables(NamedTuple):
    """Tables that give the packed state of an index (a namedtuple: numba takes it apart).

    The digits of an index fall into chunks, the lowest first. A packed state is the sum, modulo 2**64, of
    one row for each chunk. Then come steps, each for a variable that the others determine: a field of the sum, modulo
    the invariants' prime, tells its value, and that tells a row to be added.

    Attributes
    ----------
    radix : uint64 array, shape (chunks,)
        Values of each chunk.
    first : int64 array, shape (chunks,)
        The row of each chunk's value 0.
    rows : uint64 array, shape (rows, words)
        The words of `successors.Packing` come first.
    steps : int64 array, shape (steps, 3)
        The word and the shift of each step's field, and the row of its value 0.
    told : int32 array, shape (steps, prime)
        The value that each sum tells; 0 where no value has that sum, which is so in no reachable state.
    """

    radix: Words
    first: Ints
    rows: Words
    steps: Ints
    told: NDArray[np.int32]


NOWHERE = -(1 << 31)
"""In a table of changes: the move leads to no value of the cluster."""


CLUSTER = (1 << 21) - 1
"""Fields of a packed state that hold a cluster's value, or a sum that tells one, have 21 bits."""


PRIME = 8191
"""Sums that tell the value of a variable are taken modulo this prime."""


@njit(nogil=True, error_model="numpy")
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
    for step in range(len(decoder.steps)):
        total = words[decoder.steps[step, 0]] >> np.uint64(decoder.steps[step, 1]) & np.uint64(CLUSTER)
        row = decoder.steps[step, 2] + decoder.told[step, total % np.uint64(PRIME)]
        for w in range(len(words)):
            words[w] += decoder.rows[row, w]


@njit(nogil=True, error_model="numpy")
def decode_all(decoder, indices, states):
    """Write the packed state of each index into a row of `states`."""
    for i in range(len(indices)):
        decode(decoder, indices[i], states[i])


@njit(nogil=True, error_model="numpy")
def mark(decoder, block, masks, values, marks):
    """Write to `marks` in which states of a block a condition holds."""
    words = np.empty(decoder.rows.shape[1], dtype=np.uint64)
    for i in range(len(block)):
        decode(decoder, block[i], words)
        met = True
        for w in range(len(masks)):
            met &= words[w] & masks[w] == values[w]
        marks[i] = met
