"""The paper's study, reduced to two pools and teams of up to three, including its report.

    python bench/study.py [--pools N] [--humans K] [--people N] [--instance NAME] [--out DIR] [--record FILE] [--check]
    python bench/study.py --of FOLDER [--record FILE]

All conditions of the paper's protocol are run, and the whole report is written. The headline is printed. `--record`
writes the results with the table of the documentation. `--check` compares them with `bench/records/study.json`, which
the default run wrote, so that effects of a change are noticed before it is published. `--of` reads the results of an
unreduced `kitassist study --out FOLDER`.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from tables import Columns, cell, record_option, write_record

from assist.studies import Study, read, run_study
from assist.studies.reports import write_report

RECORD = Path(__file__).resolve().parent / "records" / "study.json"
RELATIVE = 1e-6  # processors differ in the last digits
KEPT = ("headline", "decline", "contrasts", "readings")
EXPECTED = (
    "## Headline",
    "## Which of the claims of the paper hold",
    "## Kinds of people",
    "## Which interpretation fits",
)
SAVED = {"actions, against none": "actions_vs_none", "actions, against reactive": "actions_vs_reactive",
         "interventions, against reactive": "interventions_vs_reactive"}  # fmt: skip
PICTURES = ("team-size", "benefit", "categories", "trade-off", "belief")


def reduced(pools: int, humans: int, people: int, instance: str | None) -> Study:
    """Return the paper's study with fewer pools, smaller teams and fewer people in a pool."""
    study = read("paper", repeats=pools)
    instances = tuple(pair for pair in study.instances if instance in (None, pair[0]))
    names = [name for name, _ in instances]
    conditions = tuple(
        replace(
            condition, humans=tuple(range(1, humans + 1)), instances=tuple(i for i in condition.instances if i in names)
        )
        for condition in study.conditions
    )
    return replace(study, pool=people, conditions=conditions, instances=instances)


def columns(headline: dict[str, Any]) -> Columns:
    """Return the columns of savings on each instance, with intervals; a row contains the name of a saving."""

    def saved(instance: str) -> Callable[[dict[str, Any]], str]:
        figures = headline["instances"][instance]
        return lambda row: "{mean:.1f} ({low:.1f} to {high:.1f})".format(**figures[SAVED[row["saving"]]])

    instances = {f"{instance}.pddl": saved(instance) for instance in headline["instances"]}
    return {"attention switching saves, reduced": cell("saving"), **instances}


def whole(folder: Path, record: Path | None) -> None:
    """Print the headline of a whole study and the paper's figures, and write the record."""
    if not (folder / "summary.json").is_file():
        raise click.UsageError(f"{folder} has no summary.json; expected what `kitassist study --out` has written")
    headline = json.loads((folder / "summary.json").read_text(encoding="utf-8"))["headline"]
    reference = read("paper").reference
    assert reference is not None
    published = dict(reference.headline)
    shown = columns(headline)
    name, *rest = shown
    shown = {name.removesuffix(", reduced"): shown[name], **{key: shown[key] for key in rest}}
    shown["the paper"] = lambda row: f"{published[SAVED[row['saving']]]:g}"
    for saving in SAVED:
        print(*(show({"saving": saving}) for show in shown.values()), sep=" | ")
    commands = ["kitassist study --out results", "python bench/study.py --of results"]
    write_record(record, shown, ({"saving": saving} for saving in SAVED), commands=commands)


def differences(found: Any, recorded: Any, place: str = "") -> Iterator[str]:
    """Yield the places at which two documents differ by more than rounding."""
    if isinstance(found, dict) and isinstance(recorded, dict) and found.keys() == recorded.keys():
        for key in found:
            yield from differences(found[key], recorded[key], f"{place}.{key}".strip("."))
    elif isinstance(found, list) and isinstance(recorded, list) and len(found) == len(recorded):
        for number, pair in enumerate(zip(found, recorded, strict=True)):
            yield from differences(*pair, f"{place}[{number}]")
    elif isinstance(found, float) and isinstance(recorded, float):
        if not math.isclose(found, recorded, rel_tol=RELATIVE, abs_tol=RELATIVE):
            yield f"{place}: {found}; recorded {recorded}"
    elif found != recorded:
        yield f"{place}: {found}; recorded {recorded}"


@click.command()
@click.option("--pools", type=click.IntRange(min=1), default=2, show_default=True)
@click.option("--humans", type=click.IntRange(min=1), default=3, show_default=True, help="The largest team.")
@click.option("--people", type=click.IntRange(min=1), default=4, show_default=True, help="In a pool.")
@click.option("--instance", type=click.Choice(["paper", "paper-fixed"]), help="One of the two.")
@click.option("--jobs", type=click.IntRange(min=1), default=2, show_default=True)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Keep the report.")
@click.option("--of", type=click.Path(path_type=Path), help="Folder of a finished study.")
@record_option
@click.option("--check", is_flag=True, help="Compare the results with the record.")
def main(
    pools: int, humans: int, people: int, instance: str | None, jobs: int, out: Path | None, of: Path | None,
    record: Path | None, check: bool,
) -> None:  # fmt: skip
    """Run the reduced study."""
    if of is not None:
        return whole(of, record)
    study = reduced(pools, humans, people, instance)
    if instance == "paper":  # the readings are of the other instance
        study = replace(study, conditions=tuple(c for c in study.conditions if c.instances))
    with tempfile.TemporaryDirectory(prefix="study-") as scratch:
        folder = out or Path(scratch)
        failed = run_study(study, folder, jobs=jobs)
        if failed:
            sys.exit(f"{len(failed)} cells failed; the first: {failed[0]}")
        summary = write_report(study, folder, jobs=jobs).summary
        text = (folder / "report.md").read_text(encoding="utf-8")
        missing = [part for part in EXPECTED if part not in text]
        missing += [name for name in PICTURES if not (folder / "figures" / f"{name}.svg").is_file()]
    if missing:
        sys.exit(f"the report lacks {', '.join(missing)}")
    for key, found in summary["headline"].items():
        if isinstance(found, dict) and "mean" in found:
            print(f"{key}: {found['mean']:.1f} %")
    found = {name: summary[name] for name in KEPT}
    if record:
        write_record(record, columns(found["headline"]), ({"saving": saving} for saving in SAVED), **found)
    if check:
        recorded = json.loads(RECORD.read_text(encoding="utf-8"))
        wrong = list(differences(found, {name: recorded[name] for name in KEPT}))
        if wrong:
            sys.exit(f"{len(wrong)} figures differ from {RECORD.name}; the first: {wrong[0]}")
        print(f"all figures are those of {RECORD.name}")


if __name__ == "__main__":
    main()
