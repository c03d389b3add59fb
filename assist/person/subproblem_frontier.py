"""Leaf bounds of an attention subproblem on a truncated task."""

from __future__ import annotations

import numpy as np

from ..people.decision import Floats
from .leaf_bounds import LeafBounds
from .pomdp import AssistPOMDP
from .time_expansion import AWAY, HERE, TimeExpansion


def frontier_of(alone: AssistPOMDP, layout: TimeExpansion, price: Floats, entry: float) -> LeafBounds | None:
    """Return the frontier bounds of a subproblem whose person alone has a frontier: at every step and position.

    Upper bound: no policy exceeds the value of a robot that is always present without a price. If the value of a robot
    that is away is known, the subproblem ends with it. A robot on its way then counts as present: these values are
    those of one that waits for free (`truncated_bound`).

    Lower bound (otherwise): a robot that is here can stay, and act like one that is always present, for at most the sum
    of all later prices. A robot that is away can come first, if that takes no time. A robot on a longer way can leave
    on arrival and stay away; then the worst case is assumed.
    """
    if alone.frontier is None:
        return None
    index = np.full(layout.states, -1)
    index[alone.frontier.states] = np.arange(len(alone.frontier.states))
    if alone.frontier.away is not None:
        ends = index[layout.x] >= 0
        states = np.flatnonzero(ends | (layout.cut & ~alone.model.choices.goal[layout.x]))
        known = np.stack([alone.frontier.away, alone.frontier.upper])
        upper = np.zeros((len(states), *known.shape[2:]))  # 0 is an upper bound, as costs are positive
        at = states[ends[states]]
        upper[ends[states]] = known[np.minimum(layout.position[at], HERE), index[layout.x[at]]]
        return LeafBounds(states, upper, upper)
    assert layout.kept is None
    states = np.flatnonzero(index[layout.x] >= 0)
    at = index[layout.x[states]]
    position = layout.position[states]
    upper = alone.frontier.upper[at]
    paid = np.append(np.cumsum((price * alone.gamma ** np.arange(len(price)))[::-1])[::-1], 0.0)
    paid = (paid / alone.gamma ** np.arange(len(paid)))[layout.step[states]]
    lower = alone.frontier.lower[at] - (paid + entry * (position == AWAY))[:, None, None]
    if layout.positions > 2:
        floor = -np.inf if alone.frontier.floor is None else alone.frontier.floor
        lower[position != HERE] = floor - paid[position != HERE, None, None]
    return LeafBounds(states, np.minimum(lower, 0.0), upper)
