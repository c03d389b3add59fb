"""Output of `fit`: files, figures and tables."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from planner.system.errors import InputFileError
from planner.system.files import atomic, write_records
from planner.system.limits import processors
from planner.system.progress import stages

from ..terminal.console import ExitCode, fail, print_json, print_table

if TYPE_CHECKING:
    from ...learning.evidence import Evidence
    from ...learning.fit import FittedPeople, Model
    from ...learning.likelihood import Method
    from ...learning.population import PopulationFit
    from ...people.ranges import Range

FEW_ACTIONS = 10_000
"""Actions in a log whose first estimates take two seconds."""


def learned(seen: Evidence, method: Method, model: Model | None, seed: int, jobs: int | None) -> FittedPeople:
    """Estimate the parameters of the people in a log. Expected errors end the command in one line."""
    if model in (None, "misconceptions"):
        _show_first(seen, method)  # before the next import, which takes as long
    from ...learning.fit import fit
    from ...people.user_code import UserCodeError

    try:
        with stages() as show:
            return fit(seen, method=method, model=model, seed=seed, jobs=jobs or processors(), progress=show)
    except (InputFileError, UserCodeError) as error:
        fail(str(error), ExitCode.FAILED)


def _show_first(seen: Evidence, method: Method) -> None:
    """Print first estimates on stderr, where the search for the others must be compiled and they take a moment only."""
    from ...learning.first_estimates import first_estimates
    from ...learning.maximum_likelihood import at_hand

    if at_hand() or len(seen.recording) > FEW_ACTIONS:
        return
    for one in first_estimates(seen.observations(), method):
        click.echo(f"first, {one}", err=True)


class FitFiles(NamedTuple):
    """What `fit` writes, and where: estimates, a population of a family, figures; and whether it prints JSON."""

    out: Path | None
    population: Path | None
    family: str | None
    figures: Path | None
    as_json: bool


def show_people(people: FittedPeople, files: FitFiles) -> bool:
    """Write and print estimates and, if requested, their distribution. Return whether the whole log was used."""
    from ...drawing.plots import people as pictures
    from .estimate_tables import lines_of, table_of

    if files.family and not files.population and len(people) < 3:
        raise click.UsageError("--family: expected a log of 3 people or more, or --write-population")
    records = people.as_dicts()
    if files.out:  # written first, since fitting a population takes longer
        write_records(files.out, records)
    general = None
    if files.population or (not files.as_json and len(people) >= 3):  # fewer say little about a population
        with stages() as show:
            general = people.distribution(family=files.family, progress=show)
    if files.population and general:
        write_population(general, files.population, people.sigma)
    if files.figures:
        pictures.draw(list(people.values()), files.figures)
    if files.as_json:
        print_json(records)
    else:
        print_table(table_of(people), width=160)
        click.echo("".join(f"{line}\n" for line in lines_of(people, general)), nl=False)
    return people.complete


def write_population(found: PopulationFit, file: Path, sigma: Range = (0.0, 0.0)) -> None:
    """Write a distribution over people, with the range of their misconceptions, as `simulate --population` reads it."""
    with atomic(file) as path:
        path.write_text(json.dumps(found.as_dict(sigma), indent=1) + "\n", encoding="utf-8")
