"""Memory of a pool and of a simulation's records, estimated before anything is allocated."""

from __future__ import annotations

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
