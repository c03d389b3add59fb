"""The options of `fit`, and the replay of a log and the estimates that are computed with them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray

import planner
from planner import Instance, LimitError, Limits, find_instances
from planner.system.machine import processors
from planner.system.progress import progress_bar, stages

from ..terminal.console import ExitCode, fail
from .common import (
    JOBS,
    NUMBER,
    OUTPUT_FOLDER,
    SEED,
    Command,
    Option,
    lapse_option,
    max_states_option,
    scale_option,
    seconds_option,
    with_options,
)
from .goals import goals_of, prior_of
from .population import choice_model, people_option
from .task import tell_note, tell_of_compiling

if TYPE_CHECKING:
    from planner import CostToGo, OnDemand

    from ...learning.comparison import Comparison
    from ...learning.fit import FittedPeople
    from ...learning.likelihood import Method
    from ...learning.log import Fault, Log
    from ...learning.observations import EvaluatedStates
    from ...learning.replay import Recording


def reading_options(command: Command) -> Command:
    """Add the options for reading a log and for evaluating the states that it visits."""
    options: tuple[Option[Any], ...] = (
        click.option(
            "--drop", multiple=True, metavar="ACTION",
            help="Ignore actions with this name, or with this name and arguments.",
        ),
        click.option(
            "--rename", multiple=True, metavar="OLD=NEW",
            help="Replace the name OLD in the log by NEW. May be repeated.",
        ),
        click.option(
            "--columns", multiple=True, metavar="NAME=COLUMN,...",
            help="Names of the log's columns, such as person=worker,action=move.",
        ),
        click.option(
            "--gaps", is_flag=True, help="Accept gaps in step numbers. Otherwise a gap means that lines are missing."
        ),
        click.option(
            "--strict", is_flag=True, help="Stop if any line cannot be used, or if any state exceeds the time limit."
        ),
        max_states_option("On a larger task evaluate only states that were visited, and their successors."),
        seconds_option("Seconds for each of these states."),
        click.option(
            "--cache", type=OUTPUT_FOLDER,
            help="Folder for the cost-to-go of solved states.  [default: kitassist in the user's cache folder]",
        ),
        click.option("--jobs", type=JOBS, help="Number of processors. All unless given."),
    )  # fmt: skip
    return with_options(command, options)


def log_options(command: Command) -> Command:
    """Add the options for reading a log and estimating people. `replayed` takes those that concern the log."""
    options: tuple[Option[Any], ...] = (
        click.option(
            "--misconception", "misconceptions", is_flag=True,
            help="Also estimate misconceptions: their size (sigma) and the perceived cost-to-go.",
        ),
        click.option(
            "--terms", is_flag=True,
            help="Fit preferences besides cost (hierarchical model).",
        ),
        click.option(
            "--compare", is_flag=True,
            help="Compare choice models by cross-validation over people.",
        ),
        click.option(
            "--folds", type=click.IntRange(2), default=8, show_default=True,
            help="Number of folds of --compare.",
        ),
        people_option,
        click.option("--eta", type=NUMBER, help="Rate of the trust update (eta). Estimated unless given."),
        scale_option,
        lapse_option("Weight of a uniform choice."),
        click.option("--level", type=NUMBER, default=0.95, show_default=True, help="Confidence level of intervals."),
        click.option(
            "--largest-beta", type=NUMBER,
            help="Upper end of the range of expertise (beta).  [default: 10, divided by the cost of the smallest "
                 "possible mistake]",
        ),
        reading_options,
        click.option("--seed", type=SEED, default=0, show_default=True, help="Random seed of the model check."),
    )  # fmt: skip
    return with_options(command, options)


class Replayed(NamedTuple):
    """A log that was replayed in its task, and the data that estimates are computed from."""

    log: Log
    walked: OnDemand
    recording: Recording
    evaluated: EvaluatedStates
    faults: tuple[Fault, ...]
    method: Method
    jobs: int


def replayed(
    found: Instance,
    file: Path,
    *,
    drop: tuple[str, ...],
    rename: tuple[str, ...],
    columns: tuple[str, ...],
    gaps: bool,
    strict: bool,
    jobs: int | None,
    max_states: int,
    time_limit: float | None,
    cache: Path | None,
    **setting: Any,
) -> Replayed:
    """Read a log and replay it in the task of an instance. Expected errors end the command in one line.

    Raises
    ------
    click.UsageError
        An option has an invalid value.
    """
    from ...learning.fit import LogError, require_actions
    from ...learning.likelihood import Method
    from ...learning.log import told
    from ...learning.replay import replay

    names = renamed(rename)
    try:
        method = Method(**setting)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    log = log_of(file, columns, gaps=gaps)
    tell_of_compiling()
    task = planner.load(found)
    tell_note(task)
    if task.decided_by_translator:
        why = "the goal is unreachable or holds in the initial state, so nothing can be estimated"
        fail(f"{found}: {why}", ExitCode.FAILED)
    walked = planner.OnDemand(task)
    try:
        recording, more = replay(log, walked, drop=drop, rename=names)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    faults = tuple(sorted([*log.faults, *more], key=lambda fault: fault.line))
    for line in told(faults, file):
        click.echo(line, err=True)
    if strict and faults:
        fail(f"{file}: nothing is fitted, because of --strict", ExitCode.FAILED)
    jobs = jobs or processors()
    try:
        require_actions(log, recording, walked)
    except LogError as error:
        fail(str(error), ExitCode.FAILED)
    evaluated = _evaluate(walked, recording.wanted(), max_states, time_limit, cache, jobs, strict=strict)
    return Replayed(log, walked, recording, evaluated, faults, method, jobs)


def people_of(
    known: Replayed, *, misconceptions: bool, terms: bool, people: str | None, max_states: int, seed: int
) -> FittedPeople:
    """Estimate the parameters of the people in a log. Expected errors end the command in one line."""
    from ...large_tasks.person_problem import WHOLE, is_whole
    from ...learning.fit import LogError, learn
    from ...people.choice_model import ChoiceModelError
    from ...people.user_code import UserCodeError

    try:
        chooses = None if people is None else choice_model(people)
    except UserCodeError as error:
        fail(str(error), ExitCode.FAILED)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    task = known.walked.task
    table: CostToGo | None = None
    if chooses is not None:
        table = planner.cost_to_go(task, max_states=min(WHOLE, max_states), cache=planner.Cache(task))
    if table is not None and not is_whole(table):
        raise click.UsageError(f"--people: expected a task of at most {min(WHOLE, max_states):,} states")
    try:
        with progress_bar("fitting people", len(known.recording.people)) as advance:
            return learn(
                known.log, known.walked, known.recording, known.evaluated, faults=known.faults, method=known.method,
                misconceptions=misconceptions, terms=terms, chooses=chooses, table=table, seed=seed, jobs=known.jobs,
                progress=advance,
            )  # fmt: skip
    except (LogError, ChoiceModelError) as error:
        fail(str(error), ExitCode.FAILED)


def people_with_goals(
    instance: str, problems: tuple[str, ...], prior: tuple[str, ...], file: Path, *, domain: str | None,
    drop: tuple[str, ...], rename: tuple[str, ...], columns: tuple[str, ...], gaps: bool, strict: bool,
    jobs: int | None, max_states: int, time_limit: float | None, cache: Path | None, **setting: Any,
) -> FittedPeople:  # fmt: skip
    """Estimate people who pursue the goal of INSTANCE or of a further problem. Expected errors end the command."""
    from ...learning.fit import LogError
    from ...learning.goal_fit import learn_with_goals
    from ...learning.goals import recorded
    from ...learning.likelihood import Method
    from ...learning.log import told
    from ...people.goals import prior_over

    names = renamed(rename)
    try:
        method = Method(**setting)
        log = log_of(file, columns, gaps=gaps)
        every = list(dict.fromkeys(str(found.problem) for found in find_instances([instance, *problems], domain)))
        goals = goals_of(
            every, domain=domain, max_states=max_states, time_limit=time_limit, cache=cache, jobs=jobs,
        )  # fmt: skip
        shares = prior_over(goals, prior_of(prior, "--goal-prior"))
        found = recorded(goals, log, drop=drop, rename=names, strict=strict)
        for line in [*told(found.faults, file), *found.notes]:
            click.echo(line, err=True)
        with progress_bar("fitting people", len(found.recording.people)) as advance:
            return learn_with_goals(
                log, found, tuple(goals), shares, method=method, jobs=jobs or processors(), progress=advance
            )
    except LogError as error:
        fail(str(error), ExitCode.FAILED)
    except ValueError as error:
        raise click.UsageError(str(error)) from None


def comparison_of(known: Replayed, folds: int) -> Comparison:
    """Compare choice models on the people in a log. Expected errors end the command in one line."""
    from ...learning.comparison import compare_observed
    from ...learning.fit import LogError, observed
    from ...people.terms import TERMS

    try:
        observations, _ = observed(known.log, known.walked, known.recording, known.evaluated, TERMS)
        with progress_bar("comparing models", len(TERMS) + 2) as advance:
            return compare_observed(observations, known.method, folds=folds, name=str(known.log.name), progress=advance)
    except LogError as error:
        fail(str(error), ExitCode.FAILED)


def log_of(file: Path, columns: tuple[str, ...], *, gaps: bool) -> Log:
    """Read a log. Invalid columns raise usage errors; what was guessed about the file is printed to stderr."""
    from ...learning.log import read_log

    named = _columns(columns)
    try:
        log = read_log(file, gaps=gaps, columns=named)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    if log.note:
        click.echo(f"{file}: {log.note}", err=True)
    return log


def renamed(pairs: tuple[str, ...]) -> dict[str, str]:
    """Return the task's name of each action name that `--rename` maps."""
    names: dict[str, str] = {}
    for pair in pairs:
        old, _, new = (part.strip() for part in pair.partition("="))
        if not old or not new:
            raise click.UsageError(f"--rename {pair}: expected OLD=NEW")
        if names.setdefault(old.lower(), new) != new:
            raise click.UsageError(f"--rename {pair}: '{old}' is renamed already")
    return names


