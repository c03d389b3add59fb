"""Relaxation of the transitions into a block of states by a compiled kernel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..states.packing import Ints
from .kernels import distance_updates

Relax = Callable[[Ints, int, Any, Ints, Ints], tuple[int, int]]
"""Kernel that relaxes a block, such as `distance_updates.relax_stored` with its first arguments.

Arguments are the keys, the first position, the distance, and the two outputs. It returns the position reached and the
filled length.
"""


def relaxed(relax: Relax, block: Ints, d: Any, room: int, kinds: int) -> list[tuple[int, Ints]]:
    """Relax the transitions into a block of states at distance `d` by a kernel, called until the block is finished.

    `room` is the size of the kernel's output, at least the number of predecessors of a state; `kinds` is the number
    of distinct costs. Return pairs as `SearchSpace.settle` does.
    """
    pushed: list[tuple[int, Ints]] = []
    out, through = np.empty(room, dtype=np.int64), np.empty(room, dtype=np.int64)
    stop = 0
    while stop < len(block):
        stop, filled = relax(block, stop, d, out, through)
        begin, ordered = np.zeros(kinds + 2, dtype=np.int64), np.empty(filled, dtype=np.int64)
        distance_updates.by_kind(out[:filled], through[:filled], begin, ordered)
        pushed += [
            (kind, ordered[begin[kind] : begin[kind + 1]]) for kind in np.flatnonzero(np.diff(begin[:-1])).tolist()
        ]
    return pushed
