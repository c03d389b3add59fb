"""The command `study`, which runs a simulation study and writes its statistics, figures and report."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from planner.system.limits import processors
from planner.system.progress import stages

from ..declare.declared import Count
from ..declare.options import Value
from .options.common import baseline_option, jobs_option, json_option, out_option, resume_option, scheduler_option
from .options.help import command
from .terminal.console import ExitCode, fail, one_line_errors, print_json, print_table


@command("study --out study")
@click.option(
    "--protocol", default="paper", show_default=True, metavar="NAME|FILE.toml",
    help="Name of a bundled study, or your own file.",
)  # fmt: skip
@click.option(
    "--repeats",
    type=Value(Count),
    metavar="N",
    help="Number of pools of people. The protocol's own number unless given.",
)
@baseline_option
@jobs_option
@scheduler_option
@out_option("a folder for episodes, summary, figures and report", folder=True, required=True)
@resume_option
@json_option
def study(
    protocol: str, repeats: int | None, baseline: str | None, jobs: int | None, scheduler: str | None, out: Path,
    resume: bool, as_json: bool,
) -> None:  # fmt: skip
    """Run a simulation study over pools of people, teams, policies and conditions, and write its report.

    The default protocol is the study of section V of the paper.
    """
    from planner.system.errors import InputFileError

    from ..people.user_code import UserCodeError
    from ..studies.cells import check
    from ..studies.protocol import read
    from ..studies.reports.study_report import headline, notes, require, write_report
    from ..studies.runner import run_study

    say = partial(click.echo, err=True)
    with one_line_errors("interrupted; finished parts are saved, --resume continues"):
        require()
        planned = read(protocol, repeats=repeats, baseline=baseline)
        with stages() as show:
            check(planned, show)
            failed = run_study(
                planned, out, jobs=jobs or processors(), scheduler=scheduler, resume=resume, progress=show, warn=say
            )
        for cell, reason in failed:
            say(f"{cell}: {reason if isinstance(reason, InputFileError | UserCodeError) else repr(reason)}")
        if failed:
            fail(
                f"{len(failed)} of {len(list(planned.cells()))} cells failed; --resume tries them again",
                ExitCode.FAILED,
            )
        summary = write_report(planned, out, jobs=jobs or processors()).summary
    if as_json:
        print_json(summary)
        return
    head, rows, pools = headline(summary)
    print_table(head, rows, left=range(len(head)))
    for line in notes(summary):
        click.echo(line)
    click.echo(f"{pools}; the report is {out / 'report.md'}")
