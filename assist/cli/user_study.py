"""User studies that `serve` conducts or rehearses."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from planner.batch.results_folder import SolveOptions
from planner.system.errors import MissingExtraError
from planner.system.progress import stages

from ..declare.options import Given
from .options.common import is_given, new_folder
from .options.listening import Listening
from .options.task import costs_of
from .terminal.console import ExitCode, fail, note, one_line_errors, usage_errors

if TYPE_CHECKING:
    from planner import CostToGo

    from ..studies.userstudy.plan import UserStudy
    from ..web.user_study.service import StudyService

OF_STUDIES = {
    "study", "rehearse", "port", "host", "public_url", "trusted_proxy", "data", "config", "log_format", "changes",
    "setting_file",
}  # fmt: skip
"""Options that can be combined with `--study`. The study's file settles everything else."""


def conduct(file: Path, data: Path | None, given: Given[Any], at: Listening, rehearse: int) -> None:
    """Serve a user study. After a rehearsal, write its export and report."""
    context = click.get_current_context()
    for name in context.params:
        if is_given(name) and name not in OF_STUDIES:
            option = next(one for one in context.command.params if one.name == name)
            raise click.UsageError(f"{option.opts[0]} cannot be combined with --study; the study's file sets it")
    if "tasks" in (context.default_map or {}):
        raise click.UsageError("the table tasks cannot be combined with --study; the study's file sets it")
    for source, _ in given.sources.values():
        raise click.UsageError(f"{source} cannot be combined with --study; the study's file sets it")
    try:
        from ..people.user_code import UserCodeError
        from ..studies.reports.preregistration import changed
        from ..studies.userstudy.export import REGISTERED
        from ..studies.userstudy.forecast import Forecast
        from ..studies.userstudy.plan_file import read
        from ..studies.userstudy.session import JOURNAL, REHEARSED
        from ..web.user_study import server as serving
        from ..web.user_study.rehearsal import Rehearsal
    except ImportError as error:
        raise MissingExtraError("user studies need", str(error.name), "study") from None
    study = read(file)
    if study.participants is not None and rehearse > study.participants:
        raise click.UsageError(f"--rehearse {rehearse}: the study is planned for {study.participants} participants")
    if study.group is not None and rehearse % study.group.size:
        raise click.UsageError(f"--rehearse {rehearse}: expected a multiple of {study.group.size}, the size of a group")
    if data is None and not rehearse:
        raise click.UsageError("--study: expected --data DIR as well, the folder in which the study's data are saved")
    folder = data or new_folder()
    if rehearse and (folder / JOURNAL).exists():
        raise click.UsageError(f"--data {folder}: contains a study already; expected another folder for each rehearsal")
    if rehearse and (folder / REGISTERED).exists():
        raise click.UsageError(f"--data {folder}: a study is registered there; expected another folder for a rehearsal")
    if not rehearse and (folder / REHEARSED).exists():
        raise click.UsageError(f"--data {folder}: has a rehearsal; expected another folder for the study itself")
    if (deviates := changed(study, folder)) is not None:
        note(deviates)
    note("preparing the study; its links follow")
    tasks = _tasks(study)

    def ready(service: StudyService) -> None:
        links = {"url": service.access.base, "operator": service.operator_url()}
        click.echo(json.dumps({**links, "join": {"everybody": service.join_url()}}))
        note(
            f"{rehearse} simulated participants take part; their data are saved in {folder}" if rehearse
            else f"the study is saved in {folder}; Ctrl-C ends the service, --data {folder} resumes it"
        )  # fmt: skip

    if rehearse:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / REHEARSED).touch()
    try:
        if not rehearse and not (folder / JOURNAL).exists():  # of a rehearsal the report says the same
            for text in Forecast.of(study, tasks, briefly=True).seldom_assisted():
                note(text)
        with (
            one_line_errors(f"interrupted; `kitassist study-report {folder}` reports on those who were there"),
            at.listen() as listening, stages() if rehearse else nullcontext() as show,
        ):  # fmt: skip
            serving.serve(
                study, tasks, folder, listening, ready, rehearsal=Rehearsal(rehearse, show) if show else None,
                public_url=at.public_url, trusted_proxies=at.trusted_proxy,
            )  # fmt: skip
    except UserCodeError as error:
        fail(str(error), ExitCode.USAGE)
    if rehearse:
        _report(folder)


def _tasks(study: UserStudy) -> dict[str, CostToGo]:
    """Read and solve the tasks of a study. Check their drawings first, so that faults show before a page is served."""
    from ..drawing import Artist

    found: dict[str, CostToGo] = {}
    instances = dict(study.tasks) | ({} if study.practice is None else {"practice": study.practice})
    for name, instance in instances.items():
        same = next((other for other in found if instances[other] == instance), None)
        found[name] = (
            found[same] if same else costs_of(instance, max_states=SolveOptions.max_states, memory_limit_mb=None)
        )
        with usage_errors():
            Artist(found[name].task)
    return found


def _report(folder: Path) -> None:
    """Write the export and the report of a rehearsal. A policy that failed ends the command with its exit code."""
    from planner.system.files import atomic

    from ..studies.reports.userstudy_report import ReportWording, write_report
    from ..studies.userstudy.export import archive
    from ..studies.userstudy.session import EXPORT, REPORT

    with atomic(folder / EXPORT) as path:
        path.write_bytes(archive(folder))
    summary = write_report(folder, folder / REPORT)
    for text in ReportWording().notes(summary):
        note(text.replace("**", ""))
    click.echo(f"export: {folder / EXPORT}; report: {folder / REPORT / 'report.md'}", err=True)
    if summary["faults"]:
        raise SystemExit(ExitCode.FAILED)
