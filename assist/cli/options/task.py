"""The single task that INSTANCE denotes, read and solved."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import click

import planner
from planner import InputFileError, Instance, LimitError, find_instances
from planner.system.jit import compiling
from planner.system.progress import compiling_line, stages

from ..terminal.console import ExitCode, fail, note

if TYPE_CHECKING:
    from planner import CostToGo, Table, Task

Known = TypeVar("Known", bound="CostToGo")


def one_instance(instance: str, domain: str | None) -> Instance:
    """Return the single problem that INSTANCE denotes."""
    found = find_instances([instance], domain)
    if len(found) != 1:
        several = f"{len(found)} problems, such as {found[0]}"
        raise InputFileError(f"{instance}: matches {several}; expected one of them")
    return found[0]


def tell_of_compiling() -> None:
    """Make the running command announce compilation, if any function is compiled before the command ends."""
    context = click.get_current_context(silent=True)
    if context is not None:
        context.with_resource(compiling(compiling_line(note)))


def tell_note(task: Task) -> None:
    """Tell the reader's note on a task, if there is one."""
    if task.note:
        note(f"{task.instance}: {task.note}")


MOST = 200_000
"""Largest number of states of a task that is solved whole, which takes about a second."""


def table_of(instance: Instance) -> Table:
    """Return the cost-to-go table of an instance. An instance that cannot be used ends the command with one line."""
    tell_of_compiling()
    task = planner.load(instance)
    tell_note(task)
    try:
        return _solvable(planner.sweep(task, max_states=MOST))
    except LimitError as error:
        fail(f"{instance}: {error}; expected a task of up to {MOST:,} states", ExitCode.FAILED)


def costs_of(instance: Instance, *, max_states: int, memory_limit_mb: float | None) -> CostToGo:
    """Read a task of any size and return its cost-to-go. States of tasks above `max_states` are solved on demand."""
    tell_of_compiling()
    task = planner.load(instance)
    tell_note(task)
    with stages() as show:
        known = planner.cost_to_go(
            task, max_states=max_states, memory_limit_mb=memory_limit_mb, cache=planner.Cache(task), progress=show
        )
    return _solvable(known)


def _solvable(known: Known) -> Known:
    """Return the cost-to-go of a task whose goal can be reached; another task ends the command with one line."""
    from ...people.arguments import require_goal

    try:
        require_goal(float(known.lookup([known.initial])[0]))
    except ValueError as error:
        fail(f"{known.task.instance}: {error}", ExitCode.FAILED)
    return known
