"""What somebody gets at most who complies with every suggestion: an upper bound in many states of a large table.

Where a part of a task breaks off, what follows has to be bounded for somebody known, whatever the robot does. Here they
do what it suggests, or avoid it, as is best for it, whatever their theta; else they choose as they do. No person gets
more: theta weighs one choice against the others, which keep their shares among themselves, so that what is done after a
suggestion is a mixture of what would be done with that choice alone and with all the others alone; and a mixture gets
no more than the best of what it mixes, of which the suggestion's cost is paid in any case. Coming costs nothing.

So theta need not be told apart: a state has one value for each beta, and a million states are swept over. Values start
from those of people who never err (`region.never_erring`) and every sweep leaves upper bounds, so that it does not
matter which states are swept, or how often.
"""

from __future__ import annotations

import math
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner import Table
from planner.system.jit import njit
from planner.system.machine import processors

from ..people.decision import Floats
from ..people.human import Human
from ..people.misconception import Misconception
from ..person.problem_arrays import read_only
from ..person.qmdp import ROUNDING
from .truncated_task import expected, never_erring

TOLERANCE = 0.02
"""Sweeps end when none changes a value by more, in cost units."""

SWEEPS = 15
"""And after so many in any case."""

SLIGHT = 1e-3
"""A state is left out of a sweep if nothing that follows it has changed by more since it was looked at."""

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class ComplianceBounds:
    """Upper bounds on what the robot gets with somebody whose beta is seen.

    Attributes
    ----------
    states : int array, shape (m,)
        As the table numbers them, ascending.
    value : float array, shape (m, B)
    """

    states: Ints
    value: Floats

    def at(self, states: Ints) -> Floats:
        """Give the bounds, shape (N, B), of some of these states."""
        return np.asarray(self.value[np.searchsorted(self.states, states)])


def around(known: Table, states: Ints, most: int) -> Ints:
    """Give these states and those that are next to them, layer by layer, up to about so many, ascending."""
    layer = found = np.unique(states)
    while len(layer) and len(found) < most:
        layer = np.setdiff1d(known.choices(layer).targets, found)[: most - len(found)]
        found = np.union1d(found, layer)
    return found


def at_most(
    known: Table,
    human: Human | None,
    betas: Floats,
    states: Ints,
    *,
    gamma: float,
    c_suggest: float,
    lapse: float,
    optimal: bool = True,
    deadline: float = math.inf,
) -> ComplianceBounds:
    """Bound from above what the robot gets with somebody from some states on.

    They choose by cost-to-go alone (eq. 5).

    Parameters
    ----------
    known : Table
    human : Human or None
        Of whom it is known what they are mistaken about, if it is.
    betas : float array, shape (B,)
    states : int array, shape (m,)
        Which are swept over, ascending; beyond them nobody errs.
    gamma, c_suggest, lapse : float
        As in `AssistPOMDP.of` and `HumanModel`.
    optimal : bool
        Whether only optimal actions are suggested, or all.
    deadline : float
        No sweep begins after this time on `time.perf_counter()`'s clock.

    Raises
    ------
    ValueError
        They are mistaken about actions, not states.
    """
    if human is not None and not mistaken_about_states(human):
        raise ValueError("expected somebody who is mistaken about states, not about actions")
    rows = known.choices(states)
    place = np.minimum(np.searchsorted(states, rows.targets), len(states) - 1)
    inside = states[place] == rows.targets
    rest = np.unique(rows.targets[~inside])
    number = np.where(inside, place, len(states) + np.searchsorted(rest, rows.targets)).astype(np.int32)
    every = np.concatenate([states, rest])
    h = known.lookup(every)
    mine = h if human is None else expected(human, known, every, h)
    costs = np.asarray(known.task.costs, dtype=np.float64)
    start = never_erring(h, costs, gamma)
    order = np.argsort(h[: len(states)], kind="stable")
    order = order[np.isfinite(h[order]) & ~known.is_goal(states)[order]]
    arrays = [read_only(array) for array in (order, rows.offsets, rows.actions, number, costs, h, mine)]

    def one(beta: float) -> Floats:
        value, stamp = start.copy(), np.zeros(len(start), dtype=np.uint8)
        for sweep in range(1, SWEEPS + 1):
            if time.perf_counter() > deadline:
                break
            if _sweep(value, stamp, sweep, *arrays, beta, gamma, c_suggest, lapse, optimal) <= TOLERANCE:
                break
        return value[: len(states)] * (1 - ROUNDING / (1 - gamma))  # values are negative

    with ThreadPoolExecutor(processors()) as threads:
        return ComplianceBounds(states, np.stack(list(threads.map(one, betas.tolist())), axis=1))


def mistaken_about_states(human: Human) -> bool:
    """Tell whether what somebody takes for the cost-to-go is a number for each state."""
    return isinstance(human.h, Misconception) and human.h.noise == "state"


@njit(nogil=True)
def _sweep(
    value: Floats, stamp: NDArray[np.uint8], sweep: int, order: Ints, offsets: Ints, actions: NDArray[np.integer],
    targets: NDArray[np.int32], prices: Floats, h: Floats, mine: Floats, beta: float, gamma: float, c_suggest: float,
    lapse: float, optimal: bool,
) -> float:  # fmt: skip
    """Lower the values of states once, in place, and return the largest change."""
    most = 0
    for x in order:
        most = max(most, offsets[x + 1] - offsets[x])
    p, u = np.empty(most), np.empty(most)
    largest = 0.0
    for x in order:
        first, choices = offsets[x], offsets[x + 1] - offsets[x]
        latest, least = 0, np.inf
        for a in range(choices):
            y = targets[first + a]
            latest = max(latest, stamp[y])
            p[a] = prices[actions[first + a]] + mine[y]
            least = min(least, p[a])
        if latest + 1 < sweep or choices == 0:
            continue
        total = 0.0
        for a in range(choices):
            # As in `decision.choice`; somebody of beta 0 does not look at what follows.
            p[a] = np.exp(-beta * (p[a] - least)) if beta > 0.0 and least < np.inf else 1.0
            total += p[a]
        alone, mean, highest = 0.0, 0.0, -np.inf
        for a in range(choices):
            p[a] /= total
            u[a] = gamma * value[targets[first + a]] - prices[actions[first + a]]
            alone += p[a] * u[a]
            mean += u[a] / choices
            highest = max(highest, u[a])
        best = (1.0 - lapse) * alone + lapse * mean
        for a in range(choices):
            if optimal and prices[actions[first + a]] + h[targets[first + a]] != h[x]:
                continue
            heard = highest  # where hardly anything but the suggestion is left, a difference would lose its digits
            if p[a] < 0.9:
                heard = max(u[a], (alone - p[a] * u[a]) / (1.0 - p[a]))
            best = max(best, (1.0 - lapse) * heard + lapse * mean - c_suggest)
        change = value[x] - best
        if change > 0.0:
            value[x] = best
            if change > SLIGHT:
                stamp[x] = sweep
            largest = max(largest, change)
    return largest
