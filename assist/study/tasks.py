"""Tasks that people are simulated on: read, solved, and refused in one line where that cannot be."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from planner import Cache, CostToGo, Instance, LimitError, Table, cost_to_go, load, sweep
from planner.system.errors import InputFileError

from ..people.choices import require_goal

Known = TypeVar("Known", bound=CostToGo)


LOOKED_AT_WHOLE = 200_000
"""The largest task that is looked at whole where nothing else will do."""


def table_of(instance: Instance) -> Table:
    """Read and solve a task that has to be looked at whole.

    Raises
    ------
    InputFileError
        It has too many states, or its goal cannot be reached.
    planner.PDDLError
    """
    try:
        table = sweep(load(instance), max_states=LOOKED_AT_WHOLE)
    except LimitError as error:
        raise InputFileError(f"{instance}: {error}; expected a task of up to {LOOKED_AT_WHOLE:,} states") from None
    return _solvable(instance, table)


def costs_of(instance: Instance, *, progress: Callable[[str, int, int | None], None] | None = None) -> CostToGo:
    """Read and solve a task that people are to be simulated on; one that cannot be swept is asked on demand.

    Parameters
    ----------
    progress : callable, optional
        Of the sweep.

    Raises
    ------
    InputFileError
        Its goal cannot be reached.
    planner.PDDLError
    """
    task = load(instance)
    return _solvable(instance, cost_to_go(task, cache=Cache(task), progress=progress))


def _solvable(instance: Instance, known: Known) -> Known:
    try:
        require_goal(float(known.lookup([known.initial])[0]))
    except ValueError as error:
        raise InputFileError(f"{instance}: {error}") from None
    return known
