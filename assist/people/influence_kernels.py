"""Influence and trust (equations 6 and 7), compiled, for one person, one choice and one theta at a time.

Simulation, fitting and solvers call these functions. The choice without a suggestion (equation 5) is an array from a
`choice_model`. Some loops rearrange an equation for speed (`person.qmdp`, `learning.likelihood`); tests compare them
with the equations of `decision`.
"""

from __future__ import annotations

import sys

from planner.system.jit import njit

from .decision import Floats

LARGEST = sys.float_info.max


@njit()
def weigh_by_influence(p: Floats, count: int, suggestion: int, theta: float) -> None:
    """Weigh the probabilities of `count` choices in place by a suggestion (equation 6), without normalisation.

    A suggestion after which no action would be possible is ignored.
    """
    others = 0.0
    for a in range(count):
        if a != suggestion:
            others += p[a]
    if theta * p[suggestion] + (1.0 - theta) * others > 0.0:
        for a in range(count):
            p[a] *= theta if a == suggestion else 1.0 - theta


@njit()
def influence_factors(theta: float, p: float, others: float) -> tuple[float, float]:
    """Return the factors by which a suggestion changes the probability of its choice and of each other (equation 6).

    `p` and `others` are the probabilities of the suggested choice and of all others. Both are parameters, because 1 - p
    would lose precision if p is almost 1. No factor is infinite, even for the smallest theta and others = 0.
    """
    total = theta * p + (1.0 - theta) * others
    if total > 0.0:
        return theta / total, min((1.0 - theta) / total, LARGEST)
    return 1.0, 1.0


@njit(inner=True)
def factors_after(suggested: int, theta: float, p: float, others: float) -> tuple[float, float]:
    """Return the factors as in `influence_factors`; 1 without a suggestion, if the suggested slot is negative."""
    return influence_factors(theta, p, others) if suggested >= 0 else (1.0, 1.0)


@njit()
def update_trust(theta: float, eta: float, gain: float) -> float:
    """Return theta after a suggestion that changes the person's value by `gain` (equation 7), in units of `eta`."""
    if eta == 0.0 or gain == 0.0:
        return theta
    return min(max(theta + eta * gain, 0.0), 1.0)
