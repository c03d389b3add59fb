"""What somebody gets at most who complies with every suggestion: an upper bound in every state of a large table.

Where a part of a task breaks off, what follows has to be bounded for somebody known, whatever the robot does. Here they
do what it suggests, or avoid it, as is best for it, whatever their theta; else they choose as they do. No person gets
more: theta weighs one choice against the others, which keep their shares among themselves, so that what is done after a
suggestion is a mixture of what would be done without it and of that choice alone, or of all the others alone; and a
mixture gets no more than the best of what it mixes, of which the suggestion's cost is paid in any case.

So theta need not be told apart: a state has a value for each beta, and millions of states are swept over.
"""

from __future__ import annotations

from collections.abc import Callable

import numba
import numpy as np
from numpy.typing import NDArray

from planner import Table

from ..people.decision import Floats
from ..people.human import Human
from ..people.misconception import Misconception
from .qmdp import ROUNDING, read_only
from .region import BLOCK, expected, never_erring

TOLERANCE = 0.02
"""Sweeps end when none changes a value by more, in cost units; every sweep leaves upper bounds."""

SWEEPS = 15
"""And after so many in any case: one over seven million states takes about five seconds."""


def at_most(
    known: Table,
    human: Human | None,
    betas: Floats,
    *,
    gamma: float,
    c_suggest: float,
    lapse: float,
    optimal: bool = True,
    progress: Callable[[int], None] | None = None,
) -> Floats:
    """Bound from above what the robot gets with somebody from each state on, whose beta is seen, shape (n, B).

    They choose by cost-to-go alone (eq. 4).

    Parameters
    ----------
    known : Table
        Of n states.
    human : Human or None
        Of whom it is known what they are mistaken about, if it is.
    betas : float array, shape (B,)
    gamma, c_suggest, lapse : float
        As in `AssistPOMDP.of` and `HumanModel`.
    optimal : bool
        Whether only optimal actions are suggested, or all.
    progress : callable, optional
        Called with how many sweeps have been made.

    Raises
    ------
    ValueError
        They are mistaken about actions, not states.
    """
    if human is not None and not mistaken_about_states(human):
        raise ValueError("expected somebody who is mistaken about states, not about actions")
    h = known.lookup(slice(None))
    mine = h
    if human is not None:
        blocks = [np.arange(begin, min(begin + BLOCK, len(h))) for begin in range(0, len(h), BLOCK)]
        mine = np.concatenate([expected(human, known, block, h[block]) for block in blocks])
    rows, costs = known.space.transitions, np.asarray(known.task.costs, dtype=np.float64)
    value = np.repeat(never_erring(h, costs, gamma)[:, None], len(betas), axis=1)
    order = np.argsort(h, kind="stable")
    order = order[np.isfinite(h[order]) & ~known.space.goal[order]]
    arrays = [read_only(array) for array in (order, *rows, costs, h, mine, betas)]
    for sweep in range(1, SWEEPS + 1):
        change = _sweep(value, *arrays, gamma, c_suggest, lapse, optimal)
        if progress is not None:
            progress(sweep)
        if change <= TOLERANCE:
            break
    value *= 1 - ROUNDING / (1 - gamma)  # values are negative
    return value


def mistaken_about_states(human: Human) -> bool:
    """Tell whether what somebody takes for the cost-to-go is a number for each state."""
    return isinstance(human.h, Misconception) and human.h.noise == "state"


@numba.njit(cache=True, nogil=True)
def _sweep(
    value: Floats, order: NDArray[np.int64], offsets: NDArray[np.int64], actions: NDArray[np.int64],
    targets: NDArray[np.int64], prices: Floats, h: Floats, mine: Floats, betas: Floats, gamma: float, c_suggest: float,
    lapse: float, optimal: bool,
) -> float:  # fmt: skip
    """Lower the value of every state once, in place, and return the largest change."""
    count = len(betas)
    most = 0
    for x in order:
        most = max(most, offsets[x + 1] - offsets[x])
    p, u = np.empty((most, count)), np.empty((most, count))
    alone, mean, best = np.empty(count), np.empty(count), np.empty(count)
    largest = 0.0
    for x in order:
        first, choices = offsets[x], offsets[x + 1] - offsets[x]
        least = np.inf
        for a in range(choices):
            least = min(least, prices[actions[first + a]] + mine[targets[first + a]])
        best[:] = 0.0
        for a in range(choices):
            q = prices[actions[first + a]] + mine[targets[first + a]] - least
            for b in range(count):
                # As in `decision.choice`; somebody of beta 0 does not look at what follows.
                p[a, b] = np.exp(-betas[b] * q) if betas[b] > 0.0 and least < np.inf else 1.0
                best[b] += p[a, b]
        alone[:] = 0.0
        mean[:] = 0.0
        for a in range(choices):
            y, cost = targets[first + a], prices[actions[first + a]]
            for b in range(count):
                p[a, b] /= best[b]
                u[a, b] = gamma * value[y, b] - cost
                alone[b] += p[a, b] * u[a, b]
                mean[b] += u[a, b] / choices
        for b in range(count):
            best[b] = (1.0 - lapse) * alone[b] + lapse * mean[b]
        for a in range(choices):
            if optimal and prices[actions[first + a]] + h[targets[first + a]] != h[x]:
                continue
            for b in range(count):
                heard = u[a, b]
                if p[a, b] < 0.9:
                    heard = max(heard, (alone[b] - p[a, b] * u[a, b]) / (1.0 - p[a, b]))
                else:  # a difference would lose its digits
                    for other in range(choices):
                        heard = max(heard, u[other, b])
                best[b] = max(best[b], (1.0 - lapse) * heard + lapse * mean[b] - c_suggest)
        for b in range(count):
            if best[b] < value[x, b]:
                largest = max(largest, value[x, b] - best[b])
                value[x, b] = best[b]
    return largest
