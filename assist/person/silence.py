"""Why a policy has made no suggestion, and at which cost of suggestions it would make one.

What a suggestion is worth depends on what later ones cost. So that cost is not read off a policy: lower costs are
tried, with policies worked out for them, until a suggestion is made.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from .solver import Solution, solve

QUARTERS, FINER = 5, 3
"""How often a quarter of the cost is tried until a suggestion is made, and how often a cost between the last two."""

MARGIN = 1e-3
"""What suggestions have to gain in all, in cost units, to count: more than values are off by."""

ENOUGH = 0.01
"""Relative gap at which a lower cost is given up, if no suggestion has been found to be worth it."""

LARGEST = 20_000
"""States, of all people's tasks together, up to which lower costs are tried: solving these takes a few seconds."""


@dataclass(frozen=True)
class Silence:
    """A policy that weighs costs has made no suggestion, as none was worth its cost.

    Attributes
    ----------
    c_suggest : float
        What a suggestion cost.
    worth_at : float or None
        The largest cost of those tried at which the same policy makes one: from there on downwards they are worth it.
    looked : bool
        Whether lower costs were tried; if so and `worth_at` is None, no suggestion is worth making even if it is free.
    """

    c_suggest: float
    worth_at: float | None
    looked: bool

    def __str__(self) -> str:
        said = f"no suggestion was worth its cost (c_suggest {self.c_suggest:g})"
        if self.worth_at:
            return f"{said}; from {self.worth_at:g} downwards some are"
        if self.looked:
            return f"{said}; {'none' if self.worth_at is None else 'some'} would be if they were free"
        return said


def silence(c_suggest: float, said: Callable[[float], bool] | None) -> Silence:
    """Describe why nothing was said.

    Parameters
    ----------
    c_suggest : float
        The cost at which it was not.
    said : callable or None
        Tells whether something is said at a lower cost; None where that would take too long.
    """
    if said is None:
        return Silence(c_suggest, None, looked=False)
    high = c_suggest
    for _ in range(QUARTERS if c_suggest else 0):
        low = _rounded(high / 4)
        if said(low):
            break
        high = low
    else:
        return Silence(c_suggest, 0.0 if c_suggest and said(0.0) else None, looked=True)
    for _ in range(FINER):
        between = _rounded(math.sqrt(low * high))
        if low < between < high:
            low, high = (between, high) if said(between) else (low, between)
    return Silence(c_suggest, low, looked=True)


def _rounded(cost: float) -> float:
    return float(f"{cost:.2g}")


def silence_of(solution: Solution) -> Silence | None:
    """Describe why a person is best left alone, as far as is known; None where a suggestion is worth its cost.

    Each lower cost is tried as long as the solution took, or a second if that is more, unless it is clear before.

    Parameters
    ----------
    solution : Solution
    """
    alone = solution.value_never + MARGIN  # which suggestions do not change, whatever they cost
    open_still = solution.stopped in ("time", "memory") and solution.upper > alone
    if solution.lower > alone or open_still:
        return None
    pomdp = solution.pomdp

    def said(c_suggest: float) -> bool:
        def look(_: float, lower: float, upper: float) -> None:
            if lower > alone or upper < alone:
                raise _Clear(lower > alone)

        try:
            limit = max(1.0, solution.seconds)
            return solve(pomdp.priced(c_suggest), gap=ENOUGH, time_limit=limit, bounds=look).lower > alone
        except _Clear as found:
            return found.said

    return silence(pomdp.c_suggest, said if len(pomdp.robot_actions) <= LARGEST else None)


class _Clear(Exception):  # noqa: N818  it ends a search and is no error
    """It is clear whether something is said."""

    def __init__(self, said: bool) -> None:
        super().__init__(said)
        self.said = said
