"""The command `fit`, which estimates people's parameters from a log of their actions."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..declare.options import Given, setting_options
from .options.common import (
    INPUT_FILE,
    OUTPUT_FILE,
    apart,
    domain_option,
    figures_option,
    json_option,
    out_option,
    separate_files,
)
from .options.goals import goals_option
from .options.help import command
from .options.log import ReadingOptions, method_of, reading_options, with_goals, with_task
from .options.person import TRUST
from .options.population import RATES, choice_model_of
from .options.settings import EstimateSetting
from .options.task import one_instance
from .options.trust import advice_of, advice_options
from .output.people_estimates import learned, show_people
from .output.trust_estimates import show_advice, show_influence
from .terminal.console import ExitCode, one_line_errors

if TYPE_CHECKING:
    from ..learning.fit import Model


@command("fit kitting/paper log.csv --out people.jsonl")
@click.argument("instance", metavar="INSTANCE", required=False)
@click.argument("file", metavar="LOG", type=INPUT_FILE, required=False)
@out_option("one record per person (JSON Lines)")
@click.option(
    "--write-population", "population", type=OUTPUT_FILE, metavar="FILE",
    help="Write the distribution of expertise (beta) and influence (theta), for `simulate --population`.",
)  # fmt: skip
@click.option(
    "--family", type=click.Choice(["uniform", "log-uniform", "log-normal", "histogram"]),
    help="Family of the distribution of expertise (beta) over people. The best-fitting parametric one unless given.",
)  # fmt: skip
@click.option(
    "--misconception", "misconceptions", is_flag=True,
    help="Also estimate misconceptions: their size (sigma) and the perceived cost-to-go.",
)  # fmt: skip
@click.option("--terms", is_flag=True, help="Fit preferences besides cost (hierarchical model).")
@click.option(
    "--influence", "trust", type=click.Choice(TRUST),
    help="Estimate influence (theta) under this trust rule, carried from episode to episode (hierarchical model).",
)  # fmt: skip
@advice_options
@figures_option
@domain_option
@goals_option
@reading_options
@setting_options(EstimateSetting)
@json_option
def fit(
    instance: str | None, domain: str | None, file: Path | None, out: Path | None, population: Path | None,
    family: str | None, figures: Path | None, misconceptions: bool, terms: bool, as_json: bool,
    trust: str | None, advice: Path | None, rows: tuple[str, ...], problems: tuple[str, ...], setting: EstimateSetting,
    given: Given[EstimateSetting], **options: Any,
) -> None:  # fmt: skip
    """Estimate people's expertise, influence and trust from a LOG of their actions.

    LOG has one line of JSON for each action: {"person": "...", "episode": "...", "step": 0, "action": "(name arg ...)",
    "suggestion": "(...)" or null}. A CSV file with these columns is accepted too. --advice takes the place of both.
    """
    from ..drawing.plots import style

    if family and as_json and not population:
        raise click.UsageError("--family: expected --write-population, since with --json it has no effect otherwise")
    kinds = {
        "--goals": problems, "--misconception": misconceptions, "--terms": terms, "chooses": setting.chooses,
        "--influence": trust,
    }  # fmt: skip
    apart(kinds)
    for name in ("--goals", "chooses", "--influence"):
        if kinds[name]:
            given.refuse(["seed"], f"with {name}")
    for name, value in {"--family": family, "--figures": figures}.items():
        apart({name: value, "--influence": trust})
    if trust not in (None, "paper"):
        given.refuse(RATES, f"with --influence {trust}")
    if not trust:
        given.refuse(["theta_per_episode"], "without --influence")
    if advice and not trust:
        raise click.UsageError("--advice: expected --influence as well")
    with one_line_errors("interrupted; nothing was estimated"):
        judgements = advice_of(advice, rows, setting, given, {"trust"})
        if judgements is not None and trust is not None:
            separate_files({"--out": out}, {"--advice": advice})
            show_advice(judgements, str(advice), trust, out, as_json=as_json)
            return
    if instance is None or file is None:
        raise click.UsageError("expected INSTANCE and LOG, or --advice")
    if population and setting.chooses:
        raise click.UsageError(
            "--write-population and chooses: a population file has no functions; expected one of them"
        )
    apart({"--family": family, "--terms": terms})
    apart({"--goals": problems, "--figures": figures})
    if not problems:
        given.refuse(["goal_prior"], "without --goals")
    reading, method = ReadingOptions.of(setting, options), method_of(setting)
    with one_line_errors("interrupted; states evaluated on demand are saved"):
        found = one_instance(instance, domain)
        inputs = {"INSTANCE": found.problem, "its domain": found.domain, "LOG": file}
        separate_files({"--out": out, "--write-population": population}, inputs)
        if figures:
            style.require()
        chooses = choice_model_of(setting.chooses)
        if problems:
            seen = with_goals([instance, *problems], file, reading, domain=domain, prior=setting.goal_prior or None)
        else:
            seen = with_task(found, file, reading, table=chooses is not None)
        if trust:
            complete = show_influence(
                seen, trust, method, not setting.theta_per_episode, out, population, as_json=as_json
            )
        else:
            model: Model | None = chooses
            if misconceptions or terms:
                model = "misconceptions" if misconceptions else "terms"
            estimates = learned(seen, method, model, setting.seed, reading.jobs)
            complete = show_people(estimates, out, population, family, figures, as_json=as_json)
    if not complete:
        sys.exit(ExitCode.FAILED)
