"""The command `study-report`, which reports the results of a user study."""

from __future__ import annotations

from pathlib import Path

import click

from ..declare.options import Input
from .options.common import baseline_option, json_option, out_option
from .options.help import command
from .terminal.console import ExitCode, fail, print_json, print_table


@command("study-report data", "study-report")
@click.argument("place", metavar="DIR|FILE.zip", type=Input(folder=True))
@out_option("a folder; `report` within DIR, or FILE-report beside FILE.zip, unless given", folder=True)
@baseline_option
@json_option
def study_report(place: Path, out: Path | None, baseline: str | None, as_json: bool) -> None:
    """Report on a user study: means, effects of conditions, questionnaires and dropouts.

    DIR is the folder of `serve --study ... --data DIR`, during the study or afterwards. FILE.zip is an export; DIR may
    also be one that was unpacked.
    """
    from planner.system.errors import InputFileError

    from ..studies.reports.userstudy_report import ReportWording, require, write_report
    from ..studies.userstudy.session import REPORT

    require()
    out = out or (place / REPORT if place.is_dir() else place.with_name(f"{place.stem}-{REPORT}"))
    try:
        summary = write_report(place, out, baseline=baseline)
    except InputFileError as error:
        fail(str(error), ExitCode.FAILED)
    if as_json:
        print_json(summary)
        return
    words = ReportWording()
    head, rows = words.headline(summary)
    print_table(head, rows, left=range(len(head)))
    for text in words.notes(summary):
        click.echo(text.replace("**", ""))
    click.echo(f"the report is {out / 'report.md'}")
