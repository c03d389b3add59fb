"""The command `study-prepare`: what is done for a user study before its first participant."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from planner.batch.results_folder import SolveOptions
from planner.system.progress import stages

from ..declare.declared import Number
from ..declare.options import Value
from .options.common import INPUT_FILE, data_option
from .options.help import command
from .options.listening import public_url_option
from .options.task import costs_of
from .terminal.console import kept_if_interrupted, note, print_json

if TYPE_CHECKING:
    from ..studies.userstudy.forecast import Forecast
    from ..studies.userstudy.plan import UserStudy


@command("study-prepare study.toml --data pilot", "study-prepare")
@click.argument("file", metavar="FILE.toml", type=INPUT_FILE)
@data_option(required=False)
@click.option(
    "--links", type=INPUT_FILE, metavar="FILE",
    help="Print a signed link for each participant ID in this file, one a line, instead of registering.",
)  # fmt: skip
@click.option(
    "--difference", type=Value(Number, gt=0, le=1e9), metavar="ACTIONS",
    help="Also print how many participants show a difference of so many actions per task with a power of 80 %.",
)  # fmt: skip
@click.option("--check", is_flag=True, help="Only check the file and the policies, and register nothing.")
@public_url_option
def study_prepare(
    file: Path, data: Path | None, links: Path | None, difference: float | None, check: bool, public_url: str | None
) -> None:
    """Preregister a user study, or sign the links of its participants.

    The registration holds FILE.toml, and digests of it and of the analysis. The report states what has changed. Which
    differences the study can show is said on stderr, by simulation, and which policy hardly suggests anything. Ctrl-C
    ends the simulation and shows what is known by then; the registration stays.
    """
    from ..declare.declared import plain
    from ..studies.reports.preregistration import register, unregister
    from ..studies.userstudy.plan_file import read

    if check and links is not None:
        raise click.UsageError("--check cannot be combined with --links")
    if difference is not None and links is not None:
        raise click.UsageError("--difference has no effect with --links")
    study = read(file)
    if check or links is None:
        if data is None and not check:
            raise click.UsageError("expected --data DIR, the folder of the study, or --check")
        record = None if check or data is None else register(study, data)  # before simulations, which take long
        if record is not None:
            note(f"registered in {data}; simulations of what the study can show follow")
        known: list[Forecast] = []
        try:
            with kept_if_interrupted(lambda: known or record):
                for found in _rounds(study):
                    known[:] = [found]
        except BaseException as error:
            if record is not None and data is not None and not isinstance(error, KeyboardInterrupt):
                unregister(data)
                note(f"the study cannot be carried out, so that it is no longer registered in {data}")
            raise
        for forecast in known:
            for text in (*forecast.remarks(), *_participants(study, forecast, difference)):
                note(text)
        if record is None:
            shown = [plain(one) for one in known[0].sensitivity()]
            counts = {"places": study.participants, "comparisons": study.comparisons}
            print_json({"study": str(file), **counts, "sensitivity": shown})
            note(f"{file} can be carried out; nothing is registered yet")
        else:
            print_json({name: value for name, value in record.items() if name != "text"})
            note(f"registered in {data}; `kitassist serve --study {file} --data {data}` begins the study")
        return
    if data is None:
        raise click.UsageError("--links: expected --data DIR as well, the folder of the study")
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
    note("from now on nobody joins without such a link; the one for everybody admits nobody any more")


def _rounds(study: UserStudy) -> Iterator[Forecast]:
    """Yield simulated participants of a study, whose tasks are solved first, after each round."""
    from ..studies.userstudy.forecast import Forecast

    tasks = {
        name: costs_of(instance, max_states=SolveOptions.max_states, memory_limit_mb=None)
        for name, instance in study.tasks
    }
    with stages() as show:
        show("simulating participants", 0, None)
        yield from Forecast.rounds(study, tasks, progress=show)


def _participants(study: UserStudy, forecast: Forecast, difference: float | None) -> Iterator[str]:
    """Yield how many participants show a difference in actions per task, for each condition."""
    for condition, needed in forecast.participants(difference) if difference is not None else ():
        compared = f"{condition} minus {study.reference}"
        if needed is None:
            reason = "tasks on demand are not simulated, and of others too few people finish one"
            yield f"{compared}: not known how many participants show {difference:g} actions per task; {reason}"
        else:
            yield f"{compared}: {difference:g} actions per task take {needed} participants"


def _ids(file: Path, longest: int = 100) -> list[str]:
    """Return the IDs in a file, one a line; empty lines are left out."""
    from ..studies.userstudy.codes import identifier

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
