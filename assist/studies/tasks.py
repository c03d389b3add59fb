"""Tasks of simulations: read and solved, or refused with a one-line error."""

from __future__ import annotations

from typing import TypeVar

from planner import Cache, CostToGo, Instance, LimitError, Table, cost_to_go, load, sweep
from planner.system.errors import InputFileError

from ..people.arguments import require_goal

Known = TypeVar("Known", bound=CostToGo)


MOST = 200_000
"""Largest number of states of a task that is solved whole, which takes about a second."""


def table_of(instance: Instance) -> Table:
    """Read and solve a task whose states are all needed.

    Parameters
    ----------
    instance : Instance

    Raises
    ------
    InputFileError
        The task has too many states, or its goal is unreachable.
    planner.PDDLError
    """
    try:
        table = sweep(load(instance), max_states=MOST)
    except LimitError as error:
        raise InputFileError(f"{instance}: {error}; expected a task of up to {MOST:,} states") from None
    return _solvable(instance, table)


def costs_of(instance: Instance) -> CostToGo:
    """Read and solve a task for simulation. States of tasks that are too large for a sweep are solved on demand.

    Raises
    ------
    InputFileError
        The goal is unreachable.
    planner.PDDLError
    """
    task = load(instance)
    return _solvable(instance, cost_to_go(task, cache=Cache(task)))


def _solvable(instance: Instance, known: Known) -> Known:
    try:
        require_goal(float(known.lookup([known.initial])[0]))
    except ValueError as error:
        raise InputFileError(f"{instance}: {error}") from None
    return known
