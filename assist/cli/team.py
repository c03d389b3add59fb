"""A team: the options that describe it, and how people and the way between them are set up from them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from planner import Instance

from .options import INPUT_FILE, NUMBER, SEED, Range, range_option
from .person import model_options
from .progress import progress_bar
from .task import one_instance, table_of

if TYPE_CHECKING:
    from ..people.human import Mixture, Population
    from ..team.pool import Pool
    from ..team.travel import Travel


def team_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options that say what team it is; `team_of` takes them all."""
    options: tuple[Callable[[Callable[..., None]], Callable[..., None]], ...] = (
        click.option("--humans", type=click.IntRange(min=1), required=True, metavar="K", help="People in a team."),
        click.option("--seed", type=SEED, default=0, show_default=True),
        *model_options(),
        click.option(
            "--c-move", type=NUMBER, default=0.5, show_default=True, help="Cost of moving by a distance of 1."
        ),
        click.option(
            "--travel-time", type=NUMBER, default=0.0, show_default=True, help="Steps that a distance of 1 takes."
        ),
        click.option(
            "--distances", type=INPUT_FILE, metavar="FILE",
            help="Distances between the K places and the base, which comes last (JSON list of lists); 1 unless given.",
        ),
        click.option(
            "--knowledge", type=click.Choice(["own", "exact"]), default="own", show_default=True,
            help="What the robot knows of people's perceived costs.",
        ),
        range_option("--beta", (0.1, 3.0), "Range of people's expertise."),
        range_option("--theta", (0.5, 0.95), "Range of the robot's influence on them."),
        range_option("--sigma", (0.1, 1.0), "Range of their misconception's size."),
        click.option(
            "--population", "crowd_file", type=INPUT_FILE,
            help="Draw people from what `fit --population` has written, in place of these three ranges.",
        ),
    )  # fmt: skip
    for option in reversed(options):
        command = option(command)
    return command


@dataclass(frozen=True)
class Team:
    """People from whom a team is drawn, and the way between its places."""

    instance: Instance
    population: Population | Mixture
    pool: Pool
    travel: Travel


def team_of(
    instance: str,
    *,
    humans: int,
    size: int,
    seed: int,
    domain: str | None,
    distances: Path | None,
    beta: Range,
    theta: Range,
    sigma: Range,
    crowd_file: Path | None,
    **setting: Any,
) -> Team:
    """Draw so many people and solve the POMDP of each.

    Raises
    ------
    click.UsageError
        An option that cannot be.
    """
    from ..people.choices import Choices
    from ..people.human import Population
    from ..team.pool import Pool
    from ..team.settings import Setting

    if humans > size:
        raise click.UsageError(f"--humans {humans} is more than --pool {size}")
    found = one_instance(instance, domain)
    choices = Choices.of(table_of(found))
    try:
        population: Population | Mixture = Population(beta, theta, sigma)
        if crowd_file:
            population = _population(crowd_file)
        chosen = Setting(**setting)
        travel = chosen.travel(humans, _matrix(distances) if distances else None)
        with progress_bar("solving people's POMDPs", size if chosen.knowledge == "own" else 1) as advance:
            pool = Pool.sample(
                choices,
                size,
                seed=seed,
                setting=chosen,
                population=population,
                progress=lambda done, _: advance(min(done, 1)),
            )
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    return Team(found, population, pool, travel)


def _population(file: Path) -> Mixture:
    """Read a population that `fit` has written."""
    from ..learning import population as populations

    try:
        return populations.mixture(json.loads(file.read_text(encoding="utf-8")))
    except ValueError as error:
        raise click.UsageError(f"--population {file}: {error}") from None


def _matrix(file: Path) -> list[list[float]]:
    """Read a matrix of distances."""
    try:
        matrix = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise click.UsageError(f"--distances {file}: {error}") from None
    rows = matrix if isinstance(matrix, list) else []
    numbers = all(isinstance(row, list) and all(isinstance(d, int | float) for d in row) for row in rows)
    if not rows or not numbers or len({len(row) for row in rows}) != 1:
        raise click.UsageError(f"--distances {file}: expected a list of lists of numbers, all of the same length")
    return rows
