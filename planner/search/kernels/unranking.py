"""Compiled unranking: from the rank of a state to its packed form."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...states.packing import Ints, Words
from ...system.jit import njit


class UnrankingTables(NamedTuple):
    """Tables for unranking, as a named tuple, which numba supports.

    The digits of a rank are grouped into chunks, the lowest first. A packed state is the sum, modulo 2**64, of one row
    per chunk. Then follow steps, one for each variable that the others determine. A field of the sum, modulo the prime
    of the invariants, determines the variable's value, whose row is added.
    """

    radix: Words
    """Number of values of each chunk."""
    first: Ints
    """Row of value 0 of each chunk."""
    rows: Words
    """Contributions to the words; those of `Packing` are first."""
    steps: Ints
    """The word and the shift of each step's field, and the row of its value 0."""
    value_of: NDArray[np.int32]
    """Value for each step and sum; 0 for sums that belong to no value, which do not occur in reachable states."""


NOWHERE = -(1 << 31)
"""Entry of a table of changes for a move without a successor in the cluster."""


FIELDS = 3
"""Number of fields in a word of a packed state, each of which holds the value of a cluster or a sum."""


FIELD_BITS = 64 // FIELDS
FIELD_MASK = (1 << FIELD_BITS) - 1
"""The bits of a field, 21 of them, once it has been shifted down."""


PRIME = 8191
"""Prime modulus of the sums that determine variables. Larger distinguishes more values, and needs wider fields and
tables.
"""


@njit(nogil=True, error_model="numpy")
def decode(decoder, rank, words):
    """Write the packed state of a rank into `words`."""
    rest = np.uint64(rank)
    words[:] = 0
    for chunk in range(len(decoder.radix)):
        above = rest // decoder.radix[chunk]
        row = decoder.first[chunk] + np.int64(rest - above * decoder.radix[chunk])
        for w in range(len(words)):
            words[w] += decoder.rows[row, w]
        rest = above
    for step in range(len(decoder.steps)):
        total = words[decoder.steps[step, 0]] >> np.uint64(decoder.steps[step, 1]) & np.uint64(FIELD_MASK)
        row = decoder.steps[step, 2] + decoder.value_of[step, total % np.uint64(PRIME)]
        for w in range(len(words)):
            words[w] += decoder.rows[row, w]


@njit(nogil=True, error_model="numpy")
def decode_all(decoder, ranks, states):
    """Write the packed state of each rank into a row of `states`."""
    for i in range(len(ranks)):
        decode(decoder, ranks[i], states[i])


@njit(nogil=True, error_model="numpy")
def mark(decoder, ranks, masks, values, marks):
    """Write to `marks` whether a condition holds in the state of each rank."""
    words = np.empty(decoder.rows.shape[1], dtype=np.uint64)
    for i in range(len(ranks)):
        decode(decoder, ranks[i], words)
        met = True
        for w in range(len(masks)):
            met &= words[w] & masks[w] == values[w]
        marks[i] = met
