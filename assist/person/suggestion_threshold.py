"""The cost of suggestions from which on downwards a policy makes one.

What a suggestion is worth depends on the cost of later ones. So the threshold cannot be read off a policy: lower costs
are tried, each with a policy that is solved for it, until a suggestion is made.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from .solver import Solution, solve

QUARTERS, FINER = 5, 3
"""How often the cost is divided by four until a suggestion is made, and how often the last two costs are bisected."""

MARGIN = 1e-3
"""Cost units that suggestions have to gain in all, to count: more than the rounding of values."""

ENOUGH = 0.01
"""Relative gap at which a lower cost is given up, if no suggestion has been found to be worth it."""

LARGEST = 20_000
"""States, of all people's tasks together, up to which lower costs are tried: solving these takes a few seconds."""


@dataclass(frozen=True)
class SuggestionThreshold:
    """The reason why a policy that weighs costs has made no suggestion.

    Attributes
    ----------
    c_suggest : float
        The cost of a suggestion at which it made none.
    worth_at : float or None
        The largest cost of those tried at which the same policy makes one.
    searched : bool
        Whether lower costs were tried. If so and `worth_at` is None, no suggestion is worth making even if it is free.
    """

    c_suggest: float
    worth_at: float | None
    searched: bool

    def __str__(self) -> str:
        reason = f"no suggestion was worth its cost (c_suggest {self.c_suggest:g})"
        if self.worth_at:
            return f"{reason}; from {self.worth_at:g} downwards some are"
        if self.searched:
            return f"{reason}; {'none' if self.worth_at is None else 'some'} would be if they were free"
        return reason


def search_threshold(c_suggest: float, suggests: Callable[[float], bool] | None) -> SuggestionThreshold:
    """Return the threshold below a cost at which no suggestion is made.

    Parameters
    ----------
    c_suggest : float
        The cost at which none is made.
    suggests : callable or None
        Whether a suggestion is made at a lower cost; None where that would take too long to find out.
    """
    if suggests is None:
        return SuggestionThreshold(c_suggest, None, searched=False)
    high = c_suggest
    for _ in range(QUARTERS if c_suggest else 0):
        low = _rounded(high / 4)
        if suggests(low):
            break
        high = low
    else:
        return SuggestionThreshold(c_suggest, 0.0 if c_suggest and suggests(0.0) else None, searched=True)
    for _ in range(FINER):
        between = _rounded(math.sqrt(low * high))
        if low < between < high:
            low, high = (between, high) if suggests(between) else (low, between)
    return SuggestionThreshold(c_suggest, low, searched=True)


def _rounded(cost: float) -> float:
    return float(f"{cost:.2g}")


def threshold_of(solution: Solution) -> SuggestionThreshold | None:
    """Return the threshold of one person's problem; None where a suggestion is worth its present cost.

    It is None, too, where the solver was stopped before that was known. Each lower cost is tried for as many seconds as
    the solution took, and at least one, unless the bounds decide it before.

    Parameters
    ----------
    solution : Solution
    """
    alone = solution.value_never + MARGIN  # it does not depend on the cost of suggestions
    undecided = solution.stopped in ("time", "memory") and solution.upper > alone
    if solution.lower > alone or undecided:
        return None
    pomdp = solution.pomdp

    def suggests(c_suggest: float) -> bool:
        def check(_: float, lower: float, upper: float) -> None:
            if lower > alone or upper < alone:
                raise _Decided(lower > alone)

        try:
            limit = max(1.0, solution.seconds)
            return solve(pomdp.priced(c_suggest), gap=ENOUGH, time_limit=limit, bounds=check).lower > alone
        except _Decided as found:
            return found.suggests

    return search_threshold(pomdp.c_suggest, suggests if len(pomdp.robot_actions) <= LARGEST else None)


class _Decided(Exception):  # noqa: N818  it ends a search and is no error
    """The bounds decide whether a suggestion is made."""

    def __init__(self, suggests: bool) -> None:
        super().__init__(suggests)
        self.suggests = suggests
