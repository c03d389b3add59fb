"""The command `infer`, which finds out which goal people pursue from a log of their actions."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from planner import find_instances

from ..declare.options import Given, setting_options
from .options.common import INPUT_FILE, domain_option, json_option, out_option, separate_files
from .options.help import command
from .options.log import ReadingOptions, reading_options, with_goals
from .options.settings import GoalSetting
from .terminal.console import ExitCode, one_line_errors, usage_errors


@command("infer kits/travel.pddl kits/mend.pddl log.jsonl")
@click.argument("problems", metavar="PROBLEM...", nargs=-1, required=True)
@click.argument("file", metavar="LOG", type=INPUT_FILE)
@out_option("one record per episode (JSON Lines)")
@domain_option
@reading_options
@setting_options(GoalSetting)
@json_option
def infer(
    problems: tuple[str, ...], file: Path, out: Path | None, domain: str | None, as_json: bool, reading: ReadingOptions,
    setting: GoalSetting, given: Given[GoalSetting],  # noqa: ARG001
) -> None:  # fmt: skip
    """Infer which goal people pursue from a LOG of their actions.

    Each PROBLEM has one of the goals; the problems differ in nothing else. A folder stands for the problems in it.
    """
    from ..learning.goals import infer_goals
    from ..people.belief import Grid
    from ..people.ranges import Population
    from .output.goal_posteriors import show_goals

    if file.suffix == ".pddl":
        raise click.UsageError(f"LOG {file}: expected a log of actions after the problems")
    with one_line_errors("interrupted; nothing was inferred"):
        separate_files(
            {"--out": out}, {"LOG": file, **{str(one): one.problem for one in find_instances(problems, domain)}}
        )
        seen = with_goals(problems, file, domain, reading, setting)
        with usage_errors():
            found = infer_goals(seen, beta=Grid.regular(Population(beta=setting.beta)).beta, lapse=setting.lapse)
        for line in found.notes[len(seen.notes) :]:
            click.echo(line, err=True)
        show_goals(found, out, as_json=as_json)
    if not seen.complete:
        sys.exit(ExitCode.FAILED)
