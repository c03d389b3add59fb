"""Comparisons of models on people to whom they were not fitted: computed with progress, and shown."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from planner.system.errors import InputFileError
from planner.system.files import write_records
from planner.system.progress import stages

from ..terminal.console import ExitCode, fail, print_json, print_table

if TYPE_CHECKING:
    from ...learning.advice_log import AdviceLog
    from ...learning.comparison import Comparison
    from ...learning.evidence import Evidence
    from ...learning.likelihood import Method


def models_compared(seen: Evidence, method: Method, folds: int) -> Comparison:
    """Compare choice models on the people in a log. Expected errors end the command in one line."""
    from ...learning.held_out import compare_models
    from ...people.terms import TERMS

    try:
        with stages() as show:
            return compare_models(seen.observations(TERMS), method, folds=folds, progress=show)
    except InputFileError as error:
        fail(f"{seen.log.name}: {error}", ExitCode.FAILED)


def rules_compared(
    people: Evidence | AdviceLog, name: str, method: Method, folds: int, *, carry: bool | None,
    beside: str | None = None, rules: Sequence[str] = (),
) -> Comparison:  # fmt: skip
    """Compare trust rules on the people of a file with this name, or rules of what they see of others beside one.

    With `rules`, these are compared with a theta that never moves, in place of all that are shipped.

    Expected errors end the command in one line.
    """
    from ...learning.held_out import REFERENCE, compare_rules

    try:
        chosen: Any = list(dict.fromkeys((REFERENCE, *rules))) if rules else None
        with stages() as show:
            return compare_rules(people, method, rules=chosen, beside=beside, folds=folds, carry=carry, progress=show)
    except ValueError as error:
        fail(f"{name}: {error}", ExitCode.FAILED)


class ComparisonFiles(NamedTuple):
    """What the others are compared with, where a comparison is written, and whether it is printed as JSON."""

    baseline: str | None
    out: Path | None
    as_json: bool


def show_comparison(compared: Comparison, files: ComparisonFiles, figures: Path | None = None) -> None:
    """Write and print a comparison."""
    from ...drawing.plots import people as pictures

    if files.baseline is not None:
        try:
            compared = compared.against(files.baseline)
        except ValueError as error:
            raise click.UsageError(f"--baseline {error}") from None
    if files.out:
        write_records(files.out, compared.of_people())
    if figures:
        pictures.draw_comparison(compared, figures)
    if files.as_json:
        print_json(compared.as_dict())
        return
    reference, people = compared.scores[0].model, len(compared.people)
    of_difference = f"minus {reference} ({compared.level:.0%} interval)"
    nats_head = "nats per choice ± standard error"
    head, rows = ("model", nats_head, of_difference, "p, corrected", "better for", "parameters"), []
    for row in compared.scores:
        paired = corrected = better = "-"
        if row.difference is not None:
            ends = "" if row.interval is None else f" ({row.interval[0]:+.4f} to {row.interval[1]:+.4f})"
            paired = f"{row.difference:+.4f}{ends}"
            corrected, better = f"{row.p_corrected:.2g}", f"{row.better_for} of {people}"
        nats = f"{row.nats_per_choice:.4f} ± {row.stderr:.4f}"
        numbers = ", ".join(f"{name.replace('_', ' ')} {value:.3g}" for name, value in row.parameters.items())
        rows.append([row.model, nats, paired, corrected, better, numbers])
    print_table(head, rows, left=(0, 5), width=200)
    best = f"best: {compared.best.model}"
    if len(rows) > 1 and compared.best.model == reference:
        best += f", since no other predicts better than it at {compared.level:.0%} (p, corrected)"
    elif len(rows) > 1:
        best += f", of those that predict better than {reference} at {compared.level:.0%} (p, corrected)"
    click.echo(f"{people:,} people, {compared.choices.sum():,} choices; {best}")
