"""What was learned from a log, written to files and to the screen."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from planner.system import files
from planner.system.progress import stages

from ..options.log import Replayed, comparison_of
from ..terminal.console import print_json, print_table

if TYPE_CHECKING:
    from ...learning.fit import FittedPeople

FEWEST = 3  # people whose distribution is printed unasked


def show_people(
    people: FittedPeople, out: Path | None, population: Path | None, family: str | None, figures: Path | None, *,
    as_json: bool,
) -> bool:  # fmt: skip
    """Write and print estimates and, where asked for, their distribution; tell whether all of the log was used."""
    from ...plots import people as pictures
    from .estimate_tables import lines_of, table_of

    records = people.as_dicts()
    if out:  # first: a population takes a while, and whoever has it has the people, too
        files.write_records(out, records)
    general = None
    if population or (not as_json and len(people) >= FEWEST):
        with stages() as show:
            general = people.distribution(family=family, progress=show)
    if population and general:
        with files.atomic(population) as path:
            path.write_text(json.dumps(general.as_dict(people.sigma), indent=1) + "\n", encoding="utf-8")
    if figures:
        pictures.draw([record.fit for record in people.values()], figures)
    if as_json:
        print_json(records)
    else:
        print_table(table_of(people), width=160)
        click.echo("".join(f"{line}\n" for line in lines_of(people, general)), nl=False)
    return people.complete


def show_comparison(known: Replayed, folds: int, out: Path | None, figures: Path | None, *, as_json: bool) -> bool:
    """Compare choice models, write and print how they do; tell whether every line of the log was used."""
    from ...plots import people as pictures
    from .estimate_tables import comparison_table

    comparison = comparison_of(known, folds)
    document = comparison.as_dict()
    if out:
        files.write_records(out, document["people"])
    if figures:
        pictures.draw_comparison(comparison, figures)
    if as_json:
        print_json(document)
    else:
        print_table(comparison_table(comparison), width=160)
    return not known.faults and sum(comparison.actions) == len(known.recording)
