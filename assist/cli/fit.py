"""The command `fit`: what a log of actions says of people."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from .options.common import (
    INPUT_FILE,
    OUTPUT_FILE,
    OUTPUT_FOLDER,
    apart,
    domain_option,
    instance_argument,
    separate_files,
)
from .options.help import command
from .options.log import log_options, people_of, replayed
from .options.task import one_instance
from .output.people_estimates import show_comparison, show_people
from .terminal.console import EXIT_FAILED, one_line_errors


@command("fit kitting/paper log.csv --out people.jsonl")
@instance_argument
@click.argument("file", metavar="LOG", type=INPUT_FILE)
@click.option("--out", type=OUTPUT_FILE, help="Write one record per person (JSON Lines).")
@click.option(
    "--population", type=OUTPUT_FILE,
    help="Write the distribution of expertise (beta) and influence (theta), for `simulate --population`.",
)  # fmt: skip
@click.option(
    "--family", type=click.Choice(["uniform", "log-uniform", "log-normal", "histogram"]),
    help="Family of the distribution of expertise (beta) over people. The best-fitting parametric one unless given.",
)  # fmt: skip
@click.option("--figures", type=OUTPUT_FOLDER, help="Folder for figures.")
@domain_option
@log_options
@click.option("--json", "as_json", is_flag=True, help="Print the records as one JSON list.")
def fit(
    instance: str, domain: str | None, file: Path, out: Path | None, population: Path | None, family: str | None,
    figures: Path | None, misconceptions: bool, terms: bool, compare: bool, people: str | None, folds: int, seed: int,
    as_json: bool, **options: Any,
) -> None:  # fmt: skip
    """Learn expertise, influence and trust of people from the LOG of their actions.

    LOG has a line of JSON for each action: {"person": "...", "episode": "...", "step": 0, "action": "(name arg ...)",
    "suggestion": "(...)" or null}; or it is CSV with these columns.
    """
    from ..plots import style

    if family and as_json and not population:
        raise click.UsageError("--family: expected --population, since with --json it has no effect otherwise")
    apart({"--misconception": misconceptions, "--terms": terms, "--compare": compare, "--people": people})
    apart({"--population": population, "--compare": compare})
    if population and people:
        raise click.UsageError("--population and --people: a population file has no functions; expected one of them")
    apart({"--family": family, "--terms": terms, "--compare": compare})
    with one_line_errors("interrupted; states that were evaluated on demand are kept"):
        found = one_instance(instance, domain)
        inputs = {"INSTANCE": found.problem, "its domain": found.domain, "LOG": file}
        separate_files({"--out": out, "--population": population}, inputs)
        if figures:
            style.require()
        known = replayed(found, file, **options)
        if compare:
            complete = show_comparison(known, folds, out, figures, as_json=as_json)
        else:
            learned = people_of(
                known, misconceptions=misconceptions, terms=terms, people=people, max_states=options["max_states"],
                seed=seed,
            )  # fmt: skip
            complete = show_people(learned, out, population, family, figures, as_json=as_json)
    if not complete:
        sys.exit(EXIT_FAILED)
