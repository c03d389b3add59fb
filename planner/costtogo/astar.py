"""The cost-to-go of one state, from Fast Downward's A*, and what its sums of costs allow."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

from ..grounding import fast_downward
from ..grounding.fast_downward import FastDownwardError
from ..grounding.task import Task
from ..states.packing import can_hold
from ..system.limits import NO_LIMITS, CostLimitError, LimitError, Limits

OVERFLOW = 1 << 31
"""Fast Downward's sums of costs have to stay below this."""

PATIENCE = 60.0
"""Seconds for a search with large costs, if there is no other limit: above 2^29 some were seen not to end."""

LARGE = OVERFLOW // 1000
"""From such a cost on no heuristic is trusted, whose sums are not known: a thousand of such actions overflow."""


def astar(
    task: Task, state: Sequence[int] | None = None, *, search: str | None = None, limits: Limits = NO_LIMITS
) -> tuple[float, list[str] | None]:
    """Ask Fast Downward's A* for h* of one state and an optimal plan from it.

    Parameters
    ----------
    task : Task
    state : sequence of int, shape (variables,), optional
        A reachable state; the initial one unless given.
    search : str, optional
        A search configuration of Fast Downward that is optimal; one that is, and fits the task, unless given.
    limits : Limits
        Of the search.

    Returns
    -------
    h : float
        Infinite where Fast Downward proves that there is no plan.
    plan : list of str or None

    Raises
    ------
    LimitError
        Out of time or memory, or costs too large for Fast Downward: nothing is known about the state.

    Notes
    -----
    Fast Downward adds costs in 32 bits. Costs are divided by their greatest common divisor first. If a thousand of the
    dearest actions could still overflow, the search is blind, whatever `search` says: it expands states in the order
    of their distance g from the beginning, at most the optimal cost C, so that no sum is larger than C + 2 c for the
    dearest action's cost c. A plan of cost P with P + 2 c below `OVERFLOW` is optimal therefore, since C is at most P.
    Any other answer is refused.
    """
    if not task.goal:  # Fast Downward wants one, and each variable in it once
        return 0.0, []
    if not can_hold(task.goal):
        return float("inf"), None
    sas, dearest = with_small_costs(task)
    if dearest >= LARGE:
        search = fast_downward.ASTAR_WITH_AXIOMS
        limits = limits if limits.seconds is not None else replace(limits, seconds=PATIENCE)
    if dearest >= OVERFLOW:
        raise CostLimitError(f"{task.instance}: a cost of {dearest} is more than Fast Downward can read")
    if state is not None:  # Fast Downward wants derived variables at their defaults, and derives them itself
        state = tuple(
            value if variable.axiom_layer < 0 else default
            for value, default, variable in zip(state, task.initial, task.variables, strict=True)
        )
    plan = fast_downward.optimal_plan(sas, state, search=search, limits=limits)
    if plan is None:
        return float("inf"), None
    cost = task.plan_cost(plan)
    if task.reduced.plan_cost(plan) + 2 * dearest >= OVERFLOW:
        raise CostLimitError(f"{task.instance}: Fast Downward's sums of costs may overflow, its plan costs {cost}")
    return float(cost), plan


def with_small_costs(task: Task) -> tuple[str, int]:
    """Return a task's SAS text with costs divided by their greatest common divisor, and the largest cost in it."""
    return task.reduced.sas, max(task.reduced.costs, default=1)


CANDIDATES = (
    fast_downward.ASTAR,
    "astar(landmark_cost_partitioning(lm_hm(m=2)))",
    "astar(lmcut())",
    "astar(hmax())",
)
"""Search configurations of which the fastest on a task is used; all give the exact cost."""


QUICK = 0.05
"""Seconds of a search of which so much is Fast Downward's start that none is worth comparing with it."""


UNIT = 1000  # what a unit of cost is worth in prices, where an action is worth 1; plans are shorter


LARGEST = 2**31  # beyond, Fast Downward's sums overflow


def priced(task: Task) -> tuple[Task, int]:
    """Give a task as Fast Downward is asked about it, and the price of a unit of cost there.

    Where actions cost nothing, every action costs one more than `UNIT` times its cost, so that of the cheapest plans
    one with the fewest actions is the best.
    """
    return (task, 1) if min(task.costs, default=1) > 0 else (counted(task), UNIT)


def counted(task: Task) -> Task:
    """Give a task whose costs count its actions as well, each as the least part of `UNIT`."""
    return replace(task, costs=tuple(cost * UNIT + 1 for cost in task.costs))


class Chosen(NamedTuple):
    """A search configuration, and what it found on the way: the plan from the initial state, None from a dead end."""

    search: str
    solved: bool
    plan: list[str] | None


def fastest_search(task: Task, candidates: Iterable[str] = CANDIDATES, *, limits: Limits = NO_LIMITS) -> Chosen:
    """Choose the search configuration that solves a task's initial state fastest.

    Each gets as long as the best so far has taken; once one took no longer than `QUICK`, no other is tried.
    Configurations that do not support the task's features are left out.

    Raises
    ------
    LimitError
        None of them solved the initial state within the limits.
    """
    if not task.goal or not can_hold(task.goal):
        return Chosen(fast_downward.ASTAR, True, None if task.goal else [])
    sas, dearest = with_small_costs(task)
    if fast_downward.has_axioms(sas) or dearest >= LARGE:
        return Chosen(fast_downward.ASTAR_WITH_AXIOMS, False, None)
    best, shortest = None, limits.seconds
    for search in candidates:
        start = time.monotonic()
        try:
            plan = fast_downward.optimal_plan(sas, search=search, limits=replace(limits, seconds=shortest))
        except (LimitError, FastDownwardError):
            continue
        seconds = time.monotonic() - start
        if shortest is None or seconds < shortest:
            best, shortest = Chosen(search, True, plan), seconds
            if seconds <= QUICK:
                break
    if best is None:
        raise LimitError("no search configuration solved the initial state within the limits")
    return best
