"""The options for reading a log and estimating people, and the replay of a log with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

import planner
from planner import Instance, LimitError, Limits, find_instances
from planner.system.errors import InputFileError
from planner.system.limits import processors
from planner.system.progress import adding, stages

from ...declare.declared import Whole, names_of
from ...declare.options import Value
from ..terminal.console import ExitCode, fail, usage_errors
from .common import INPUT_FILE, Option, domain_option, jobs_option, together
from .goals import goals_of
from .settings import EstimateSetting, GoalSetting, ReadingSetting
from .task import one_instance, tell_note, tell_of_compiling

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from planner import CostToGo, OnDemand

    from ...learning.evidence import Evidence
    from ...learning.log import Fault, Log
    from ...learning.method import Method
    from ...learning.observations import EvaluatedStates


folds_option = click.option(
    "--folds", type=Value(Whole, ge=2), default=8, show_default=True,
    help="Number of groups of people, each of which is predicted from the others; at most one for each person.",
)  # fmt: skip


def method_of(setting: EstimateSetting) -> Method:
    """Return the options of the estimation."""
    from ...learning.method import Method

    return Method(**{name: getattr(setting, name) for name in names_of(Method)})


def carried(seen: Evidence, setting: EstimateSetting) -> bool | None:
    """Return whether theta is carried from episode to episode, if the setting says it; else say what the log tells."""
    if setting.theta_per_episode is not None:
        return not setting.theta_per_episode
    if seen.log.simulated:
        said = "a simulation wrote the log (policy, theta), so that theta begins anew in each episode"
        click.echo(f"{seen.log.name}: {said}; --set theta_per_episode=false carries it over", err=True)
    return None


class ReadingOptions(NamedTuple):
    """How a log is read besides the command's setting."""

    drop: tuple[str, ...]
    rename: tuple[str, ...]
    columns: tuple[str, ...]
    strict: bool
    jobs: int | None

    def replayed(
        self, file: Path, setting: ReadingSetting, problems: Sequence[str], task: Any, **more: Any
    ) -> Evidence:  # fmt: skip
        """Replay a log, as `learning.replayed` does; tell its faults. Expected errors end the command in one line.

        `task` returns what is replayed in: the tasks of the problems.
        """
        from ...learning.evidence import replayed
        from ...learning.log import as_one_goal, selected, told
        from ...people.action_names import words_of

        def tell(log: Log, faults: tuple[Fault, ...]) -> None:
            for line in told(faults, file):
                click.echo(line, err=True)
            if (lost := selected(log, faults)) is not None:
                click.echo(f"{file}: {lost}", err=True)
            if self.strict:
                fail(f"{file}: nothing is estimated, because of --strict", ExitCode.FAILED)

        names = renamed(self.rename)
        log = log_of(file, problems, self.columns, gaps=setting.gaps)
        tasks = task()
        if not isinstance(tasks, Mapping) and (said := as_one_goal(log)) is not None:
            click.echo(f"{file}: {said}", err=True)
        try:
            with usage_errors(InputFileError):
                called = {names.get(name, name) for name in log.called}
                drop = [one for one in self.drop if not called or {*words_of(one)[:1]} <= called]
                for one in self.drop:  # the same options may be given with several logs
                    if one not in drop:
                        click.echo(f"{file}: --drop {one}: no action is called so", err=True)
                found = replayed(tasks, log, tell=tell, drop=drop, rename=names, strict=self.strict, **more)
        except InputFileError as error:
            fail(str(error), ExitCode.FAILED)
        for note in found.notes:
            click.echo(note, err=True)
        return found


reading_options = together(
    "reading", ReadingOptions,
    (
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
            "--strict", is_flag=True, help="Stop if any line cannot be used, or if any state exceeds the time limit."
        ),
        jobs_option,
    ),
)  # fmt: skip


class TaskLog(NamedTuple):
    """A task and a log of what people did in it."""

    instance: str | None
    file: Path | None
    domain: str | None

    def found(self) -> tuple[Instance, Path, dict[str, Path | None]]:
        """Return the instance, the log, and both and the domain as the command's input files.

        Raises
        ------
        click.UsageError
            There is none, and no other data in its place.
        """
        if self.instance is None or self.file is None:
            raise click.UsageError("expected INSTANCE and LOG, or --advice")
        found = one_instance(self.instance, self.domain)
        return found, self.file, {"INSTANCE": found.problem, "its domain": found.domain, "LOG": self.file}


