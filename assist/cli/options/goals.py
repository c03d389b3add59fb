"""The goals that a person may pursue, each from a problem file, and their cost-to-go."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import click

from planner import Cache, CostToGo, Instance, LimitError, Limits, OnDemand, find_instances, load, sweep_goals
from planner.costtogo.goals import require_same_states
from planner.system.machine import processors
from planner.system.progress import stages
from planner.system.threads import on_threads

from ..terminal.console import ExitCode, fail
from .task import tell_note, tell_of_compiling


def goals_of(
    problems: Sequence[str], *, domain: str | None, max_states: int, time_limit: float | None, cache: Path | None,
    jobs: int | None,
) -> dict[str, CostToGo]:  # fmt: skip
    """Return the cost-to-go of each problem's goal, by the problem's name. Expected errors end the command in one line.

    If there are too many states for tables, states are solved on demand.
    """
    found = find_instances(problems, domain)
    _same_domain(found)
    tell_of_compiling()
    tasks = on_threads(load, found, jobs or processors())
    for task in tasks:
        tell_note(task)
    require_same_states(tasks)
    counted = Counter(task.name for task in tasks)
    names = [task.name if counted[task.name] == 1 else str(task.instance) for task in tasks]
    every: Sequence[CostToGo]
    try:
        with stages() as show:
            every = sweep_goals(tasks, max_states=max_states, threads=jobs, progress=show)
    except LimitError as error:
        click.echo(f"evaluating states on demand: {error}", err=True)
        limits = Limits(seconds=time_limit)
        every = [OnDemand(task, cache=Cache(task, cache), jobs=jobs, limits=limits) for task in tasks]
    for costs in every:
        if costs.lookup([costs.initial])[0] == float("inf"):
            fail(f"{costs.task.instance}: the goal cannot be reached from the initial state", ExitCode.FAILED)
    return dict(zip(names, every, strict=True))


def _same_domain(found: Sequence[Instance]) -> None:
    """Check that all problems have the same domain file, or files with the same text."""
    first = found[0]
    for other in found[1:]:
        files = first.domain, other.domain
        if files[0] != files[1] and len({file.read_bytes() for file in files if file.is_file()}) > 1:
            fail(f"{other}: its domain is {files[1]}; expected {files[0]}, as for {first}", ExitCode.FAILED)


def prior_of(given: Sequence[str]) -> dict[str, float] | None:
    """Return the prior that `--prior` gives, by the names of the goals.

    Raises
    ------
    click.UsageError
        A part is not of the form GOAL=P.
    """
    prior: dict[str, float] = {}
    for pair in filter(None, (pair.strip() for text in given for pair in text.split(","))):
        name, _, share = (part.strip() for part in pair.rpartition("="))
        try:
            value = float(share)
        except ValueError:
            name = ""
        if not name or name in prior:
            raise click.UsageError(f"--prior {pair}: expected GOAL=PROBABILITY, once for each goal")
        prior[name] = value
    return prior or None
