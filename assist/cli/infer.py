"""The command `infer`, which finds out which goal people pursue from a log of their actions."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from .options.common import INPUT_FILE, OUTPUT_FILE, Range, domain_option, lapse_option, range_option, separate_files
from .options.goals import goals_of, prior_of
from .options.help import command
from .options.log import log_of, reading_options, renamed
from .terminal.console import ExitCode, fail, one_line_errors


@command("infer kits/travel.pddl kits/mend.pddl log.jsonl")
@click.argument("problems", metavar="PROBLEM...", nargs=-1, required=True)
@click.argument("file", metavar="LOG", type=INPUT_FILE)
@click.option(
    "--prior", multiple=True, metavar="GOAL=P,...",
    help="Probability of each goal, by the problem's name. All are equal unless given.",
)  # fmt: skip
@range_option("--beta", (0.1, 3.0), "Range of people's expertise (beta), over which the posterior is averaged.")
@lapse_option("Weight of a uniform choice.")
@click.option("--out", type=OUTPUT_FILE, help="Write one record per episode (JSON Lines).")
@domain_option
@reading_options
@click.option("--json", "as_json", is_flag=True, help="Print the records, with the posterior after each action.")
def infer(
    problems: tuple[str, ...], file: Path, prior: tuple[str, ...], beta: Range, lapse: float, out: Path | None,
    domain: str | None, as_json: bool, drop: tuple[str, ...], rename: tuple[str, ...], columns: tuple[str, ...],
    gaps: bool, strict: bool, **evaluation: Any,
) -> None:  # fmt: skip
    """Infer which goal people pursue from a LOG of their actions.

    Each PROBLEM has one of the goals; the problems differ in nothing else. A folder stands for the problems in it.
    """
    from ..learning.fit import LogError
    from ..learning.goals import inferred
    from ..learning.log import told
    from ..people.belief import Grid
    from ..people.human import Population
    from .output.goal_posteriors import show_goals

    if file.suffix == ".pddl":
        raise click.UsageError(f"LOG {file}: expected a log of actions after the problems")
    shares, names = prior_of(prior), renamed(rename)
    with one_line_errors("interrupted; nothing was inferred"):
        log = log_of(file, columns, gaps=gaps)
        goals = goals_of(problems, domain=domain, **evaluation)
        separate_files({"--out": out}, {"LOG": file, **{name: g.task.instance.problem for name, g in goals.items()}})
        try:
            grid = Grid.regular(Population(beta=beta)).beta
            found = inferred(
                goals, log, prior=shares, beta=grid, lapse=lapse, drop=drop, rename=names, strict=strict,
            )  # fmt: skip
        except LogError as error:
            fail(str(error), ExitCode.FAILED)
        except ValueError as error:
            raise click.UsageError(str(error)) from None
        for line in [*told(found.faults, file), *found.notes]:
            click.echo(line, err=True)
        show_goals(found, out, as_json=as_json)
    if found.faults or found.left_out:
        sys.exit(ExitCode.FAILED)
