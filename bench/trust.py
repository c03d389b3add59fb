"""Which trust rule predicts best whether people take advice, held out by person, on public data.

    KITASSIST_ADVICE=FOLDER python bench/trust.py [--fixed | --fitted [--keep FILE]] [--record FILE]

The folder holds `cards.csv` and `dates.csv` (docs/results/trust.md names their sources). Each rule is fitted to the
people of seven folds and predicts the answers of the eighth, as `kitassist compare rules --advice` does.
With `--fixed` nothing is fitted: the parameters are those of `reference/fixed_parameters.csv` in the folder, and the
command says by how much its figures differ. With `--fitted` all rows of `reference/cv_dev.csv` are fitted;
`--keep` continues an earlier run.
Rows that are too far off are fitted again in each fold, by one search from the reference's fit to all people
(`reference/parameters_dev.csv`). That tells two reasons apart: another definition, or another local maximum.
"""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import click
from advice_rules import RULES, model_of
from tables import cell, record_option, write_record

from assist.learning.advice_fit import (
    COMPARED,
    base_of,
    fit_model,
    fit_to,
    fold_of,
    local_maximum,
)
from assist.learning.advice_log import AdviceLog, read_advice
from assist.learning.advice_model import BASES
from assist.learning.advice_rules import Rule
from assist.learning.comparison import compared, ratio
from assist.learning.rule_comparison import compare_rules
from planner.system.files import atomic

VARIABLE = "KITASSIST_ADVICE"
DATA: dict[str, dict[str, Any]] = {
    "cards": {"file": "cards.csv", "confidence": "one", "rows": {"attention_fail": "0"}},
    "dates_fb": {"file": "dates.csv", "rows": {"condition": "feedback"}},
    "dates_none": {"file": "dates.csv", "rows": {"condition": "none"}},
}
SHOWN = {
    "data": cell("data"), "people": cell("people"), "rule": cell("rule"), "nats": cell("nats", ".4f"),
    "se": cell("se", ".4f"), "minus constant": cell("difference", "+.4f"), "its 95 % interval": cell("interval"),
    "p": cell("p"), "p, corrected": cell("corrected"),
}  # fmt: skip


def logs(folder: Path) -> dict[str, AdviceLog]:
    """Return the logs of the folder by name."""
    return {
        name: read_advice(folder / about["file"], **{key: value for key, value in about.items() if key != "file"})
        for name, about in DATA.items()
    }


def fixed(folder: Path, known: dict[str, AdviceLog]) -> float:
    """Print the figures with the reference's parameters; return the largest difference, in nats per decision."""
    largest = 0.0
    with (folder / "reference" / "fixed_parameters.csv").open(newline="") as stream:
        for row in csv.DictReader(stream):
            if row["data"] not in known:
                continue
            rule, log = RULES[row["rule"]], known[row["data"]]
            given = dict(pair.split("=") for pair in filter(None, row["rule_parameters"].split(";")))
            values = [*BASES[row["base"]].values(), *(float(given[name]) for name in rule.parameters)]
            found = -model_of(row["base"], rule, tuple(values)).predictions(log)
            off = max(
                abs(found.mean() - float(row["nats_per_decision"])),
                abs(found[~log.agrees].mean() - float(row["nats_per_disagreement"])),
            )
            largest = max(largest, off)
            click.echo(f"{row['data']:10} {row['base']:2} {rule.name:45} {found.mean():.5f}  off by {off:.5f}")
    return largest


def near_reference(folder: Path, log: AdviceLog, data: str, base: str, rule: str) -> tuple[float, float]:
    """Return the held-out figure at local maxima near the reference's fit to all people, and what they are behind.

    That is the log likelihood of the people of seven folds at the package's fits, minus that at these local maxima,
    in nats, as a sum over folds.
    """
    columns = {"sigma": "ls", "slope": "lsl", "advised": "g_adv"}
    with (folder / "reference" / "parameters_dev.csv").open(newline="") as stream:
        row = next(
            row for row in csv.DictReader(stream) if (row["data"], row["base"], row["rule"]) == (data, base, rule)
        )
    own = model_of(base, RULES[rule])
    positive, unit = ("sigma", *own.rule.positive), own.rule.unit
    read = {name: float(row[columns.get(name, name)]) for name in BASES[base] if row[columns.get(name, name)]}
    read |= {name: float(row[columns.get(name, f"r_{name}")]) for name in own.rule.parameters}
    values = [  # logarithms and logits in the file
        math.exp(number) if name in positive else 1 / (1 + math.exp(-number)) if name in unit else number
        for name, number in ((name, read.get(name, -math.inf)) for name in own.parameters)
    ]
    fold, total, behind = fold_of(log.people), 0.0, 0.0
    for each in range(8):
        training, left_out = log.of(fold != each), log.of(fold == each)
        near, own = local_maximum(model_of(base, own.rule, tuple(values)), training), fit_model(own, training)
        total -= near.log_likelihood(left_out)
        behind += own.log_likelihood(training) - near.log_likelihood(training)
    return total / len(log), behind