def _columns(given: tuple[str, ...]) -> dict[str, str]:
    """Return the log's own name of each column that `--columns` maps."""
    names: dict[str, str] = {}
    for pair in filter(None, (pair.strip() for text in given for pair in text.split(","))):
        name, _, column = (part.strip() for part in pair.partition("="))
        if not name or not column:
            raise click.UsageError(f"--columns {pair}: expected NAME=COLUMN")
        if names.setdefault(name.lower(), column) != column:
            raise click.UsageError(f"--columns {pair}: '{name}' has a column already")
    return names


def _evaluate(
    walked: OnDemand, wanted: NDArray[np.int64], max_states: int, time_limit: float | None, cache: Path | None,
    jobs: int, *, strict: bool,
) -> EvaluatedStates:  # fmt: skip
    """Evaluate the wanted states among those that were visited, by a sweep or on demand.

    States that exceed the time limit get NaN. With `strict`, they raise `LimitError`.
    """
    from ...learning.observations import EvaluatedStates

    values, limits = walked.values(wanted), Limits(seconds=time_limit)
    kept = planner.Cache(walked.task, cache)
    what = f"evaluating {len(wanted):,} states"
    with stages() as show:
        show(what, 0, None)
        costs = planner.cost_to_go(
            walked.task, values, max_states=max_states, cache=kept, jobs=jobs, limits=limits,
            progress=lambda of_all, done, total: show(f"{what}; all of the task, {of_all}", done, total),
        )  # fmt: skip
    numbers = costs.numbers(values)
    if not isinstance(costs, planner.OnDemand):
        return EvaluatedStates.of(costs, numbers, costs.lookup(numbers), wanted, len(walked))
    if np.isnan(costs.known(numbers)).any():
        click.echo(f"evaluating {len(wanted)} states on demand: {costs.reason}", err=True)
    with progress_bar("evaluating states", len(wanted)) as advance:
        try:
            h = costs.lookup(numbers, advance)
        except LimitError as error:
            if strict:
                raise
            h = costs.known(numbers)
            click.echo(f"{error}; actions that depend on them are left out", err=True)
    return EvaluatedStates.of(costs, numbers, h, wanted, len(walked))
