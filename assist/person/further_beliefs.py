"""The search for bounds at further beliefs than those of the search from the prior, for bounds from sample paths."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.decision import Floats
from . import belief_hulls, hsvi
from .rounding import compiled as rounding
from .search import Search, relative_gap


def widen(
    search: Search, states: NDArray[np.int64], beliefs: Floats, gap: float, until: float, memory_limit_mb: float
) -> None:
    """Improve the bounds at further beliefs.

    Each belief gets one upper backup, then rounds of trials. A belief stays in the rounds while 60 backups of
    trials reduce its gap by more than 5 %. The numbers balance the effort between the beliefs.
    """
    flat = np.array(beliefs, dtype=float).reshape(len(states), -1)
    states = np.array(states, dtype=np.int64)
    step = search.options.finest * abs(search.bounds(int(states[0]), flat[0])[0])
    finest = (0.01, 0.05)  # coarser than at the root, since there are many beliefs
    fineness = np.array(finest)

    def once() -> None:
        at = 0
        while at < len(states) and search.make_room(memory_limit_mb):
            at = _upper_backups(at, states, flat, step, search.tables)

    def gains(i: int) -> bool:
        below, above = search.bounds(int(states[i]), flat[i])
        if relative_gap(below, above) <= gap:
            return False
        fineness[:] = finest
        hsvi.trials(int(states[i]), flat[i], gap * abs(below), 60, fineness, search.rng, search.tables)
        lower, upper = search.bounds(int(states[i]), flat[i])
        return upper - lower < 0.95 * (above - below)

    once()
    left = list(range(len(states)))
    while left:
        kept: list[int] = []
        for i in search.rng.permutation(left).tolist():
            if time.perf_counter() >= until or not search.make_room(memory_limit_mb):
                kept = []
                break
            if gains(i):
                kept.append(i)
        left = kept
    once()


@njit(nogil=True)
def _upper_backups(start, states, beliefs, step, s):
    """Back up the upper bound at beliefs, shape (N, H), of the given states, from index `start` on.

    Improvements up to `step` are not stored. Return where to continue if memory is short.
    """
    trial, hull, m, room = s.trial, s.hull, s.m, hsvi.new_room(s)
    margin = rounding(beliefs.shape[1] + m.targets.shape[1])
    for i in range(start, len(states)):
        if len(hull.drop) == hull.space[0]:
            return i
        x = states[i]
        trial.state[0] = x
        hsvi.start_node(hsvi.ZERO, beliefs[i], 1.0, s.q, trial, m)
        belief = trial.belief[0]  # given that the goal is none that is reached in x
        value = trial.q[0, hsvi.most_promising(hsvi.ZERO, room, trial, hull, m)]
        value += 2 * margin * abs(value)
        if value < belief_hulls.upper(x, belief, hull, room.program) - step - 4 * margin * abs(value):
            belief_hulls.add_point(x, belief, value, hull)
    return len(states)
