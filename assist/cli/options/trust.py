"""The options about trust rules and judgements with advice."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from planner.system.errors import InputFileError

from ...declare.declared import names_of
from ...declare.options import Given
from ...people.trust_rules import RULES
from ..terminal.console import ExitCode, fail
from .common import INPUT_FILE, is_given, together
from .policies import NameOrFile
from .settings import EstimateSetting

if TYPE_CHECKING:
    from ...learning.advice_log import AdviceLog

WITH_ADVICE = {"advice", "rows", "out", "as_json", "changes", "setting_file"}
"""Parameters of all commands that have an effect with `--advice`."""


class AdviceOptions(NamedTuple):
    """Judgements with advice that take the place of a log: a file, and which rows of it."""

    advice: Path | None
    rows: tuple[str, ...]


RULE_NAME = NameOrFile("rule", RULES, "RULE")

influence_option = click.option(
    "--influence", "trust", type=RULE_NAME, metavar="RULE",
    help="Trust rule by which influence (theta) moves, carried from episode to episode (hierarchical model): "
    f"{', '.join(RULES)}, or FILE.py:RULE.",
)  # fmt: skip


class ComparedRules(NamedTuple):
    """Trust rules that are compared; or one of people's own, beside which those of what they see of others are."""

    trust: str | None
    chosen: tuple[str, ...]


compared_rules = together(
    "rules", ComparedRules,
    (
        influence_option,
        click.option(
            "--rule", "chosen", type=RULE_NAME, metavar="RULE", multiple=True,
            help="Compare this trust rule with one of a constant theta, in place of all shipped ones; a name or "
            "FILE.py:RULE. May be repeated.",
        ),
    ),
)  # fmt: skip


advice_options = together(
    "judged", AdviceOptions,
    (
        click.option(
            "--advice", type=INPUT_FILE,
            help="Estimate influence from judgements with advice (CSV), in place of INSTANCE and LOG.",
        ),
        click.option(
            "--rows", multiple=True, metavar="COLUMN=VALUE",
            help="Use the rows of --advice with this value in this column only. Several must all hold.",
        ),
    ),
)  # fmt: skip


def advice_of(
    judged: AdviceOptions, setting: EstimateSetting, given: Given[EstimateSetting], also: set[str]
) -> AdviceLog | None:
    """Return the judgements with advice; None without any.

    Parameters
    ----------
    judged : AdviceOptions
    setting, given
        The command's setting, and what of it was given.
    also : set of str
        Parameters of the running command, and fields of its setting, that have an effect with `--advice`, besides
        `WITH_ADVICE`.

    Raises
    ------
    click.UsageError
        An option has no effect together with the others.
    """
    chosen: dict[str, str] = {}
    for one in judged.rows:
        column, equals, value = (part.strip() for part in one.partition("="))
        if not column or not equals:
            raise click.UsageError(f"--rows {one}: expected COLUMN=VALUE, such as condition=feedback")
        if column in chosen:
            raise click.UsageError(f"--rows: column {column} is there twice; expected one value for it")
        chosen[column] = value
    if judged.advice is None:
        if judged.rows:
            raise click.UsageError("--rows: expected --advice as well")
        given.refuse(["confidence"], "without --advice")
        return None
    given.refuse(set(names_of(type(setting))) - {"confidence", *also}, "with --advice")
    for parameter in click.get_current_context().command.params:
        if parameter.name and parameter.name not in WITH_ADVICE | also and is_given(parameter.name):
            shown = parameter.metavar if isinstance(parameter, click.Argument) else parameter.opts[0]
            raise click.UsageError(f"{shown} has no effect with --advice")
    from ...learning.advice_log import read_advice

    try:
        return read_advice(judged.advice, confidence=setting.confidence, rows=chosen)
    except InputFileError as error:
        fail(str(error), ExitCode.FAILED)
