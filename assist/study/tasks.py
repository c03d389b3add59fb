"""Tasks that people are simulated on: read, solved, and refused in one line where that cannot be."""

from __future__ import annotations

from planner import Instance, LimitError, Table, load, sweep

from ..people.choices import require_goal
from ..team.pool import SIMULATED_STATES
from .study import StudyError


def table_of(instance: Instance) -> Table:
    """Read and solve a task that people are to be simulated on.

    Raises
    ------
    StudyError
        It has too many states, or its goal cannot be reached.
    planner.PDDLError
    """
    try:
        table = sweep(load(instance), max_states=SIMULATED_STATES)
    except LimitError as error:
        raise StudyError(
            f"{instance}: {error}; people are simulated on tasks of up to {SIMULATED_STATES:,} states"
        ) from None
    try:
        require_goal(table[table.initial])
    except ValueError as error:
        raise StudyError(f"{instance}: {error}") from None
    return table
