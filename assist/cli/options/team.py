"""The options that describe a team, and the people and distances that are built from them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from planner import Instance, LimitError

from ..terminal.console import ExitCode, fail
from .common import (
    INPUT_FILE,
    SEED,
    Command,
    Option,
    Range,
    is_given,
    max_states_option,
    megabytes_option,
    range_option,
    refuse_unused,
    region_states_option,
    with_options,
)
from .person import model_options
from .population import (
    people_option,
    population_of,
    population_options,
    read_population,
    refuse_unused_rates,
    with_rule_of,
)
from .task import costs_of, one_instance
from .travel import travel_of, travel_options

if TYPE_CHECKING:
    from planner import CostToGo

    from ...people.goals import Goals
    from ...people.human import Population
    from ...simulation.pool import Pool
    from ...team.state import TeamPolicy
    from ...team.travel import Travel


def team_options(command: Command) -> Command:
    """Add the options that describe a team. `team_of` takes their values."""
    options: tuple[Option[Any], ...] = (
        click.option(
            "--humans", type=click.IntRange(min=1), required=True, metavar="K",
            help="Number of people in a team.",
        ),
        click.option("--seed", type=SEED, default=0, show_default=True, help="Random seed."),
        *model_options(),
        travel_options,
        click.option(
            "--knowledge", type=click.Choice(["own", "exact"]), default="own", show_default=True,
            help="What the robot knows: each person's own perceived costs, or the exact costs only (one policy for "
                 "all).",
        ),
        population_options(),
        people_option,
        click.option(
            "--prior", type=INPUT_FILE, metavar="FILE",
            help="The robot's prior over people, as in --population. The true population unless given.",
        ),
        range_option("--sigma", (0.1, 1.0), "Range of the size of people's misconceptions (sigma, cost units)."),
        megabytes_option("Memory for policies.", default=4000.0),
        max_states_option("Largest number of states solved exhaustively. States of larger tasks are solved on demand."),
        region_states_option(
            "Size of the truncated problem used for policies on large tasks (states most likely to be visited). "
            "Unless given, 3,000 if symmetries were used, 200 if states are solved on demand, and 1,000 or more for "
            "each of several goals."
        ),
    )  # fmt: skip
    return with_options(command, options)


class TeamSetup(NamedTuple):
    """The task, the pool of people from which teams are drawn, and the distances between their stations."""

    instance: Instance
    known: CostToGo | Goals
    population: Population
    pool: Pool
    travel: Travel

    def prepared(self, policy: str | TeamPolicy) -> TeamPolicy:
        """Return the team policy of this name; a policy object is returned unchanged."""
        if not isinstance(policy, str):
            return policy
        try:
            return self.pool.policy(policy, self.travel)
        except ValueError as error:  # the policy needs a problem that is not truncated
            truncated = self.pool.goals == 1 and self.pool.setting.observation is None
            hint = " (--region-states)" if truncated else ""
            fail(f"{self.instance}: {error}{hint}", ExitCode.FAILED)


def team_of(
    instance: str, *, humans: int, size: int, seed: int, domain: str | None, distances: Path | None, beta: Range,
    theta: Range, sigma: Range, population_file: Path | None, people: str | None, prior: Path | None,
    memory_limit: float, max_states: int, region_states: int, goals: Goals | None = None, **setting: Any,
) -> TeamSetup:  # fmt: skip
    """Draw a pool of `size` people, of whom each pursues one of some goals if there are several.

    Expected errors end the command in one line.
    """
    from ...simulation.pool import Pool
    from ...team.settings import Setting

    refuse_unused_rates(setting.get("trust"))
    if humans > size:
        raise click.UsageError(f"--humans {humans} is more than --pool {size}")
    population = population_of(beta, theta, sigma, file=population_file, people=people)
    try:
        believed = None if prior is None else read_population(prior)
    except ValueError as error:
        raise click.UsageError(f"--prior {prior}: {error}") from None
    found = one_instance(instance, domain)
    known = goals or costs_of(found, max_states=max_states, memory_limit_mb=None)
    try:
        chosen = Setting(**with_rule_of(population_file, setting, rate=True))
        if not chosen.fleet.executes:
            refuse_unused(["c_execute"], "without --execute")
        travel = travel_of(chosen, humans, distances)
        pool = Pool.sample(
            known, size, seed=seed, setting=chosen, population=population, prior=believed,
            memory_limit_mb=memory_limit, states=region_states,
            region=region_states if (goals is None and known.method == "sweep") or is_given("region_states") else None,
        )  # fmt: skip
    except LimitError as error:
        fail(f"{found}: {error} (--memory-limit)", ExitCode.FAILED)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    return TeamSetup(found, known, population, pool, travel)
