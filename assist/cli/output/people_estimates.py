"""Output of `fit`: files, figures and tables."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from planner.system.errors import InputFileError
from planner.system.files import atomic, write_records
from planner.system.limits import processors
from planner.system.progress import stages

from ..terminal.console import ExitCode, fail, print_json, print_table

if TYPE_CHECKING:
    from ...learning.distribution import PopulationFit
    from ...learning.evidence import Evidence
    from ...learning.fit import FittedPeople, Model
    from ...learning.likelihood import Method
    from ...people.ranges import Range

FEW_ACTIONS = 10_000
"""Actions in a log whose first estimates take two seconds."""


def learned(seen: Evidence, method: Method, model: Model | None, jobs: int | None) -> FittedPeople:
    """Estimate the parameters of the people in a log. Expected errors end the command in one line."""
    if model in (None, "misconceptions"):
        _show_first(seen, method)  # before the next import, which takes as long
    from ...learning.fit import fit
    from ...people.user_code import UserCodeError

    try:
        with stages() as show:
            return fit(seen, method=method, model=model, jobs=jobs or processors(), progress=show)
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
        head, *rows = _table_of(people)
        print_table(head, rows, width=160)
        click.echo("".join(f"{line}\n" for line in _lines_of(people, general)), nl=False)
    return people.complete


def write_population(found: PopulationFit, file: Path, sigma: Range = (0.0, 0.0)) -> None:
    """Write a distribution over people, with the range of their misconceptions, as `simulate --population` reads it."""
    with atomic(file) as path:
        path.write_text(json.dumps(found.as_dict(sigma), indent=1) + "\n", encoding="utf-8")


def _table_of(people: FittedPeople) -> Iterator[list[str]]:
    """Yield the head and the rows of a table of the estimates of every person in the log, with intervals."""
    level = people.method.level
    head = ["person", *(interval_head(name, level) for name in ("beta", "theta", "eta"))]
    head += ["actions", "suboptimal", "log-likelihood", "check p"]
    head += [interval_head("sigma", level)] * any(record.misconception is not None for record in people.values())
    head += [interval_head(name, level) for name in next((record.weights for record in people.values()), {})]
    yield head
    for name in _everybody(people):
        if name not in people:
            yield [name, *["-"] * (len(head) - 1)]
            continue
        record = people[name]
        every, m = record.estimates, record.misconception
        cells = [
            interval_of(value, every[name].interval, every[name].open_above, digits=digits) if name in every else "-"
            for name, value, digits in (("beta", record.beta, 2), ("theta", record.theta, 2), ("eta", record.eta, 3))
        ]
        cells += [f"{record.actions}", _counted(record.suboptimal_actions), f"{record.log_likelihood:.2f}"]
        cells.append("-" if record.check.p is None else f"{record.check.p:.3f}")
        if m is not None:
            cells.append(interval_of(m.sigma, m.interval, m.open_above))
        weights = [every[weight] for weight in record.weights]
        cells += [interval_of(one.value, one.interval, one.open_above) for one in weights]
        yield [name, *cells]


def _lines_of(people: FittedPeople, found: PopulationFit | None) -> Iterable[str]:
    """Return notes on each person's estimates, followed by the distribution over people if it is known."""
    for name in _everybody(people):
        notes = people[name].notes if name in people else [people.unknown[name]["error"]]
        yield from (f"{name}: {note}" for note in notes)
    if found is None:
        return
    whose = f"population of {found.people}"
    for name, margin in (("beta", found.beta), ("theta", found.theta)):
        if margin is not None:
            ends = margin.ends
            between = "" if ends is None else f" from {ends[0]:.2f} to {ends[1]:.2f}"
            spread = f"mean {margin.mean:.2f}, standard deviation {margin.spread:.2f}"
            yield f"{whose}: {name} is {margin.family}{between}, {spread}"
    for name, (mean, deviation) in found.weights.items():
        yield f"{whose}: the weight of {name} is normal, mean {mean:.2f}, standard deviation {deviation:.2f}"
    for name in next((one.weights for one in people.values()), {}):
        if name not in found.weights:
            yield f"{whose}: the weight of {name} is not known, as no choices in the log differ in it"
    if found.eta is not None:
        yield f"{whose}: eta {found.eta:.3f}"


def _everybody(people: FittedPeople) -> list[str]:
    from ...learning.log import in_order

    return sorted([*people, *people.unknown], key=in_order)


def _counted(actions: float) -> str:
    """Return a number of actions, which is a mean where the goal is not known."""
    return f"{actions}" if isinstance(actions, int) else f"{actions:.1f}"


def interval_head(name: str, level: float) -> str:
    """Return the head of a column of estimates with intervals of a level."""
    return f"{name} ({level:.0%} interval)"


def interval_of(
    value: float | None, interval: tuple[float, float], open_above: bool = False, *, digits: int = 2
) -> str:
    """Return an estimate with its interval, both with so many digits; a value that nothing is known of is `?`."""
    shown = "?" if value is None else f"{value:.{digits}f}"
    return f"{shown} ({interval[0]:.{digits}f} to {interval[1]:.{digits}f}{'+' if open_above else ''})"