def task_log_options(*, required: bool = True) -> Option[Any]:
    """Return what adds the arguments INSTANCE and LOG, and the option `--domain`."""
    return together(
        "log", TaskLog,
        (
            click.argument("instance", metavar="INSTANCE", required=required),
            click.argument("file", metavar="LOG", type=INPUT_FILE, required=required),
            domain_option,
        ),
    )  # fmt: skip


def with_task(
    found: Instance, file: Path, reading: ReadingOptions, setting: ReadingSetting, *, choices: bool = False
) -> Evidence:
    """Replay a log in the task of an instance. Expected errors end the command in one line.

    With `choices`, the result answers for further states, as a choice model asks for those that suggestions lead to.
    """

    def loaded() -> CostToGo:
        tell_of_compiling()
        task = planner.load(found)
        tell_note(task)
        if task.decided_by_translator:
            why = "the goal is unreachable or holds in the initial state, so nothing can be estimated"
            fail(f"{found}: {why}", ExitCode.FAILED)
        if choices:
            return planner.cost_to_go(
                task, max_states=setting.max_states, cache=planner.Cache(task, _cache(setting)), jobs=reading.jobs,
                limits=Limits(seconds=setting.time_limit),
            )  # fmt: skip
        walked.append(planner.OnDemand(task))
        return walked[0]

    walked: list[OnDemand] = []
    evaluate = None if choices else lambda wanted: _evaluate(walked[0], wanted, reading, setting)
    return reading.replayed(file, setting, [str(found.problem)], loaded, evaluate=evaluate)


def with_goals(
    problems: Sequence[str], file: Path, domain: str | None, reading: ReadingOptions,
    setting: GoalSetting | EstimateSetting,
) -> Evidence:  # fmt: skip
    """Replay a log in the tasks of several goals. Expected errors end the command in one line."""
    from ...people.goals import prior_over

    every = list(dict.fromkeys(str(found.problem) for found in find_instances(problems, domain)))

    def loaded() -> dict[str, CostToGo]:
        found = goals_of(
            every, domain=domain, max_states=setting.max_states, time_limit=setting.time_limit, cache=_cache(setting),
            jobs=reading.jobs,
        )  # fmt: skip
        with usage_errors():
            prior_over(found, setting.goal_prior or None, "goal_prior")
        return found

    return reading.replayed(file, setting, every, loaded, prior=setting.goal_prior or None)


def _cache(setting: ReadingSetting) -> Path | None:
    return None if setting.cache is None else Path(setting.cache)


def log_of(file: Path, problems: Sequence[str], columns: tuple[str, ...], *, gaps: bool) -> Log:
    """Read the log of some tasks. Invalid columns raise usage errors; what was guessed is printed to stderr."""
    from ...learning import log as logs

    named = _columns(columns)
    with usage_errors(InputFileError):
        log = logs.log_of(file, problems, gaps=gaps, columns=named)
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
    walked: OnDemand, wanted: NDArray[np.int64], reading: ReadingOptions, setting: ReadingSetting
) -> EvaluatedStates:
    """Evaluate the wanted states among those that were visited, by a sweep or on demand.

    States that exceed the time limit get NaN. With `strict`, they raise `LimitError`.
    """
    import numpy as np

    from ...learning.observations import EvaluatedStates

    values, limits = walked.values(wanted), Limits(seconds=setting.time_limit)
    kept = planner.Cache(walked.task, _cache(setting))
    what = f"evaluating {len(wanted):,} states"
    with stages() as show:
        show(what, 0, None)
        costs = planner.cost_to_go(
            walked.task, values, max_states=setting.max_states, cache=kept, jobs=reading.jobs or processors(),
            limits=limits, progress=lambda of_all, done, total: show(f"{what}; all of the task, {of_all}", done, total),
        )  # fmt: skip
    numbers = costs.numbers(values)
    if not isinstance(costs, planner.OnDemand):
        return EvaluatedStates.of(costs, numbers, costs.lookup(numbers), wanted, len(walked))
    if np.isnan(costs.known(numbers)).any():
        click.echo(f"evaluating {len(wanted)} states on demand: {costs.reason}", err=True)
    with stages() as show:
        try:
            h = costs.lookup(numbers, adding(show, "evaluating states", len(wanted)))
        except LimitError as error:
            if reading.strict:
                raise
            h = costs.known(numbers)
            click.echo(f"{error}; actions that depend on them are left out", err=True)
    return EvaluatedStates.of(costs, numbers, h, wanted, len(walked))
