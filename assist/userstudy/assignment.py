"""Which condition, or order of conditions, who begins next gets: one of those that fewest have, by lot.

So the numbers of any two differ by at most one whenever somebody has begun, whoever comes and goes before; with as many
as there are (a block) each has had its turn. The lot follows from the study's seed and from how many have begun: it is
the same every time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np


def assign(counts: Mapping[str, int], seed: int, begun: int) -> str:
    """Give the condition of who begins next.

    Parameters
    ----------
    counts : mapping of str to int
        How many count in each condition, or order of conditions.
    seed : int
    begun : int
        How many have begun, those who do not count any more included.
    """
    fewest = min(counts.values())
    free = [name for name, count in counts.items() if count == fewest]
    return free[int(np.random.default_rng([seed, begun]).integers(len(free)))]


def balanced_orders(conditions: Sequence[str]) -> list[tuple[str, ...]]:
    """Give orders in which each condition comes equally often at each place, and directly after each other one.

    Of an even number of conditions there are as many, a Latin square; of an odd one twice as many (E. J. Williams,
    "Experimental designs balanced for the estimation of residual effects of treatments", 1949).
    """
    n = len(conditions)
    first = [(place + 1) // 2 if place % 2 else -(place // 2) for place in range(n)]
    rows = [[(shift + one) % n for one in first] for shift in range(n)]
    rows += [row[::-1] for row in rows] if n % 2 and n > 1 else []
    return [tuple(conditions[one] for one in row) for row in rows]
