"""Influence and trust (eq. 6 and 7), compiled: for code that takes one person, one choice, one theta at a time.

What simulates, fits and searches calls these; the choice without a suggestion (eq. 5) comes to it as an array, from a
`choice_model`. Where a loop was made faster by arranging an equation in another way (`person.qmdp`,
`person.alpha_vectors`, `learning.likelihood`), tests hold it to those of `decision`.
"""

from __future__ import annotations

import sys

from planner.system.jit import njit

from .decision import Floats

LARGEST = sys.float_info.max


@njit()
def heed(p: Floats, count: int, suggestion: int, theta: float) -> None:
    """Weigh the chances of `count` choices by a suggestion (eq. 6), not normalised.

    A suggestion that leaves no action possible is ignored.
    """
    others = 0.0
    for a in range(count):
        if a != suggestion:
            others += p[a]
    if theta * p[suggestion] + (1.0 - theta) * others > 0.0:
        for a in range(count):
            p[a] *= theta if a == suggestion else 1.0 - theta


@njit()
def answer(theta: float, p: float, others: float) -> tuple[float, float]:
    """Give the factors by which a suggestion changes the chance of the suggested choice, and of each other (eq. 6).

    `p` and `others` are the chances of the suggested choice and of all others; they are given both, since 1 - p would
    lose its digits where p is almost 1. No factor is infinite, not even where theta is the least number there is and
    all others have no chance, which stays none.
    """
    total = theta * p + (1.0 - theta) * others
    if total > 0.0:
        return theta / total, min((1.0 - theta) / total, LARGEST)
    return 1.0, 1.0


@njit()
def moved(theta: float, eta: float, gain: float) -> float:
    """Give theta after a suggestion that changes the person's value by `gain` (eq. 7), in units of `eta`."""
    if eta == 0.0 or gain == 0.0:
        return theta
    return min(max(theta + eta * gain, 0.0), 1.0)
