"""The command `infer`, which finds out which goal people pursue from a log of their actions."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from planner import find_instances
from planner.system import files

from ..declare.options import Given, setting_options
from .options.common import INPUT_FILE, domain_option, json_option, out_option, separate_files
from .options.help import command
from .options.log import ReadingOptions, reading_options, with_goals
from .options.settings import GoalSetting
from .terminal.console import ExitCode, one_line_errors, print_json, print_table, usage_errors

if TYPE_CHECKING:
    from ..learning.goals import InferredGoals

MOST = 8
"""Goals that have a column each; of more, the three most probable ones are named."""


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
        if out:
            files.write_records(out, found.as_dicts())
        if as_json:
            print_json(found.as_dicts())
        else:
            _show(found)
    if not seen.complete:
        sys.exit(ExitCode.FAILED)


def _show(found: InferredGoals) -> None:
    """Print the posterior at the end of each episode; of many goals those that are the most probable then."""
    rows, several = [], len(found.goals) > MOST
    for one in found.episodes:
        posterior = one.posterior[-1]
        cells = [f"{p:.3f}" for p in posterior]
        if several:
            best = (-posterior).argsort(kind="stable")[:3].tolist()
            cells = [", ".join(f"{found.goals[goal]} {posterior[goal]:.3f}" for goal in best)]
        rows.append([one.person, one.episode, f"{len(one)}", f"{one.beta[-1]:.2f}", *cells])
    head = ("person", "episode", "actions", "beta", *(["most probable goals"] if several else found.goals))
    print_table(head, rows, left=(0, 1, 4) if several else (0, 1), width=160)
