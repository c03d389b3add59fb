"""The command `compare`, which says what predicts people best to whom it was not fitted."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from ..declare.options import Given, setting_options
from .options.common import INPUT_FILE, domain_option, figures_option, json_option, out_option, separate_files
from .options.help import command
from .options.log import ReadingOptions, folds_option, method_of, reading_options, with_task
from .options.settings import EstimateSetting
from .options.task import one_instance
from .options.trust import advice_of, advice_options
from .output.comparisons import models_compared, rules_compared, show_comparison
from .terminal.console import ExitCode, one_line_errors


@click.group()
def compare() -> None:
    """Compare models of people by how well they predict people to whom they were not fitted."""


@command("compare models kitting/paper log.csv", "models")
@click.argument("instance", metavar="INSTANCE")
@click.argument("file", metavar="LOG", type=INPUT_FILE)
@folds_option
@out_option("one record per person (JSON Lines)")
@figures_option
@domain_option
@reading_options
@setting_options(EstimateSetting)
@json_option
def models(
    instance: str, domain: str | None, file: Path, folds: int, out: Path | None, figures: Path | None, as_json: bool,
    setting: EstimateSetting, given: Given[EstimateSetting], **options: Any,
) -> None:  # fmt: skip
    """Compare choice models: cost alone, and cost with one or all terms, on a LOG of people's actions."""
    from ..drawing.plots import style

    given.refuse(
        ("goal_prior", "seed", "theta_per_episode", "confidence", "chooses"), "on a comparison of choice models"
    )
    reading, method = ReadingOptions.of(setting, options), method_of(setting)
    with one_line_errors("interrupted; states evaluated on demand are saved"):
        found = one_instance(instance, domain)
        separate_files({"--out": out}, {"INSTANCE": found.problem, "its domain": found.domain, "LOG": file})
        if figures:
            style.require()
        seen = with_task(found, file, reading)
        show_comparison(models_compared(seen, method, folds), out, figures, as_json=as_json)
    if not seen.complete:
        sys.exit(ExitCode.FAILED)


@command("compare rules kitting/paper log.csv", "rules")
@click.argument("instance", metavar="INSTANCE", required=False)
@click.argument("file", metavar="LOG", type=INPUT_FILE, required=False)
@folds_option
@advice_options
@out_option("one record per person (JSON Lines)")
@domain_option
@reading_options
@setting_options(EstimateSetting)
@json_option
def rules(
    instance: str | None, domain: str | None, file: Path | None, folds: int, out: Path | None, as_json: bool,
    advice: Path | None, rows: tuple[str, ...], setting: EstimateSetting, given: Given[EstimateSetting],
    **options: Any,
) -> None:  # fmt: skip
    """Compare trust rules on a LOG of people's actions, or on judgements with --advice.

    Of --advice, base rates, a theta that all people share, and rules of given steps are compared, too.
    """
    given.refuse(("goal_prior", "seed", "chooses"), "on a comparison of trust rules")
    reading, method = ReadingOptions.of(setting, options), method_of(setting)
    with one_line_errors("interrupted; states evaluated on demand are saved"):
        judgements = advice_of(advice, rows, setting, given, {"folds", "level"})
        if judgements is not None:
            separate_files({"--out": out}, {"--advice": advice})
            found = rules_compared(judgements, str(advice), method, folds, carry=True)
            show_comparison(found, out, None, as_json=as_json)
            return
        if instance is None or file is None:
            raise click.UsageError("expected INSTANCE and LOG, or --advice")
        task = one_instance(instance, domain)
        separate_files({"--out": out}, {"INSTANCE": task.problem, "its domain": task.domain, "LOG": file})
        seen = with_task(task, file, reading)
        found = rules_compared(seen.observations(), seen.log.name, method, folds, carry=not setting.theta_per_episode)
        show_comparison(found, out, None, as_json=as_json)
    if not seen.complete:
        sys.exit(ExitCode.FAILED)


compare.add_command(models)
compare.add_command(rules)
