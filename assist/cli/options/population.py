"""From whom people are drawn: ranges of their parameters, or a file that `fit --population` has written.

How they choose is in such a file, too, or in a function of the user's own.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ...people import user_code
from .common import INPUT_FILE, Command, Option, Range, is_given, range_option, with_options

if TYPE_CHECKING:
    from ...people.choice_model import ChoiceModel
    from ...people.human import Mixture, Population

RANGES = ("beta", "theta", "sigma")


def population_options(whose: str = "people's", influence: str = "them") -> Callable[[Command], Command]:
    """Add the options that `population_of` takes, but for the range of sigma, which one person does not have."""

    def add(command: Command) -> Command:
        options: tuple[Option[Any], ...] = (
            range_option("--beta", (0.1, 3.0), f"Range of {whose} expertise (beta)."),
            range_option("--theta", (0.5, 0.95), f"Range of the robot's influence on {influence} (theta)."),
            click.option(
                "--population", "population_file", type=INPUT_FILE, metavar="FILE",
                help="Draw people from a population that `fit --population` wrote, in place of ranges.",
            ),
        )  # fmt: skip
        return with_options(command, options)

    return add


people_option = click.option(
    "--people", metavar="FILE.py:FUNCTION",
    help="Your own choice model, in place of choice by cost-to-go.",
)  # fmt: skip


def population_of(
    beta: Range, theta: Range, sigma: Range | None = None, *, file: Path | None = None, people: str | None = None
) -> Population | Mixture:
    """Give the population that the options describe.

    Raises
    ------
    click.UsageError
        Ranges that cannot be, a file that holds no population, both ranges and a file, or no function.
    """
    from ...people.human import Population

    try:
        if file is None:
            found = Population(beta, theta) if sigma is None else Population(beta, theta, sigma)
            return found if people is None else choosing(found, people)
        for name in RANGES if sigma is not None else RANGES[:2]:
            if is_given(name):
                raise click.UsageError(f"--population {file} says what --{name} says; expected one of them")
        if people is not None:
            raise click.UsageError(
                f"--population {file} says how people choose, as --people does; expected one of them"
            )
        return read_population(file)
    except ValueError as error:
        raise click.UsageError(f"--population {file}: {error}" if file else str(error)) from None


def read_population(file: Path) -> Mixture:
    """Read what `fit --population` has written.

    Raises
    ------
    ValueError
        The file holds no population.
    """
    from ...learning import population as populations

    try:
        return populations.mixture(json.loads(file.read_text(encoding="utf-8")))
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(str(error)) from None


def choice_model(people: str) -> ChoiceModel:
    """Return the choice model that a function of the user's own is, FILE.py:FUNCTION."""
    place = user_code.parse(people)
    if place is None:
        raise ValueError(f"--people '{people}'; expected FILE.py:FUNCTION")
    return user_code.UserChoiceModel.load(*place)


def choosing(population: Population, people: str) -> Population:
    """Return a population that chooses as a function of the user's own says, FILE.py:FUNCTION."""
    from dataclasses import replace

    return replace(population, chooses=choice_model(people))
