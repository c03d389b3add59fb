"""Output of `fit` about trust rules: estimates of influence under one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import click

from planner.system.files import write_records

from ..options.log import carried
from ..terminal.console import ExitCode, fail, print_json, print_table
from .people_estimates import FitFiles, interval_head, interval_of, write_population

if TYPE_CHECKING:
    from ...learning.advice_log import AdviceLog
    from ...learning.evidence import Evidence
    from ...learning.likelihood import Method
    from ...learning.trust_fit import InfluenceFit
    from ..options.settings import EstimateSetting


FAR = 5.0
"""Difference of log likelihoods from which one of two models with as many parameters is said to be better."""


def show_influence(seen: Evidence, rule: str, method: Method, setting: EstimateSetting, files: FitFiles) -> bool:
    """Estimate influence under a rule. Return whether every line of the log was used."""
    from ...learning.trust_fit import fit_influence

    try:
        found = fit_influence(seen, rule, method, carry=carried(seen, setting))
    except ValueError as error:
        fail(f"{seen.log.name}: {error}", ExitCode.FAILED)
    if files.population:
        write_population(found.distribution(), files.population)
    _show_influence(found, method.level, files)
    return seen.complete


def show_advice(log: AdviceLog, name: str, rule: str, files: FitFiles) -> None:
    """Fit a trust rule to judgements with advice."""
    from ...learning.advice_fit import fit_advice

    try:
        found = fit_advice(log, rule)
    except ValueError as error:
        fail(f"{name}: {error}", ExitCode.FAILED)
    if files.out:
        write_records(files.out, [found.as_dict()])
    if files.as_json:
        print_json(found.as_dict())
        return
    click.echo(f"{found.people:,} people, {found.choices:,} choices; log likelihood {found.log_likelihood:.3f}")
    click.echo(f"trust rule {rule}: {_numbers(found.parameters)}")


def _show_influence(found: InfluenceFit, level: float, files: FitFiles) -> None:
    document = found.as_dict()
    if files.out:
        write_records(files.out, document["people"])
    if files.as_json:
        print_json(document)
        return
    rows = [
        [
            one.person, f"{one.followed} of {one.suggestions}", interval_of(one.theta_first, one.theta_first_interval),
            interval_of(one.theta, one.theta_interval), interval_of(one.beta, one.beta_interval),
        ]
        for one in found.people
    ]  # fmt: skip
    head = [interval_head(name, level) for name in ("theta at first", "theta at last", "beta")]
    print_table(("person", "followed", *head), rows, width=160)
    known = {name: None if name in found.unidentified else found.parameters[name] for name in found.intervals}
    fitted = {
        name: interval_of(known[name], ends, name in found.open_above, digits=3)
        for name, ends in found.intervals.items()
    }
    numbers = "".join(f", {name} {value}" for name, value in fitted.items())
    click.echo(f"trust rule {found.rule}{numbers}; log likelihood {found.log_likelihood:.3f}")
    for name in found.unidentified:
        click.echo(f"these actions say nothing about {name}")
    click.echo(f"population of {len(found.people)}: {_numbers(vars(found.population))}")
    if found.log_likelihood_anew is not None and found.log_likelihood_anew > found.log_likelihood + FAR:
        click.echo(
            f"if theta begins anew in each episode, the log likelihood is {found.log_likelihood_anew:.3f}: carried "
            "over, it does not describe these people; --set theta_per_episode=true"
        )


def _numbers(parameters: Mapping[str, float]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {value:.3g}" for name, value in parameters.items())
