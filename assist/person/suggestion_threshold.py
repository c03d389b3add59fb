"""The suggestion threshold: the largest cost of a suggestion at which a policy makes one.

The value of a suggestion depends on the cost of later suggestions, so that the threshold cannot be read off one policy.
The search tries lower costs, each with a policy that is solved for that cost.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..people.arguments import check_costs
from ..people.decision import NOTHING
from .pomdp import AssistPOMDP
from .solver import Solution, solve

SEARCHED_STATES = 20_000
"""Total number of states, over all people's tasks, up to which lower costs are tried.

One policy for so many states takes a few seconds to solve, and a search solves up to eight.
"""


@dataclass(frozen=True)
class SuggestionThreshold:
    """The reason why a policy that weighs costs has made no suggestion.

    Attributes
    ----------
    c_suggest : float
        The cost of a suggestion, in cost units, at which the policy made none.
    worth_at : float or None
        The largest tried cost at which the same policy makes a suggestion.
    searched : bool
        Whether lower costs were tried. If so and `worth_at` is None, the policy makes no suggestion even if it is free.
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

    The cost is divided by four up to five times. The last two costs then enclose the threshold, and three bisections on
    a logarithmic scale narrow it to a factor of 4 ** (1 / 8), about 1.2. Costs are rounded to two digits.

    Parameters
    ----------
    c_suggest : float
        Cost at which no suggestion is made, in cost units.
    suggests : callable or None
        Returns whether a suggestion is made at a lower cost; None if this would take too long.
    """
    if suggests is None:
        return SuggestionThreshold(c_suggest, None, searched=False)
    high = c_suggest
    for _ in range(5 if c_suggest else 0):
        low = _rounded(high / 4)
        if suggests(low):
            break
        high = low
    else:
        return SuggestionThreshold(c_suggest, 0.0 if c_suggest and suggests(0.0) else None, searched=True)
    for _ in range(3):
        between = _rounded(math.sqrt(low * high))
        if low < between < high:
            low, high = (between, high) if suggests(between) else (low, between)
    return SuggestionThreshold(c_suggest, low, searched=True)


def priced(pomdp: AssistPOMDP, c_suggest: float) -> AssistPOMDP:
    """Return the same problem with another cost of a suggestion."""
    check_costs(pomdp.gamma, c_suggest=c_suggest)
    costs = np.where(pomdp.suggested == NOTHING, pomdp.robot_costs, c_suggest)
    return replace(pomdp, c_suggest=c_suggest, robot_costs=costs)


def _rounded(cost: float) -> float:
    return float(f"{cost:.2g}")


def threshold_of(solution: Solution) -> SuggestionThreshold | None:
    """Return the threshold of one person's problem; None where a suggestion is worth its present cost.

    The result is also None if the solver was stopped before this was known. The search spends on each lower cost as
    many seconds as the solution took, but at least one. It ends earlier if the bounds decide the question.

    Parameters
    ----------
    solution : Solution
    """
    # The value without suggestions does not depend on their cost. A gain of 1e-3 cost units exceeds rounding errors.
    alone = solution.value_never + 1e-3
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
            # At a relative gap of 1 % without a decision, no suggestion is worth the cost for practical purposes.
            return solve(priced(pomdp, c_suggest), gap=0.01, time_limit=limit, bounds=check).lower > alone
        except _Decided as found:
            return found.suggests

    return search_threshold(pomdp.c_suggest, suggests if len(pomdp.robot_actions) <= SEARCHED_STATES else None)


class _Decided(Exception):  # noqa: N818  it ends a search and does not report an error
    """Raised when the bounds decide whether a suggestion is made."""

    def __init__(self, suggests: bool) -> None:
        super().__init__(suggests)
        self.suggests = suggests
