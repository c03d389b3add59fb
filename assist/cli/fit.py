"""The command `fit`, which estimates people's parameters from a log of their actions."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, NamedTuple

import click

from ..declare.options import Given, setting_options
from ..people.trust_rules import RULES
from .options.common import OUTPUT_FILE, apart, figures_option, json_option, out_option, separate_files, together
from .options.goals import goals_option
from .options.help import command
from .options.log import ReadingOptions, TaskLog, method_of, reading_options, task_log_options, with_goals, with_task
from .options.population import RATES
from .options.settings import OF_INFLUENCE, EstimateSetting
from .options.trust import AdviceOptions, advice_of, advice_options, influence_option
from .output.people_estimates import FitFiles, learned, show_people
from .output.trust_estimates import show_advice, show_influence
from .terminal.console import ExitCode, one_line_errors

if TYPE_CHECKING:
    from ..learning.fit import Model


class Estimated(NamedTuple):
    """What is estimated besides expertise, influence and trust, and under which rule."""

    misconceptions: bool
    terms: bool
    trust: str | None
    problems: tuple[str, ...]


file_options = together(
    "files", FitFiles,
    (
        out_option("one record per person (JSON Lines)"),
        click.option(
            "--write-population", "population", type=OUTPUT_FILE, metavar="FILE",
            help="Write the distribution of expertise (beta) and influence (theta), for `simulate --population`.",
        ),
        click.option(
            "--family", type=click.Choice(["uniform", "log-uniform", "log-normal", "histogram"]),
            help="Family of the distribution of expertise (beta) over people. The best-fitting parametric one unless "
            "given.",
        ),
        figures_option,
        json_option,
    ),
)  # fmt: skip
model_options = together(
    "what", Estimated,
    (
        click.option(
            "--misconception", "misconceptions", is_flag=True,
            help="Also estimate misconceptions: their size (sigma) and the perceived cost-to-go.",
        ),
        click.option("--terms", is_flag=True, help="Fit preferences besides cost (hierarchical model)."),
        influence_option,
        goals_option,
    ),
)  # fmt: skip


@command("fit kitting/paper log.csv --out people.jsonl")
@task_log_options(required=False)
@file_options
@model_options
@advice_options
@reading_options
@setting_options(EstimateSetting)
def fit(
    log: TaskLog, files: FitFiles, what: Estimated, judged: AdviceOptions, reading: ReadingOptions,
    setting: EstimateSetting, given: Given[EstimateSetting],
) -> None:  # fmt: skip
    """Estimate people's expertise, influence and trust from a LOG of their actions.

    LOG has one line of JSON for each action: {"person": "...", "episode": "...", "step": 0, "action": "(name arg ...)",
    "suggestion": "(...)" or null}. A CSV file with these columns is accepted too. --advice takes the place of both.
    """
    from ..drawing.plots import style

    _require_one_model(files, what, setting, given)
    if judged.advice and not what.trust:
        raise click.UsageError("--advice: expected --influence as well")
    with one_line_errors("interrupted; nothing was estimated"):
        judgements = advice_of(judged, setting, given, {"trust"})
        if judgements is not None and what.trust is not None:
            separate_files({"--out": files.out}, {"--advice": judged.advice})
            show_advice(judgements, str(judged.advice), what.trust, files)
            return
    with one_line_errors("interrupted; states evaluated on demand are saved"):
        found, file, inputs = log.found()
        separate_files({"--out": files.out, "--write-population": files.population}, inputs)
        if files.figures:
            style.require()
        chooses = setting.chooses
        if what.problems:
            seen = with_goals([str(log.instance), *what.problems], file, log.domain, reading, setting)
        else:
            seen = with_task(found, file, reading, setting, choices=chooses is not None)
        method = method_of(setting)
        if what.trust:
            complete = show_influence(seen, what.trust, method, setting, files)
        else:
            model: Model | None = "misconceptions" if what.misconceptions else "terms" if what.terms else chooses
            complete = show_people(learned(seen, method, model, reading.jobs), files)
    if not complete:
        sys.exit(ExitCode.FAILED)


def _require_one_model(
    files: FitFiles, what: Estimated, setting: EstimateSetting, given: Given[EstimateSetting]
) -> None:
    """Refuse options that have no effect together."""
    if files.family and files.as_json and not files.population:
        raise click.UsageError("--family: expected --write-population, since with --json it has no effect otherwise")
    models = {"--misconception": what.misconceptions, "--terms": what.terms, "chooses": setting.chooses}
    kinds = {"--goals": what.problems, **models, "--influence": what.trust}
    for one in ("--goals", "--influence"):  # which go together
        apart({name: value for name, value in kinds.items() if name == one or name in models})
    for name in ("--goals", "chooses", "--influence"):
        if kinds[name]:
            given.refuse(["seed"], f"with {name}")
    for name, value in {"--family": files.family, "--figures": files.figures}.items():
        apart({name: value, "--influence": what.trust})
    apart({"--family": files.family, "--terms": what.terms})
    apart({"--goals": what.problems, "--figures": files.figures})
    apart({"--write-population": files.population, "neighbours": setting.neighbours})
    if files.population and what.trust not in (None, *RULES):
        raise click.UsageError(
            f"--write-population and --influence {what.trust}: a population file has no rules of your own; expected "
            "one of them"
        )
    if files.population and setting.chooses:
        raise click.UsageError(
            "--write-population and chooses: a population file has no functions; expected one of them"
        )
    if what.trust not in (None, "paper"):
        given.refuse(RATES, f"with --influence {what.trust}")
    if not what.trust:
        given.refuse(OF_INFLUENCE, "without --influence")
    if not what.problems:
        given.refuse(["goal_prior"], "without --goals")
