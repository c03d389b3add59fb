"""Which condition who begins next gets: one of those that fewest have, by lot.

So the numbers of any two conditions differ by at most one whenever somebody has begun, whoever comes and goes before;
with as many as there are conditions (a block) each has had its turn. The lot follows from the study's seed and from how
many have begun: the same order of conditions every time.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


def assign(counts: Mapping[str, int], seed: int, begun: int) -> str:
    """Give the condition of who begins next.

    Parameters
    ----------
    counts : mapping of str to int
        How many count in each condition, in the order of the study's file.
    seed : int
    begun : int
        How many have begun, those who do not count any more included.
    """
    fewest = min(counts.values())
    free = [name for name, count in counts.items() if count == fewest]
    return free[int(np.random.default_rng([seed, begun]).integers(len(free)))]
