"""The goals that a person may pursue, each from a problem file, and their cost-to-go."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import planner
from planner import Instance, LimitError, Limits, find_instances
from planner.batch.results_folder import SolveOptions
from planner.system.limits import processors
from planner.system.processes import on_threads
from planner.system.progress import stages

from ...declare.options import Given
from ..terminal.console import ExitCode, fail, note, usage_errors
from .task import tell_note, tell_of_compiling

if TYPE_CHECKING:
    from planner import CostToGo

    from ...people.goals import Goals
    from ...person.settings import Setting


def goals_of(
    problems: Sequence[str], *, domain: str | None, max_states: int, time_limit: float | None = None,
    cache: Path | None = None, jobs: int | None = None, tables: bool = False,
) -> dict[str, CostToGo]:  # fmt: skip
    """Return the cost-to-go of each problem's goal, by the problem's name. Expected errors end the command in one line.

    If there are too many states for tables, states are solved on demand, or, with `tables`, a `LimitError` is raised.
    """
    from planner.costtogo.goal_tables import require_same_states

    found = find_instances(problems, domain)
    _same_domain(found)
    tell_of_compiling()
    tasks = on_threads(planner.load, found, jobs or processors())
    for task in tasks:
        tell_note(task)
    require_same_states(tasks)
    counted = Counter(task.name for task in tasks)
    names = [task.name if counted[task.name] == 1 else str(task.instance) for task in tasks]
    every: Sequence[CostToGo]
    try:
        with stages() as show:
            every = planner.sweep_goals(tasks, max_states=max_states, threads=jobs, progress=show)
    except LimitError as error:
        if tables:
            raise
        note(f"evaluating states on demand: {error}")
        limits = Limits(seconds=time_limit)
        every = [planner.OnDemand(task, cache=planner.Cache(task, cache), jobs=jobs, limits=limits) for task in tasks]
    for costs in every:
        if costs.lookup([costs.initial])[0] == float("inf"):
            fail(f"{costs.task.instance}: the goal cannot be reached from the initial state", ExitCode.FAILED)
    return dict(zip(names, every, strict=True))


goals_option = click.option(
    "--goals", "problems", multiple=True, metavar="PROBLEM",
    help="A problem with a further goal, or a folder of problems. Repeat it for several.",
)  # fmt: skip


def check_questions(setting: Setting, given: Given[Any], problems: Sequence[str], *, doubtful: bool = False) -> None:
    """Raise a usage error if a robot would ask where no question is possible.

    Parameters
    ----------
    setting, given
        A command's setting, and what of it was given.
    problems : sequence of str
        Values of `--goals`.
    doubtful : bool
        Whether a question about the last action is possible.
    """
    if not problems and not doubtful:
        given.refuse(["c_ask"], "without --goals")
    if setting.c_ask is None:
        given.refuse(["ask_error"], "without c_ask")
    if not problems:
        given.refuse(["goal_prior", "goal_knowledge"], "without --goals")


def several_goals(
    instance: str,
    problems: Sequence[str],
    prior: Mapping[str, float],
    *,
    domain: str | None,
    max_states: int = SolveOptions.max_states,
) -> Goals | None:
    """Return the goals of INSTANCE and of further problems; None if there is one only."""
    from ...people.goals import Goals, prior_over

    if not problems:
        return None
    every = list(dict.fromkeys(str(found.problem) for found in find_instances([instance, *problems], domain)))
    try:
        known = goals_of(every, domain=domain, max_states=max_states, tables=True)
    except LimitError as error:
        fail(f"--goals: {error}; expected a task of at most {max_states:,} states", ExitCode.FAILED)
    with usage_errors():
        prior_over(known, prior or None, "goal_prior")
        return Goals(known, prior)  # type: ignore[arg-type]


def _same_domain(found: Sequence[Instance]) -> None:
    """Check that all problems have the same domain file, or files with the same text."""
    first = found[0]
    for other in found[1:]:
        files = first.domain, other.domain
        if files[0] != files[1] and len({file.read_bytes() for file in files if file.is_file()}) > 1:
            fail(f"{other}: its domain is {files[1]}; expected {files[0]}, as for {first}", ExitCode.FAILED)
