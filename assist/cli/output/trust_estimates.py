"""Output of `fit` about trust rules: estimates of influence under one, and comparisons of all."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.table import Table

from planner.system import files
from planner.system.errors import InputFileError
from planner.system.progress import progress_bar

from ..options.log import Replayed
from ..options.trust import TrustOptions
from ..terminal.console import ExitCode, fail, print_json, print_table
from .people_estimates import write_population

if TYPE_CHECKING:
    from ...learning.trust_fit import InfluenceFit
    from ...learning.trust_scores import TrustComparison


def show_trust(
    known: Replayed, wanted: TrustOptions, folds: int, out: Path | None, population: Path | None, *, as_json: bool
) -> bool:  # fmt: skip
    """Estimate influence under a rule, or compare all rules. Return whether every line of the log was used."""
    from ...learning.fit import LogError, observed
    from ...learning.rule_families import families
    from ...learning.trust_comparison import compare_trust
    from ...learning.trust_fit import fit_influence

    carry, method, name = wanted.carry, known.method, known.log.name
    try:
        observations, _ = observed(known.log, known.walked, known.recording, known.evaluated)
        if wanted.rule is None:
            with progress_bar("comparing trust rules", len(families(method))) as advance:
                compared = compare_trust(observations, method, folds=folds, carry=carry, progress=advance)
            _show_comparison(compared, out, as_json=as_json)
        else:
            found = fit_influence(observations, wanted.rule, method, carry=carry)
            if population:
                write_population(found.distribution(), population)
            _show_influence(found, out, as_json=as_json)
    except LogError as error:
        fail(f"{name}: {str(error).removeprefix(f'{name}: ')}", ExitCode.FAILED)
    return not known.faults and sum(len(o) for o in observations) == len(known.recording)


def show_advice(wanted: TrustOptions, folds: int, level: float, out: Path | None, *, as_json: bool) -> None:
    """Fit a trust rule to judgements with advice, or compare all rules."""
    from ...learning.advice_fit import COMPARED, compare_advice, fit_advice
    from ...learning.advice_log import read_advice

    assert wanted.advice is not None
    if not 0 < level < 1:
        raise click.UsageError(f"level {level:g}: expected 0 < level < 1")
    try:
        log = read_advice(wanted.advice, confidence=wanted.confidence, rows=wanted.rows)
    except InputFileError as error:
        fail(str(error), ExitCode.FAILED)
    try:
        if wanted.rule is None:
            with progress_bar("comparing trust rules", len(COMPARED)) as advance:
                compared = compare_advice(log, folds=folds, level=level, progress=advance)
            _show_comparison(compared, out, as_json=as_json)
            return
        found = fit_advice(log, wanted.rule)
    except ValueError as error:
        fail(f"{wanted.advice}: {error}", ExitCode.FAILED)
    if out:
        files.write_records(out, [found])
    if as_json:
        print_json(found)
        return
    click.echo(
        f"{found['people']:,} people, {found['choices']:,} choices; log likelihood {found['log_likelihood']:.3f}"
    )
    click.echo(f"trust rule {wanted.rule}: {_numbers(found['parameters'])}")


def _show_influence(found: InfluenceFit, out: Path | None, *, as_json: bool) -> None:
    document = found.as_dict()
    if out:
        files.write_records(out, document["people"])
    if as_json:
        print_json(document)
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("person")
    for name in ("followed", "theta at first", "theta at last", "beta"):
        table.add_column(name, justify="right")
    for one in found.people:
        table.add_row(
            one.person, f"{one.followed} of {one.suggestions}", _interval(one.theta_first, one.theta_first_interval),
            _interval(one.theta, one.theta_interval), _interval(one.beta, one.beta_interval),
        )  # fmt: skip
    print_table(table, width=160)
    fitted = {name: _interval(found.parameters[name], ends) for name, ends in found.intervals.items()}
    numbers = "".join(f", {name} {value}" for name, value in fitted.items())
    click.echo(f"trust rule {found.rule}{numbers}; log likelihood {found.log_likelihood:.3f}")
    click.echo(f"population of {len(found.people)}: {_numbers(vars(found.population))}")


def _show_comparison(compared: TrustComparison, out: Path | None, *, as_json: bool) -> None:
    document = compared.as_dict()
    if out:
        files.write_records(out, document["rules"])
    if as_json:
        print_json(document)
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("trust rule")
    for name in ("nats per choice", f"minus constant ({compared.level:.0%} interval)", "p, corrected"):
        table.add_column(name, justify="right")
    table.add_column("parameters")
    for row in compared.scores:
        paired = corrected = "-"
        if row.difference is not None and row.interval is not None:
            paired = f"{row.difference:+.4f} ({row.interval[0]:+.4f} to {row.interval[1]:+.4f})"
            corrected = f"{row.p_corrected:.2g}"
        nats = f"{row.nats_per_choice:.4f} ± {row.stderr:.4f}"
        table.add_row(row.rule, nats, paired, corrected, _numbers(row.parameters))
    print_table(table, width=200)
    click.echo(f"{compared.people:,} people, {compared.choices:,} choices; best: {compared.best.rule}")


def _interval(value: float, interval: tuple[float, float]) -> str:
    return f"{value:.2f} ({interval[0]:.2f} to {interval[1]:.2f})"


def _numbers(parameters: Mapping[str, float]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {value:.3g}" for name, value in parameters.items())
