"""The command `fit`: what a log of actions says of people."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from planner import storage

from .console import EXIT_FAILED, one_line_errors, print_json, print_table
from .log import log_options, people_of
from .options import INPUT_FILE, OUTPUT_FILE, OUTPUT_FOLDER, domain_option, instance_argument, separate_files
from .progress import progress_bar
from .task import one_instance

FEWEST = 3  # people whose distribution is printed unasked


@click.command()
@instance_argument
@click.argument("file", metavar="LOG", type=INPUT_FILE)
@click.option("--out", type=OUTPUT_FILE, help="Write a record of each person (JSON Lines).")
@click.option(
    "--population", type=OUTPUT_FILE,
    help="Write the distribution of beta and theta over people, for `simulate --population`.",
)  # fmt: skip
@click.option(
    "--family", type=click.Choice(["uniform", "log-uniform", "log-normal", "histogram"]),
    help="Of beta's distribution over people; the parametric one that fits best unless given.",
)  # fmt: skip
@click.option("--figures", type=OUTPUT_FOLDER, help="Draw into this folder.")
@domain_option
@log_options
@click.option("--json", "as_json", is_flag=True, help="Print the records as one JSON list.")
def fit(
    instance: str, domain: str | None, file: Path, out: Path | None, population: Path | None, family: str | None,
    figures: Path | None, as_json: bool, **options: Any,
) -> None:  # fmt: skip
    """Learn expertise, influence and trust of people from the LOG of their actions.

    LOG has a line of JSON for each action: {"person": "...", "episode": "...", "step": 0, "action": "(name arg ...)",
    "suggestion": "(...)" or null}; or it is CSV with these columns.
    """
    from ..learning import population as populations
    from ..learning.summary import lines_of, table_of
    from ..plots import people as pictures
    from ..plots import style

    if family and as_json and not population:
        raise click.UsageError("--family: expected --population, since with --json it has no effect otherwise")
    with one_line_errors("interrupted; states that were evaluated on demand are kept"):
        found = one_instance(instance, domain)
        inputs = {"INSTANCE": found.problem, "its domain": found.domain, "LOG": file}
        separate_files({"--out": out, "--population": population}, inputs)
        if figures:
            style.require()
        people = people_of(found, file, **options)
        records = people.as_dicts()
        general = None
        if population or (not as_json and len(people) >= FEWEST):
            with progress_bar("fitting the population", populations.ETAS) as advance:
                general = people.distribution(family=family, progress=advance)
        if population and general:
            with storage.atomic(population) as path:
                path.write_text(json.dumps(general.as_dict(people.sigma), indent=1) + "\n", encoding="utf-8")
        if out:
            storage.write_records(out, records)
        if figures:
            pictures.draw([record.fit for record in people.values()], figures)
    if as_json:
        print_json(records)
    else:
        print_table(table_of(people), width=160)
        click.echo("".join(f"{line}\n" for line in lines_of(people, general)), nl=False)
    if not people.complete:
        sys.exit(EXIT_FAILED)
