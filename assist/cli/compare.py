"""The command `compare`, which says what predicts people best to whom it was not fitted."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from ..declare.options import Given, setting_options
from .options.common import apart, baseline_option, figures_option, json_option, out_option, separate_files, together
from .options.help import command
from .options.log import (
    ReadingOptions,
    TaskLog,
    carried,
    folds_option,
    method_of,
    reading_options,
    task_log_options,
    with_task,
)
from .options.settings import OF_INFLUENCE, EstimateSetting
from .options.trust import AdviceOptions, ComparedRules, advice_of, advice_options, compared_rules
from .output.comparisons import ComparisonFiles, models_compared, rules_compared, show_comparison
from .terminal.console import ExitCode, one_line_errors

comparison_files = together(
    "files", ComparisonFiles,
    (
        baseline_option,
        out_option("one record per person (JSON Lines)"), json_option,
    ),
)  # fmt: skip


class Comparisons(click.Group):
    """The group of the comparisons; whoever names none of them learns which there are."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a comparison; another word is a usage error."""
        if cmd_name not in self.commands and not cmd_name.startswith("-"):
            known = " or ".join(self.commands)
            ctx.fail(f"'{cmd_name}': expected {known} first, such as kitassist compare models INSTANCE LOG")
        return super().get_command(ctx, cmd_name)


@click.group(cls=Comparisons)
def compare() -> None:
    """Compare models of people by how well they predict people to whom they were not fitted."""


@command("compare models kitting/paper log.csv", "models")
@task_log_options()
@folds_option
@comparison_files
@figures_option
@reading_options
@setting_options(EstimateSetting)
def compare_models(
    log: TaskLog, folds: int, files: ComparisonFiles, figures: Path | None, reading: ReadingOptions,
    setting: EstimateSetting, given: Given[EstimateSetting],
) -> None:  # fmt: skip
    """Compare choice models: cost alone, and cost with one or all terms, on a LOG of people's actions."""
    from ..drawing.plots import style

    given.refuse(
        ("goal_prior", "seed", *OF_INFLUENCE, "confidence", "chooses"),
        "on a comparison of choice models",
    )
    with one_line_errors("interrupted; states evaluated on demand are saved"):
        found, file, inputs = log.found()
        separate_files({"--out": files.out}, inputs)
        if figures:
            style.require()
        seen = with_task(found, file, reading, setting)
        show_comparison(models_compared(seen, method_of(setting), folds), files, figures)
    if not seen.complete:
        sys.exit(ExitCode.FAILED)


@command("compare rules kitting/paper log.csv", "rules")
@task_log_options(required=False)
@folds_option
@compared_rules
@advice_options
@comparison_files
@reading_options
@setting_options(EstimateSetting)
def compare_rules(
    log: TaskLog, folds: int, rules: ComparedRules, judged: AdviceOptions, files: ComparisonFiles,
    reading: ReadingOptions, setting: EstimateSetting, given: Given[EstimateSetting],
) -> None:  # fmt: skip
    """Compare trust rules on a LOG of people's actions, or on judgements with --advice.

    Of --advice, base rates, a theta that all people share, and rules of given steps are compared, too. With --influence
    and the table `neighbours`, rules of what people see of each other are compared, beside this trust rule.
    """
    given.refuse(("goal_prior", "seed", "chooses"), "on a comparison of trust rules")
    method = method_of(setting)
    with one_line_errors("interrupted; states evaluated on demand are saved"):
        judgements = advice_of(judged, setting, given, {"folds", "level"})
        if judgements is not None:
            separate_files({"--out": files.out}, {"--advice": judged.advice})
            show_comparison(rules_compared(judgements, str(judged.advice), method, folds, carry=True), files)
            return
        trust, chosen = rules
        if (trust is None) != (setting.neighbours is None):
            raise click.UsageError("--influence and neighbours: expected both, such as --set neighbours.sees=next")
        apart({"--rule": chosen, "--influence": trust})
        task, file, inputs = log.found()
        separate_files({"--out": files.out}, inputs)
        seen = with_task(task, file, reading, setting)
        carry = carried(seen, setting)
        compared = rules_compared(seen, seen.log.name, method, folds, carry=carry, beside=trust, rules=chosen)
        show_comparison(compared, files)
    if not seen.complete:
        sys.exit(ExitCode.FAILED)


compare.add_command(compare_models)
compare.add_command(compare_rules)
