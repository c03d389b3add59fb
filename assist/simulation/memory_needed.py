"""Memory of a pool and of a simulation's records, estimated before anything is allocated."""

from __future__ import annotations

import sys

from planner import LimitError

from ..people.arguments import positive

MEMORY_LIMIT_MB = 4000.0
"""Default limit of the memory of all people's policies, and of all records of a simulation, in MB."""


ONE_FOR_ALL = "a smaller pool, one policy for all (knowledge 'exact'), or "


def require_room(one: int, rows: int, models: int, limit_mb: float, goals: int = 1) -> None:
    """Raise a `LimitError` if the policies of `one` bytes each would exceed the memory limit.

    They have `rows` for all goals together.
    """
    needed = (models + 1) * one / 1e6  # a sorted copy of one policy's values exists temporarily
    if needed > positive("memory_limit_mb", limit_mb):
        who, less = ("one person", "") if models == 1 else (f"{models:,} people", ONE_FOR_ALL)
        size = f"{rows // goals:,} states" + (f" and {goals} goals" if goals > 1 else "")
        raise LimitError(
            f"policies for {who} on a task of {size} take about {needed:,.0f} MB of memory, and "
            f"{limit_mb:,.0f} MB are allowed; expected {less}a higher memory limit"
        )


def states_within(limit_mb: float, goals: int, models: int) -> int:
    """Return the number of states of a truncated task for each goal, so that all policies are within the limit.

    With one goal, the number is not limited: a policy's truncated task takes some tens of MB.

    Raises
    ------
    LimitError
        There would be fewer than 20 states for each goal.
    """
    if goals == 1:
        return sys.maxsize
    of_a_state, least = 6_000, 20  # bytes: values with and without a robot that comes and goes, and choices
    states = int(limit_mb * 1e6 / (of_a_state * goals * (models + 1)))
    if states < least:
        needed = of_a_state * goals * (models + 1) * least / 1e6
        raise LimitError(
            f"policies for {models:,} people with {goals} goals take about {needed:,.0f} MB of memory even on {least} "
            f"states, and {limit_mb:,.0f} MB are allowed; expected {ONE_FOR_ALL}a higher memory limit"
        )
    return states


def require_room_for_people(size: int, one: int, limit_mb: float) -> None:
    """Raise a `LimitError` if people with `one` bytes of perceived cost-to-go each would exceed the memory limit."""
    needed = size * (2000 + one) / 1e6  # a person and their policy take about 2,000 bytes
    if needed > positive("memory_limit_mb", limit_mb):
        raise LimitError(
            f"{size:,} people take about {needed:,.0f} MB of memory, and {limit_mb:,.0f} MB are allowed; expected a "
            "smaller pool, or a higher memory limit"
        )


def require_room_for_episodes(count: int, places: int, memory_limit_mb: float) -> None:
    """Raise a `LimitError` if the records of some episodes would exceed the memory limit."""
    needed = count * (57 * places + 40) / 1e6
    if needed > positive("memory_limit_mb", memory_limit_mb):
        raise LimitError(
            f"{count:,} episodes of {places} people take {needed:,.0f} MB of memory, and {memory_limit_mb:,.0f} MB are "
            f"allowed; expected at most {int(memory_limit_mb / needed * count):,} episodes, or a higher memory limit"
        )
