"""One person's problem: the options that describe it, and how it is set up from them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from planner import Cache, CostToGo, Instance, Table, cost_to_go, load

from .options import NUMBER, SEED, Range, domain_option
from .population import population_of, population_options
from .progress import progress_bar
from .task import one_instance, require_goal, table_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..person.pomdp import AssistPOMDP, Suggestions


def model_options() -> tuple[Callable[[Callable[..., None]], Callable[..., None]], ...]:
    """Give the options that say what the robot takes for granted, of a person or of a team."""
    return (
        domain_option,
        click.option("--gamma", type=NUMBER, default=0.99, show_default=True, help="Discount factor per step."),
        click.option("--c-suggest", type=NUMBER, default=1.0, show_default=True, help="Cost of a suggestion."),
        click.option("--eta", type=NUMBER, default=0.2, show_default=True, help="Rate of the trust update."),
        click.option(
            "--utility-scale", type=NUMBER, default=1.0, show_default=True, help="Cost units that change trust by eta."
        ),
        click.option(
            "--lapse", type=NUMBER, default=1e-3, show_default=True,
            help="Weight of a uniform choice in the robot's model.",
        ),
        click.option("--suggestions", type=click.Choice(["optimal", "all"]), default="optimal", show_default=True),
        click.option("--execute", is_flag=True, help="The robot can also do such an action itself."),
        click.option("--c-execute", type=NUMBER, default=1.0, show_default=True, help="What that costs."),
    )  # fmt: skip


def person_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options that say whose problem it is; `person_problem` takes them all."""
    options: tuple[Callable[[Callable[..., None]], Callable[..., None]], ...] = (
        *model_options(),
        population_options("the person's"),
        click.option(
            "--sigma", type=NUMBER, default=0.0, show_default=True,
            help="Size of a misconception, drawn once and known to the robot; with 0 it knows the task only.",
        ),
        click.option("--seed", type=SEED, default=0, show_default=True, help="Of the misconception."),
    )  # fmt: skip
    for option in reversed(options):
        command = option(command)
    return command


@dataclass(frozen=True)
class Part:
    """How a task is handled that is too large to keep all of.

    Attributes
    ----------
    max_states : int
        Beyond this many the cost-to-go is asked for on demand.
    region_states : int
        Beyond this many only the states that matter are looked at, and so many of them.
    memory_limit : float or None
        In megabytes.
    time_limit : float or None
        For collecting the states that matter, in seconds.
    """

    max_states: int
    region_states: int
    memory_limit: float | None
    time_limit: float | None


@dataclass(frozen=True)
class Person:
    """One person's problem and where it comes from.

    Attributes
    ----------
    instance : Instance
    known : CostToGo
    pomdp : AssistPOMDP
    states : int array, shape (n,)
        The number of each of the problem's states in `known`.
    """

    instance: Instance
    known: CostToGo
    pomdp: AssistPOMDP
    states: NDArray[np.int64]


def person_problem(
    instance: str,
    *,
    domain: str | None,
    gamma: float,
    c_suggest: float,
    eta: float,
    utility_scale: float,
    lapse: float,
    suggestions: Suggestions,
    execute: bool,
    c_execute: float,
    beta: Range,
    theta: Range,
    population_file: Path | None,
    sigma: float,
    seed: int,
    part: Part | None = None,
) -> Person:
    """Set up one person's problem from `person_options`; errors are those of a command.

    With `part` a task that is too large is cut down to the states that matter.
    """
    from ..people.choices import Choices
    from ..people.decision import perceived_cost, perceived_cost_to_go
    from ..people.human import HumanModel
    from ..person.pomdp import AssistPOMDP
    from ..person.region import Region

    found = one_instance(instance, domain)
    if not 0 <= sigma < math.inf:
        raise click.UsageError(f"--sigma {sigma:g}: expected 0 or more")
    population = population_of(beta, theta, file=population_file)
    known: CostToGo
    if part is None:
        known = table_of(found)
    else:
        task = load(found)
        known = cost_to_go(task, max_states=part.max_states, memory_limit_mb=part.memory_limit, cache=Cache(task))
        require_goal(found, float(known.lookup([known.initial])[0]))
    options = {"population": population, "gamma": gamma, "c_suggest": c_suggest, "suggestions": suggestions}
    human = {"eta": eta, "lapse": lapse, "utility_scale": utility_scale}
    whole = isinstance(known, Table) and (part is None or len(known) <= part.region_states)
    if part is not None and not whole:
        for name, given in (("--sigma", sigma > 0), ("--execute", execute)):
            if given:
                raise click.UsageError(
                    f"{name}: expected a task of at most {part.region_states:,} states (--region-states)"
                )
    try:
        if isinstance(known, Table) and whole:
            choices = Choices.of(known)
            h = perceived_cost_to_go(choices, sigma, np.random.default_rng(seed)) if sigma else choices.h
            model = HumanModel(choices, perceived_cost(choices, h), **human)
            pomdp = AssistPOMDP.of(model, execute=execute, c_execute=c_execute, **options)  # type: ignore[arg-type]
            return Person(found, known, pomdp, np.arange(len(known)))
        assert part is not None
        with progress_bar("collecting states", part.region_states) as advance:
            region = Region.of(
                known, states=part.region_states, population=population, time_limit=part.time_limit, progress=advance
            )
        return Person(found, known, region.problem(**options, **human), region.states)  # type: ignore[arg-type]
    except ValueError as error:
        raise click.UsageError(str(error)) from None