def fitted(folder: Path, known: dict[str, AdviceLog], allowed: float, keep: Path | None = None) -> float:
    """Print the held-out figures of every rule in the reference; return the largest difference, in nats per decision.

    Rules that the package does not have are named and skipped. Figures that the file `keep` has are not computed again,
    and each new one is written there.
    """
    largest, done = 0.0, json.loads(keep.read_text(encoding="utf-8")) if keep is not None and keep.exists() else {}
    with (folder / "reference" / "cv_dev.csv").open(newline="") as stream:
        for row in csv.DictReader(stream):
            if row["data"] not in known:
                continue
            log, cell_of = known[row["data"]], "|".join(row[name] for name in ("data", "base", "rule"))
            if cell_of not in done:
                rule = row["rule"]
                if rule == "base rate (agree, disagree)":
                    start = None
                elif rule in RULES:
                    start = model_of(row["base"], RULES[rule])
                else:
                    click.echo(f"{row['data']:10} {row['base']:2} {row['rule']:60} not here")
                    continue
                fits = {rule: partial(fit_to, log, start)}
                found = compared(fits, log.people, log.counts, rule, fold=fold_of(log.people), level=0.95)
                done[cell_of] = found.scores[0].nats_per_choice
                if keep is not None:
                    with atomic(keep) as unfinished:
                        unfinished.write_text(json.dumps(done, indent=1), encoding="utf-8")
            off = done[cell_of] - float(row["nats"])
            largest = max(largest, abs(off))
            click.echo(f"{row['data']:10} {row['base']:2} {row['rule']:60} {done[cell_of]:.4f}  off by {off:+.4f}")
            if abs(off) > allowed and row["rule"] in RULES:
                near, behind = near_reference(folder, log, row["data"], row["base"], row["rule"])
                click.echo(
                    f"{'':14}found from the reference's fit: {near:.4f}, off by {near - float(row['nats']):+.4f}; "
                    f"log likelihood of the fitted people lower by {behind:.2f} nats, summed over folds"
                )
    return largest


def rows_of(known: dict[str, AdviceLog]) -> Iterator[dict[str, Any]]:
    """Yield a row for each data set and rule."""
    for name, log in known.items():
        found = compare_rules(log)
        for score in found.scores:
            low, high = score.interval or (0.0, 0.0)
            yield {
                "data": name, "people": len(found.people), "rule": score.model, "nats": score.nats_per_choice,
                "se": score.stderr, "difference": score.difference or 0.0,
                "interval": "-" if score.interval is None else f"{low:+.4f} to {high:+.4f}",
                "p": "-" if score.p is None else f"{score.p:.2g}",
                "corrected": "-" if score.p_corrected is None else f"{score.p_corrected:.2g}",
            }  # fmt: skip


def elsewhere(known: dict[str, AdviceLog], others: dict[str, AdviceLog], rules: tuple[Rule, ...]) -> None:
    """Print how well rules fitted to the known people predict others."""
    for name, log in others.items():
        base, counts = base_of(log), log.counts
        constant = -fit_model(model_of(base, RULES["none"]), known[name]).log_likelihoods(log)
        for rule in rules:
            found = -fit_model(model_of(base, rule), known[name]).log_likelihoods(log)
            (nats, se), (difference, its_se) = ratio(found, counts), ratio(found - constant, counts)
            click.echo(f"{name:10} {base:2} {rule.name:45} {nats:.4f} ({se:.4f})  {difference:+.4f} ({its_se:.4f})")


@click.command()
@click.option(
    "--others",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Folder with files of the same names, of other people: predict these with rules fitted to all known people.",
)
@click.option("--fixed", "nothing_fitted", is_flag=True, help="Compare with the reference's fixed parameters.")
@click.option("--fitted", "all_fitted", is_flag=True, help="Compare with the reference's held-out figures.")
@click.option(
    "--keep",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Keep the figures of --fitted in this file, and compute those only that it does not have.",
)
@click.option("--data", "names", type=click.Choice(list(DATA)), multiple=True, help="Data to use. All unless given.")
@record_option
def main(
    others: Path | None, nothing_fitted: bool, all_fitted: bool, keep: Path | None, names: tuple[str, ...],
    record: Path | None,
) -> None:  # fmt: skip
    """Compare trust rules by how well they predict held-out people."""
    folder = os.environ.get(VARIABLE)
    if not folder:
        click.echo(f"nothing is measured: {VARIABLE} does not name the folder with cards.csv and dates.csv", err=True)
        return
    known = {name: log for name, log in logs(Path(folder)).items() if not names or name in names}
    for wanted, compare, allowed in (
        (nothing_fitted, fixed, 0.0005), (all_fitted, partial(fitted, allowed=0.0015, keep=keep), 0.0015),
    ):  # fmt: skip
        if wanted:
            largest = compare(Path(folder), known)
            click.echo(f"largest difference {largest:.5f}")
            if largest > allowed:
                raise SystemExit(f"more than {allowed} nats off")
            return
    if others is not None:
        elsewhere(known, logs(others), tuple(rule for rule in COMPARED.values() if rule))
        return
    rows = []
    for row in rows_of(known):
        rows.append(row)
        click.echo("  ".join(show(row) for show in SHOWN.values()))
    write_record(record, SHOWN, rows)


if __name__ == "__main__":
    main()
