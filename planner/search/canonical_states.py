"""Compiled computation of the canonical state of each orbit under the symmetries of a task, for `costtogo.orbit_table`.

The canonical state is computed along the stabiliser chain, as in minimal images (Linton 2004; Jefferson et al. 2019).
Each level applies all of its symmetries to the current images. It keeps the images with the smallest key. The key is a
sum of weights of orbits that later levels preserve. Equal images, which occur for symmetric states, are kept once. If
more than 64 images remain, some are dropped. States of one orbit may then get different canonical states. This
increases the number of states, but it is still correct, since the result is always an image of the state.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..system.arrays import Ints, Words
from ..system.jit import njit
from .automorphisms import Symmetries
from .packing import Packing


class Forms(NamedTuple):
    """Symmetries in the layout of the compiled code. Facts are numbered across the variables."""

    word: Ints
    """Word of each variable in a packed state."""
    first: Ints
    """First fact of each variable."""
    shift: Words
    field: Words
    at: Ints
    """Word in which each fact is stored."""
    bits: Words
    """Bits that represent each fact in its word."""
    begin: Ints
    """The symmetries of level `l` are the rows `begin[l]:begin[l + 1]` of `permutations`."""
    permutations: NDArray[np.int32]
    """Image of every fact under each symmetry."""
    weight: Words
    """From `facts * begin[l]` on, the contribution of each fact to the key of its image, one entry for each symmetry of
    level `l`.
    """
    own: Words
    """Contribution of each fact to the hash that distinguishes images."""

    @classmethod
    def of(cls, symmetries: Symmetries, packing: Packing) -> Forms:
        """Return the layout of the symmetries of a task with packed states."""
        facts = int(symmetries.first[-1])
        variable = np.repeat(np.arange(len(packing.word)), np.diff(symmetries.first))
        value = np.arange(facts) - symmetries.first[variable]
        rng = np.random.default_rng(0)
        weights = [np.empty(0, dtype=np.uint64)]
        for level in symmetries.levels:
            of_orbit = rng.integers(1 << 63, size=facts, dtype=np.uint64)
            weights.append(of_orbit[level.orbits][level.permutations].T.reshape(-1))
        return cls(
            packing.word,
            symmetries.first[:-1],
            packing.shift.astype(np.uint64),
            (np.uint64(1) << packing.bits.astype(np.uint64)) - np.uint64(1),
            packing.word[variable],
            value.astype(np.uint64) << packing.shift[variable].astype(np.uint64),
            np.cumsum([0, *(len(level.permutations) for level in symmetries.levels)]),
            np.concatenate([level.permutations for level in symmetries.levels]).astype(np.int32),
            np.concatenate(weights),
            rng.integers(1 << 63, size=facts, dtype=np.uint64),
        )


@njit(nogil=True, error_model="numpy")
def canonical(forms, states):
    """Replace each state by its canonical state, in place; states have shape (n, words)."""
    variables, levels = len(forms.word), len(forms.begin) - 1
    facts = len(forms.at)
    wide = 64  # images kept per level; more find more equal orbits, and take longer
    images = np.empty((2, wide, variables), dtype=np.int64)
    marks = np.empty(wide, dtype=np.uint64)
    keys = np.empty(len(forms.permutations), dtype=np.uint64)
    best, packed = np.empty(states.shape[1], dtype=np.uint64), np.empty(states.shape[1], dtype=np.uint64)
    for i in range(len(states)):
        side, held = 0, 1
        for v in range(variables):
            images[0, 0, v] = forms.first[v] + np.int64(states[i, forms.word[v]] >> forms.shift[v] & forms.field[v])
        for level in range(levels):
            begin = forms.begin[level]
            count = forms.begin[level + 1] - begin
            least, more = np.uint64(0), 0
            for image in range(held):
                for j in range(count):
                    keys[j] = 0
                for v in range(variables):
                    row = begin * facts + images[side, image, v] * count
                    for j in range(count):
                        keys[j] += forms.weight[row + j]
                for j in range(count):
                    if more > 0 and keys[j] > least:
                        continue
                    if more == 0 or keys[j] < least:
                        least, more = keys[j], 0
                    if more == wide:
                        continue
                    mark = np.uint64(0)
                    for v in range(variables):
                        fact = forms.permutations[begin + j, images[side, image, v]]
                        images[1 - side, more, v] = fact
                        mark += forms.own[fact]
                    known = False
                    for other in range(more):
                        known |= marks[other] == mark
                    if not known:
                        marks[more] = mark
                        more += 1
            side, held = 1 - side, more
        for image in range(held):
            for w in range(len(packed)):
                packed[w] = 0
            for v in range(variables):
                fact = images[side, image, v]
                packed[forms.at[fact]] |= forms.bits[fact]
            smaller = image == 0
            for w in range(len(packed)):
                if packed[w] != best[w]:
                    smaller |= packed[w] < best[w]
                    break
            if smaller:
                for w in range(len(packed)):
                    best[w] = packed[w]
        for w in range(len(packed)):
            states[i, w] = best[w]
