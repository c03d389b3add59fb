"""The command `check`, which tries a user's own code before it is used."""

from __future__ import annotations

import click

from planner.system.progress import stages

from .options.common import json_option
from .options.help import command
from .terminal.console import ExitCode, fail, print_json


@command("check policies.py:furthest_first")
@click.argument("code", metavar="FILE.py:NAME")
@click.option(
    "--as", "kind", type=click.Choice(["policy", "people", "trust", "neighbours", "term"]),
    help="What it is: a team policy, a choice model of people, a trust rule, a rule of neighbours or a term. Its form "
    "tells unless given.",
)  # fmt: skip
@json_option
def check(code: str, kind: str | None, as_json: bool) -> None:
    """Try your own policy, choice model, rule or term, and say what is wrong with it.

    It is called in the situations in which it will be called later: with one person and three, one robot and two,
    several goals, dead ends, truncated tasks.
    """
    from ..people.user_code import UserCodeError
    from ..studies.own_code import check as tried

    try:
        with stages() as show:
            found = tried(code, kind, progress=show)  # type: ignore[arg-type]
    except UserCodeError as error:
        fail(str(error), ExitCode.FAILED)
    if as_json:
        trials = [{"situation": one.what, "fault": one.fault} for one in found.trials]
        print_json({"code": found.name, "kind": found.kind, "trials": trials})
    else:
        click.echo(str(found))
    if found.faults:
        raise SystemExit(ExitCode.FAILED)
