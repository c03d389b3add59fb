"""Memory of the subproblems of a bound, estimated before they are built."""

from __future__ import annotations

from planner import LimitError

from ..large_tasks.truncated_bound import TruncatedProblem
from ..people.arguments import positive
from ..team.memory_needed import policy_bytes
from ..team.time_expansion import TimeExpansion


def require_room(problems: list[TruncatedProblem], entry_steps: list[int], window: int, limit_mb: float) -> None:
    """Raise a `LimitError` if the subproblems would exceed the memory limit."""
    needed, states = 0.0, 0
    for one, steps in zip(problems, entry_steps, strict=True):
        alone = one.problem
        timed = window and one.outer is None
        if timed:  # each step has at least one state; enumerating them would take long
            refuse_above(limit_mb, policy_bytes(window), len(problems), window, window)
        states = len(TimeExpansion.of(alone, 2 + steps, window if timed else 0))
        slots, robots = alone.model.choices.applicable.shape[1], 1 + alone.suggested.shape[1]
        needed += policy_bytes(states, slots=slots, robots=robots)
    needed *= 1 + 1 / len(problems)  # in each round, one subproblem is built again
    needed += sum(one.outer.nbytes for one in problems if one.outer is not None)
    refuse_above(limit_mb, needed, len(problems), states, window)


def refuse_above(limit_mb: float, needed: float, kinds: int, states: int, window: int) -> None:
    """Raise a `LimitError` if the `needed` bytes of some kinds of subproblems exceed the limit."""
    if needed > positive("memory_limit_mb", limit_mb) * 1e6:
        raise LimitError(
            f"{kinds:,} {'problem' if kinds == 1 else 'problems'} of people, each of up to {states:,} states with "
            f"{window} steps of prices, take about {needed / 1e6:,.0f} MB of memory, and {limit_mb:,.0f} MB are "
            "allowed; expected one model for all (knowledge 'exact'), prices on fewer steps (window), or a higher limit"
        )
