"""The one task that INSTANCE stands for: people are to be assisted in it, or were recorded in it."""

from __future__ import annotations

import math

from planner import Instance, InstanceError, LimitError, Table, find_instances, load, sweep

from ..team.pool import SIMULATED_STATES
from .console import EXIT_FAILED, fail


def one_instance(instance: str, domain: str | None) -> Instance:
    """Find the one problem that INSTANCE stands for."""
    found = find_instances([instance], domain)
    if len(found) != 1:
        raise InstanceError(f"{instance}: stands for {len(found)} problems; expected one")
    return found[0]


def table_of(instance: Instance) -> Table:
    """Read and solve a task that people are to be assisted in, and say in one line why that cannot be."""
    try:
        table = sweep(load(instance), max_states=SIMULATED_STATES)
    except LimitError as error:
        fail(f"{instance}: {error}; people are simulated on tasks of up to {SIMULATED_STATES:,} states", EXIT_FAILED)
    require_goal(instance, table[table.initial])
    return table


def require_goal(instance: Instance, cost: float) -> None:
    """Refuse a task that cannot be solved."""
    if not math.isfinite(cost):
        fail(
            f"{instance}: the goal cannot be reached from the initial state, so there is nobody to assist", EXIT_FAILED
        )
