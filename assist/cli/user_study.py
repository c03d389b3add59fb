"""The server socket of `serve`, and user studies that `serve` conducts or rehearses."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import click

from planner.batch.results_folder import SolveOptions
from planner.system.errors import MissingExtraError

from ..declare.options import Given
from .options.common import is_given
from .options.task import costs_of
from .terminal.console import ExitCode, fail, note

if TYPE_CHECKING:
    import socket

    from planner import CostToGo

    from ..studies.userstudy.plan import UserStudy
    from ..web.request_limits import Networks
    from ..web.user_study.service import StudyService

PORT = 8000  # usual port of local web servers that need no privileges
OF_STUDIES = {
    "study",
    "rehearse",
    "port",
    "host",
    "public_url",
    "trusted_proxy",
    "data",
    "config",
    "log_format",
    "changes",
    "setting_file",
}
"""Options that can be combined with `--study`. The study's file settles everything else."""


def live_server() -> ModuleType:
    """Return the module of the live assistant's server.

    Raises
    ------
    MissingExtraError
        The packages of the extra `web` are not installed.
    """
    try:
        from ..web import server
    except ImportError as error:
        raise MissingExtraError("the live assistant needs", str(error.name), "web") from None
    return server


def _public_address(_context: click.Context, _option: click.Parameter, given: str | None) -> str | None:
    from ..web.tokens import public_address

    try:
        return None if given is None else public_address(given)
    except ValueError as error:
        raise click.UsageError(f"--public-url {error}") from None


public_url_option = click.option(
    "--public-url", callback=_public_address, metavar="URL",
    help="Address of the service behind a proxy, such as https://host.example/kits.",
)  # fmt: skip


def _networks(_context: click.Context, _option: click.Parameter, given: tuple[str, ...]) -> Networks:
    if not given:
        return ()
    from ..web.request_limits import networks

    try:
        return networks(given)
    except ValueError as error:
        raise click.UsageError(f"--trusted-proxy {error}") from None


trusted_proxy_option = click.option(
    "--trusted-proxy", callback=_networks, multiple=True, metavar="ADDRESS",
    help="Address or network of a proxy whose X-Forwarded-For names the client. Can be repeated.",
)  # fmt: skip


def listen(host: str, port: int | None, public_url: str | None) -> socket.socket:
    """Return a listening socket. If no port is given, use `PORT`, or any free port if `PORT` is taken."""
    server = live_server()
    found: socket.socket = server.listen(host, PORT if port is None else port, otherwise=0 if port is None else None)
    if public_url is not None:
        note(f"listening at {server.address(found)} for a proxy that serves {public_url}")
    return found


def new_folder() -> Path:
    """Make a temporary folder for a session without `--data`, and return its path."""
    return Path(tempfile.mkdtemp(prefix="kitassist-"))


def conduct(
    file: Path, data: Path | None, given: Given[Any], host: str, port: int | None, rehearse: int,
    public_url: str | None, trusted_proxies: Networks,
) -> None:  # fmt: skip
    """Serve a user study. After a rehearsal, write its export and report."""
    context = click.get_current_context()
    for name in context.params:
        if is_given(name) and name not in {*OF_STUDIES, "changes", "setting_file"}:
            option = next(one for one in context.command.params if one.name == name)
            raise click.UsageError(f"{option.opts[0]} cannot be combined with --study; the study's file sets it")
    for source, _ in given.sources.values():
        raise click.UsageError(f"{source} cannot be combined with --study; the study's file sets it")
    try:
        from planner.system.errors import InputFileError

        from ..people.user_code import UserCodeError
        from ..studies.userstudy.plan_file import read
        from ..web.user_study import server as serving
    except ImportError as error:
        raise MissingExtraError("user studies need", str(error.name), "study") from None
    try:
        study = read(file)
    except InputFileError as error:
        fail(str(error), ExitCode.USAGE)
    if study.participants is not None and rehearse > study.participants:
        raise click.UsageError(f"--rehearse {rehearse}: the study is planned for {study.participants} participants")
    if study.group is not None and rehearse % study.group.size:
        raise click.UsageError(f"--rehearse {rehearse}: expected a multiple of {study.group.size}, the size of a group")
    if data is None and not rehearse:
        raise click.UsageError("--study: expected --data DIR as well, the folder in which the study's data are saved")
    folder = data or new_folder()
    if rehearse and any((folder / name).exists() for name in ("journal.sqlite", "journal.jsonl")):
        raise click.UsageError(f"--data {folder}: contains a study already; expected another folder for each rehearsal")
    tasks = _tasks(study)

    def ready(service: StudyService) -> None:
        links = {"url": service.access.base, "operator": service.operator_url()}
        click.echo(json.dumps({**links, "join": {"everybody": service.join_url()}}))
        note(f"the study is saved in {folder}; Ctrl-C ends the service, --data {folder} resumes it")

    try:
        with listen(host, port, public_url) as listening:
            serving.serve(
                study, tasks, folder, listening, ready, participants=rehearse, public_url=public_url,
                trusted_proxies=trusted_proxies,
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
        try:
            Artist(found[name].task)
        except ValueError as error:
            raise click.UsageError(str(error)) from None
    return found


def _report(folder: Path) -> None:
    """Write the export and the report of a rehearsal."""
    from planner.system.files import atomic

    from ..studies.reports.userstudy_report import ReportWording, write_report
    from ..studies.userstudy.export import archive
    from ..studies.userstudy.session import EXPORT, REPORT

    with atomic(folder / EXPORT) as path:
        path.write_bytes(archive(folder))
    for text in ReportWording().notes(write_report(folder, folder / REPORT)):
        note(text.replace("**", ""))
    click.echo(f"export: {folder / EXPORT}; report: {folder / REPORT / 'report.md'}", err=True)
