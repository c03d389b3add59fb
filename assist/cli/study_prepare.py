"""The command `study-prepare`: what is done for a user study before its first participant."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import click

from .options.common import INPUT_FILE, data_option
from .options.help import command
from .terminal.console import ExitCode, fail, print_json
from .user_study import public_url_option


@command("study-prepare study.toml --data pilot", "study-prepare")
@click.argument("file", metavar="FILE.toml", type=INPUT_FILE)
@data_option(required=True)
@click.option(
    "--links", type=INPUT_FILE, metavar="FILE",
    help="Print a signed link for each participant ID in this file, one a line, instead of registering.",
)  # fmt: skip
@public_url_option
def study_prepare(file: Path, data: Path, links: Path | None, public_url: str | None) -> None:
    """Preregister a user study, or sign the links of its participants.

    The registration holds digests of FILE.toml and of the analysis. The report states whether they have changed.
    """
    from planner.system.errors import InputFileError, ResultsExistError

    from ..reports.preregistration import register
    from ..userstudy.plan_file import read

    try:
        study = read(file)
        if links is None:
            print_json(register(study, data))
            return
    except (InputFileError, ResultsExistError) as error:
        fail(str(error), ExitCode.USAGE)
    if public_url is None:
        raise click.UsageError("--links: expected --public-url URL as well, with which the links begin")
    from ..web.tokens import AccessTokens
    from ..web.user_study.service import participant_url

    ids = _ids(links)
    data.mkdir(parents=True, exist_ok=True)
    access = AccessTokens.kept(data / "secret", public_url)
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(("participant", "link"))
    writer.writerows((one, participant_url(access, one, data)) for one in ids)


def _ids(file: Path, longest: int = 100) -> list[str]:
    """Return the IDs in a file, one a line; empty lines are left out."""
    from ..userstudy.codes import identifier

    try:
        lines = [identifier(line) for line in file.read_text(encoding="utf-8-sig").splitlines()]
    except UnicodeDecodeError:
        raise click.UsageError(f"--links {file}: expected a text file in UTF-8") from None
    found: dict[str, int] = {}
    for number, one in enumerate(lines, start=1):
        if len(one) > longest:
            raise click.UsageError(f"--links {file}:{number}: expected an ID of at most {longest} characters")
        if one in found:
            raise click.UsageError(f"--links {file}:{number}: the ID of line {found[one]}; expected different IDs")
        if one:
            found[one] = number
    if not found:
        raise click.UsageError(f"--links {file}: expected an ID on each line")
    return list(found)
