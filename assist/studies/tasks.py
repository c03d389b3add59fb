"""Tasks of simulations: read and solved, or refused with a one-line error."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from planner import Cache, CostToGo, Instance, LimitError, Table, cost_to_go, load, sweep
from planner.system.errors import InputFileError

from ..people.arguments import require_goal

Known = TypeVar("Known", bound=CostToGo)


def table_of(instance: Instance, *, max_states: int = 200_000) -> Table:
    """Read and solve a task whose states are all needed.

    Parameters
    ----------
    instance : Instance
    max_states : int
        Largest number of states. The default takes about a second.

    Raises
    ------
    InputFileError
        The task has too many states, or its goal is unreachable.
    planner.PDDLError
    """
    try:
        table = sweep(load(instance), max_states=max_states)
    except LimitError as error:
        raise InputFileError(f"{instance}: {error}; expected a task of up to {max_states:,} states") from None
    return _solvable(instance, table)


def costs_of(instance: Instance, *, progress: Callable[[str, int, int | None], None] | None = None) -> CostToGo:
    """Read and solve a task for simulation. States of tasks that are too large for a sweep are solved on demand.

    Parameters
    ----------
    progress : callable, optional
        Receives the progress of the sweep.

    Raises
    ------
    InputFileError
        The goal is unreachable.
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
