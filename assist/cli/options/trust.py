"""The options of `fit` about trust rules, and what they exclude."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import click

from .common import INPUT_FILE, Command, Option, is_given, refuse_unused, with_options
from .person import TRUST
from .population import refuse_unused_rates

Confidence = Literal["own", "one"]

WITH_ADVICE = {"advice", "trust", "compare_trust", "confidence", "rows", "folds", "level", "out", "as_json"}
"""Parameters of `fit` that have an effect with `--advice`."""


class TrustOptions(NamedTuple):
    """What to estimate about trust rules.

    Attributes
    ----------
    rule : str or None
        Estimate influence under this rule.
    compare : bool
        Compare all rules.
    carry : bool
        Theta is carried from episode to episode.
    advice : Path or None
        Judgements with advice, in place of a log.
    confidence : "own" or "one"
        What confidences in that file are about.
    rows : dict of str to str
        Values of columns of that file; other rows are left out.
    """

    rule: str | None
    compare: bool
    carry: bool
    advice: Path | None
    confidence: Confidence
    rows: dict[str, str]

    @property
    def wanted(self) -> bool:
        """Whether anything about trust rules is to be estimated."""
        return self.compare or self.rule is not None

    @property
    def named(self) -> dict[str, object]:
        """The options by name that say what is estimated."""
        return {"--trust": self.rule, "--compare-trust": self.compare}


def fit_trust_options(command: Command) -> Command:
    """Add the options about trust rules. `trust_of` takes their values."""
    options: tuple[Option[Any], ...] = (
        click.option(
            "--trust", type=click.Choice(TRUST),
            help="Estimate influence (theta) under this trust rule, carried from episode to episode (hierarchical "
                 "model).",
        ),
        click.option("--compare-trust", is_flag=True, help="Compare trust rules by cross-validation over people."),
        click.option("--theta-per-episode", is_flag=True, help="Influence (theta) begins anew in each episode."),
        click.option(
            "--advice", type=INPUT_FILE,
            help="Estimate influence from judgements with advice (CSV), in place of INSTANCE and LOG.",
        ),
        click.option(
            "--confidence", type=click.Choice(["own", "one"]), default="own", show_default=True,
            help="What confidences in the file of --advice are about: the own choice, or the chance that choice 1 is "
                 "right.",
        ),
        click.option(
            "--rows", multiple=True, metavar="COLUMN=VALUE",
            help="Use the rows of --advice with this value in this column only. Several must all hold.",
        ),
    )  # fmt: skip
    return with_options(command, options)


def trust_of(
    trust: str | None, compare_trust: bool, theta_per_episode: bool, advice: Path | None,
    confidence: Confidence, rows: Sequence[str] = (),
) -> TrustOptions:  # fmt: skip
    """Return what to estimate about trust rules.

    Raises
    ------
    click.UsageError
        An option has no effect together with the others.
    """
    chosen: dict[str, str] = {}
    for one in rows:
        column, equals, value = (part.strip() for part in one.partition("="))
        if not column or not equals:
            raise click.UsageError(f"--rows {one}: expected COLUMN=VALUE, such as condition=feedback")
        if column in chosen:
            raise click.UsageError(f"--rows: column {column} is there twice; expected one value for it")
        chosen[column] = value
    found = TrustOptions(trust, compare_trust, not theta_per_episode, advice, confidence, chosen)
    refuse_unused_rates(trust)
    for option, given in found.named.items():
        if given:
            refuse_unused(["seed"], f"with {option}")
    if theta_per_episode and not found.wanted:
        raise click.UsageError("--theta-per-episode: expected --trust or --compare-trust as well")
    if advice is None:
        if is_given("confidence"):
            raise click.UsageError("--confidence: expected --advice as well")
        if rows:
            raise click.UsageError("--rows: expected --advice as well")
        return found
    if not found.wanted:
        raise click.UsageError("--advice: expected --trust or --compare-trust as well")
    if trust is not None:
        refuse_unused(["level"], "with --advice and --trust")
    context = click.get_current_context()
    for parameter in context.command.params:
        if parameter.name and parameter.name not in WITH_ADVICE and is_given(parameter.name):
            name = parameter.metavar if isinstance(parameter, click.Argument) else parameter.opts[0]
            raise click.UsageError(f"{name} has no effect with --advice")
    return found
