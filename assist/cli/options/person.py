"""The options that describe one person's POMDP, and the problem that is built from them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from planner import Instance
from planner.system.progress import progress_bar

from .common import (
    NUMBER,
    SEED,
    Command,
    Option,
    Range,
    domain_option,
    is_given,
    lapse_option,
    refuse_unused,
    scale_option,
    with_options,
)
from .population import people_option, population_of, population_options, refuse_unused_rates, with_rule_of
from .task import one_instance

TRUST = ("paper", "constant", "outcome", "outcome-at-disagreement", "reliability")
"""Names of `assist.people.trust_rules.RULES`, without loading numpy."""

if TYPE_CHECKING:
    from planner import CostToGo

    from ...large_tasks.person_problem import PersonProblem
    from ...people.goals import Goals


def model_options() -> tuple[Option[Any], ...]:
    """Return the options for the robot's costs and its model of people, shared by single people and teams."""
    return (
        domain_option,
        click.option("--gamma", type=NUMBER, default=0.99, show_default=True, help="Discount factor per step (gamma)."),
        click.option(
            "--c-suggest", type=NUMBER, default=1.0, show_default=True,
            help="Cost of a suggestion (cost units).",
        ),
        click.option("--eta", type=NUMBER, default=0.2, show_default=True, help="Rate of the trust update (eta)."),
        scale_option,
        click.option(
            "--trust", type=click.Choice(TRUST),
            help="How influence (theta) moves: by equation (7), not at all, or by the outcome of suggestions.  "
                 "[default: paper; constant for real people]",
        ),
        lapse_option("Weight of a uniform choice in the robot's model."),
        click.option(
            "--suggestions", type=click.Choice(["optimal", "all"]), default="optimal", show_default=True,
            help="Actions that the robot may suggest: optimal choices only, or all.",
        ),
        click.option("--execute", is_flag=True, help="The robot can also execute an action itself."),
        click.option(
            "--c-execute", type=NUMBER, default=1.0, show_default=True,
            help="Cost of an action executed by the robot (cost units).",
        ),
    )  # fmt: skip


def observation_options(command: Command) -> Command:
    """Add the options for a robot that does not see every action as it is. `observation_of` takes their values."""
    share = click.FloatRange(0, 1, max_open=True)
    return with_options(
        command,
        (
            click.option(
                "--miss", type=share, default=0.0, show_default=True, metavar="P",
                help="Probability that the robot misses an action.",
            ),
            click.option(
                "--confusion", type=share, default=0.0, show_default=True, metavar="P",
                help="Probability that it sees another action instead.",
            ),
        ),
    )  # fmt: skip


def person_options(command: Command) -> Command:
    """Add the options that describe one person's problem. `person_problem` takes their values."""
    options: tuple[Option[Any], ...] = (
        *model_options(),
        population_options("the person's"),
        people_option,
        click.option(
            "--sigma", type=NUMBER, default=0.0, show_default=True,
            help="Standard deviation of the person's misconception (sigma, cost units). The robot knows the "
                 "misconception.",
        ),
        click.option(
            "--seed", type=SEED, default=0, show_default=True,
            help="Random seed of the person's misconception.",
        ),
    )  # fmt: skip
    return with_options(command, options)


def person_problem(
    instance: str, known_of: Callable[[Instance], CostToGo | Goals], *, states: int | None, domain: str | None,
    beta: Range, theta: Range, population_file: Path | None, people: str | None, sigma: float, execute: bool,
    time_limit: float | None = None, memory_limit: float = float("inf"), **setting: Any,
) -> tuple[Instance, PersonProblem]:  # fmt: skip
    """Build one person's problem from the values of `person_options`. Invalid options raise usage errors.

    Parameters
    ----------
    known_of : callable
        Reads and solves the task, or the tasks of several goals.
    states : int or None
        Largest number of states in the problem; a larger task is truncated to it. None: all states of the task.
    time_limit : float, optional
        Seconds for choosing the states of a truncated problem.
    memory_limit : float
        Memory of the solver in MB. A truncated problem has fewer states if it is short, unless their number was given.
    """
    from ...large_tasks.person_problem import PersonProblem, is_whole
    from ...people.goals import each_of

    refuse_unused_rates(setting.get("trust"))
    if not execute:
        refuse_unused(["c_execute"], "without --execute")
    found = one_instance(instance, domain)
    population = population_of(beta, theta, file=population_file, people=people)
    known = known_of(found)
    if states is None:
        states = len(known)
    whole = is_whole(known, states)
    for name, given in (("--sigma", sigma > 0), ("--execute", execute)):
        if given and not whole:
            raise click.UsageError(f"{name}: expected a task of at most {states:,} states (--region-states)")
    if not whole and not is_given("region_states"):  # a state takes memory for each goal
        states = max(1, states // len(each_of(known)))
    else:
        memory_limit = float("inf")
    try:
        with nullcontext() if whole else progress_bar("collecting states", states) as advance:
            problem = PersonProblem.of(
                known, states=states, population=population, sigma=sigma, execute=execute, time_limit=time_limit,
                memory_limit_mb=memory_limit,
                progress=advance, **with_rule_of(population_file, setting, rate=True),
            )  # fmt: skip
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    return found, problem
