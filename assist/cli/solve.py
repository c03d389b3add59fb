"""The command `solve`, which solves instances and prints one record for each."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from planner import find_instances
from planner.batch.results_folder import DONE, SolveOptions
from planner.system.limits import processors

from ..declare.declared import Count
from ..declare.options import Value
from .options.common import (
    Megabytes,
    domain_option,
    is_given,
    jobs_option,
    json_option,
    out_option,
    resume_option,
    scheduler_option,
    time_limit_option,
)
from .options.help import command
from .output.solve_progress import solving
from .output.solve_records import Answers
from .terminal.console import ExitCode, one_line_errors


@command("solve kitting --out results")
@click.argument("instances", metavar="INSTANCE...", nargs=-1, required=True)
@domain_option
@out_option("a folder for results.jsonl, tables and plans", folder=True)
@jobs_option
@time_limit_option
@click.option(
    "--memory-limit", type=Value(Megabytes), metavar="MB", help="Memory for each instance. No limit unless given."
)
@click.option(
    "--max-states", type=Value(Count), default=SolveOptions.max_states, show_default=True,
    help="Largest number of states solved exhaustively. Larger tasks are solved in the initial state only.",
)  # fmt: skip
@click.option(
    "--most-values", type=Value(Count), default=SolveOptions.most_values, show_default=True,
    help="Largest number of values of one number of the files, such as a stock or a battery.",
)  # fmt: skip
@click.option(
    "--verify", type=Value(Count), metavar="N", show_default="20 in a fourth of the search's time",
    help="Number of states compared with Fast Downward's A*, however long it takes.",
)  # fmt: skip
@scheduler_option
@resume_option
@json_option
def solve(
    instances: tuple[str, ...],
    domain: str | None,
    out: Path | None,
    jobs: int | None,
    scheduler: str | None,
    resume: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Solve PDDL instances: the exact cost-to-go of every state, and an optimal plan.

    INSTANCE is a problem file, a folder (all its problems), or a glob.
    """
    from planner.batch.solve_batch import solve_batch

    if resume and out is None:
        raise click.UsageError("--resume needs --out")
    with one_line_errors("interrupted; finished results are saved, --resume continues" if out else "interrupted"):
        found = find_instances(instances, domain)
        jobs = jobs or processors()
        if len(found) == 1 and options["memory_limit"] is None and not is_given("time_limit"):
            jobs = 0  # starting a worker takes longer than solving most tasks
        answers = Answers([str(each.problem) for each in found], as_json=as_json)
        try:
            with solving(len(found), answers.add) as (solved, stage):
                records = solve_batch(
                    found, SolveOptions(**options), out=out, jobs=jobs, resume=resume, scheduler=scheduler,
                    progress=solved, stages=stage, tell=answers.first,
                )  # fmt: skip
        except KeyboardInterrupt:
            if answers.records:
                answers.show(list(answers.records.values()))
            raise
    answers.show(records)
    if any(record["status"] not in DONE for record in records):
        sys.exit(ExitCode.FAILED)
