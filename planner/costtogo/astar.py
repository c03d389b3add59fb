"""The cost-to-go of one state, from Fast Downward's A*, and what its sums of costs allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..grounding import fast_downward
from ..grounding.fast_downward import NO_LIMITS, CostLimitError, Limits
from ..grounding.task import Task
from ..states.successors import can_hold

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
