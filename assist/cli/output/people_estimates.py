"""Output of `fit`: files, figures and tables."""

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
    from ...learning.population import PopulationFit
    from ...people.human import Range


def show_people(
    people: FittedPeople, out: Path | None, population: Path | None, family: str | None, figures: Path | None, *,
    as_json: bool,
) -> bool:  # fmt: skip
    """Write and print estimates and, if requested, their distribution. Return whether the whole log was used."""
    from ...plots import people as pictures
    from .estimate_tables import lines_of, table_of

    if family and not population and len(people) < 3:
        raise click.UsageError("--family: expected a log of 3 people or more, or --population")
    records = people.as_dicts()
    if out:  # written first, since fitting a population takes longer
        files.write_records(out, records)
    general = None
    if population or (not as_json and len(people) >= 3):  # fewer say little about a population
        with stages() as show:
            general = people.distribution(family=family, progress=show)
    if population and general:
        write_population(general, population, people.sigma)
    if figures:
        pictures.draw([record.fit for record in people.values()], figures)
    if as_json:
        print_json(records)
    else:
        print_table(table_of(people), width=160)
        click.echo("".join(f"{line}\n" for line in lines_of(people, general)), nl=False)
    return people.complete


def write_population(found: PopulationFit, file: Path, sigma: Range = (0.0, 0.0)) -> None:
    """Write a distribution over people, with the range of their misconceptions, as `simulate --population` reads it."""
    with files.atomic(file) as path:
        path.write_text(json.dumps(found.as_dict(sigma), indent=1) + "\n", encoding="utf-8")


def show_comparison(known: Replayed, folds: int, out: Path | None, figures: Path | None, *, as_json: bool) -> bool:
    """Compare choice models; write and print the results. Return whether every line of the log was used."""
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
