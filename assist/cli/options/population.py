"""The options that describe the population from which people are drawn.

The population is given by ranges of the parameters, or by a file that `fit --population` wrote. The file also says how
people choose; otherwise a function of the user may.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ...people import user_code
from ..terminal.console import ExitCode, fail
from .common import INPUT_FILE, NUMBER, Command, Option, Range, is_given, range_option, refuse_unused, with_options

if TYPE_CHECKING:
    from ...people.choice_model import ChoiceModel
    from ...people.human import Population


def population_options(
    whose: str = "people's", influence: str = "them", *, real: bool = False
) -> Callable[[Command], Command]:
    """Return a decorator that adds the options of `population_of`, except `--sigma`, which one person does not need.

    Without a range of theta, the influence of real people is that of `advice_takers`.
    """
    theta: Option[Any] = (
        click.option(
            "--theta", nargs=2, type=NUMBER, metavar="LOW HIGH",
            help=f"Range of the robot's influence on {influence} (theta).  [default: as wide as real people's]",
        )
        if real
        else range_option("--theta", (0.5, 0.95), f"Range of the robot's influence on {influence} (theta).")
    )  # fmt: skip

    def add(command: Command) -> Command:
        options: tuple[Option[Any], ...] = (
            range_option("--beta", (0.1, 3.0), f"Range of {whose} expertise (beta)."),
            theta,
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
    beta: Range, theta: Range | None, sigma: Range | None = None, *, file: Path | None = None, people: str | None = None
) -> Population:
    """Return the population that the options describe.

    Raises
    ------
    click.UsageError
        A range is invalid, the file contains no population, both ranges and a file are given, or the function is
        missing.
    """
    from ...people.human import Population
    from ...people.real_people import advice_takers

    try:
        if file is None:
            chooses, sigma = None if people is None else choice_model(people), sigma or Population().sigma
            if theta is None:
                return advice_takers(beta, sigma, chooses=chooses)
            return Population(beta, theta, sigma, chooses=chooses)
        for name in ("beta", "theta") if sigma is None else ("beta", "theta", "sigma"):
            if is_given(name):
                raise click.UsageError(f"--population {file} also sets --{name}; expected one of them")
        if people is not None:
            raise click.UsageError(f"--population {file} also sets how people choose (--people); expected one of them")
        return read_population(file)
    except ValueError as error:
        raise click.UsageError(f"--population {file}: {error}" if file else str(error)) from None


def read_population(file: Path) -> Population:
    """Read a population that `fit --population` wrote.

    Raises
    ------
    ValueError
        The file contains no population.
    """
    from ...learning import population as populations

    return populations.mixture(_record(file))


def with_rule_of(file: Path | None, setting: dict[str, Any], *, rate: bool = False) -> dict[str, Any]:
    """Return the options of a `Setting`, with the trust rule of a population file if it has one.

    With `rate`, a file without a rule gives the rate of equation 7 that was estimated, unless options set it. That is
    for simulated people, as theta of real people stays unless a rule is given.

    Raises
    ------
    click.UsageError
        The file has a trust rule, and so do the options.
    """
    if file is None:
        return setting
    from ...learning import population as populations
    from ...people.trust_rules import EquationSeven

    try:
        rule, estimated = populations.trust_of(record := _record(file)), populations.rate_of(record)
    except ValueError as error:
        raise click.UsageError(f"--population {file}: {error}") from None
    if rule is None:
        own = is_given("eta") or is_given("utility_scale") or setting.get("trust") not in (None, "paper")
        return setting | estimated if rate and not own else setting
    for name in ("trust", "eta", "utility_scale"):
        if is_given(name):
            raise click.UsageError(f"--population {file} also sets --{name.replace('_', '-')}; expected one of them")
    if isinstance(rule, EquationSeven):
        return setting | {"trust": "paper", "eta": rule.eta, "utility_scale": rule.utility_scale}
    return setting | {"trust": rule}


def refuse_unused_rates(trust: str | None) -> None:
    """Raise a usage error if the user set the rate or the unit of equation 7 together with another trust rule."""
    if trust not in (None, "paper"):
        refuse_unused(["eta", "utility_scale"], f"with --trust {trust}")


def _record(file: Path) -> dict[str, Any]:
    record = json.loads(file.read_text(encoding="utf-8"))
    return record if isinstance(record, dict) else {}


def choice_model_of(people: str | None) -> ChoiceModel | None:
    """Return the choice model FILE.py:FUNCTION of a user. Expected errors end the command in one line."""
    from ...people.user_code import UserCodeError

    try:
        return None if people is None else choice_model(people)
    except UserCodeError as error:
        fail(str(error), ExitCode.FAILED)
    except ValueError as error:
        raise click.UsageError(str(error)) from None


def choice_model(people: str) -> ChoiceModel:
    """Return the choice model FILE.py:FUNCTION of a user."""
    place = user_code.parse(people)
    if place is None:
        raise ValueError(f"--people '{people}'; expected FILE.py:FUNCTION")
    return user_code.UserChoiceModel.load(*place)
