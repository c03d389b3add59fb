"""Assignment of participants to conditions, or to orders of conditions: a random one among the least frequent ones.

The counts of any two conditions differ by at most one after each assignment, also after dropouts. Each block of
as many participants as conditions contains each condition once. The assignment depends only on the study's seed and the
number of previous assignments, so it is reproducible.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np


def assign(counts: Mapping[str, int], seed: int, begun: int) -> str:
    """Return the condition of the next participant.

    Parameters
    ----------
    counts : mapping of str to int
        Number of participants that count in each condition or order.
    seed : int
    begun : int
        Number of previous assignments, including participants who no longer count.
    """
    fewest = min(counts.values())
    free = [name for name, count in counts.items() if count == fewest]
    return free[int(np.random.default_rng([seed, begun]).integers(len(free)))]


def balanced_orders(conditions: Sequence[str]) -> list[tuple[str, ...]]:
    """Return orders in which each condition is equally often at each position and directly after each other condition.

    An even number n of conditions gives n orders, a Latin square; an odd n gives 2 n orders (E. J. Williams,
    "Experimental designs balanced for the estimation of residual effects of treatments", 1949).
    """
    n = len(conditions)
    first = [(place + 1) // 2 if place % 2 else -(place // 2) for place in range(n)]
    rows = [[(shift + one) % n for one in first] for shift in range(n)]
    rows += [row[::-1] for row in rows] if n % 2 and n > 1 else []
    return [tuple(conditions[one] for one in row) for row in rows]
