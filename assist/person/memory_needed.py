"""Memory of the first bounds of a solution, estimated before they are computed."""

from __future__ import annotations

from planner import LimitError

from .pomdp import AssistPOMDP
from .search import SolverOptions


def first_bounds_bytes(pomdp: AssistPOMDP, depth: int = SolverOptions.depth) -> int:
    """Return the approximate memory, in bytes, that `solve` needs before its search begins."""
    slots, hidden = pomdp.model.choices.targets.shape[1], pomdp.prior.size
    states, robots = pomdp.task_states, pomdp.suggested.shape[1]
    # QMDP's values and a copy; the corners; vectors and witnesses of four policies; the values of one policy.
    return 8 * hidden * (states * (2 * robots + 12) + depth * (8 + robots * slots))


def depth_within(pomdp: AssistPOMDP, limit_mb: float) -> int:
    """Return the largest length of a trial, of 500, 250 and 125 steps, that leaves a fifth of the memory limit free."""
    depth = SolverOptions.depth
    while depth > 125 and first_bounds_bytes(pomdp, depth) > 0.8e6 * limit_mb:
        depth //= 2
    return depth


def require_room(pomdp: AssistPOMDP, depth: int, limit_mb: float) -> None:
    """Raise a `LimitError` if the first bounds would exceed the memory limit."""
    needed = first_bounds_bytes(pomdp, depth) / 1e6
    if needed > limit_mb:
        raise LimitError(
            f"the first bounds on {pomdp.task_states:,} states take about {needed:,.0f} MB of memory, and "
            f"{limit_mb:,.0f} MB are allowed; expected fewer states, a coarser grid or more memory"
        )
