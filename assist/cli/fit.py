"""The command `fit`, which estimates people's parameters from a log of their actions."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from .options.common import (
    INPUT_FILE,
    OUTPUT_FILE,
    OUTPUT_FOLDER,
    apart,
    domain_option,
    refuse_unused,
    separate_files,
)
from .options.goals import goal_list_options
from .options.help import command
from .options.log import log_options, people_of, people_with_goals, replayed
from .options.task import one_instance
from .options.trust import Confidence, fit_trust_options, trust_of
from .output.people_estimates import show_comparison, show_people
from .output.trust_estimates import show_advice, show_trust
from .terminal.console import ExitCode, one_line_errors


@command("fit kitting/paper log.csv --out people.jsonl")
@click.argument("instance", metavar="INSTANCE", required=False)
@click.argument("file", metavar="LOG", type=INPUT_FILE, required=False)
@click.option("--out", type=OUTPUT_FILE, help="Write one record per person (JSON Lines).")
@click.option(
    "--population", type=OUTPUT_FILE,
    help="Write the distribution of expertise (beta) and influence (theta), for `simulate --population`.",
)  # fmt: skip
@click.option(
    "--family", type=click.Choice(["uniform", "log-uniform", "log-normal", "histogram"]),
    help="Family of the distribution of expertise (beta) over people. The best-fitting parametric one unless given.",
)  # fmt: skip
@fit_trust_options
@click.option("--figures", type=OUTPUT_FOLDER, help="Folder for figures.")
@domain_option
@goal_list_options
@log_options
@click.option("--json", "as_json", is_flag=True, help="Print the records as one JSON list.")
def fit(
    instance: str | None, domain: str | None, file: Path | None, out: Path | None, population: Path | None,
    family: str | None, figures: Path | None, misconceptions: bool, terms: bool, compare: bool, people: str | None,
    folds: int, seed: int, as_json: bool, trust: str | None, compare_trust: bool, theta_per_episode: bool,
    advice: Path | None, confidence: Confidence, rows: tuple[str, ...], problems: tuple[str, ...],
    goal_prior: tuple[str, ...], **options: Any,
) -> None:  # fmt: skip
    """Estimate people's expertise, influence and trust from a LOG of their actions.

    LOG has one line of JSON for each action: {"person": "...", "episode": "...", "step": 0, "action": "(name arg ...)",
    "suggestion": "(...)" or null}. A CSV file with these columns is accepted too. --advice takes the place of both.
    """
    from ..plots import style

    if family and as_json and not population:
        raise click.UsageError("--family: expected --population, since with --json it has no effect otherwise")
    by_rule = trust_of(trust, compare_trust, theta_per_episode, advice, confidence, rows)
    if not compare and not compare_trust:
        refuse_unused(["folds"], "without --compare or --compare-trust")
    if compare:
        refuse_unused(["level", "seed"], "with --compare")
    for name, without in {"--goals": problems, "--people": people}.items():
        if without:
            refuse_unused(["seed"], f"with {name}")
    kinds = {
        "--goals": problems,
        "--misconception": misconceptions,
        "--terms": terms,
        "--compare": compare,
        "--people": people,
    }
    apart(kinds | by_rule.named)
    for name, given in {"--family": family, "--figures": figures}.items():
        apart({name: given} | by_rule.named)
    apart({"--population": population, "--compare-trust": compare_trust})
    if advice:
        separate_files({"--out": out}, {"--advice": advice})
        with one_line_errors("interrupted; nothing was estimated"):
            show_advice(by_rule, folds, options["level"], out, as_json=as_json)
        return
    if instance is None or file is None:
        raise click.UsageError("expected INSTANCE and LOG, or --advice")
    apart({"--population": population, "--compare": compare})
    if population and people:
        raise click.UsageError("--population and --people: a population file has no functions; expected one of them")
    apart({"--family": family, "--terms": terms, "--compare": compare})
    apart({"--goals": problems, "--figures": figures})
    if goal_prior and not problems:
        raise click.UsageError("--goal-prior: expected --goals, too")
    with one_line_errors("interrupted; states evaluated on demand are saved"):
        found = one_instance(instance, domain)
        inputs = {"INSTANCE": found.problem, "its domain": found.domain, "LOG": file}
        separate_files({"--out": out, "--population": population}, inputs)
        if figures:
            style.require()
        if problems:
            people_found = people_with_goals(
                instance, problems, goal_prior, file, domain=domain, **options,
            )  # fmt: skip
            if not show_people(people_found, out, population, family, figures, as_json=as_json):
                sys.exit(ExitCode.FAILED)
            return
        known = replayed(found, file, **options)
        if by_rule.wanted:
            complete = show_trust(known, by_rule, folds, out, population, as_json=as_json)
        elif compare:
            complete = show_comparison(known, folds, out, figures, as_json=as_json)
        else:
            learned = people_of(
                known, misconceptions=misconceptions, terms=terms, people=people, max_states=options["max_states"],
                seed=seed,
            )  # fmt: skip
            complete = show_people(learned, out, population, family, figures, as_json=as_json)
    if not complete:
        sys.exit(ExitCode.FAILED)
