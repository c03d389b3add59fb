"""Which trust rule predicts best whether people take advice, held out by person, on public data.

    KITASSIST_ADVICE=FOLDER python bench/trust.py [--fixed] [--record FILE]

The folder holds `cards.csv` and `dates.csv` (docs/results/trust.md names their sources). Each rule is fitted to the
people of seven folds and predicts the answers of the eighth, as `kitassist compare rules --advice` does.
With `--fixed` nothing is fitted: the parameters of all rules of logs are those of `reference/fixed_parameters.csv` in
the folder, and the command says by how much its figures differ.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from advice_rules import RULES, model_of
from tables import cell, record_option, write_record

from assist.learning.advice_log import AdviceLog, read_advice
from assist.learning.advice_model import BASES
from assist.learning.held_out import compare_rules

VARIABLE = "KITASSIST_ADVICE"
DATA: dict[str, dict[str, Any]] = {
    "cards": {"file": "cards.csv", "confidence": "one", "rows": {"attention_fail": "0"}},
    "dates_fb": {"file": "dates.csv", "rows": {"condition": "feedback"}},
    "dates_none": {"file": "dates.csv", "rows": {"condition": "none"}},
}
ALLOWED = 0.0005
"""Largest difference from the reference, in nats per decision."""
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


@click.command()
@click.option("--fixed", "nothing_fitted", is_flag=True, help="Compare with the reference's fixed parameters.")
@click.option("--data", "names", type=click.Choice(list(DATA)), multiple=True, help="Data to use. All unless given.")
@record_option
def main(nothing_fitted: bool, names: tuple[str, ...], record: Path | None) -> None:
    """Compare trust rules by how well they predict held-out people."""
    folder = os.environ.get(VARIABLE)
    if not folder:
        click.echo(f"nothing is measured: {VARIABLE} does not name the folder with cards.csv and dates.csv", err=True)
        return
    known = {name: log for name, log in logs(Path(folder)).items() if not names or name in names}
    if nothing_fitted:
        largest = fixed(Path(folder), known)
        click.echo(f"largest difference {largest:.5f}")
        if largest > ALLOWED:
            raise SystemExit(f"more than {ALLOWED} nats off")
        return
    rows = []
    for row in rows_of(known):
        rows.append(row)
        click.echo("  ".join(show(row) for show in SHOWN.values()))
    write_record(record, SHOWN, rows)


if __name__ == "__main__":
    main()
