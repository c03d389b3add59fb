"""Prices of the robot's attention on truncated tasks, where prices need the outer relaxation."""

from __future__ import annotations

from planner import LimitError

from ..people.arguments import whole
from ..people.decision import Floats
from .computation import Computation
from .priced_steps import window_of
from .prices import SubproblemGroup


def truncated_prices(run: Computation, window: int | None) -> tuple[int, list[SubproblemGroup], Floats]:
    """Optimise the prices; return the number of steps in which people are at work, the subproblems and the prices.

    Parameters
    ----------
    run : Computation
    window : int or None
        The requested number of steps with prices, if any.
    """
    priced = window is not None or _worth_prices(run)
    if window is not None:
        together = most = whole("window", window)
    else:
        together = window_of(run.pool, run.team, run.seed) if priced or run.paths else 0
        most = min(together, run.options.priced_steps)
    groups, steps = _with_outer(run, most if priced and len(run.team) > 1 else 0, window is not None)
    # The outer relaxations have had 30 % of the time, and the solver needs more of the rest.
    price = run.optimised(groups, steps, 0.3 + 0.25)
    if run.needs_prices(steps) and not price.size:
        groups = run.groups(0, run.paths > 0)
    return together, groups, price


def _worth_prices(run: Computation) -> bool:
    """Return whether prices are optimised: not if states need searches, robots execute actions or memory is short."""
    searches = run.pool.setting.fleet.executes or any(policy.problem.searches for policy in run.policies)
    return not searches and run.memory_limit_mb / len(run.policies) >= run.options.price_memory_mb


def _with_outer(run: Computation, steps: int, wanted: bool) -> tuple[list[SubproblemGroup], int]:
    """Return the groups, and the number of steps with prices that the memory allows.

    The number is 0 if the effect of prices at a frontier is unknown, unless prices are requested.
    """
    while steps:
        try:
            groups = run.groups(steps, True)
        except LimitError:
            steps //= 2
            continue
        if wanted or all(group.problem.between is not None or group.visits.pomdp.frontier is None for group in groups):
            return groups, steps
        break
    return run.groups(0, run.paths > 0), 0
